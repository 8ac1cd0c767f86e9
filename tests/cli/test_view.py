"""``mixseq view``: a viewer that starts and ends, a page that plays on its own, and what is refused."""

from __future__ import annotations

import re
import select
import signal
import socket
import subprocess
import sys
import sysconfig
import time
import webbrowser
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from urllib.request import urlopen

import numpy as np
import pytest

import mixseq
from mixseq.cli import view as module
from mixseq.errors import OutputError
from mixseq.pictures.colours import SceneColours
from mixseq.runtime.parallel import thread_count
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.model import Model
from mixseq.viewer.live import ViewSettings
from mixseq.viewer.live import viewer as live
from mixseq.viewer.session import Save
from tests.cli.conftest import Contents, Run
from tests.viewer.pages import Opened

pytestmark = pytest.mark.slow


MIXSEQ = str(Path(sysconfig.get_path("scripts")) / "mixseq")
PATIENCE = 60.0
"""Seconds until we give up."""


# What is refused ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("view", "Missing argument 'FILES...'.*see mixseq view --help"),
        ("view none.npz", "none.npz.* does not exist"),
        ("view none.h5", "none.h5 does not exist"),
        ("view notes.txt", "notes.txt"),
        ("view cut_model.h5", "cut_model.h5"),
        ("view bar.npz none.usdc", "none.usdc.* does not exist"),
        ("view bar.npz --fps 0", "--fps.*0.0 is not in the range"),
        ("view bar.npz --export new.html --fps 0.1", "a film has 2 to 100,000, change its duration or its frame rate"),
        ("view bar.npz --port 0", "--port.*0 is not in the range"),
        ("view bar.npz --every 2", "--every is about pages; give --export as well"),
        ("view bar.npz --max-error 0.1", "--max-error is about pages; give --export as well"),
        ("view bar.npz --against none.npz", "none.npz.* does not exist"),
        ("view bar.npz --against other.npz", "none of the meshes has .* errors need the same topology"),
        ("view bar.npz --prim /mesh", "none of the files is read with an option 'prim'"),
        ("view bar.usdc --prim /none", "/none"),
        ("view bar.npz --export new.html --port 9000", "--port is about the viewer in a browser; leave it out"),
        ("view bar.npz --export new.html --read-only", "--read-only is about the viewer in a browser"),
        ("view bar.npz --export new.html --host 0.0.0.0", "--host is about the viewer in a browser"),
        ("view bar.npz --export new.html --no-browser", "--no-browser is about the viewer in a browser"),
        ("view bar.npz --export new.html --shading simple", "--shading is about the viewer in a browser"),
        ("view bar.npz --export new.pdf", "new.pdf: pages end in .html"),
        ("view none.npz --export new", "new: pages end in .html"),
        ("view bar.npz --export nowhere/new.html", "nowhere does not exist; make it first"),
        ("view bar.npz --export new.html --every 0", "--every.*0 is not in the range"),
        ("view bar.npz --export new.html --max-error -1", "-1"),
        ("view bar.npz --export new.html --max-error 1e-30", "max_error"),
        ("view none.npz --export new.html", "none.npz.* does not exist"),
        ("view bar.npz --export new.html --against other.npz", "errors need the same topology"),
    ],
)
def test_failure(run: Run, contents: Contents, monkeypatch: pytest.MonkeyPatch, line: str, message: str) -> None:
    monkeypatch.setattr("mixseq.viewer.live.check_viser", lambda: None)
    monkeypatch.setattr(live, "run_viewer", None)  # nothing gets so far
    before = contents()
    result = run(*line.split())
    assert (result.exit_code, result.stdout) == (2, ""), result.output
    assert re.fullmatch(f"mixseq: error: .*{message}.*\n", result.stderr), result.stderr
    assert contents() == before


@pytest.mark.parametrize("against", [False, True])
def test_a_page_never_replaces_a_source(run: Run, contents: Contents, folder: Path, against: bool) -> None:
    (folder / "page.html").symlink_to(folder / "bar.npz")
    before = contents()
    files = ["bar.usdc", "--against", "bar.npz"] if against else ["model.h5", "bar.npz"]
    result = run("view", *files, "--export", "page.html")
    assert (result.exit_code, result.stdout) == (2, "")
    assert "page.html is the source itself and would be lost; give another name" in result.stderr
    assert contents() == before


def test_without_viser(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)  # importing it fails
    result = run("view", "bar.npz", "--no-browser")
    assert (result.exit_code, result.stdout) == (2, "")
    assert re.fullmatch(r"mixseq: error: .*viser.*pip install 'mixseq\[viewer\]'\n", result.stderr)


# Pages ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("files", [["bar.npz"], ["model.h5"], ["bar.npz", "model.h5", "bar.usdc"]])
def test_a_page(run: Run, monkeypatch: pytest.MonkeyPatch, files: list[str]) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)  # which pages do not need
    np.save("numbers.npy", np.arange(77) - 40)
    result = run("view", *files, "--export", "new.html", "--scalar", "numbers.npy")
    assert (result.exit_code, result.stderr) == (0, "")
    between = r"between frames, \S+ of the diagonal from the model"
    said = rf"o vertex is off by more than 0\.001 of the diagonal, \S+ units; {between}: 1e-3 from \S+.*\n"
    lines = [f"{re.escape(file)}: n{said}" for file in files] if len(files) > 1 else [f"n{said}"]
    assert re.fullmatch(r"wrote new\.html \(.*\)\n" + "".join(lines), result.stdout)
    page = Opened(Path("new.html"))
    assert page.text.startswith("<!doctype html>")
    assert [item.description["name"] for item in page.items] == files
    values = page.items[0].description["colourings"][0]
    assert (values["name"], values["low"], values["top"]) == ("values", -40, 36)


def test_a_page_of_a_compressed_model(run: Run) -> None:
    """Its frames are on the page as they are in the file, whatever error the page may have."""
    assert run("encode", "bar.npz", "small.h5", "--max-error", "0.02", "-q").exit_code == 0
    result = run("view", "small.h5", "--export", "new.html", "--max-error", "1e-6")
    assert "no vertex is off by more than 0.02 of the diagonal" in result.stdout
    model, item = mixseq.load("small.h5"), Opened(Path("new.html")).items[0]
    for elapsed in (0.0, 0.2):
        assert np.array_equal(item.model(item.model.start + elapsed), model(model.start + elapsed))


def test_a_page_with_fewer_frames(run: Run) -> None:
    sizes = []
    for options in ((), ("--every", "3")):
        assert run("view", "bar.npz", "--export", "new.html", *options).exit_code == 0
        sizes.append(Path("new.html").stat().st_size)
    assert sizes[1] < sizes[0]


def test_a_page_with_everything_in_one_place(run: Run) -> None:
    pages = []
    for options in ((), ("--overlaid",), ("--follow",)):
        assert run("view", "bar.npz", "model.h5", "--export", "new.html", *options).exit_code == 0
        pages.append(Path("new.html").read_bytes())
    assert len(set(pages)) == 3


def test_a_page_replaces_a_page(run: Run, folder: Path) -> None:
    (folder / "old.html").write_text("somebody's work")
    assert run("view", "bar.npz", "--against", "bar.usdc", "--export", "old.html", "-q").exit_code == 0
    assert "error" in Opened(folder / "old.html").items[0].colours


# The viewer, by what it is told -----------------------------------------------------------------------------


class Room:
    """A viewer that remembers what it was given, and ends at once, as by Ctrl-C."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.unsaved: dict[str, Model] = {}
        self.opened: list[str] = []
        self.ended = False
        self.colours: SceneColours
        self.settings: ViewSettings
        self.save: Save
        monkeypatch.setattr(live, "run_viewer", self._viewer)
        monkeypatch.setattr(webbrowser, "open", self.opened.append)
        monkeypatch.setattr(module, "threading", SimpleNamespace(Event=lambda: self))

    @contextmanager
    def _viewer(self, colours: SceneColours, settings: ViewSettings, save: Any) -> Iterator[Any]:
        self.colours, self.settings, self.save = colours, settings, save
        try:
            yield SimpleNamespace(address="http://127.0.0.1:8080", session=SimpleNamespace(unsaved=self.unsaved))
        finally:
            self.ended = True

    def wait(self) -> None:
        assert not self.ended
        raise KeyboardInterrupt


@pytest.fixture
def room(monkeypatch: pytest.MonkeyPatch) -> Room:
    return Room(monkeypatch)


def test_the_address_is_told(run: Run, room: Room) -> None:
    result = run("view", "model.h5", "--no-browser")
    assert (result.exit_code, result.stderr) == (0, "")
    assert result.stdout == "mixseq view: http://127.0.0.1:8080 (Ctrl-C ends it)\n\n"
    assert room.ended


def test_what_is_shown(run: Run, room: Room) -> None:
    run("view", "bar.npz", "model.h5", "bar.usdc", "--against", "bar_sequence.h5", "--fps", "30", "--no-browser")
    scene = room.colours.scene
    assert [item.name for item in scene.items] == ["bar.npz", "model.h5", "bar.usdc"]
    assert [isinstance(item.motion, Model) for item in scene.items] == [False, True, False]
    assert (scene.fps, "error" in room.colours.names) == (30, True)


def test_defaults(run: Run, room: Room, folder: Path) -> None:
    run("view", "bar.npz", "model.h5", "--no-browser")
    settings = room.settings
    assert (settings.host, settings.port, settings.material) == ("127.0.0.1", None, "standard")
    assert (settings.folder, settings.threads) == (folder, thread_count())
    assert (settings.overlaid, settings.read_only) == (False, False)


@pytest.mark.parametrize(
    ("files", "names"),
    [
        ("a.h5 b.usdc", ["a.h5", "b.usdc"]),
        ("a.h5 old/a.h5", ["a.h5", "old/a.h5"]),
        ("one/a.h5 two/a.h5 b.h5", ["one/a.h5", "two/a.h5", "one/b.h5"]),
        ("a.h5 a.h5", ["1 a.h5", "2 a.h5"]),
    ],
)
def test_files_are_told_apart(files: str, names: list[str]) -> None:
    found = module._names([Path(name) for name in files.split()])
    assert len(set(found)) == len(found)
    assert [name.rpartition("/")[2] for name in found] == [name.rpartition("/")[2] for name in names]


def test_settings(run: Run, room: Room) -> None:
    line = "view bar.npz --host 0.0.0.0 --port 9123 --shading simple --threads 1 --overlaid --read-only --no-browser"
    run(*line.split())
    settings = room.settings
    assert (settings.host, settings.port, settings.material) == ("0.0.0.0", 9123, "toon5")
    assert (settings.threads, settings.overlaid, settings.read_only) == (1, True, True)


@pytest.mark.parametrize(
    ("options", "environment", "opens"),
    [
        (["--browser"], {}, True),
        (["--browser"], {"SSH_CONNECTION": "1"}, True),
        (["--no-browser"], {"DISPLAY": ":0"}, False),
        ([], {"DISPLAY": ":0"}, True),
        ([], {"WAYLAND_DISPLAY": "wayland-0"}, True),
        ([], {"DISPLAY": ":0", "SSH_CONNECTION": "1"}, False),
        ([], {}, False),
    ],
)
def test_a_browser_where_there_is_a_screen(
    run: Run, room: Room, monkeypatch: pytest.MonkeyPatch, options: list[str], environment: dict[str, str], opens: bool
) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SSH_CONNECTION"):
        monkeypatch.delenv(name, raising=False)
        if name in environment:
            monkeypatch.setenv(name, environment[name])
    assert run("view", "bar.npz", *options).exit_code == 0
    assert room.opened == (["http://127.0.0.1:8080"] if opens else [])


def test_edits_that_were_not_saved_are_kept(run: Run, room: Room, bar_model: Model, folder: Path) -> None:
    (folder / "run-unsaved.h5").write_text("of yesterday")
    room.unsaved.update({"walk.h5": bar_model, "old/run.h5": bar_model})
    result = run("view", "model.h5", "--no-browser")
    assert result.exit_code == 0
    assert result.stderr == (
        "mixseq: warning: what was edited of walk.h5 was not saved; it is in walk-unsaved.h5\n"
        "mixseq: warning: what was edited of old/run.h5 was not saved; it is in run-unsaved-2.h5\n"
    )
    for name in ("walk-unsaved.h5", "run-unsaved-2.h5"):
        np.testing.assert_allclose(mixseq.load(folder / name)(0.1), bar_model(0.1), atol=1e-12)
    assert (folder / "run-unsaved.h5").read_text() == "of yesterday"


def test_what_was_edited_is_saved(run: Run, room: Room, bar_model: Model, folder: Path) -> None:
    run("view", "model.h5", "bar.npz", "--no-browser")
    edited = replace(bar_model)
    room.save(folder / "edited.h5", edited, False)
    again = mixseq.load(folder / "edited.h5")
    np.testing.assert_allclose(again(0.1), edited(0.1), atol=1e-12)
    room.save(folder / "edited.usdc", edited, False)
    decoded: MeshSequence = mixseq.read(folder / "edited.usdc")
    np.testing.assert_allclose(decoded.points[2], edited(edited.times[2]), atol=1e-5)
    with pytest.raises(OutputError, match=r"edited\.usdc exists; give another name, or tick Replace"):
        room.save(folder / "edited.usdc", edited, False)
    told = room.save(folder / "edited.usdc", edited, True)
    assert told == f"edited.usdc in {folder}"
    room.save(folder / "edits.toml", '[[edit]]\noperation = "reverse"\n', False)
    assert (folder / "edits.toml").read_text() == '[[edit]]\noperation = "reverse"\n'
    with pytest.raises(OutputError, match=r"edits\.toml exists"):
        room.save(folder / "edits.toml", "", False)
    for source in ("model.h5", "bar.npz"):
        before = (folder / source).read_bytes()
        with pytest.raises(OutputError, match="is the source itself"):
            room.save(folder / source, edited, True)
        assert (folder / source).read_bytes() == before


# The viewer as a process ------------------------------------------------------------------------------------


def free_port() -> int:
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        port: int = server.getsockname()[1]
    return port


def first_line(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    ready, _, _ = select.select([process.stdout], [], [], PATIENCE)
    assert ready, "it said nothing"
    return process.stdout.readline()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("--host 192.0.2.7", "cannot listen at 192.0.2.7:8080: .*; give another --host"),  # of RFC 5737, nobody's
        ("--host nohost.invalid", "cannot listen at nohost.invalid:8080: .*; give another --host"),
        ("--port {taken}", "cannot listen at 127.0.0.1:.*in use; give another --port"),
    ],
)
def test_addresses_that_cannot_be(run: Run, folder: Path, options: str, message: str) -> None:
    pytest.importorskip("viser", reason="the extra viewer is not installed")
    with socket.create_server(("127.0.0.1", 0)) as other:
        line = options.format(taken=other.getsockname()[1])
        result = run("view", "bar.npz", "--no-browser", *line.split())
    assert (result.exit_code, result.stdout) == (2, "")
    assert re.fullmatch(f"mixseq: error: {message}\n", result.stderr), result.stderr


@pytest.mark.usefixtures("interruptible")
def test_it_runs_until_it_is_interrupted(folder: Path) -> None:
    pytest.importorskip("viser", reason="the extra viewer is not installed")
    before = sorted(folder.iterdir())
    command = [MIXSEQ, "view", "model.h5", "bar.npz", "--no-browser", "--port", str(free_port())]
    with subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            found = re.fullmatch(
                r"mixseq view: (http://127\.0\.0\.1:\d+/\?token=[\w-]{43}) \(Ctrl-C ends it\)\n", first_line(process)
            )
            assert found
            with urlopen(found[1], timeout=PATIENCE) as response:
                assert response.status == 200
                assert b"<html" in response.read()
            begin = time.monotonic()
            process.send_signal(signal.SIGINT)
            stdout, stderr = process.communicate(timeout=PATIENCE)
        finally:
            process.kill()
    assert (process.returncode, stdout.strip(), stderr) == (0, "", "")
    assert time.monotonic() - begin < 15.0
    with pytest.raises(OSError, match="refused"):
        urlopen(found[1], timeout=PATIENCE)
    assert sorted(folder.iterdir()) == before
