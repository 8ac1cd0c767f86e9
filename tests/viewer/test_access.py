"""Who may connect to a viewer, by the headers of a request."""

from __future__ import annotations

import pytest
from websockets.datastructures import Headers

from mixseq.viewer.live.guard import Access

TOKEN = "right"
OURS = f"/?token={TOKEN}"


def refusal(path: str = OURS, host: str = "127.0.0.1", **headers: str) -> str | None:
    values = {"Host": "127.0.0.1:8080", **headers}
    lines = Headers([(name, value) for name, each in values.items() for value in each.split("|")])
    return Access(host, 8080, TOKEN).refusal(path, lines)


@pytest.mark.parametrize(
    "given",
    [
        {},
        {"Host": "localhost:8080"},
        {"Host": "LOCALHOST:8080", "Origin": "http://localhost:8080"},
        {"Host": "[::1]:8080"},
        {"Origin": "http://127.0.0.1:8080"},
        {"path": "/", "Cookie": f"mixseq-8080={TOKEN}"},
        {"path": "/x.js?a=b", "Cookie": f'a=b; c="d; mixseq-8080={TOKEN}'},
        {"path": "/", "Cookie": f"a=b|mixseq-8080={TOKEN}"},
        {"host": "station.lan", "Host": "station.lan:8080"},
        {"host": "fe80::7", "Host": "[fe80::7]:8080"},
        {"host": "0.0.0.0", "Host": "192.0.2.7:8080"},
        {"host": "::", "Host": "[2001:db8::7]:8080"},
    ],
)
def test_let_in(given: dict[str, str]) -> None:
    assert refusal(**given) is None


@pytest.mark.parametrize(
    ("given", "why"),
    [
        ({"path": "/"}, "its token"),
        ({"path": "/?token="}, "its token"),
        ({"path": "/?token=wrong"}, "its token"),
        ({"path": "/?token=righ"}, "its token"),
        ({"path": "/?token=%C3%A9"}, "its token"),
        ({"path": f"/{TOKEN}#token={TOKEN}"}, "its token"),
        ({"path": "//[?token=right"}, "its token"),
        ({"path": "/?" + 2000 * "&token=wrong"}, "its token"),
        ({"path": "/", "Cookie": "mixseq-8080=wrong"}, "its token"),
        ({"path": "/", "Cookie": f"mixseq-8081={TOKEN}"}, "its token"),
        ({"path": "/", "Cookie": "mixseq-8080"}, "its token"),
        ({"Host": "evil.example:8080"}, "its host"),
        ({"Host": "evil.example"}, "its host"),
        ({"Host": "127.0.0.1"}, "its host"),
        ({"Host": "127.0.0.1:8081"}, "its host"),
        ({"Host": "127.0.0.1.evil.example:8080"}, "its host"),
        ({"Host": "[::1]"}, "its host"),
        ({"Host": ""}, "its host"),
        ({"Host": "127.0.0.1:8080|evil.example:8080"}, "its host"),
        ({"Host": "192.0.2.7:8080"}, "its host"),
        ({"host": "0.0.0.0", "Host": "evil.example:8080"}, "its host"),
        ({"Origin": "https://evil.example"}, "it comes"),
        ({"Origin": "null"}, "it comes"),
        ({"Origin": "http://127.0.0.1:8081"}, "it comes"),
        ({"Origin": "https://127.0.0.1:8080"}, "it comes"),
        ({"Origin": "http://localhost:8080"}, "it comes"),
        ({"Origin": "http://127.0.0.1:8080|https://evil.example"}, "it comes"),
    ],
)
def test_kept_out(given: dict[str, str], why: str) -> None:
    found = refusal(**given)
    assert found is not None
    assert found.startswith(why)


def test_the_usual_port_is_left_out_by_browsers() -> None:
    assert Access("127.0.0.1", 80, TOKEN).refusal(OURS, Headers(Host="localhost")) is None
    assert Access("::1", 80, TOKEN).refusal(OURS, Headers(Host="[::1]")) is None


@pytest.mark.parametrize(
    ("host", "name"), [("127.0.0.1", "127.0.0.1"), ("0.0.0.0", "127.0.0.1"), ("::", "127.0.0.1"), ("::1", "[::1]")]
)
def test_the_address(host: str, name: str) -> None:
    assert Access(host, 8080, TOKEN).address == f"http://{name}:8080/?token={TOKEN}"


def test_tokens_are_new_and_long_and_not_in_tracebacks() -> None:
    one, other = Access("127.0.0.1"), Access("127.0.0.1")
    assert one.token != other.token
    assert len(one.token) >= 43
    assert one.token not in repr(one)
