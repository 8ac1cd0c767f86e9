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


class NewPage(Protocol):
    """Opens a page of so many pixels, `scale` of the screen's for each."""

    def __call__(self, width: int = 1280, height: int = 800, scale: float = 1.0) -> Page: ...


# One for every file, no more: while playwright lives, its event loop runs in this thread, and other tests start theirs.
@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Headless Chromium."""
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    executable = next(filter(None, map(shutil.which, NAMES)), None)
    if executable is None:
        pytest.skip(f"there is no browser: none of {', '.join(NAMES)} is on the PATH")
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=executable, args=list(ARGUMENTS), timeout=PATIENCE
        )
        yield browser
        browser.close()


@pytest.fixture
def new_page(browser: Browser) -> Iterator[NewPage]:
    """Opens pages. Errors on them, and requests to anywhere but this machine, fail the test at its end."""
    complaints: list[str] = []
    opened: list[Page] = []

    def listen_to_console(message: ConsoleMessage) -> None:
        if message.type == "error":
            complaints.append(f"on the console: {message.text}")

    def listen_to_requests(request: Request) -> None:
        address = urlsplit(request.url)
        if address.scheme not in ("file", "data", "blob", "about") and address.hostname != "127.0.0.1":
            complaints.append(f"a request to {request.url}")

    def open_page(width: int = 1280, height: int = 800, scale: float = 1.0) -> Page:
        page = browser.new_page(viewport={"width": width, "height": height}, device_scale_factor=scale)
        page.set_default_timeout(PATIENCE)
        page.on("console", listen_to_console)
        page.on("pageerror", lambda error: complaints.append(f"an error: {error}"))
        page.on("request", listen_to_requests)
        opened.append(page)
        return page

    yield open_page
    for page in opened:
        page.context.close()
    assert not complaints, "\n".join(complaints)


@pytest.fixture
def page(new_page: NewPage) -> Page:
    """An empty page of 1280 x 800, watched as `new_page` does."""
    return new_page()


@pytest.fixture
def screenshots(tmp_path: Path) -> Path:
    """Where pictures of pages are kept: the folder $MIXSEQ_SCREENSHOTS, if it is set."""
    named = os.environ.get("MIXSEQ_SCREENSHOTS")
    folder = Path(named) if named else tmp_path / "screenshots"
    folder.mkdir(parents=True, exist_ok=True)
    return folder
