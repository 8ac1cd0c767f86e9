"""A guard in front of viser's server: only browsers with the token of the viewer, and a few kinds of checked messages.

viser creates its server with ``websockets.asyncio.server.serve``, whose arguments for a request hook and a connection
class are set by replacing that function.
"""

from __future__ import annotations

import http
import logging
import secrets
import socket
import sys
from asyncio import sleep
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from ipaddress import ip_address
from time import monotonic
from typing import Annotated, Any, Protocol
from urllib.parse import parse_qs, urlsplit

import msgspec
import websockets.asyncio.server as sockets
from websockets.exceptions import ConnectionClosed
from websockets.frames import CloseCode

EVERYWHERE = ("0.0.0.0", "::", "")
"""Hosts that mean all addresses of a machine."""

CLOSED = "This is a viewer of mixseq. Open the address that it printed, with its token."
"""Message without the token, for any refusal."""


class Headers(Protocol):
    """Headers of a request, with repetitions."""

    def get_all(self, key: str) -> list[str]:
        """Return all values of a header."""


@dataclass
class Access:
    """Decides which requests a viewer answers.

    Other pages in the same browser can send requests, with cookies if they are on the same host. They lack the token,
    its cookie is ``SameSite=Strict``, and the browser sends their ``Origin``. Pages whose name resolves to this machine
    (DNS rebinding) are recognised by that name (``Host``).
    """

    host: str
    port: int = 0
    token: str = field(default_factory=lambda: secrets.token_urlsafe(32), repr=False)

    @property
    def address(self) -> str:
        """Address of the viewer for a browser, with the token."""
        name = "127.0.0.1" if self.host in EVERYWHERE else self.host
        return f"http://{_bracketed(name)}:{self.port}/?token={self.token}"

    @property
    def cookie(self) -> str:
        """Cookie with the token."""
        return f"{self._cookie_name}={self.token}; Path=/; HttpOnly; SameSite=Strict"

    def refusal(self, path: str, headers: Headers) -> str | None:
        """Return the reason for refusing a request, None if it is allowed."""
        hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
        if len(hosts) != 1 or not self._is_ours(hosts[0].lower()):
            return "a name that is not this machine's"
        if any(origin.lower() != f"http://{hosts[0].lower()}" for origin in origins):
            return "a page from elsewhere"
        if not (self.brings_token(path) or any(map(self._is_token, self._cookies(headers)))):
            return "no token, or a wrong one"
        return None

    def brings_token(self, path: str) -> bool:
        """Whether the token is in the query of a path."""
        try:
            return any(map(self._is_token, parse_qs(urlsplit(path).query).get("token", [])))
        except ValueError:  # too many fields, or no address at all
            return False

    @property
    def _cookie_name(self) -> str:
        """Name with the port, as all ports of a host share cookies."""
        return f"mixseq-{self.port}"

    def _cookies(self, headers: Headers) -> list[str]:
        pairs = (each.partition("=") for line in headers.get_all("Cookie") for each in line.split(";"))
        return [value.strip() for name, _, value in pairs if name.strip() == self._cookie_name]

    def _is_token(self, given: str) -> bool:
        return secrets.compare_digest(given.encode(errors="replace"), self.token.encode())

    def _is_ours(self, given: str) -> bool:
        """Whether a host, as a browser writes it, is one of this machine's names, with the port."""
        name, found, port = given.rpartition(":")
        if not found or port.endswith("]"):  # a browser leaves the usual port out
            name, port = given, "80"
        if port != str(self.port):
            return False
        if name in ("localhost", "127.0.0.1", "[::1]", _bracketed(self.host.lower())):
            return True
        # names can be made to mean any machine, numbers cannot
        return self.host in EVERYWHERE and (name == socket.gethostname().lower() or _is_number(name))


def _bracketed(host: str) -> str:
    return f"[{host}]" if ":" in host else host


def _is_number(name: str) -> bool:
    try:
        ip_address(name.removeprefix("[").removesuffix("]"))
    except ValueError:
        return False
    return True


LARGEST = 2**20
"""Largest message, in bytes; a stroke of the pen has some 200,000."""

Number = Annotated[float, msgspec.Meta(ge=-1e15, le=1e15)]
Pixels = Annotated[float, msgspec.Meta(ge=1, le=1e6)]
Text = Annotated[str, msgspec.Meta(max_length=200)]
Pair = tuple[Number, Number]
Triple = tuple[Number, Number, Number]
Value = bool | Number | str | Annotated[list[Number], msgspec.Meta(max_length=16)]


class Said(msgspec.Struct, tag_field="type", forbid_unknown_fields=True):
    """A message of a page; viser's other kinds (uploads, tunnels, images) are rejected."""


class Camera(Said, tag="ViewerCameraMessage"):
    """The view of the scene."""

    wxyz: tuple[Number, Number, Number, Number]
    position: Triple
    fov: Number
    near: Number
    far: Number
    image_height: Pixels
    image_width: Pixels
    look_at: Triple
    up_direction: Triple


class Click(Said, tag="SceneNodeClickMessage"):
    """A mesh was clicked."""

    name: Text
    instance_index: int | None
    ray_origin: Triple
    ray_direction: Triple
    screen_pos: Pair
    modifier: Text | None = None
    owner: Text = ""


class Command(Said, tag="CommandTriggerMessage"):
    """A key was pressed."""

    uuid: Text


class NewValue(msgspec.Struct, forbid_unknown_fields=True):
    """The new value of a control, without other properties."""

    value: Value


class Change(Said, tag="GuiUpdateMessage"):
    """A control was used."""

    uuid: Text
    updates: NewValue


_DECODER = msgspec.msgpack.Decoder(Camera | Click | Command | Change)
_ENCODER = msgspec.msgpack.Encoder()


def checked_message(raw: bytes | str, controls: Mapping[str, Any]) -> bytes | None:
    """Validate a message and encode it for viser; None to ignore it, ValueError if it is bad."""
    if isinstance(raw, str):
        raise ValueError("text, where bytes are expected")
    try:
        said = _DECODER.decode(raw)
    except (msgspec.DecodeError, RecursionError, UnicodeDecodeError) as error:
        raise ValueError(str(error)) from None
    if isinstance(said, Change):
        if said.uuid not in controls:
            raise ValueError("there is no such control")
        state = controls[said.uuid]._impl
        _check_kind(said.updates.value, state.value, getattr(state.props, "options", None))
        if not _in_range(said.updates.value, state.props):
            return None
    return _ENCODER.encode(said)


def _check_kind(value: Any, before: Any, options: Any) -> None:
    """Raise ValueError for a value of a wrong type for a control."""
    if isinstance(before, bool):
        fits = isinstance(value, bool)
    elif isinstance(before, int | float):
        fits = isinstance(value, float)
    elif isinstance(before, tuple):
        fits = isinstance(value, list) and len(value) == len(before)
    else:
        fits = isinstance(before, str) and isinstance(value, str)
    if not fits:
        raise ValueError("a control cannot have this kind of value")
    if options is not None and value not in options:
        raise ValueError("a control has no such option")


def _in_range(value: Any, props: Any) -> bool:
    low, high = getattr(props, "min", None), getattr(props, "max", None)
    if isinstance(value, str | bool):
        return True
    numbers = value if isinstance(value, list) else [value]
    slack = 1e-9 * max(1.0, *map(abs, numbers)) if numbers else 0.0
    return all(
        (low is None or each >= low - slack) and (high is None or each <= high + slack) for each in numbers
    )


@dataclass
class Rate:
    """A token bucket: events per second, and in a burst."""

    persecond: float
    atonce: float
    _left: float = field(init=False)
    _when: float = field(init=False)

    def __post_init__(self) -> None:
        self._left, self._when = self.atonce, monotonic()

    def wait(self) -> float:
        """Count an event, and return the seconds by which it is early."""
        now = monotonic()
        self._left = min(self.atonce, self._left + (now - self._when) * self.persecond) - 1
        self._when = now
        return max(0.0, -self._left / self.persecond)

    def spare(self) -> bool:
        """Whether another event is allowed; only then it is counted."""
        if self.wait() > 0:
            self._left += 1
            return False
        return True


FAST = 1000.0, 2000.0
"""Messages of a page per second, and in a burst; more are delayed. At 144 Hz a page sends some 400."""

BAD = 1.0, 20.0
"""Bad messages of a page per second, and in a burst; more close the connection."""

MOST = 256
"""Largest number of websockets; a page has one."""

LINES = 0.5, 20.0
"""Lines on the terminal per second, and in a burst; more are dropped."""

PATIENCE = 1.0
"""Seconds to wait for the other side when closing a connection."""

HEADERS = {
    "Cache-Control": "no-store",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "SAMEORIGIN",
}
"""Headers of every page: no embedding elsewhere, no referrer."""


class Guard:
    """Guards one viser server."""

    def __init__(self, access: Access) -> None:
        self.access = access
        self.controls: Mapping[str, Any] = {}
        self._lines = Rate(*LINES)
        self._refusals: set[str] = set()
        self.connected = 0
        self._log = logging.Logger("mixseq.viewer")  # nobody else's
        self._log.addHandler(logging.NullHandler())

    def tell(self, text: str) -> None:
        """Print a line about a refusal, within the rate `LINES`."""
        if self._lines.spare():
            line = "".join(each if each.isprintable() else "?" for each in text[:200])
            print(f"mixseq: viewer: {line}", file=sys.stderr, flush=True)

    @contextmanager
    def posted(self) -> Iterator[None]:
        """Guard the server that is started in the block."""
        usual, started = sockets.serve, []

        def serve(handler: Any, host: str, port: int, **settings: Any) -> Any:
            started.append(port)
            self.access.port = port
            settings |= {
                "process_request": partial(self._answer, settings["process_request"]),
                "create_connection": partial(_Connection, self),
                "max_size": LARGEST,
                "close_timeout": PATIENCE,
                "logger": self._log,
            }
            return usual(handler, host, port, **settings)

        sockets.serve = serve  # type: ignore[misc, assignment]
        try:
            yield
        finally:
            sockets.serve = usual  # type: ignore[misc]
        if not started:
            raise RuntimeError("this version of viser cannot be guarded")

    def unhook(self, server: Any) -> None:
        """Remove viser's handlers of public tunnels and uploads, and get its controls."""
        from viser import _messages as kinds

        for kind in (
            kinds.ShareUrlRequest,
            kinds.ShareUrlDisconnect,
            kinds.FileTransferStartUpload,
            kinds.FileTransferPart,
        ):
            server._websock_server.unregister_handler(kind)
        self.controls = server.gui._gui_input_handle_from_uuid

    def _answer(self, pages: Callable[..., Any], connection: Any, request: Any) -> Any:
        """Answer a request, or accept a websocket."""
        why = self.access.refusal(request.path, request.headers)
        if why is not None:
            if why not in self._refusals:  # a page of an earlier viewer asks again and again
                self._refusals.add(why)
                self.tell(f"a request was refused: {why}; further ones are not told")
            response = connection.respond(http.HTTPStatus.FORBIDDEN, f"{CLOSED}\n")
        else:
            response = pages(connection, request) or self._connected(connection)
        if response is not None:
            for name, value in HEADERS.items():
                response.headers[name] = value
            if why is None and self.access.brings_token(request.path):
                response.headers["Set-Cookie"] = self.access.cookie
        return response

    def _connected(self, connection: Any) -> Any:
        """Count a websocket, or refuse it."""
        if self.connected >= MOST:
            self.tell(f"a page was refused: there are {MOST} already")
            return connection.respond(http.HTTPStatus.SERVICE_UNAVAILABLE, "Too many pages are open.\n")
        self.connected += 1
        connection.counted = True
        return None


class _Connection(sockets.ServerConnection):
    """A connection that passes only allowed messages."""

    def __init__(self, guard: Guard, *args: Any, **settings: Any) -> None:
        super().__init__(*args, **settings)
        self._guard = guard
        self._fast, self._bad = Rate(*FAST), Rate(*BAD)
        self.counted = False

    def connection_lost(self, exc: Exception | None) -> None:
        """Free the place of the connection."""
        super().connection_lost(exc)
        if self.counted:
            self.counted = False
            self._guard.connected -= 1

    async def recv(self, decode: bool | None = None) -> Any:
        """Return the next valid message."""
        while True:
            try:
                raw = await super().recv(decode)
            except ConnectionClosed as closed:
                if closed.sent is not None and closed.sent.code == CloseCode.MESSAGE_TOO_BIG:
                    self._guard.tell(f"a page was cut off: its message is larger than {LARGEST} bytes")
                raise
            await sleep(self._fast.wait())  # what is not read, the page has to keep
            try:
                message = checked_message(raw, self._guard.controls)
            except ValueError as error:
                self._guard.tell(f"a message was left out: {error}")
                if not self._bad.spare():
                    self._guard.tell("a page was cut off: many bad messages")
                    await self.close(CloseCode.POLICY_VIOLATION, "many bad messages")
                    raise self.protocol.close_exc from None  # and what came after them is not read
                continue
            if message is not None:
                return message
