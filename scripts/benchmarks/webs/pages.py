"""How large exported pages are, and when they show their first frame: beside those of before, which had all positions.

Before is commit b4fcc21, the last one whose pages had positions in 16 bits, as `mixseq view --export` made them. The
first frame is timed in headless Chromium without a graphics card, from a file, from the start of the navigation on.
Pages of before can be timed beside those of now: put them, as ``NAME.html``, into the folder $MIXSEQ_PAGES.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING

import mixseq
from mixseq.pictures.colours import SceneColours
from mixseq.pictures.scene import Scene, SceneItem
from mixseq.viewer.export import ExportReport, ExportSettings, export_page
from mixseq.viewer.export_data import page_items
from scripts.benchmarks.common.animations import animation

if TYPE_CHECKING:
    from playwright.sync_api import Browser

BEFORE = {
    "q_man_run": 636_257,
    "horse_gallop": 1_177_687,
    "CesiumMan": 735_530,
    "abc_dembones_bone": 1_579_083,
}
"""Bytes of pages of commit b4fcc21; CesiumMan is ``gltf/CesiumMan.glb``."""

NAMES = tuple(BEFORE)

COLUMNS = (
    "sequence",
    "max error",
    "before",
    "page",
    "of it mesh and motion",
    "page / before",
    "first frame, before",
    "first frame",
)

ERRORS = (1e-3, 1e-4)
ROUNDS = 7

_ARGUMENTS = ["--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader"]
_WATCH = """(function watch() {
  if (window.mixseqPlayer && mixseqPlayer.state().drawn > 0) window.firstFrame = performance.now();
  else requestAnimationFrame(watch);
})()"""


def rows(name: str) -> Iterator[tuple[str, ...]]:
    """Export an animation with every bound, and open the page."""
    from playwright.sync_api import sync_playwright

    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=_ARGUMENTS)
        for error in ERRORS:
            page, old = Path(folder, "page.html"), Path(os.environ.get("MIXSEQ_PAGES", ""), f"{name}.html")
            report = _exported(name, page, error)
            firsts = [(first_frame(browser, page), _timed(browser, old)) for _ in range(ROUNDS)]
            now, before = zip(*firsts, strict=True)
            share = report.size / BEFORE[name] if name in BEFORE else float("nan")
            yield (
                name,
                f"{error:g}",
                f"{BEFORE.get(name, 0) / 1000:.1f} kB",
                f"{report.size / 1000:.1f} kB",
                f"{report.items[0].positions / 1000:.1f} kB",
                f"{100 * share:.1f} %",
                "" if None in before else f"{median(each for each in before if each):.0f} ms",
                f"{median(now):.0f} ms",
            )
        browser.close()


def _exported(name: str, target: Path, error: float) -> ExportReport:
    file = Path(os.environ.get("MIXSEQ_DATA", ""), "gltf", f"{name}.glb")
    sequence = mixseq.read(file) if file.exists() else animation(name)
    scene = Scene((SceneItem(name, sequence),))
    return export_page(target, page_items(SceneColours(scene)), ExportSettings(max_error=error))


def _timed(browser: Browser, page: Path) -> float | None:
    return first_frame(browser, page) if page.is_file() else None


def first_frame(browser: Browser, page: Path) -> float:
    """Return the milliseconds from the start of the navigation to the first frame that is drawn."""
    opened = browser.new_page(viewport={"width": 1280, "height": 800})
    opened.add_init_script(_WATCH)
    opened.goto(page.absolute().as_uri())
    while (first := opened.evaluate("window.firstFrame ?? null")) is None:
        opened.wait_for_timeout(20)  # who asks all the time takes a processor away from the page
    opened.close()
    return float(first)
