"""The plugin for three.js shows Python's frames, whatever three.js it is, and the pages play."""

from __future__ import annotations

from base64 import b64decode
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from numpy.typing import NDArray

import mixseq
from mixseq.choices import StillName
from mixseq.compression.compressed_model import CompressedModel
from mixseq.mesh.measures import corner_normals
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import CornerValues, Surface
from mixseq.pictures.scene import CLAY_COLOUR
from mixseq.sequence.sequence import MeshSequence
from tests.formats.gltf.test_mesh_sequences import dressed_bar, needs_draco
from tests.meshes import bar
from tests.viewer.conftest import Keep, browser, keep, new_page, page
from tests.web.site import ADDRESS, serve, three

if TYPE_CHECKING:
    from playwright.sync_api import Page

__all__ = ["browser", "keep", "new_page", "page"]  # fixtures

pytestmark = pytest.mark.slow

NEAR = 2e-6
"""Diagonals that positions may be off by: sums of float32."""

LOAD = """async () => {
  const { GLTFLoader } = await import("three/addons/loaders/GLTFLoader.js"), THREE = await import("three");
  const { MeshSequencePlugin, meshSequences } = await import("./mesh_sequence.js");
  const loader = new GLTFLoader();
  loader.register((parser) => new MeshSequencePlugin(parser));
  const gltf = await loader.loadAsync("walk.glb");
  const packed = (array) => {
    const bytes = new Uint8Array(array.buffer, array.byteOffset, array.byteLength);
    return btoa(Array.from(bytes, (byte) => String.fromCharCode(byte)).join(""));
  };
  const renderer = new THREE.WebGLRenderer({ preserveDrawingBuffer: true }), gl = renderer.getContext();
  const read = (buffer, size, count) => {
    const values = new Float32Array(size * count);
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.getBufferSubData(gl.ARRAY_BUFFER, 0, values);
    return packed(values);
  };
  Object.assign(globalThis, { THREE, gltf, shots: meshSequences(gltf.scene), packed, renderer, gl, read });
  globalThis.shot = shots[0];
}"""

FACTS = """() => ({
  shots: shots.length, name: shot.name, duration: shot.duration, children: gltf.scene.children.length,
  vertices: packed(shot.drawn.vertices), triangles: packed(shot.geometry.index.array),
  uvs: shot.geometry.attributes.uv ? packed(shot.geometry.attributes.uv.array) : null,
  groups: shot.geometry.groups, materials: [shot.material].flat().map(({ name, metalness }) => [name, metalness]),
  matrix: shot.matrixWorld ? (gltf.scene.updateMatrixWorld(), shot.matrixWorld.elements) : null,
})"""

NUMBERS = """(times) => times.map((time) => {
  const { position, normal } = shot.update(time).geometry.attributes;
  return [packed(position.array), packed(normal.array)];
})"""

CARD = """(times) => times.map((time) => {
  shot.update(time, renderer);
  const { position, normal } = shot.geometry.attributes;
  return [read(position.buffer, 4, position.count), read(normal.buffer, 3, normal.count)];
})"""


def floats(text: str, width: int) -> NDArray[np.float32]:
    return np.frombuffer(b64decode(text), "<f4").reshape(-1, width)


def opened(page: Page, file: Path, kind: str = "trimesh") -> dict[str, Any]:
    """Load a file with the plugin, and return what is known of it."""
    head, files = three(kind)
    serve(page, {**files, "walk.glb": file.read_bytes(), "index.html": f"<!doctype html><body>{head}"})
    page.goto(f"{ADDRESS}index.html")
    page.evaluate(LOAD)
    facts: dict[str, Any] = page.evaluate(FACTS)
    return facts


def moments(model: mixseq.Model) -> NDArray[np.float64]:
    """Every frame, and times between, before and after."""
    first, last = model.times[[0, -1]]
    between = np.random.default_rng(0).uniform(first, last, 9)
    return np.concatenate([model.times, between, [first - 1, last + 1]])


def late(sequence: MeshSequence) -> MeshSequence:
    """The same, from frame 1001 on."""
    return replace(sequence, times=sequence.times + 1001 / sequence.fps)


@pytest.fixture(scope="module")
def sequence() -> MeshSequence:
    return late(dressed_bar())


@pytest.mark.parametrize(
    ("still", "kind"), [("plain", "trimesh"), ("draco", "trimesh"), ("none", "trimesh"), ("plain", "npm")]
)
def test_frames_are_those_of_python(
    page: Page, tmp_path: Path, sequence: MeshSequence, still: StillName, kind: str
) -> None:
    needs_draco(still)
    file = tmp_path / "walk.glb"
    mixseq.save(file, mixseq.compress(sequence, max_error=1e-3), still=still)
    model = mixseq.load(file)
    assert isinstance(model, CompressedModel)
    facts = opened(page, file, kind)
    assert facts["shots"] == facts["children"] == 1
    assert facts["duration"] == pytest.approx(sequence.times[-1] - sequence.times[0], rel=1e-12)
    vertices = np.frombuffer(b64decode(facts["vertices"]), "<u4")
    drawn = np.frombuffer(b64decode(facts["triangles"]), "<u4").reshape(-1, 3)
    header = model.header
    np.testing.assert_array_equal(vertices[drawn], header.faces)
    corners = Polygons(header.polygons.counts, np.arange(header.polygons.indices.size)).triangles
    uvs = header.surface.uvs
    assert uvs is not None
    np.testing.assert_array_equal(
        floats(facts["uvs"], 2)[drawn],
        np.array([0, 1], np.float32) + uvs.at_corners[corners] * np.array([1, -1], np.float32),
    )
    hard = header.surface.hard_edges
    assert hard is not None
    assert len(vertices) == len(np.unique(np.column_stack([header.polygons.indices, hard, uvs.indices]), axis=0))
    times = moments(model)
    for script, width in ((NUMBERS, 3), (CARD, 4)):
        frames = page.evaluate(script, (times - header.times[0]).tolist())
        for time, (positions, normals) in zip(times, frames, strict=True):
            points = model.playback(np.clip(time, *header.times[[0, -1]]))
            apart = np.abs(floats(positions, width)[:, :3] - points[vertices])
            assert apart.max() < NEAR * sequence.diagonal
            expected = corner_normals(points[None], header.polygons, hard)[0][hard[corners]]
            np.testing.assert_allclose(floats(normals, 3)[drawn], expected, atol=1e-4)


COUNT = """globalThis.answers = 0;
globalThis.Worker = class extends Worker {
  constructor(...given) {
    super(...given);
    this.addEventListener("message", ({ data }) => (globalThis.answers += data.error === undefined));
  }
};"""


def test_a_worker_decodes_for_the_page(page: Page, tmp_path: Path) -> None:
    """It opens the file, and sends what is drawn and every chunk."""
    file = tmp_path / "walk.glb"
    coded = mixseq.compress(bar(8, 25, 40), max_error=1e-4, chunk=16)
    mixseq.save(file, coded, still="none")
    chunks = len(coded.chunks)
    assert chunks > 1
    page.add_init_script(COUNT)
    opened(page, file)
    page.wait_for_function(f"answers === {2 + chunks}")
    assert page.evaluate("shot.sequence.chunks.every(({ loaded }) => loaded)")


STOPS = (
    "throw new Error()",
    "this.terminate = this.postMessage = () => {}; setTimeout(() => this.onerror({ message: '' }))",
)


@pytest.mark.parametrize("fails", STOPS)
def test_without_workers_the_page_decodes(page: Page, tmp_path: Path, fails: str) -> None:
    file = tmp_path / "walk.glb"
    mixseq.save(file, mixseq.compress(bar(), max_error=1e-3), still="none")
    page.add_init_script(f"globalThis.Worker = class {{ constructor() {{ {fails}; }} }};")
    assert opened(page, file)["shots"] == 1


def test_materials_and_place(page: Page, tmp_path: Path, sequence: MeshSequence) -> None:
    file = tmp_path / "walk.glb"
    mixseq.save(file, mixseq.compress(sequence, max_error=1e-3), still="none")
    facts = opened(page, file)
    assert facts["name"] == "Stange"
    assert [name for name, _ in facts["materials"]] == ["skin", "felt"]
    counts = 3 * (sequence.polygons.counts - 2)
    third, half = len(counts) // 3, len(counts) // 2
    assert [(each["start"], each["count"], each["materialIndex"]) for each in facts["groups"]] == [
        (0, counts[:third].sum(), 0),
        (counts[:third].sum(), counts[third:half].sum(), 1),
        (counts[:half].sum(), counts[half:].sum(), 0),
    ]
    matrix = np.reshape(facts["matrix"], (4, 4)).T  # Z is up, in centimetres
    np.testing.assert_allclose(matrix @ [0, 0, 1, 1], [0, 0.01, 0, 1], atol=1e-9)


def test_colours_of_vertices_are_drawn(page: Page, tmp_path: Path) -> None:
    """One polygon is red, and cut off; the others have colours at their vertices."""
    sequence = bar()
    shades = np.arange(sequence.vertex_count) % 256 / 255
    values = np.column_stack([shades, 1 - shades, shades, np.ones_like(shades)])
    indices = np.array(sequence.polygons.indices)
    indices[: sequence.polygons.counts[0]] = sequence.vertex_count
    colours = CornerValues(np.vstack([values, [1, 0, 0, 0.5]]), indices)
    sequence = replace(sequence, surface=Surface(colours=colours))
    mixseq.save(tmp_path / "walk.glb", mixseq.compress(sequence, max_error=1e-3), still="none")
    facts = opened(page, tmp_path / "walk.glb")
    header = mixseq.load(tmp_path / "walk.glb").header
    drawn = np.frombuffer(b64decode(facts["triangles"]), "<u4")
    painted = header.surface.colours
    assert painted is not None and header.polygons.only_triangles
    found = floats(page.evaluate("() => packed(shot.geometry.attributes.color.array)"), 4)
    np.testing.assert_array_equal(found[drawn], painted.at_corners)
    assert page.evaluate("() => [shot.material.vertexColors, shot.material.color.getHex()]") == [True, 0xFFFFFF]


def test_copies_have_moments_of_their_own(page: Page, tmp_path: Path) -> None:
    file = tmp_path / "walk.glb"
    mixseq.save(file, mixseq.compress(bar(), max_error=1e-3), still="plain")
    facts = opened(page, file)
    assert (facts["uvs"], facts["groups"]) == (None, [])
    apart = page.evaluate(
        """() => {
          const copy = shot.clone(), { array } = copy.update(copy.duration).geometry.attributes.position;
          const own = shot.update(0).geometry.attributes.position.array;
          return [own.some((value, k) => value !== array[k]), copy.isMeshSequence, copy.material === shot.material];
        }"""
    )
    assert apart == [True, True, True]


def test_meshes_stay_on_the_graphics_card(page: Page, tmp_path: Path) -> None:
    file = tmp_path / "walk.glb"
    mixseq.save(file, mixseq.compress(bar(), max_error=1e-3), still="plain")
    opened(page, file)
    told = page.evaluate(
        """() => {
          shot.update(0, renderer);
          try { shot.update(0); } catch (error) { return error.message; }
        }"""
    )
    assert told == "this mesh is on the graphics card; give update its renderer, too"


def test_it_is_drawn(page: Page, tmp_path: Path, keep: Keep) -> None:
    """The bar covers pixels, others at the end than at the beginning, the same by either path."""
    file = tmp_path / "walk.glb"
    mixseq.save(file, mixseq.compress(bar(), max_error=1e-3), still="plain")
    opened(page, file)
    pictures = page.evaluate(
        """() => {
          const scene = new THREE.Scene(), camera = new THREE.PerspectiveCamera(40, 1, 0.1, 100);
          scene.add(gltf.scene);
          shot.material.emissive?.set(0xffffff);
          camera.position.set(0, 0, 12);
          renderer.setSize(200, 200);
          document.body.append(renderer.domElement);
          const picture = (...given) => {
            shot.update(...given);
            renderer.render(scene, camera);
            const pixels = new Uint8Array(4 * 200 * 200);
            gl.readPixels(0, 0, 200, 200, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
            return packed(pixels);
          };
          const times = [0, shot.duration], numbers = times.map((time) => picture(time));
          return [...numbers, ...times.map((time) => picture(time, renderer))];
        }"""
    )
    keep(page, "three")
    first, last, card_first, card_last = (
        np.frombuffer(b64decode(each), np.uint8).reshape(200, 200, 4)[..., :3].max(axis=2) > 100 for each in pictures
    )
    assert 500 < first.sum() < 20_000
    assert (first != last).sum() > 200
    assert (first != card_first).sum() < 20
    assert (last != card_last).sum() < 20


def test_other_meshes_are_loaded_as_ever(page: Page, tmp_path: Path) -> None:
    mixseq.write(tmp_path / "walk.glb", bar(8, 25, 1))
    head, files = three("trimesh")
    served = {**files, "walk.glb": (tmp_path / "walk.glb").read_bytes()}
    serve(page, {**served, "index.html": f"<!doctype html><body>{head}"})
    page.goto(f"{ADDRESS}index.html")
    page.evaluate(LOAD)
    assert page.evaluate("() => [shots.length, gltf.scene.children[0].isMesh]") == [0, True]


@pytest.mark.parametrize("coloured", [False, True])
def test_the_page_without_three_draws_colours(page: Page, coloured: bool, tmp_path: Path, keep: Keep) -> None:
    """A bar that is half red: linear 0.5 is 188 in sRGB, times a light of at most 1.22. Without colours it is clay."""
    image = pytest.importorskip("PIL.Image")
    sequence = bar(8, 25, 2)
    if coloured:
        red = np.tile([0.5, 0, 0, 1], (sequence.vertex_count, 1))
        surface = Surface(colours=CornerValues(red, sequence.polygons.indices))
        sequence = replace(sequence, surface=surface)
    mixseq.save(tmp_path / "shot.glb", mixseq.compress(sequence, max_error=1e-3), still="none")
    serve(page, {"shot.glb": (tmp_path / "shot.glb").read_bytes()})
    page.goto(f"{ADDRESS}player.html")
    page.wait_for_function("globalThis.shown > 0")
    keep(page, "player-colours")
    seen = np.asarray(image.open(BytesIO(page.locator("canvas").screenshot())).convert("RGB")).astype(int)
    if not coloured:
        clay = seen[seen[..., 0] > seen[..., 2] + 8]  # the ground is grey
        assert len(clay) > 500
        # shade is cooler, by up to a tenth
        assert np.abs(clay / clay[:, :1] - np.array(CLAY_COLOUR) / CLAY_COLOUR[0]).mean() < 0.03
        return
    reds = seen[(seen[..., 0] > 60) & (seen[..., 1:] < 8).all(axis=-1)]
    assert len(reds) > 500
    assert 150 < reds[:, 0].max() <= 230


@pytest.mark.parametrize("name", ["player.html", "example.html"])
def test_pages_play(page: Page, tmp_path: Path, keep: Keep, name: str, sequence: MeshSequence) -> None:
    file = tmp_path / "shot.glb"
    mixseq.save(file, mixseq.compress(sequence, max_error=1e-3), still="plain")
    added: dict[str, str | bytes] = {"shot.glb": file.read_bytes()}
    if name == "example.html":
        _, files = three("npm")
        added |= files
        added |= {f"node_modules/{path}": text for path, text in files.items()} | {
            "node_modules/three/package.json": "{}"
        }
    serve(page, added)
    page.goto(f"{ADDRESS}{name}")
    page.wait_for_function("parseFloat(document.querySelector('output')?.textContent) > 0")
    page.get_by_role("button", name="Pause").click()
    half = (sequence.times[-1] - sequence.times[0]) / 2
    page.locator("input").fill(str(half))
    page.wait_for_function(
        f"document.querySelector('output').textContent.endsWith(' {sequence.times[0] + half:.3f} s')"
    )
    page.keyboard.press("Home")
    page.wait_for_function(f"document.querySelector('output').textContent.endsWith(' {sequence.times[0]:.3f} s')")
    assert page.get_by_role("button", name="Play").is_visible()
    keep(page, name.removesuffix(".html"))
