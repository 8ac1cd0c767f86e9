"""The pages of the npm package without a network, and what they say when they cannot play."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

import mixseq
from mixseq.operations import key_poses, with_body
from mixseq.web import package_files
from tests.meshes import bar
from tests.viewer.conftest import PATIENCE, Keep, browser, keep, new_page, page
from tests.web.site import ADDRESS, serve, three_of_trimesh

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

__all__ = ["browser", "keep", "new_page", "page"]  # fixtures

pytestmark = pytest.mark.slow

NAMES = ("player.html", "example.html")
FOLDER = "node_modules/three/"
THREE = {
    f"{FOLDER}package.json": "{}",
    f"{FOLDER}build/three.module.js": """await new Promise((resolve) => {
      const script = document.createElement("script");
      Object.assign(script, { src: "three_global.js", onload: resolve });
      document.head.append(script);
    });
    export const { Box3, BufferAttribute, BufferGeometry, Color, DirectionalLight, GLBufferAttribute, HemisphereLight,
      Mesh, MeshStandardMaterial, PerspectiveCamera, PlaneGeometry, Scene, ShaderMaterial, ShadowMaterial, VSMShadowMap,
      Vector2, Vector3, WebGLRenderer } = THREE;""",
    f"{FOLDER}examples/jsm/loaders/GLTFLoader.js": 'import "three"; export const { GLTFLoader } = globalThis.THREE;',
    f"{FOLDER}examples/jsm/controls/OrbitControls.js": """import { Vector3 } from "three";
    export class OrbitControls {
      constructor(camera) { Object.assign(this, { camera, target: new Vector3() }); }
      update() { this.camera.lookAt(this.target); }
    }""",
}
"""What `npm install three` puts beside a page, of the three.js in trimesh."""


@pytest.fixture(scope="module")
def shot(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A compressed sequence."""
    path = tmp_path_factory.mktemp("shot") / "shot.glb"
    mixseq.save(path, mixseq.compress(bar(sides=5, rings=8, frames=4), max_error=1e-3), still="none")
    return path.read_bytes()


@pytest.fixture
def broken(browser: Browser) -> Iterator[Page]:
    """A page that may complain, and that reaches only this machine."""
    page = browser.new_page()
    page.set_default_timeout(PATIENCE)
    page.route("https://**", lambda route: route.abort())
    yield page
    page.context.close()


def said(page: Page) -> str:
    """Return what stands in the middle of a page that has ended loading."""
    page.wait_for_function("!['', 'Loading'].includes(document.querySelector('#message').textContent)")
    assert page.locator("#message").is_visible()
    return page.inner_text("#message")


@pytest.mark.parametrize("name", NAMES)
def test_pages_play_without_a_network(page: Page, shot: bytes, name: str, keep: Keep) -> None:
    serve(page, {"shot.glb": shot, "three_global.js": three_of_trimesh(), **THREE})
    page.goto(f"{ADDRESS}{name}")
    page.wait_for_function("parseFloat(document.querySelector('output')?.textContent) > 0")
    assert not page.locator("#message").is_visible()
    keep(page, f"offline-{name}")


@pytest.fixture(scope="module")
def herd(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Two bodies, one of them thrice as wide."""
    path, thin = tmp_path_factory.mktemp("herd") / "herd.glb", mixseq.fit(bar(5, 8, 4), exact=True)
    keys = key_poses(thin)
    wide = with_body(thin, keys.with_points(keys.points * [1.0, 3.0, 3.0]), "wide")
    mixseq.save(path, mixseq.compress(wide, max_error=1e-3), still="none")
    return path.read_bytes()


@pytest.mark.parametrize("name", NAMES)
def test_bodies_are_chosen(page: Page, herd: bytes, name: str, keep: Keep) -> None:
    serve(page, {"shot.glb": herd, "three_global.js": three_of_trimesh(), **THREE})
    page.goto(f"{ADDRESS}{name}")
    page.wait_for_function("parseFloat(document.querySelector('output')?.textContent) > 0")
    assert page.locator("#body option").all_text_contents() == ["bar", "wide"]
    page.keyboard.press("End")

    def picture() -> bytes:
        page.wait_for_timeout(200)
        return page.screenshot(clip={"x": 0, "y": 60, "width": 1280, "height": 600})

    first = picture()
    time = page.inner_text("output")
    page.select_option("#body", "wide")
    keep(page, f"wide-{name}")
    assert picture() != first
    assert page.inner_text("output") == time
    page.select_option("#body", "bar")
    assert picture() == first


def test_player_asks_for_nothing_elsewhere(page: Page, shot: bytes) -> None:
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    serve(page, {"shot.glb": shot})
    page.goto(f"{ADDRESS}player.html")
    page.wait_for_function("globalThis.shown > 0")
    assert {url for url in asked if not url.startswith(("data:", "blob:"))} == {
        f"{ADDRESS}{file}" for file in ("player.html", "page.css", "page.js", "mixseq.js", "shot.glb")
    }


def test_example_without_three_names_what_plays(broken: Page, shot: bytes, keep: Keep) -> None:
    serve(broken, {"shot.glb": shot})
    broken.goto(f"{ADDRESS}example.html")
    text = said(broken)
    assert text.startswith("three.js cannot be loaded: it is not beside this page, and there is no network.")
    assert "npm install three" in text and "player.html" in text
    keep(broken, "offline-no-three")


def cut(shot: bytes) -> bytes:
    return shot[: len(shot) // 2]


def flipped(shot: bytes) -> bytes:
    return shot[:-200] + bytes(255 - byte for byte in shot[-200:])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (None, "shot.glb is not on the server. Another file is shown with ?file=NAME.glb"),
        (cut, "shot.glb cannot be shown: this GLB file is "),
        (flipped, "shot.glb cannot be shown: "),
        (lambda _: b"<!doctype html><title>no such page</title>", "shot.glb cannot be shown: this is not a GLB file."),
    ],
    ids=["missing", "cut", "flipped", "no glb"],
)
def test_player_says_what_is_wrong_with_a_file(
    broken: Page, shot: bytes, change: Callable[[bytes], bytes] | None, message: str, keep: Keep
) -> None:
    serve(broken, {} if change is None else {"shot.glb": change(shot)})
    broken.goto(f"{ADDRESS}player.html")
    assert said(broken).startswith(message)
    keep(broken, f"player-{message[:30]}")


def test_example_says_that_a_file_is_missing(broken: Page) -> None:
    serve(broken, {"three_global.js": three_of_trimesh(), **THREE})
    broken.goto(f"{ADDRESS}example.html?file=walk.glb")
    assert said(broken).startswith("walk.glb cannot be shown: ")


def test_player_says_that_webgl_is_missing(broken: Page, shot: bytes) -> None:
    broken.add_init_script("HTMLCanvasElement.prototype.getContext = () => null;")
    serve(broken, {"shot.glb": shot})
    broken.goto(f"{ADDRESS}player.html")
    assert said(broken).startswith("This browser has no WebGL 2. Update it")


def test_player_says_that_its_module_is_missing(broken: Page, shot: bytes) -> None:
    serve(broken, {"shot.glb": shot})
    broken.route(f"{ADDRESS}mixseq.js", lambda route: route.fulfill(status=404))
    broken.goto(f"{ADDRESS}player.html")
    assert said(broken).startswith("A file of this page cannot be loaded. Copy all files")


@pytest.mark.parametrize("name", NAMES)
def test_pages_say_that_they_need_a_server(broken: Page, tmp_path: Path, name: str, keep: Keep) -> None:
    for file, text in package_files().items():
        (tmp_path / file).write_text(text, encoding="utf-8")
    broken.goto((tmp_path / name).as_uri())
    text = said(broken)
    assert text.startswith("Browsers load the modules of this page only from a server. Run “python -m http.server”")
    assert text.endswith(f"http://localhost:8000/{name}")
    keep(broken, f"file-{name}")
