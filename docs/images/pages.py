"""Take the pictures of pages in the documentation: ``python docs/images/pages.py``; needs Chromium on the PATH."""

from __future__ import annotations

import shutil
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Thread

import numpy as np
from PIL import Image
from playwright.sync_api import Page, sync_playwright

import mixseq
from mixseq.cli.view import command as view_command
from mixseq.creature import walk_cycle
from mixseq.pictures.colours import SceneColours
from mixseq.pictures.scene import Scene, SceneItem
from mixseq.signals.model import Model
from mixseq.viewer.live import ViewSettings
from mixseq.viewer.live.viewer import run_viewer
from mixseq.web import package_files

HERE = Path(__file__).parent
SIZE = {"width": 1280, "height": 800}
ARGUMENTS = ["--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader"]
COLOURS = 160


def main() -> None:
    """Take all pictures."""
    walk = walk_cycle(frames=24, fps=24)
    model = mixseq.fit(
        mixseq.MeshSequence.from_arrays(
            np.concatenate([walk.points, walk.points[:1]]), walk.polygons, fps=24, name="fox"
        )
    )
    with TemporaryDirectory() as folder, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=ARGUMENTS)
        settings = ViewSettings(folder=Path(folder))
        with run_viewer(SceneColours(Scene((SceneItem("walk.h5", model),))), settings, save_model) as running:
            take_viewer(browser.new_page(viewport=SIZE), running.address)
        mixseq.save(Path(folder, "walk.h5"), model)
        exported = str(Path(folder, "walk.html"))
        view_command.main([str(Path(folder, "walk.h5")), "--export", exported], standalone_mode=False)
        page = browser.new_page(viewport=SIZE)
        page.goto(f"file://{exported}")
        page.wait_for_timeout(8000)
        page.keyboard.press("Space")
        page.wait_for_timeout(3000)
        save(page, "page.png")
        mixseq.save(Path(folder, "shot.glb"), mixseq.compress(model.sample(), max_error=1e-3), still="none")
        for name, text in package_files().items():
            Path(folder, name).write_text(text, encoding="utf-8")
        take_player(browser.new_page(viewport=SIZE), folder)
        browser.close()


def save_model(path: Path, model: Model, replace: bool) -> str:
    """Save nothing."""
    return ""


def take_viewer(page: Page, address: str) -> None:
    """The viewer, with parts in colours, while a point of the curve is dragged."""
    page.goto(address)
    page.get_by_text("Software WebGL").wait_for(timeout=60_000)
    page.locator(".mantine-Notification-closeButton").click()
    page.wait_for_function("() => document.getElementById('mixseq-charts')?.mixseqCharts?.handlePixels().length")
    page.locator("input[role='combobox'][value='clay']").click()
    page.get_by_role("option", name="parts", exact=True).click()
    places = page.evaluate("document.getElementById('mixseq-charts').mixseqCharts.handlePixels()")
    x, y = places[8]
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x - 30, y - 50, steps=4)
    page.wait_for_timeout(8000)
    save(page, "viewer.png")
    page.mouse.up()


def take_player(page: Page, folder: str) -> None:
    """The player of the npm package."""
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(SimpleHTTPRequestHandler, directory=folder)) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        page.goto(f"http://127.0.0.1:{server.server_port}/player.html")
        page.wait_for_timeout(5000)
        page.keyboard.press("Space")
        page.wait_for_timeout(2000)
        save(page, "web.png")
        server.shutdown()


def save(page: Page, name: str) -> None:
    """Keep what a page shows, in few colours."""
    picture = Image.open(BytesIO(page.screenshot(timeout=60_000))).convert("RGB")
    packed = picture.quantize(COLOURS, method=Image.Quantize.MAXCOVERAGE, kmeans=3, dither=Image.Dither.NONE)
    packed.save(HERE / name, optimize=True)
    print(f"{name}: {(HERE / name).stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
