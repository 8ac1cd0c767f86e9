"""Guard viser's server: accept only browsers with the viewer's token, and only valid messages.

viser creates its server with ``websockets.asyncio.server.serve``. While the server starts,
this function is replaced by a wrapper that adds a request hook and a connection class.
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
from typing import Annotated, Any, Literal
from urllib.parse import parse_qs, urlsplit

import msgspec
import websockets.asyncio.server as sockets
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.frames import CloseCode

WILDCARD_HOSTS = ("0.0.0.0", "::", "")
"""Host arguments that mean all addresses of a machine."""


@dataclass
class Access:
    """Access control of a viewer.

    Other pages in the same browser can send requests, with cookies if they are on the same host. Such pages lack the
    token, the token's cookie is ``SameSite=Strict``, and the browser sends the page's ``Origin``. DNS rebinding gives
    this machine an attacker's host name, which is recognised in the header ``Host``.
    """

    host: str
    port: int = 0
    token: str = field(default_factory=lambda: secrets.token_urlsafe(32), repr=False)

    @property
    def address(self) -> str:
        """Address of the viewer for a browser, with the token."""
        name = "127.0.0.1" if self.host in WILDCARD_HOSTS else self.host
        return f"http://{_bracket_ipv6(name)}:{self.port}/?token={self.token}"

    @property
    def cookie(self) -> str:
        """Cookie with the token."""
        return f"{self._cookie_name}={self.token}; Path=/; HttpOnly; SameSite=Strict"

    def refusal(self, path: str, headers: Headers) -> str | None:
        """Return the reason for refusing a request, or None if the request is allowed."""
        hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
        if len(hosts) != 1 or not self._is_own_host(hosts[0].lower()):
            return "its host is not this machine"
        if any(origin.lower() != f"http://{hosts[0].lower()}" for origin in origins):
            return "it comes from another site"
        if not (self.has_token(path) or any(map(self._is_token, self._cookies(headers)))):
            return "its token is missing or wrong"
        return None

    def has_token(self, path: str) -> bool:
        """Whether the query of a path contains the token."""
        try:
            return any(map(self._is_token, parse_qs(urlsplit(path).query).get("token", [])))
        except ValueError:  # too many fields, or not a valid address
            return False

    @property
    def _cookie_name(self) -> str:
        """Name of the cookie; it contains the port, because all ports of a host share cookies."""
        return f"mixseq-{self.port}"

    def _cookies(self, headers: Headers) -> list[str]:
        pairs = (pair.partition("=") for line in headers.get_all("Cookie") for pair in line.split(";"))
        return [value.strip() for name, _, value in pairs if name.strip() == self._cookie_name]

    def _is_token(self, given: str) -> bool:
        return secrets.compare_digest(given.encode(errors="replace"), self.token.encode())

    def _is_own_host(self, given: str) -> bool:
        """Whether a ``Host`` header is a name of this machine, with the port."""
        name, separator, port = given.rpartition(":")
        if not separator or port.endswith("]"):  # browsers omit the default port
            name, port = given, "80"
        if port != str(self.port):
            return False
        if name in ("localhost", "127.0.0.1", "[::1]", _bracket_ipv6(self.host.lower())):
            return True
        # an attacker can make other names resolve to this machine, but cannot do so with IP addresses
        return self.host in WILDCARD_HOSTS and (name == socket.gethostname().lower() or _is_ip_address(name))


def _bracket_ipv6(host: str) -> str:
    return f"[{host}]" if ":" in host else host


def _is_ip_address(name: str) -> bool:
    try:
        ip_address(name.removeprefix("[").removesuffix("]"))
    except ValueError:
        return False
    return True


MAX_MESSAGE_BYTES = 2**20
"""Largest message in bytes; a sketch has up to 200,000 bytes."""

Number = Annotated[float, msgspec.Meta(ge=-1e15, le=1e15)]
Pixels = Annotated[float, msgspec.Meta(ge=1, le=1e6)]
Text = Annotated[str, msgspec.Meta(max_length=200)]
Pair = tuple[Number, Number]
Triple = tuple[Number, Number, Number]
Value = bool | Number | str


class ClientMessage(msgspec.Struct, tag_field="type", forbid_unknown_fields=True):
    """Permitted message of a page; viser's other messages (uploads, tunnels, images) are rejected."""


class Camera(ClientMessage, tag="ViewerCameraMessage"):
    """Change of the camera."""

    wxyz: tuple[Number, Number, Number, Number]
    position: Triple
    fov: Number
    near: Number
    far: Number
    image_height: Pixels
    image_width: Pixels
    look_at: Triple
    up_direction: Triple


class Click(ClientMessage, tag="SceneNodeClickMessage"):
    """Click on a mesh."""

    name: Text
    instance_index: int | None
    ray_origin: Triple
    ray_direction: Triple
    screen_pos: Pair
    modifier: Text | None = None
    owner: Text = ""


class Drag(ClientMessage, tag="SceneNodeDragMessage"):
    """Drag of a mesh: where it began, and where the pointer is."""

    phase: Literal["start", "update", "end"]
    name: Text
    instance_index: int | None
    start_position: Triple
    start_screen_pos: Pair
    end_position: Triple
    end_screen_pos: Pair
    button: Literal["left"]
    modifier: Text | None = None
    owner: Text = ""


class Command(ClientMessage, tag="CommandTriggerMessage"):
    """Keyboard shortcut."""

    uuid: Text


class ControlValue(msgspec.Struct, forbid_unknown_fields=True):
    """New value of a control; messages with other properties are rejected."""

    value: Value


class ControlUpdate(ClientMessage, tag="GuiUpdateMessage"):
    """Change of a control's value, or click on a button."""

    uuid: Text
    updates: ControlValue


_MESSAGE_DECODER = msgspec.msgpack.Decoder(Camera | Click | Drag | Command | ControlUpdate)
_MESSAGE_ENCODER = msgspec.msgpack.Encoder()


def validate_message(raw: bytes | str, controls: Mapping[str, Any]) -> bytes | None:
    """Encode a message for viser; return None if it must be ignored, and raise ValueError if it is invalid."""
    if isinstance(raw, str):
        raise ValueError("it is text, not bytes")
    try:
        message = _MESSAGE_DECODER.decode(raw)
    except (msgspec.DecodeError, RecursionError, UnicodeDecodeError) as error:
        raise ValueError(str(error)) from None
    if isinstance(message, ControlUpdate):
        if message.uuid not in controls:
            raise ValueError("its control does not exist")
        state = controls[message.uuid]._impl
        _check_type(message.updates.value, state.value, getattr(state.props, "options", None))
        if not _is_in_range(message.updates.value, state.props):
            return None
    return _MESSAGE_ENCODER.encode(message)


def _check_type(value: Any, before: Any, options: Any) -> None:
    """Raise ValueError if a control cannot have the value."""
    if isinstance(before, bool):
        is_valid = isinstance(value, bool)
    elif isinstance(before, int | float):
        is_valid = isinstance(value, float)
    else:
        is_valid = isinstance(before, str) and isinstance(value, str)
    if not is_valid:
        raise ValueError("its value has the wrong type for the control")
    if options is not None and value not in options:
        raise ValueError("its value is not an option of the control")


def _is_in_range(value: Any, props: Any) -> bool:
    """Whether a value is within the limits of a control."""
    low, high = getattr(props, "min", None), getattr(props, "max", None)
    if isinstance(value, str | bool):
        return True
    tolerance = 1e-9 * max(1.0, abs(value))
    return (low is None or value >= low - tolerance) and (high is None or value <= high + tolerance)


@dataclass
class RateLimit:
    """Rate limit by a token bucket."""

    per_second: float
    burst: float
    _tokens: float = field(init=False)
    _updated_at: float = field(init=False)

    def __post_init__(self) -> None:
        self._tokens, self._updated_at = self.burst, monotonic()

    def delay(self) -> float:
        """Count an event, and return the required delay of the event in seconds."""
        now = monotonic()
        self._tokens = min(self.burst, self._tokens + (now - self._updated_at) * self.per_second) - 1
        self._updated_at = now
        return max(0.0, -self._tokens / self.per_second)

    def allow(self) -> bool:
        """Return whether another event is allowed, and count it if so."""
        if self.delay() > 0:
            self._tokens += 1
            return False
        return True


MESSAGE_RATE = 1000.0, 2000.0
"""Messages of a page per second, and in a burst; further messages are delayed. At 144 Hz a page sends about 400."""

MAX_CONNECTIONS = 256
"""Largest number of websockets; each page has one."""

HEADERS = {
    "Cache-Control": "no-store",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "SAMEORIGIN",
}
"""Headers of all responses, which forbid caching, referrers and embedding in other sites."""


class Guard:
    """Guard of one viser server."""

    def __init__(self, access: Access) -> None:
        self.access = access
        self.controls: Mapping[str, Any] = {}
        self._log_rate = RateLimit(per_second=0.5, burst=20)
        self._refusals: set[str] = set()
        self.connection_count = 0
        self._log = logging.Logger("mixseq.viewer")  # without the handlers of other loggers
        self._log.addHandler(logging.NullHandler())

    def report(self, text: str) -> None:
        """Print a line about a refusal on the terminal, unless there were many."""
        if self._log_rate.allow():
            line = "".join(letter if letter.isprintable() else "?" for letter in text[:200])
            print(f"mixseq: viewer: {line}", file=sys.stderr, flush=True)

    @contextmanager
    def guard_new_server(self) -> Iterator[None]:
        """Guard the server that is started within the context."""
        original_serve, ports = sockets.serve, []

        def serve(handler: Any, host: str, port: int, **settings: Any) -> Any:
            ports.append(port)
            self.access.port = port
            settings |= {
                "process_request": partial(self._answer, settings["process_request"]),
                "create_connection": partial(_Connection, self),
                "max_size": MAX_MESSAGE_BYTES,
                "close_timeout": 1.0,  # seconds to wait for the reply of a page
                "logger": self._log,
            }
            return original_serve(handler, host, port, **settings)

        sockets.serve = serve  # type: ignore[misc, assignment]
        try:
            yield
        finally:
            sockets.serve = original_serve  # type: ignore[misc]
        if not ports:
            raise RuntimeError("this version of viser starts its server in a way that cannot be guarded")

    def attach(self, server: Any) -> None:
        """Remove viser's handlers of public tunnels and uploads; validate messages against the server's controls."""
        from viser import _messages as kinds

        for kind in (
            kinds.ShareUrlRequest,
            kinds.ShareUrlDisconnect,
            kinds.FileTransferStartUpload,
            kinds.FileTransferPart,
        ):
            server._websock_server.unregister_handler(kind)
        self.controls = server.gui._gui_input_handle_from_uuid

    def _answer(self, answer_page: Callable[..., Any], connection: Any, request: Any) -> Any:
        """Return the response to a request, or None to accept a websocket."""
        refusal = self.access.refusal(request.path, request.headers)
        if refusal is not None:
            if refusal not in self._refusals:  # pages of earlier viewers repeat their requests
                self._refusals.add(refusal)
                self.report(f"refused a request: {refusal}; further ones are not reported")
            text = "This is a viewer of mixseq. Open the address that it printed, with its token.\n"  # not the reason
            response = connection.respond(http.HTTPStatus.FORBIDDEN, text)
        else:
            try:
                response = answer_page(connection, request) or self._count_connection(connection)
            except OSError:  # such as a path that is too long for a file
                response = connection.respond(http.HTTPStatus.NOT_FOUND, "There is no such page.\n")
        if response is not None:
            for name, value in HEADERS.items():
                response.headers[name] = value
            if refusal is None and self.access.has_token(request.path):
                response.headers["Set-Cookie"] = self.access.cookie
        return response

    def _count_connection(self, connection: Any) -> Any:
        """Count a websocket, or refuse it if there are too many websockets."""
        if self.connection_count >= MAX_CONNECTIONS:
            self.report(f"refused a page: {MAX_CONNECTIONS} are open already")
            return connection.respond(http.HTTPStatus.SERVICE_UNAVAILABLE, "Too many pages are open.\n")
        self.connection_count += 1
        connection.is_counted = True
        return None


class _Connection(sockets.ServerConnection):
    """Connection that passes only valid messages, and delays them to keep the rate limits."""

    def __init__(self, guard: Guard, *args: Any, **settings: Any) -> None:
        super().__init__(*args, **settings)
        self._guard = guard
        self._message_rate = RateLimit(*MESSAGE_RATE)
        self._invalid_message_rate = RateLimit(per_second=1, burst=20)  # a further one closes the connection
        self.is_counted = False

    def connection_lost(self, exc: Exception | None) -> None:
        """Remove the connection from the count of open connections."""
        super().connection_lost(exc)
        if self.is_counted:
            self.is_counted = False
            self._guard.connection_count -= 1

    async def recv(self, decode: bool | None = None) -> Any:
        """Return the next valid message."""
        while True:
            try:
                raw = await super().recv(decode)
            except ConnectionClosed as closed:
                if closed.sent is not None and closed.sent.code == CloseCode.MESSAGE_TOO_BIG:
                    self._guard.report(f"disconnected a page: its message is larger than {MAX_MESSAGE_BYTES} bytes")
                raise
            await sleep(self._message_rate.delay())  # unread messages wait in the page
            try:
                message = validate_message(raw, self._guard.controls)
            except ValueError as error:
                self._guard.report(f"ignored a message: {error}")
                if not self._invalid_message_rate.allow():
                    self._guard.report("disconnected a page: too many invalid messages")
                    await self.close(CloseCode.POLICY_VIOLATION, "too many invalid messages")
                    raise self.protocol.close_exc from None
                continue
            if message is not None:
                return message
