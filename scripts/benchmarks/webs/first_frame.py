"""Time to the first frame, of pages that come over a slow line: a server on this machine with so many bytes a second.

Texts are sent deflated, as servers do. The clock starts with the page and ends when the graphics card has drawn the
first frame of the motion. Chromium is new for every page, and draws in software.
"""

from __future__ import annotations

import gzip
import http.server
import shutil
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

from scripts.benchmarks.webs.shipping import Shipped, shipped

RATES = (200_000, 1_000_000)
"""Bytes a second."""

COLUMNS = ("sequence", "what", "kB sent", *(f"first frame at {rate // 1000} kB/s" for rate in RATES))

BOUND, ROUNDS, _PIECE = 1e-3, 3, 16_384

_TEXTS = {".html": "text/html", ".js": "text/javascript"}

_WATCH = """
const look = () => {
  if (globalThis.mixseqPlayer?.state().drawn) globalThis.shown ??= performance.now();
  if (globalThis.shown === undefined) requestAnimationFrame(look);
};
look();
"""
"""Exported pages tell what they have drawn; the others set `shown` themselves."""


class _Line:
    """A line that all answers share."""

    def __init__(self, rate: int) -> None:
        self.rate, self.sent = rate, 0
        self._free = threading.Lock()

    def send(self, data: bytes, write: Any) -> None:
        for start in range(0, len(data), _PIECE):
            piece = data[start : start + _PIECE]
            with self._free:
                time.sleep(len(piece) / self.rate)
                self.sent += len(piece)
            write(piece)


class _Handler(http.server.BaseHTTPRequestHandler):
    def __init__(self, folder: Path, line: _Line, *args: Any) -> None:
        self._folder, self._line = folder, line
        super().__init__(*args)

    def do_GET(self) -> None:
        path = self._folder / self.path.partition("?")[0].lstrip("/")
        if not path.is_file():
            self.send_error(404)
            return
        data, kind = path.read_bytes(), _TEXTS.get(path.suffix)
        self.send_response(200)
        if kind:
            data = gzip.compress(data)
            self.send_header("Content-Encoding", "gzip")
        self.send_header(
            "Content-Type",
            kind or ("application/wasm" if path.suffix == ".wasm" else "application/octet-stream"),
        )
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self._line.send(data, self.wfile.write)

    def log_message(self, *_: Any) -> None:
        """Say nothing."""


@contextmanager
def _serving(folder: Path, rate: int) -> Iterator[tuple[str, _Line]]:
    line = _Line(rate)
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), partial(_Handler, folder, line))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}", line
    finally:
        server.shutdown()


def rows(name: str) -> Iterator[tuple[str, ...]]:
    """Load an animation in every form."""
    with tempfile.TemporaryDirectory() as folder:
        for each in shipped(name, BOUND, Path(folder)):
            found = [[_loaded(each, rate) for _ in range(ROUNDS)] for rate in RATES]
            seconds = [median(one for one, _ in rounds) for rounds in found]
            yield name, each.title, f"{found[0][0][1] / 1000:.0f}", *(f"{one:.1f} s" for one in seconds)


def _loaded(what: Shipped, rate: int) -> tuple[float, int]:
    """Return seconds to the first frame, and the bytes sent until then."""
    from playwright.sync_api import sync_playwright

    executable = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))))
    arguments = ["--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader"]
    with _serving(what.folder, rate) as (address, line), sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=executable, args=arguments)
        page = browser.new_page()
        page.add_init_script(_WATCH)
        page.goto(f"{address}/{what.page}", wait_until="commit")
        while (shown := page.evaluate("globalThis.shown ?? null")) is None:  # pages may forbid to wait for a function
            page.wait_for_timeout(20)
        sent = line.sent
        browser.close()
    return shown / 1000, sent
