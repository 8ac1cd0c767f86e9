"""Frames on the graphics card and in a Worker are those of Python."""

from __future__ import annotations

from base64 import b64decode, b64encode
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from mixseq.compression.bitstream.compressed_sequence import CompressedSequence, TemporalInterpolation, decode
from mixseq.compression.encoder.compress import compress
from mixseq.types import Float, FloatArray, IntArray
from mixseq.web import bundled
from tests.compression.test_golden import stored
from tests.meshes import bar
from tests.viewer.conftest import browser, new_page, page
from tests.web.played import write_container

if TYPE_CHECKING:
    from playwright.sync_api import Page

__all__ = ["browser", "new_page", "page"]  # fixtures

pytestmark = pytest.mark.slow

NEAR = 2e-6
"""Diagonals that positions may be off by: sums of float32."""

START = """([text, coding, streams]) => {
  const bytes = (packed) => Uint8Array.from(atob(packed), (letter) => letter.charCodeAt(0));
  globalThis.packed = (array) => {
    let letters = "";
    for (const byte of new Uint8Array(array.buffer)) letters += String.fromCharCode(byte);
    return btoa(letters);
  };
  globalThis.address = URL.createObjectURL(new Blob([text], { type: "text/javascript" }));
  globalThis.given = [coding, bytes(streams)];
  return import(address).then((module) => { globalThis.mixseq = module; });
}"""

DRAWN = """async ([times, vertices, groups]) => {
  const sequence = await mixseq.open(...given), gl = document.createElement("canvas").getContext("webgl2");
  const named = vertices && new Map(vertices.map((vertex, k) => [vertex, k]));
  const triangles = vertices ? sequence.triangles().map((vertex) => named.get(vertex)) : sequence.triangles();
  const card = mixseq.fieldTextures(gl, sequence.fields(), triangles, ...(vertices ? [vertices, groups] : []));
  const read = (buffer, size) => {
    const values = new Float32Array(size * card.count);
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.getBufferSubData(gl.ARRAY_BUFFER, 0, values);
    return packed(values);
  };
  const frames = times.map((time) => {
    card.evaluate(sequence.weights(time), sequence.residuals(time));
    return [read(card.positions, 4), read(card.normals, 3)];
  });
  card.dispose();
  return { frames, error: gl.getError(), there: gl.isBuffer(card.positions) };
}"""


def golden(name: str) -> CompressedSequence:
    """A golden sequence that tells what it is between frames: these do not."""
    return replace(stored(name)[0], between=TemporalInterpolation(2.0, (0.2, 0.9)))


def opened(page: Page, folder: Path, coded: CompressedSequence | Path) -> None:
    """Have a page load the decoder, and what it decodes."""
    write_container(folder, coded)
    page.route(
        "http://127.0.0.1/*", lambda route: route.fulfill(body="<title>player</title>", content_type="text/html")
    )
    page.goto("http://127.0.0.1/")  # Workers need an origin
    streams = b64encode((folder / "streams").read_bytes()).decode()
    modules = ("decoder/sequence.js", "player/field_textures.js", "player/remote.js")
    page.evaluate(START, [bundled(*modules), (folder / "text").read_text("ascii"), streams])


def drawn(page: Page, times: Float, *vertices: list[int]) -> tuple[FloatArray, FloatArray]:
    """Positions and normals ``(T, V, 3)`` that the graphics card has."""
    told = page.evaluate(DRAWN, [times.tolist(), *(vertices or (None, None))])
    assert told["error"] == 0
    assert not told["there"]
    positions, normals = (
        np.array([np.frombuffer(b64decode(each), "<f4").reshape(-1, size) for each in frames])
        for frames, size in zip(zip(*told["frames"], strict=True), (4, 3), strict=True)
    )
    assert (positions[..., 3] == 1).all()
    return positions[..., :3], normals


def times_of(coded: CompressedSequence) -> Float:
    """Some frames, and times between."""
    times = coded.header.times
    between = np.random.default_rng(0).uniform(times[0], times[-1], 5)
    return np.append(times[:: max(len(times) // 8, 1)], between)


def normals_of(points: FloatArray, faces: IntArray) -> Any:
    """Sums of the normals of triangles by area, of length one."""
    sums = np.zeros_like(points)
    a, b, c = points[faces].transpose(1, 0, 2)
    for corner in range(3):
        np.add.at(sums, faces[:, corner], np.cross(b - a, c - a))
    return sums / np.linalg.norm(sums, axis=1, keepdims=True)


def frames_of(coded: CompressedSequence, times: Float) -> Float:
    return np.concatenate(list(decode(coded).blocks(times)))


@pytest.mark.parametrize("name", ["bounded", "shapes", "long", "parts"])
def test_frames_on_the_graphics_card(page: Page, tmp_path: Path, name: str) -> None:
    coded = golden(name)
    opened(page, tmp_path, coded)
    positions, _ = drawn(page, times_of(coded))
    apart = np.abs(positions - frames_of(coded, times_of(coded)))
    assert apart.max() < NEAR * coded.parameters.diagonal


def test_normals_on_the_graphics_card(page: Page, tmp_path: Path) -> None:
    coded = compress(bar(), max_error=1e-3)
    opened(page, tmp_path, coded)
    positions, normals = drawn(page, coded.header.times)
    for points, found in zip(positions, normals, strict=True):
        np.testing.assert_allclose(found, normals_of(points.astype(np.float64), coded.header.faces), atol=2e-5)


def test_vertices_that_are_cut_along_seams(page: Page, tmp_path: Path) -> None:
    """Every other vertex comes twice: once with the normal of its vertex, once with one of its own triangles only."""
    coded = compress(bar(), max_error=1e-3)
    opened(page, tmp_path, coded)
    count = coded.header.vertex_count
    vertices = [*range(count), *range(0, count, 2)]
    whole, whole_normals = drawn(page, coded.header.times)
    positions, normals = drawn(page, coded.header.times, vertices, vertices)
    np.testing.assert_array_equal(positions, whole[:, vertices])
    np.testing.assert_allclose(normals, whole_normals[:, vertices], atol=1e-6)
    # the triangles have the later ones, so the earlier ones have none when they are groups of their own
    _, apart = drawn(page, coded.header.times, vertices, list(range(len(vertices))))
    np.testing.assert_array_equal(apart[:, :count:2], np.broadcast_to([0, 0, 1], apart[:, :count:2].shape))
    np.testing.assert_allclose(apart[:, count:], whole_normals[:, :count:2], atol=1e-6)


def test_a_worker_decodes(page: Page, tmp_path: Path) -> None:
    coded = golden("long")
    opened(page, tmp_path, coded)
    told = page.evaluate(
        """async (times) => {
          const remote = await mixseq.openRemote(...given, address), shares = [], before = remote.at(times[0]);
          await Promise.all([remote.decode((share) => shares.push(share)), before]);
          const frames = await Promise.all(times.map(async (time) => packed(await remote.at(time))));
          const triangles = packed(await remote.triangles()), { count } = await remote.fields();
          remote.close();
          return { frames, shares, triangles, count, vertexCount: remote.vertexCount, times: packed(remote.times) };
        }""",
        times_of(coded).tolist(),
    )
    frames = np.array([np.frombuffer(b64decode(each), "<f4") for each in told["frames"]])
    apart = np.abs(frames.reshape(len(frames), -1, 3) - frames_of(coded, times_of(coded)))
    assert apart.max() < NEAR * coded.parameters.diagonal
    assert told["vertexCount"] == coded.header.vertex_count
    np.testing.assert_array_equal(np.frombuffer(b64decode(told["times"])), coded.header.times)
    faces = np.frombuffer(b64decode(told["triangles"]), "<u4").reshape(-1, 3)
    np.testing.assert_array_equal(faces, coded.header.faces)
    assert len(told["shares"]) == 1 + len(coded.chunks)
    assert sorted(told["shares"]) == told["shares"]
    assert told["shares"][-1] == pytest.approx(1)


@pytest.mark.parametrize("method", ["open", "frame"])
def test_what_is_wrong_in_a_worker_is_told(page: Page, tmp_path: Path, method: str) -> None:
    """Bytes with a mistake do not open; a frame at no time is refused, and the Worker goes on."""
    opened(page, tmp_path, golden("parts"))
    told = page.evaluate(
        """async (method) => {
          const kept = (error) => [error instanceof mixseq.MixseqError, error.message];
          if (method === "open") given[1][given[1].length - 9] ^= 1;
          const remote = await mixseq.openRemote(...given, address).catch(kept);
          if (method === "open") return remote;
          const wrong = await remote.frame("none").catch(kept), right = await remote.frame(0);
          remote.close();
          return [...wrong, right.length, await remote.frame(0).catch(kept)];
        }""",
        method,
    )
    assert told[0]
    assert "damaged" in told[1] if method == "open" else "number" in told[1]
    if method == "frame":
        assert told[2] == 3 * golden("parts").header.vertex_count
        assert told[3] == [True, "the sequence was closed"]
