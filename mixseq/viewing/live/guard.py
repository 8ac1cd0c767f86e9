"""A guard in front of viser's server, for requests allowed by `Access` and messages allowed by `checked_message`.

viser creates its server with ``websockets.asyncio.server.serve``, whose arguments for a request hook and a connection
class are set by replacing that function.
"""

from __future__ import annotations

import http
import logging
import sys
from asyncio import sleep
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from typing import Any

import websockets.asyncio.server as sockets
from websockets.exceptions import ConnectionClosed
from websockets.frames import CloseCode

from mixseq.viewing.live.access import CLOSED, Access
from mixseq.viewing.live.incoming import LARGEST, Rate, checked_message

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
