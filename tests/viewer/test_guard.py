"""What a viewer does with requests and messages that no page of its own sends, over real sockets."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack
from http.client import HTTPConnection, HTTPResponse
from pathlib import Path
from typing import Any

import pytest

import mixseq
from mixseq.pictures.colours import SceneColours
from mixseq.pictures.scene import Scene, SceneItem
from mixseq.signals.model import Model
from tests.meshes import coarse_walk
from tests.viewer.pages import eventually

pytest.importorskip("viser", reason="the extra viewer is not installed")

import msgspec
import viser
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect
from websockets.sync.connection import Connection

from mixseq.viewer.live import ViewSettings
from mixseq.viewer.live.controls import _is_file_name
from mixseq.viewer.live.guard import MAX_MESSAGE_BYTES, Guard, RateLimit
from mixseq.viewer.live.viewer import Viewer, run_viewer

pytestmark = pytest.mark.slow

CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": (1.0, 0.0, 0.0, 0.0),
    "position": (0.0, 0.0, 3.0),
    "fov": 1.0,
    "near": 0.1,
    "far": 100.0,
    "image_height": 600,
    "image_width": 800,
    "look_at": (0.0, 0.0, 0.0),
    "up_direction": (0.0, 1.0, 0.0),
}


DRAG = {
    "type": "SceneNodeDragMessage",
    "phase": "start",
    "name": "/mesh/0",
    "instance_index": None,
    "start_position": (0.0, 0.0, 0.0),
    "start_screen_pos": (0.5, 0.5),
    "end_position": (0.0, 0.0, 0.0),
    "end_screen_pos": (0.5, 0.5),
    "button": "left",
    "modifier": None,
    "owner": "",
}


@pytest.fixture(scope="module")
def model() -> Model:
    return mixseq.fit(coarse_walk(8), rank=3)


def save(path: Path, model: Any, replace: bool) -> str:
    mixseq.save(path, model)
    return path.name


@pytest.fixture
def running(model: Model, tmp_path: Path) -> Iterator[Viewer]:
    settings = ViewSettings(folder=tmp_path, threads=1)
    with run_viewer(SceneColours(Scene((SceneItem("fox.h5", model),))), settings, save) as started:
        yield started


class Page:
    """The address of a viewer, taken apart, and what a browser can do with it; or somebody who is none."""

    def __init__(self, running: Viewer) -> None:
        self.origin, _, query = running.address.partition("/?")
        self.host = self.origin.removeprefix("http://")
        self.port = int(self.host.rpartition(":")[2])
        self.token = query.removeprefix("token=")
        self.cookie = f"mixseq-{self.port}={self.token}"
        self._running = running

    def get(self, path: str, **headers: str) -> HTTPResponse:
        connection = HTTPConnection("127.0.0.1", self.port, timeout=30)
        connection.request("GET", path, headers=headers)
        response = connection.getresponse()
        response.read()
        connection.close()
        return response

    def open(self, cookie: str | None = None, origin: str | None = "", host: str = "") -> Connection:
        """Open a websocket, as our page does unless something else is given."""
        given = self.cookie if cookie is None else cookie
        return connect(
            f"ws://{host or self.host}/",
            sock=socket.create_connection(("127.0.0.1", self.port)),
            origin=self.origin if origin == "" else origin,  # type: ignore[arg-type]
            additional_headers={"Cookie": given} if given else {},
            subprotocols=[f"viser-v{viser.__version__}"],  # type: ignore[list-item]
            compression=None,
            max_size=None,
            close_timeout=1,
        )

    def control(self, label: str) -> Any:
        """A control of the panel, as Python has it."""
        controls = self._running._server.gui._gui_input_handle_from_uuid.values()
        return next(each for each in controls if getattr(each, "label", None) == label)


@pytest.fixture
def page(running: Viewer) -> Page:
    return Page(running)


def packed(type_: str, **fields: Any) -> bytes:
    return msgspec.msgpack.encode({"type": type_, **fields})


def change(control: Any, **updates: Any) -> bytes:
    return packed("GuiUpdateMessage", uuid=control._impl.uuid, updates=updates)


def check_it_hears(page: Page, line: Connection) -> None:
    """Tick a box over a connection."""
    box = page.control("Wireframe")
    wanted = not box.value
    line.send(change(box, value=wanted))
    eventually(lambda: box.value == wanted)


def test_a_path_that_is_too_long_for_a_file_is_not_found(page: Page) -> None:
    assert page.get("/" + 7000 * "a", Cookie=page.cookie).status == 404
    assert page.get("/", Cookie=page.cookie).status == 200


# Who is let in --------------------------------------------------------------------------------------------


def test_the_first_visit_brings_a_cookie(page: Page) -> None:
    first = page.get(f"/?token={page.token}")
    assert first.status == 200
    cookie = first.headers["Set-Cookie"]
    assert cookie == f"{page.cookie}; Path=/; HttpOnly; SameSite=Strict"
    assert first.headers["Referrer-Policy"] == "no-referrer"
    assert first.headers["X-Frame-Options"] == "SAMEORIGIN"
    later = page.get("/", Cookie=page.cookie)
    assert (later.status, later.headers["Set-Cookie"]) == (200, None)


@pytest.mark.parametrize("path", ["/", "/?token=", "/?token=wrong", "/index.html", "/../x", "/?a=%ff"])
def test_pages_are_for_those_with_the_token(page: Page, path: str) -> None:
    response = page.get(path)
    assert (response.status, response.headers["Set-Cookie"]) == (403, None)


def test_pages_are_not_for_other_names(page: Page) -> None:
    path = f"/?token={page.token}"
    assert page.get(path, Host=f"evil.example:{page.port}").status == 403
    assert page.get(path, Host=f"localhost:{page.port}").status == 200


@pytest.mark.parametrize(
    "given",
    [
        {"origin": "https://evil.example"},
        {"origin": "null"},
        {"origin": "http://127.0.0.1:1"},
        {"host": "evil.example:{port}"},
        {"host": "evil.example:{port}", "origin": "http://evil.example:{port}"},
        {"cookie": "other=1"},
        {"cookie": "mixseq-{port}=wrong"},
        {"cookie": "mixseq-1={token}"},
    ],
)
def test_websockets_are_for_our_own_pages(page: Page, given: dict[str, str], capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(InvalidStatus) as refused:
        page.open(**{name: each.format(port=page.port, token=page.token) for name, each in given.items()})
    assert refused.value.response.status_code == 403
    lines = capfd.readouterr().err.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("mixseq: viewer: refused a request: ")
    assert page.token not in lines[0]


def test_a_page_of_an_earlier_viewer_is_told_once(page: Page, capfd: pytest.CaptureFixture[str]) -> None:
    for _ in range(30):
        assert page.get("/", Cookie=f"mixseq-{page.port}=old").status == 403
    assert len(capfd.readouterr().err.splitlines()) == 1


def test_our_own_page_is_let_in(page: Page) -> None:
    with page.open() as line:
        assert line.recv(timeout=30)
        line.send(msgspec.msgpack.encode(CAMERA))
        check_it_hears(page, line)


def test_noise_that_is_no_request(page: Page, capfd: pytest.CaptureFixture[str]) -> None:
    for noise in (b"", b"\r\n\r\n", b"\xff" * 5000, b"GET / HTTP/1.1\r\nHost: a\r\nHost: b\r\n\r\n"):
        with socket.create_connection(("127.0.0.1", page.port)) as line:
            line.sendall(noise)
    with page.open() as ours:
        check_it_hears(page, ours)
    assert "Traceback" not in capfd.readouterr().err


def test_another_viser_is_not_run_without_a_guard() -> None:
    from mixseq.viewer.live.guard import Access

    with pytest.raises(RuntimeError, match="cannot be guarded"), Guard(Access("127.0.0.1")).guard_new_server():
        pass


# What is heard --------------------------------------------------------------------------------------------


def test_no_tunnel_can_be_asked_for(
    running: Viewer, page: Page, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    asked: list[str] = []
    monkeypatch.setattr(running._server, "request_share_url", lambda *_: asked.append("tunnel"))
    with page.open() as line:
        line.send(packed("ShareUrlRequest"))
        line.send(packed("ShareUrlDisconnect"))
        check_it_hears(page, line)
    assert not asked
    assert len(capfd.readouterr().err.splitlines()) == 2
    handled = {kind.__name__ for kind in running._server._websock_server._incoming_handlers}
    assert not {each for each in handled if "Share" in each or "FileTransfer" in each}


def test_no_uploads(running: Viewer, page: Page, capfd: pytest.CaptureFixture[str]) -> None:
    start = {"transfer_uuid": "t", "filename": "a", "mime_type": "b", "part_count": 1, "size_bytes": 9}
    with page.open() as line:
        uuid = page.control("Wireframe")._impl.uuid
        line.send(packed("FileTransferStartUpload", source_component_uuid=uuid, **start))
        part = {"transfer_uuid": "t", "part_index": 0, "content": bytes(9), "source_component_uuid": uuid}
        line.send(packed("FileTransferPart", **part))
        check_it_hears(page, line)
    assert not running._server.gui._current_file_upload_states
    assert len(capfd.readouterr().err.splitlines()) == 2


@pytest.mark.parametrize(
    "updates",
    [{"removed": True}, {"value": True, "removed": True}, {"update_cb": []}, {"props": {}}, {"is_button": True}, {}],
)
def test_only_values_of_controls_change(page: Page, updates: dict[str, Any], capfd: pytest.CaptureFixture[str]) -> None:
    with page.open() as line:
        line.send(change(page.control("Wireframe"), **updates))
        check_it_hears(page, line)
    assert len(capfd.readouterr().err.splitlines()) == 1


@pytest.mark.parametrize(
    ("label", "value"),
    [
        ("Pen", 1.0),
        ("Pen", "yes"),
        ("Gain", "1"),
        ("Gain", float("nan")),
        ("Gain", float("inf")),
        ("Gain", [1, 2]),
        ("Gain", {"a": 1}),
        ("Gain", None),
        ("Speed", "3"),
        ("Speed", 1.0),
        ("Colour", "none such"),
        ("File", 3),
        ("File", b"bytes"),
    ],
)
def test_values_that_a_control_cannot_have(
    page: Page, label: str, value: Any, capfd: pytest.CaptureFixture[str]
) -> None:
    control = page.control(label)
    before = control.value
    with page.open() as line:
        line.send(change(control, value=value))
        check_it_hears(page, line)
    assert control.value == before
    lines = capfd.readouterr().err.splitlines()
    assert len(lines) == 1, lines
    assert lines[0].startswith("mixseq: viewer: ignored a message: ")


def test_numbers_out_of_range_may_be_half_typed(page: Page, capfd: pytest.CaptureFixture[str]) -> None:
    times = page.control("Times")
    with page.open() as line:
        for value in (0, 101, -1e300, 10**9):
            line.send(change(times, value=value))
        line.send(change(times, value=3))
        eventually(lambda: times.value == 3)
    assert len(capfd.readouterr().err.splitlines()) == 1  # that of no number at all


GARBAGE: list[str | bytes] = [
    b"",
    b"\x00",
    b"\xc1" * 100,
    b"\x91" * 100_000,
    b"not msgpack",
    "text",
    msgspec.msgpack.encode([1, 2]),
    msgspec.msgpack.encode({"type": 3}),
    packed("NoSuchMessage"),
    packed("\x1b[2J"),
    packed("GuiUpdateMessage"),
    packed("GuiUpdateMessage", uuid="none", updates={"value": 1}),
    packed("GuiUpdateMessage", uuid=["none"], updates={"value": 1}),
    packed("CommandTriggerMessage", uuid="x" * 1000),
    msgspec.msgpack.encode({**CAMERA, "image_height": 0}),
    msgspec.msgpack.encode({**CAMERA, "position": (0.0, 1.0)}),
    msgspec.msgpack.encode({**CAMERA, "position": (0.0, 1.0, float("nan"))}),
    msgspec.msgpack.encode({**CAMERA, "extra\x1b[2J": 1}),
    msgspec.msgpack.encode({**DRAG, "button": "right"}),
]


def test_garbage_is_a_line_each(page: Page, capfd: pytest.CaptureFixture[str]) -> None:
    with page.open() as line:
        for each in GARBAGE:
            line.send(each)
        check_it_hears(page, line)
    err = capfd.readouterr().err
    assert len(err.splitlines()) == len(GARBAGE), err
    assert all(each.startswith("mixseq: viewer: ignored a message: ") for each in err.splitlines())
    assert err.replace("\n", "").isprintable()


def test_many_bad_messages_end_a_connection(page: Page, capfd: pytest.CaptureFixture[str]) -> None:
    with page.open() as line, page.open() as other:
        with pytest.raises(ConnectionClosed) as closed:
            for _ in range(2000):
                line.send(b"garbage")
            while True:
                line.recv(timeout=30)
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 1008
        check_it_hears(page, other)
    assert 20 <= len(capfd.readouterr().err.splitlines()) <= 23


def test_too_large_messages_end_a_connection(page: Page, capfd: pytest.CaptureFixture[str]) -> None:
    with page.open() as line, page.open() as other:
        line.send(change(page.control("File"), value="x" * (MAX_MESSAGE_BYTES + 1)))
        with pytest.raises(ConnectionClosed) as closed:
            while True:
                line.recv(timeout=30)
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 1009
        check_it_hears(page, other)
    assert len(capfd.readouterr().err.splitlines()) == 1


def test_a_flood_is_slowed_down(running: Viewer, page: Page, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mixseq.viewer.live.guard.MESSAGE_RATE", (100.0, 10.0))
    box = page.control("Wireframe")
    seen: list[bool] = []
    box.on_update(lambda _: seen.append(box.value))
    with page.open() as line:
        line.send(msgspec.msgpack.encode(CAMERA))
        begin = time.monotonic()
        for number in range(110):
            line.send(change(box, value=number % 2 == 0))
        eventually(lambda: len(seen) == 110)
        assert time.monotonic() - begin > 0.9


def test_two_hundred_pages_and_one_that_never_reads(running: Viewer, page: Page) -> None:
    with ExitStack() as stack:
        lines = [stack.enter_context(page.open()) for _ in range(200)]
        lines[0].send(msgspec.msgpack.encode(CAMERA))
        group = next(
            each
            for each in running._server.gui._gui_input_handle_from_uuid.values()
            if "Reverse" in getattr(each, "options", ())
        )
        lines[1].send(msgspec.msgpack.encode(CAMERA))
        lines[1].send(change(group, value="Reverse"))
        eventually(lambda: running.session.history.current.name == "reverse")
        lines[1].send(change(page.control("File"), value="many.h5"))
        eventually(lambda: page.control("File").value == "many.h5")


def test_more_pages_than_there_is_room_for(
    page: Page, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("mixseq.viewer.live.guard.MAX_CONNECTIONS", 2)
    with page.open() as first:
        with page.open():
            with pytest.raises(InvalidStatus) as refused:
                page.open()
            assert refused.value.response.status_code == 503
            assert page.get("/", Cookie=page.cookie).status == 200  # which takes no room
        eventually(lambda: len(page._running._server.get_clients()) <= 1)
        with page.open() as third:
            check_it_hears(page, third)
        check_it_hears(page, first)
    assert "2 are open already" in capfd.readouterr().err


def test_read_only(model: Model, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    settings = ViewSettings(folder=tmp_path, threads=1, read_only=True)
    with run_viewer(SceneColours(Scene((SceneItem("fox.h5", model),))), settings, save) as running:
        page = Page(running)
        controls = running._server.gui._gui_input_handle_from_uuid.values()
        labels = {getattr(each, "label", None) for each in controls}
        assert not labels & {"Save", "File", "Replace", "Steps", "Pen", "Gain", "Part"}
        assert labels >= {"Speed", "Frames/s", "Wireframe", "mixseq"}
        with page.open() as line:
            line.send(msgspec.msgpack.encode(CAMERA))
            for said in ('{"kind": "retime", "keys": [[0, 0.1], [1, 0.2]], "done": true}', '{"kind": "drawn"}'):
                line.send(change(page.control("mixseq"), value=said))
            check_it_hears(page, line)
        assert running.session.model is model
        assert not running.session.unsaved
    assert not list(tmp_path.iterdir())
    assert not capfd.readouterr().err


# Parts ------------------------------------------------------------------------------------------------------


def test_rates(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 0.0
    monkeypatch.setattr("mixseq.viewer.live.guard.monotonic", lambda: now)
    rate = RateLimit(10.0, 3.0)
    assert [rate.delay() for _ in range(5)] == pytest.approx([0, 0, 0, 0.1, 0.2])
    now = 100.0
    assert [rate.allow() for _ in range(5)] == [True, True, True, False, False]
    now = 100.125
    assert [rate.allow() for _ in range(2)] == [True, False]


@pytest.mark.parametrize(
    ("name", "fits"),
    [
        ("walk.h5", True),
        ("Ein Fuß läuft.usdc", True),
        ("walk_####.obj", True),
        ("", False),
        (".", False),
        ("..", False),
        ("a/b.h5", False),
        ("a\\b.h5", False),
        ("c:a.h5", False),
        ("a\x00.h5", False),
        ("a\n.h5", False),
        ("é" * 300, False),
    ],
)
def test_names_of_files(name: str, fits: bool) -> None:
    assert _is_file_name(name) is fits
