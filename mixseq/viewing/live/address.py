"""Where the viewer listens, and whether it can."""

from __future__ import annotations

import errno
import socket

from mixseq.errors import SettingsError

FIRST_PORT, PORTS = 8080, 100
"""Where a free port is looked for."""


def free_port(host: str, wanted: int | None) -> int:
    """Return a port at which one may listen: the one that is wanted, or else the first that is free.

    Raises
    ------
    SettingsError
        If there is none; viser would go on to look for others, for minutes and whatever the reason is.
    """
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


def address(host: str, port: int) -> str:
    """Return where a browser finds a server that listens at a host and a port."""
    name = "127.0.0.1" if host in ("0.0.0.0", "::") else host
    return f"http://[{name}]:{port}" if ":" in name else f"http://{name}:{port}"
