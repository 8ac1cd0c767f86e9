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
from make import long_legs
from PIL import Image
from playwright.sync_api import Page, sync_playwright

import mixseq
from mixseq.cli.view import command as view_command
from mixseq.creature import walk_cycle
from mixseq.pictures.colours import SceneColours
from mixseq.pictures.scene import Scene, SceneItem
from mixseq.retargeting.markers import Markers
from mixseq.signals.model import Model
from mixseq.viewer.live import ViewSettings
from mixseq.viewer.live.marking import MarkedMeshes, run_marking_viewer
from mixseq.viewer.live.viewer import run_viewer
from mixseq.web import package_files

HERE = Path(__file__).parent
SIZE = {"width": 1280, "height": 800}
ARGUMENTS = ["--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader"]
FILM_CROP = (364, 130, 1280, 640)
"""Mesh and controls: left, upper, right and lower edge in pixels."""


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
        context = browser.new_context(viewport=SIZE)
        context.set_default_timeout(180_000)
        settings = ViewSettings(folder=Path(folder))
        with run_viewer(SceneColours(Scene((SceneItem("walk.h5", model),))), settings, save_model) as running:
            take_viewer(context.new_page(), running.address)
        with run_viewer(SceneColours(Scene((SceneItem("walk.h5", model),))), settings, save_model) as running:
            take_pose(context.new_page(), running.address, model)
        take_markers(context.new_page())
        mixseq.save(Path(folder, "walk.h5"), model)
        exported = str(Path(folder, "walk.html"))
        view_command.main([str(Path(folder, "walk.h5")), "--export", exported], standalone_mode=False)
        page = context.new_page()
        page.goto(f"file://{exported}")
        page.wait_for_timeout(8000)
        page.keyboard.press("Space")
        page.wait_for_timeout(3000)
        save(page, "page.png")
        mixseq.save(Path(folder, "shot.glb"), mixseq.compress(model.sample(), max_error=1e-3), still="none")
        for name, text in package_files().items():
            Path(folder, name).write_text(text, encoding="utf-8")
        take_player(context.new_page(), folder)
        browser.close()


def save_model(path: Path, model: Model, replace: bool) -> str:
    """Save nothing."""
    return ""


def open_viewer(page: Page, address: str) -> None:
    """Open the viewer, and close what is said of the missing graphics card."""
    page.goto(address)
    page.get_by_text("Software WebGL").wait_for(timeout=60_000)
    page.locator(".mantine-Notification-closeButton").click()
    page.wait_for_function("() => document.getElementById('mixseq-charts')?.mixseqCharts?.handlePixels().length")


ON_SCREEN = """(vertex) => {
  const { nodeRefFromName, camera, canvas } = window.__viserMutable;
  const { x, y, width, height } = canvas.getBoundingClientRect();
  let mesh = null;
  nodeRefFromName["/mesh/0"].traverse((each) => { if (each.isMesh && !mesh) mesh = each });
  const point = mesh.position.clone().fromArray(mesh.geometry.attributes.position.array, 3 * vertex);
  mesh.localToWorld(point).project(camera);
  return [x + (1 + point.x) / 2 * width, y + (1 - point.y) / 2 * height];
}"""
"""Where a vertex is on the page."""


def take_pose(page: Page, address: str, model: Model) -> None:
    """A film: the nose is dragged up, with a forepaw pinned."""
    open_viewer(page, address)
    page.wait_for_timeout(3000)
    page.get_by_label("Pose", exact=True).check()
    page.get_by_label("Exact", exact=True).check()
    points, shots = model(model.start), []
    nose, paw = int(points[:, 0].argmax()), int(points[:, 1].argmin())
    x, y = page.evaluate(ON_SCREEN, paw)
    page.mouse.click(x, y - 5)
    x, y = page.evaluate(ON_SCREEN, nose)
    page.mouse.move(x - 8, y)
    page.mouse.down()
    for share in np.concatenate([np.zeros(2), np.linspace(0, 1, 12), np.ones(3)]):
        page.mouse.move(x - 8 - 70 * share, y - 90 * share)
        page.wait_for_timeout(2500)
        shots.append(Image.open(BytesIO(page.screenshot(timeout=60_000))).convert("RGB").crop(FILM_CROP))
    page.mouse.up()
    page.keyboard.press("Escape")
    film = HERE / "viewer-pose.webp"
    shots[0].save(film, save_all=True, append_images=shots[1:] + shots[-4:1:-1], duration=100, loop=0, quality=60)
    print(f"{film.name}: {film.stat().st_size / 1000:.0f} kB")


def take_viewer(page: Page, address: str) -> None:
    """The viewer, with parts in colours, while a point of the curve is dragged."""
    open_viewer(page, address)
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


def take_markers(page: Page) -> None:
    """Markers of the fox and of one with longer legs, which looks elsewhere, seen from the same side."""
    source, legs = walk_cycle(frames=4), long_legs()
    a = np.radians(35.0)
    turned = legs.points @ np.array([[np.cos(a), 0, -np.sin(a)], [0, 1, 0], [np.sin(a), 0, np.cos(a)]])
    target = mixseq.MeshSequence.from_arrays(turned, legs.polygons, fps=24)
    nothing = Markers.from_pairs(np.zeros((0, 2), np.int64))
    meshes = MarkedMeshes(source, target, ("fox.usdc", "long legs.usdc"), nothing, "pairs.txt")
    with run_marking_viewer(meshes, ViewSettings(), lambda _: "") as running:
        page.goto(running.address)
        page.get_by_text("Software WebGL").wait_for(timeout=60_000)
        page.locator(".mantine-Notification-closeButton").click()
        page.get_by_text("The next one has a ?").wait_for(timeout=180_000)
        page.get_by_role("button", name="Accept all").click()
        page.get_by_text("(median)").wait_for(timeout=60_000)
        page.get_by_role("button", name="Back", exact=True).click()  # foxes look along x
        page.wait_for_timeout(5000)
        save(page, "markers.png")


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
    packed = picture.quantize(256, method=Image.Quantize.MEDIANCUT, kmeans=3, dither=Image.Dither.NONE)  # no bands
    packed.save(HERE / name, optimize=True)
    print(f"{name}: {(HERE / name).stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
