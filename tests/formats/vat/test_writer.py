"""Vertex animation textures: what is in the folder, read back number by number, and drawn by a browser."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

import mixseq
from mixseq.creature import walk_cycle
from mixseq.errors import MixseqWarning, OutputError, SettingsError
from mixseq.sequence.sequence import MeshSequence, bounding_diagonal
from mixseq_io.vat.textures import Texels
from mixseq_io.vat.writer import VatReport, write_vat
from tests.formats.gltf_files import validate
from tests.formats.vat.shader import looked_up, told, vertices_of
from tests.meshes import bar, rotation
from tests.viewer.conftest import browser, new_page, page

if TYPE_CHECKING:
    from playwright.sync_api import Page, Route

pytestmark = pytest.mark.slow

__all__ = ["browser", "new_page", "page"]


def test_points_are_as_far_off_as_is_told(written: tuple[Path, VatReport], fox: MeshSequence) -> None:
    folder, report = written
    vertices, diagonal = vertices_of(folder), bounding_diagonal(fox.points[0])
    apart = [
        np.linalg.norm(looked_up(folder, "points", frame) - fox.points[frame][vertices], axis=1).max() / diagonal
        for frame in range(fox.frame_count)
    ]
    assert max(apart) == pytest.approx(report.max_error, rel=1e-3)
    assert max(apart) <= (1e-3 if report.rank else 2e-5)
    assert told(folder)["error"]["max"] == report.max_error


def test_normals_are_as_far_off_as_is_told(written: tuple[Path, VatReport], fox: MeshSequence) -> None:
    folder, report = written
    texels, squares = Texels.from_header(fox.header), []
    for frame in range(fox.frame_count):
        found = looked_up(folder, "normals", frame)
        found /= np.linalg.norm(found, axis=1, keepdims=True)
        expected = texels.normals_of(fox.points[frame][None])[0][np.concatenate(texels.primitive_texels)]
        squares.append(np.square(np.degrees(np.arccos(np.clip(np.sum(found * expected, axis=1), -1, 1)))))
    assert np.sqrt(np.mean(squares)) == pytest.approx(report.normal_degrees, rel=0.02)
    assert report.normal_degrees < (3 if report.rank else 0.3)


def test_low_rank_textures_are_smaller(tmp_path: Path) -> None:
    plain, low = (write_vat(tmp_path / f"{error}.vat", walk_cycle(frames=8), error) for error in (None, 1e-2))
    assert low.memory_bytes < plain.memory_bytes / 2
    assert low.file_bytes < plain.file_bytes / 2
    files = sum(each.stat().st_size for each in (tmp_path / "0.01.vat").glob("*.png"))
    assert files == low.file_bytes


def test_rigid_parts_take_four_basis_vectors_and_normals_are_exact(tmp_path: Path) -> None:
    """Two bars, one of which turns: x' = R x + t, and so do normals."""
    still = bar(frames=1)
    angles = np.linspace(0, 2, 12)
    turned = np.stack([still.points[0] @ rotation((0, 0, angle)).T + [angle, 0, 0] for angle in angles])
    sequence = MeshSequence.from_arrays(turned, still.faces)
    report = write_vat(tmp_path / "bar.vat", sequence, 1e-4)
    assert report.rank <= 4
    assert report.normal_degrees < 0.1


@pytest.mark.parametrize(("max_error", "factor"), [(None, 1), (0.01, 1), (5e-4, 2)])
def test_shaders_join_frames_by_straight_lines(tmp_path: Path, max_error: float | None, factor: int) -> None:
    """A bar turns by a quarter radian per frame about its axis, which is told and held in the steps of the textures."""
    still = bar(frames=1)
    angles = 0.25 * np.arange(5)
    turned = np.stack([still.points[0] @ rotation((0, 0, angle)).T for angle in angles])
    sequence = MeshSequence.from_arrays(turned, still.faces)
    report = write_vat(tmp_path / "bar.vat", sequence, max_error, motion=sequence, between_frames=max_error is not None)
    radius = np.linalg.norm(still.points[0, :, :2], axis=1).max()
    chord = radius * (1 - np.cos(0.25 / 2 / factor)) / sequence.diagonal
    assert report.between_error is not None
    assert abs(report.between_error - chord) <= report.max_error
    metadata = json.loads((tmp_path / "bar.vat" / "vat.json").read_text())
    assert (metadata["frames"] - 1, metadata["fps"]) == (4 * factor, 24 * factor)
    assert metadata["error"]["between"] == report.between_error <= (max_error or 1)


def test_a_bound_between_frames_needs_one_at_frames(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="between_frames is about max_error"):
        write_vat(tmp_path / "bar.vat", bar(frames=3), between_frames=True)


def test_hard_edges_have_texels_of_their_own(tmp_path: Path) -> None:
    still = bar(frames=3)
    corners = np.arange(still.faces.size, dtype=np.int32)  # all flat
    flat = replace(still, surface=replace(still.surface, hard_edges=corners))
    write_vat(tmp_path / "bar.vat", flat)
    assert told(tmp_path / "bar.vat")["texels"] == still.faces.size
    found = looked_up(tmp_path / "bar.vat", "points", 2)
    np.testing.assert_allclose(found, flat.points[2][vertices_of(tmp_path / "bar.vat")], atol=1e-3)


def test_the_mesh(written: tuple[Path, VatReport], fox: MeshSequence) -> None:
    folder, _ = written
    with pytest.warns(MixseqWarning, match="several sets of texture coordinates"):
        shown = mixseq.read(folder / "mesh.glb")
    np.testing.assert_allclose(shown.points[0], fox.points[0], atol=1e-6)
    np.testing.assert_array_equal(shown.faces, fox.faces)
    validate(folder / "mesh.glb")


def test_shaders_have_the_numbers(written: tuple[Path, VatReport]) -> None:
    folder, _ = written
    low = int(told(folder)["kind"] != "plain")
    for name in ("godot.gdshader", "unity.shader", "unreal.hlsl"):
        text = (folder / name).read_text()
        assert "@" not in text
        assert f"LOW_RANK {low}\n" in text or f"#if {low}\n" in text


def test_exr_holds_the_numbers_themselves(fox: MeshSequence, tmp_path: Path) -> None:
    library = pytest.importorskip("OpenEXR")
    report = write_vat(tmp_path / "fox.vat", fox, texture="exr")
    assert report.max_error < 1e-6
    with library.File(str(tmp_path / "fox.vat" / "points.exr")) as file:
        pixels = np.asarray(file.channels()["RGB"].pixels)
    vat = told(tmp_path / "fox.vat")
    rows = pixels.reshape(fox.frame_count, -1, 3)[:, : vat["texels"]]
    expected = fox.points[:, Texels.from_header(fox.header).vertices].astype(np.float32)
    np.testing.assert_array_equal(rows, expected)


def test_what_is_refused(fox: MeshSequence, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(OutputError, match=r"end its name in .vat"):
        write_vat(tmp_path / "fox", fox)
    (tmp_path / "file.vat").write_text("")
    with pytest.raises(OutputError, match="is a file"):
        write_vat(tmp_path / "file.vat", fox)
    with pytest.raises(SettingsError, match="max_error is 0"):
        write_vat(tmp_path / "fox.vat", fox, 0)
    with pytest.raises(SettingsError, match=r"rounding to 16 bits alone.*--texture exr"):
        write_vat(tmp_path / "bar.vat", bar(frames=2), 1e-7)
    with pytest.raises(SettingsError, match="one of png16, exr"):
        write_vat(tmp_path / "fox.vat", fox, texture="bmp")  # type: ignore[arg-type]
    monkeypatch.setattr("mixseq_io.vat.textures.MAX_TEXTURE_SIDE_PIXELS", 16)
    with pytest.raises(SettingsError, match=r"17 frames of .* texels take 17 rows"):
        write_vat(tmp_path / "long.vat", bar(frames=17))
    assert [each.name for each in tmp_path.iterdir()] == ["file.vat"]


DRAWN = """async ([folder, frames]) => {
  const module = await import(folder + "webgl2.js");
  const vat = await module.open(folder);
  const gl = document.createElement("canvas").getContext("webgl2");
  const compiled = (kind, text) => {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    return shader;
  };
  const program = gl.createProgram();
  gl.attachShader(program, compiled(gl.VERTEX_SHADER, `#version 300 es
    ${module.glsl(vat)}
    in vec2 lookup;
    uniform float frame;
    out vec3 point;
    out vec3 normal;
    void main() { point = vatPoint(lookup, frame); normal = vatNormal(lookup, frame); }`));
  gl.attachShader(program, compiled(gl.FRAGMENT_SHADER, `#version 300 es
    void main() {}`));
  gl.transformFeedbackVaryings(program, ["point", "normal"], gl.SEPARATE_ATTRIBS);
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
  const count = vat.texels, lookup = new Float32Array(2 * count);
  for (let texel = 0; texel < count; texel++) {
    lookup[2 * texel] = ((texel % vat.width) + 0.5) / vat.width;
    lookup[2 * texel + 1] = (Math.floor(texel / vat.width) + 0.5) / vat.height;
  }
  const buffer = (data, use) => {
    const made = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, made);
    gl.bufferData(gl.ARRAY_BUFFER, data, use);
    return made;
  };
  buffer(lookup, gl.STATIC_DRAW);
  const place = gl.getAttribLocation(program, "lookup");
  gl.enableVertexAttribArray(place);
  gl.vertexAttribPointer(place, 2, gl.FLOAT, false, 0, 0);
  const out = [0, 1].map(() => buffer(12 * count, gl.STREAM_READ));
  gl.bindBuffer(gl.ARRAY_BUFFER, null);
  module.bind(gl, program, module.textures(gl, vat));
  gl.enable(gl.RASTERIZER_DISCARD);
  const found = frames.map((frame) => {
    gl.uniform1f(gl.getUniformLocation(program, "frame"), frame);
    out.forEach((each, index) => gl.bindBufferBase(gl.TRANSFORM_FEEDBACK_BUFFER, index, each));
    gl.beginTransformFeedback(gl.POINTS);
    gl.drawArrays(gl.POINTS, 0, count);
    gl.endTransformFeedback();
    return out.map((each) => {
      const values = new Float32Array(3 * count);
      gl.bindBuffer(gl.TRANSFORM_FEEDBACK_BUFFER, each);
      gl.getBufferSubData(gl.TRANSFORM_FEEDBACK_BUFFER, 0, values);
      return Array.from(values);
    });
  });
  return { found, error: gl.getError() };
}"""


def serve(page: Page, folder: Path, changed: dict[str, bytes]) -> None:
    """Let a page find the files of a folder, some of them changed."""

    def answer(route: Route) -> None:
        name = route.request.url.rpartition("/")[2]
        file = folder / name
        kind = {".js": "text/javascript", ".json": "application/json"}.get(file.suffix, "application/octet-stream")
        body = changed.get(name) or (file.read_bytes() if file.is_file() else b"<!doctype html>")
        route.fulfill(body=body, content_type=kind if file.is_file() else "text/html")

    page.route("http://127.0.0.1/**", answer)
    page.goto("http://127.0.0.1/page")


OPENED = """async (folder) => {
  const module = await import(folder + "webgl2.js");
  return module.open(folder).then(() => "opened", (error) => error.message);
}"""


def test_a_browser_refuses_hostile_files(written: tuple[Path, VatReport], page: Page) -> None:
    """Neither shaders nor addresses take what is no number or no name, and pictures unpack to what they say."""
    folder, _ = written
    vat, png = told(folder), (folder / "points.png").read_bytes()
    width = vat["textures"]["points"]["width"]
    header = png[:16] + (width + 1).to_bytes(4, "big") + png[20:]
    many = {name: {**each, "width": 16384, "height": 16384} for name, each in vat["textures"].items()}
    elsewhere = vat["textures"] | {"points": {**vat["textures"]["points"], "file": "//example.org/points.png"}}
    scaled = vat["textures"] | {"normals": {**vat["textures"]["normals"], "scale": "1.0); while (true) {}"}}
    hostile = {
        "points.png is not 16384 by 16384": {"vat.json": json.dumps({**vat, "textures": many}).encode()},
        "this PNG ends early": {"points.png": header},
        "this PNG is damaged": {"points.png": png[:16] + b"\xff" * 8 + png[24:]},
    }
    for key, value in [
        ("frames", "1; } void main() { while (true) {} }"), ("rows", -1), ("width", 2**31), ("kind", "__proto__"),
        ("textures", None), ("textures", elsewhere), ("textures", scaled), ("textures", {"a b": {}}),
    ]:  # fmt: skip
        serve(page, folder, {"vat.json": json.dumps({**vat, key: value}).encode()})
        assert "vat.json is damaged" in page.evaluate(OPENED, "http://127.0.0.1/fox.vat/"), key
    for message, changed in hostile.items():
        serve(page, folder, changed)
        assert message in page.evaluate(OPENED, "http://127.0.0.1/fox.vat/")
    serve(page, folder, {})
    assert page.evaluate(OPENED, "http://127.0.0.1/fox.vat/") == "opened"


def test_a_browser_draws_the_frames(written: tuple[Path, VatReport], fox: MeshSequence, page: Page) -> None:
    """At frames, and half-way between two of them, where motion is straight."""
    folder, report = written
    serve(page, folder, {})
    shown = page.evaluate(DRAWN, ["http://127.0.0.1/fox.vat/", [0, 3, 3.5, 7, 9]])
    assert shown["error"] == 0
    vertices, diagonal = Texels.from_header(fox.header).vertices, bounding_diagonal(fox.points[0])
    expected = [
        fox.points[0],
        fox.points[3],
        (fox.points[3] + fox.points[4]) / 2,
        fox.points[7],
        fox.points[7],
    ]
    for (points, normals), wanted in zip(shown["found"], expected, strict=True):
        apart = np.linalg.norm(np.reshape(points, (-1, 3)) - wanted[vertices], axis=1).max() / diagonal
        assert apart <= report.max_error + 1e-6
        np.testing.assert_allclose(np.linalg.norm(np.reshape(normals, (-1, 3)), axis=1), 1, atol=1e-5)
