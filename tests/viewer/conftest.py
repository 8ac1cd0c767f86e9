"""A browser for tests of pages: headless Chromium, driven by playwright, that never leaves this machine."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Protocol
from urllib.parse import urlsplit

import pytest

if TYPE_CHECKING:
    from playwright.sync_api import Browser, ConsoleMessage, Page, Request

NAMES = ("chromium", "chromium-browser", "google-chrome")

ARGUMENTS = (
    "--no-sandbox",  # containers have none
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-quic",
    "--disable-gpu",
    "--enable-unsafe-swiftshader",  # WebGL in software
)

PATIENCE = 60_000
"""Milliseconds that a busy machine may take for anything."""


SCREENSHOTS = "MIXSEQ_SCREENSHOTS"
"""Where pictures of pages are kept."""


class NewPage(Protocol):
    """Opens a page of so many pixels, `scale` of the screen's for each."""

    def __call__(self, width: int = 1280, height: int = 800, scale: float = 1.0) -> Page: ...


class Keep(Protocol):
    """Keeps a picture of a page under a name."""

    def __call__(self, page: Page, name: str) -> None: ...


# One for every file, no more: while playwright lives, its event loop runs in this thread, and other tests start theirs.
@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Headless Chromium."""
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    executable = next(filter(None, map(shutil.which, NAMES)), None)
    if executable is None:
        pytest.skip(f"there is no browser: none of {', '.join(NAMES)} is on the PATH")
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=executable, args=list(ARGUMENTS), timeout=PATIENCE)
        yield browser
        browser.close()


class Watched:
    """Opens pages, and keeps what goes wrong on them: errors, and requests to anywhere but this machine."""

    def __init__(self, browser: Browser) -> None:
        self._browser = browser
        self._opened: list[Page] = []
        self._complaints: list[str] = []

    def open(self, width: int = 1280, height: int = 800, scale: float = 1.0) -> Page:
        page = self._browser.new_page(viewport={"width": width, "height": height}, device_scale_factor=scale)
        page.set_default_timeout(PATIENCE)
        page.on("console", self._listen_to_console)
        page.on("pageerror", lambda error: self._complaints.append(f"an error: {error}"))
        page.on("request", self._listen_to_requests)
        self._opened.append(page)
        return page

    def check(self) -> None:
        """Fail if something went wrong since last time."""
        complaints, self._complaints = self._complaints, []
        assert not complaints, "\n".join(complaints)

    def close(self) -> None:
        for page in self._opened:
            page.context.close()

    def _listen_to_console(self, message: ConsoleMessage) -> None:
        # viser's own page says this when a mesh is dragged
        if message.type == "error" and "inside passive event listener" not in message.text:
            self._complaints.append(f"on the console: {message.text}")

    def _listen_to_requests(self, request: Request) -> None:
        address = urlsplit(request.url)
        if address.scheme not in ("file", "data", "blob", "about") and address.hostname != "127.0.0.1":
            self._complaints.append(f"a request to {request.url}")


def own_port() -> int:
    """A port that no other process of this run has: tests of a module may run in several."""
    return 8300 + int(os.environ.get("PYTEST_XDIST_WORKER", "gw0")[2:])


@pytest.fixture
def new_page(browser: Browser) -> Iterator[NewPage]:
    """Opens pages for one test, which fails at its end if something went wrong on them."""
    watched = Watched(browser)
    yield watched.open
    watched.close()
    watched.check()


@pytest.fixture(scope="module")
def watched(browser: Browser) -> Iterator[Watched]:
    """Opens pages that the tests of a file share; each test calls `Watched.check` at its end."""
    watched = Watched(browser)
    yield watched
    watched.close()


@pytest.fixture
def page(new_page: NewPage) -> Page:
    """An empty page of 1280 x 800, watched as `new_page` does."""
    return new_page()


@pytest.fixture
def keep() -> Keep:
    """Keeps pictures of pages, to be looked at, in the folder $MIXSEQ_SCREENSHOTS if it is set: they take time."""

    def keep(page: Page, name: str) -> None:
        if folder := os.environ.get(SCREENSHOTS):
            Path(folder).mkdir(parents=True, exist_ok=True)
            page.screenshot(path=Path(folder) / f"{name}.png")

    return keep


@pytest.fixture
def screenshots(tmp_path: Path) -> Path:
    """The folder of `keep`, or a temporary one."""
    named = os.environ.get(SCREENSHOTS)
    folder = Path(named) if named else tmp_path / "screenshots"
    folder.mkdir(parents=True, exist_ok=True)
    return folder
