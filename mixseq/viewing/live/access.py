"""Access control of a viewer: browsers with the token in its address, under one of its names."""

from __future__ import annotations

import secrets
import socket
from dataclasses import dataclass, field
from ipaddress import ip_address
from typing import Protocol
from urllib.parse import parse_qs, urlsplit

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
