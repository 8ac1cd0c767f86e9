"""Who may connect to a viewer: browsers that were given its address with the token, under a name that it has."""

from __future__ import annotations

import secrets
import socket
from dataclasses import dataclass, field
from ipaddress import ip_address
from typing import Protocol
from urllib.parse import parse_qs, urlsplit

EVERYWHERE = ("0.0.0.0", "::", "")
"""Hosts that stand for all addresses of a machine."""

CLOSED = "This is a viewer of mixseq. Open the address that it printed, with its token."
"""What is told to somebody without the token, whatever else is wrong: no more than that."""


class Headers(Protocol):
    """Headers of a request, any of which may be there several times."""

    def get_all(self, key: str) -> list[str]:
        """Return all values of a header."""


@dataclass
class Access:
    """Tells which requests a viewer answers.

    A page of somebody else, open in the same browser, can send requests to a viewer, with cookies if it is on the same
    host. It does not know the token, its cookie is for our own pages only (``SameSite=Strict``), and the browser says
    whose page it is (``Origin``). A page whose name was made to mean this machine (DNS rebinding) gives itself away by
    that name (``Host``).
    """

    host: str
    port: int = 0
    token: str = field(default_factory=lambda: secrets.token_urlsafe(32), repr=False)

    @property
    def address(self) -> str:
        """Where a browser finds the viewer, with the token."""
        name = "127.0.0.1" if self.host in EVERYWHERE else self.host
        return f"http://{_bracketed(name)}:{self.port}/?token={self.token}"

    @property
    def cookie(self) -> str:
        """What a browser shall keep, so that it need not give the token again."""
        return f"{self._cookie_name}={self.token}; Path=/; HttpOnly; SameSite=Strict"

    def refusal(self, path: str, headers: Headers) -> str | None:
        """Return why a request is refused, None if it is not."""
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
        """Cookies are the same at all ports of a host, where another viewer may run."""
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
