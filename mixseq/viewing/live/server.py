"""A guarded viser server, which prints its address with the token."""

from __future__ import annotations

import errno
import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, redirect_stdout
from io import StringIO
from typing import Any

from mixseq.errors import MissingExtraError, SettingsError


def check_viser() -> None:
    """Raise MissingExtraError without viser."""
    try:
        import viser  # noqa: F401
    except ImportError:
        raise MissingExtraError(
            "the viewer needs viser, which is not installed; run: pip install 'mixseq[viewer]'"
        ) from None


@contextmanager
def served(host: str, wanted: int | None) -> Iterator[tuple[Any, str]]:
    """Run a server for the duration of the context; yields it, and its address with the token."""
    check_viser()
    import viser

    from mixseq.viewing.live.access import Access
    from mixseq.viewing.live.guard import Guard

    port = free_port(host, wanted)
    guard = Guard(Access(host))
    with ExitStack() as stack:
        with redirect_stdout(StringIO()), guard.posted():  # viser has a greeting
            server = viser.ViserServer(host, port, label="mixseq", verbose=False)
            stack.callback(_stop, server)
        guard.unhook(server)
        yield server, guard.access.address


def _stop(server: Any) -> None:
    with redirect_stdout(StringIO()):
        server.stop()


FIRST_PORT, PORTS = 8080, 100
"""Range of ports in which a free one is searched."""


def free_port(host: str, wanted: int | None) -> int:
    """Return the wanted port, or by default the first free one."""
    for port in [wanted] if wanted is not None else range(FIRST_PORT, FIRST_PORT + PORTS):
        try:
            with socket.create_server((host, port), family=_family(host)):
                return port
        except OSError as error:
            if wanted is None and error.errno == errno.EADDRINUSE:
                continue
            why = str(error.strerror or error).partition(" (")[0]
            cure = (
                "give another --port"
                if error.errno in (errno.EADDRINUSE, errno.EACCES)
                else "give another --host"
            )
            raise SettingsError(f"cannot listen at {host}:{port}: {why}; {cure}") from None
    raise SettingsError(f"the ports {FIRST_PORT} to {FIRST_PORT + PORTS - 1} are all taken; give a --port")


def _family(host: str) -> socket.AddressFamily:
    return socket.AF_INET6 if ":" in host else socket.AF_INET
