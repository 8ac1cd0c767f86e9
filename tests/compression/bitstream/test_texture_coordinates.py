"""Texture coordinates come back exactly, small, and from the same bytes for ever."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from mixseq.compression.bitstream.corner_values import MAX_COORDINATE, code_uvs, decode_uvs, from_grid, to_grid
from mixseq.compression.bitstream.corners import MAX_SEARCHED_NODES
from mixseq.compression.encoder.uvs import encode_uvs
from mixseq.errors import FormatError
from mixseq.mesh.polygons import Polygons
from mixseq.types import FloatArray
from tests.compression.bitstream.test_connectivity import polygons_of
from tests.meshes import flipped, grid, joined, pages, tetrahedron, torus, tube

pytestmark = pytest.mark.slow

GOLDEN = Path(__file__).parents[1] / "golden" / "uvs.npz"


def there_and_back(polygons: Polygons, numbers: NDArray[np.int64], steps: int = 1000) -> tuple[int, int]:
    """Return how many bytes there are, and nodes."""
    count = int(polygons.indices.max()) + 1
    data = encode_uvs(polygons, count, numbers)
    found = decode_uvs(data, polygons, count, steps)
    np.testing.assert_array_equal(found.at_corners, from_grid(numbers, steps))
    return len(data), len(found.values)


def numbers_of(polygons: Polygons, seed: int = 0) -> NDArray[np.int64]:
    """Coordinates of vertices at random, and a few corners of others."""
    rng = np.random.default_rng(seed)
    numbers = rng.integers(-500, 1500, (int(polygons.indices.max()) + 1, 2))[polygons.indices]
    some = rng.random(len(numbers)) < 0.1
    numbers[some] = rng.integers(0, 1000, (some.sum(), 2))
    return numbers


MESHES = {
    "tetrahedron": tetrahedron()[1],
    "tube": tube(8, 25)[1],
    "torus": torus(20, 9)[1],
    "three at an edge": pages(3)[1],
    "several components": joined(tube(6, 9), tetrahedron(), tube(5, 7))[1],
    "turned over": flipped(tube(8, 25)[1]),
    "in no order": np.random.default_rng(2).permutation(torus(20, 9)[1]),
}


@pytest.mark.parametrize("faces", MESHES.values(), ids=MESHES.keys())
def test_any_coordinates_come_back(faces: NDArray[np.int64]) -> None:
    polygons = Polygons.from_triangles(faces)
    there_and_back(polygons, numbers_of(polygons))


@pytest.mark.parametrize(
    "polygons",
    [
        polygons_of([0, 1, 2, 3], [3, 2, 4], [2, 1, 5, 6, 7, 4], [0, 3, 8]),
        polygons_of([0, 0, 0], [4, 4, 1], [1, 4, 4]),
        polygons_of(*[[0, 1, 2]] * 5),
        polygons_of(*[[0, i, i + 1] for i in range(1, 200, 2)]),
    ],
    ids=["mixed", "degenerate", "the same", "a hundred at a vertex"],
)
def test_odd_polygons_come_back(polygons: Polygons) -> None:
    there_and_back(polygons, numbers_of(polygons))
    corners = len(polygons.indices)
    _, nodes = there_and_back(polygons, np.stack([np.arange(corners), np.zeros(corners, int)], axis=1))
    assert nodes == corners
    there_and_back(polygons, np.full((corners, 2), MAX_COORDINATE) * [1, -1])


def test_more_nodes_at_a_vertex_than_are_looked_at() -> None:
    polygons = polygons_of(*[[0, 2 * i + 1, 2 * i + 2] for i in range(2 * MAX_SEARCHED_NODES)] * 2)
    numbers = np.zeros((len(polygons.indices), 2), dtype=np.int64)
    numbers[:, 0] = np.tile(np.arange(len(numbers) // 2), 2)
    there_and_back(polygons, numbers)


@st.composite
def textured(draw: st.DrawFn) -> tuple[Polygons, NDArray[np.int64]]:
    face = st.lists(st.integers(0, 8), min_size=3, max_size=6)
    polygons = polygons_of(*draw(st.lists(face, min_size=1, max_size=15)))
    pair = st.tuples(st.integers(0, 3), st.sampled_from([0, 1, 700, MAX_COORDINATE]))
    size = len(polygons.indices)
    return polygons, np.array(draw(st.lists(pair, min_size=size, max_size=size)))


@given(textured())
@settings(max_examples=50, deadline=None)
def test_any_coordinates_on_any_polygons_come_back(mesh: tuple[Polygons, NDArray[np.int64]]) -> None:
    there_and_back(*mesh)


# How small --------------------------------------------------------------------------------------------------


def plane(rows: int, columns: int) -> tuple[Polygons, NDArray[np.int64]]:
    points, faces = grid(rows, columns)
    uvs = np.rint(points[:, :2] / points[:, :2].max() * 4000).astype(np.int64)
    return Polygons.from_triangles(faces), uvs


def bumpy(uvs: NDArray[np.int64], size: float = 40.0) -> NDArray[np.int64]:
    return uvs + np.rint(np.random.default_rng(1).normal(size=uvs.shape) * size).astype(np.int64)


def test_a_plane_costs_nearly_nothing() -> None:
    polygons, uvs = plane(60, 70)
    size, nodes = there_and_back(polygons, uvs[polygons.indices])
    assert nodes == len(uvs)
    assert size < 0.25 * nodes


@pytest.mark.parametrize("turn", [1, 1j, 0.5 * np.exp(0.4j)], ids=["moved", "turned", "smaller"])
@pytest.mark.parametrize("mirrored", [False, True])
def test_copies_cost_little(turn: complex, mirrored: bool) -> None:
    """Two pieces of the same shape take little more than one, however the second one was packed."""
    polygons, uvs = plane(12, 15)
    uvs = bumpy(uvs)
    at = uvs @ [1, 1j]
    away = turn * (np.conj(at) if mirrored else at) + 7000 + 300j
    faces = polygons.triangles[:, ::-1] if mirrored else polygons.triangles
    both = Polygons.from_triangles(np.concatenate([polygons.triangles, faces + len(uvs)]))
    copied = np.rint(np.stack([away.real, away.imag], axis=1)).astype(np.int64)
    one, _ = there_and_back(polygons, uvs[polygons.indices])
    two, _ = there_and_back(both, np.concatenate([uvs, copied])[both.indices])
    assert two < 1.5 * one


# From the same bytes ----------------------------------------------------------------------------------------


def golden_uvs() -> tuple[Polygons, NDArray[np.int64]]:
    """Two bumpy pieces, one the mirror image of the other, of triangles and quads, with a seam."""
    polygons, uvs = plane(8, 9)
    uvs = bumpy(uvs, 15.0)
    copy = uvs * [-1, 1] + [9000, 0]
    ring = tube(5, 4)[1]
    faces: list[NDArray[np.integer]] = [polygons.triangles, polygons.triangles[:, ::-1] + len(uvs), ring + 2 * len(uvs)]
    quads = np.array([[0, 1, 2, 3], [3, 2, 4, 5], [1, 6, 7, 2]]) + 2 * len(uvs) + int(ring.max()) + 1
    triangles = np.concatenate(faces)
    whole = Polygons(
        np.concatenate([np.full(len(triangles), 3), np.full(len(quads), 4)]),
        np.concatenate([triangles.reshape(-1), quads.reshape(-1)]),
    )
    rest = int(whole.indices.max()) + 1 - 2 * len(uvs)
    values = np.concatenate([uvs, copy, np.stack([np.arange(rest) * 37 % 500, np.arange(rest) * 11], axis=1)])
    numbers = values[whole.indices]
    numbers[2 * polygons.indices.size :: 7] += [2000, 50]
    return whole, numbers


def stored_uvs() -> tuple[FloatArray, FloatArray]:
    """Return what golden coordinates decode to, and what they were ``(C, 2)``."""
    with np.load(GOLDEN) as stored:
        polygons, steps = Polygons(stored["counts"], stored["indices"]), int(stored["steps"])
        found = decode_uvs(stored["data"].tobytes(), polygons, int(stored["indices"].max()) + 1, steps)
        return found.at_corners, stored["at_corners"]


def test_golden_bytes_decode_to_the_same_coordinates() -> None:
    np.testing.assert_array_equal(*stored_uvs())


BYTES = (459, "e8268d98827d25f4")


def test_bytes_stay_the_same() -> None:
    """A change here is a change of the file format."""
    polygons, numbers = golden_uvs()
    data = code_uvs(polygons, int(polygons.indices.max()) + 1, numbers).data
    assert (len(data), hashlib.sha256(data).hexdigest()[:16]) == BYTES


# Refusals ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kept", [0, 3, 16, -4, -1])
def test_truncated_data_are_refused_or_harmless(kept: int) -> None:
    polygons, numbers = golden_uvs()
    refused_or_harmless(encode_uvs(polygons, int(polygons.indices.max()) + 1, numbers)[:kept], polygons)


def test_bits_of_another_mesh_are_refused() -> None:
    polygons, numbers = golden_uvs()
    data = encode_uvs(polygons, int(polygons.indices.max()) + 1, numbers)
    with pytest.raises(FormatError, match="are damaged; restore the file"):
        decode_uvs(data, Polygons(polygons.counts, np.roll(polygons.indices, 5)), len(data), 10)


@given(st.binary(max_size=200))
@settings(max_examples=100, deadline=None)
def test_any_bytes_are_refused_or_harmless(data: bytes) -> None:
    refused_or_harmless(data, Polygons.from_triangles(tetrahedron()[1]))


@given(st.lists(st.tuples(st.integers(0, 10**6), st.integers(1, 255)), min_size=1, max_size=4))
@settings(max_examples=50, deadline=None)
def test_changed_bytes_are_refused_or_harmless(changes: list[tuple[int, int]]) -> None:
    polygons, _ = golden_uvs()
    with np.load(GOLDEN) as stored:
        data = bytearray(stored["data"].tobytes())
    for place, by in changes:
        data[place % len(data)] ^= by
    refused_or_harmless(bytes(data), polygons)


def refused_or_harmless(data: bytes, polygons: Polygons) -> None:
    """Other bytes are damaged data, or coordinates that are finite."""
    try:
        found = decode_uvs(data, polygons, int(polygons.indices.max()) + 1, 1000)
    except FormatError:
        return
    assert len(found.indices) == len(polygons.indices)
    assert (np.abs(found.values) <= MAX_COORDINATE / 1000 + 1).all()


# The grid ---------------------------------------------------------------------------------------------------


def test_numbers_of_coordinates() -> None:
    numbers = np.array([[0, 1], [333, -7], [1 << 22, 3]])
    found = to_grid(from_grid(numbers, 999), 999)
    assert found is not None
    assert found.tolist() == numbers.tolist()
    for wrong in (0.3, np.nan, np.inf, 1e9):
        assert to_grid(np.array([[0.5, wrong]], dtype=np.float32), 4) is None


if __name__ == "__main__":
    mesh, corners = golden_uvs()
    vertices = int(mesh.indices.max()) + 1
    coded = encode_uvs(mesh, vertices, corners)
    np.savez_compressed(
        GOLDEN,
        counts=mesh.counts,
        indices=mesh.indices,
        steps=5000,
        data=np.frombuffer(coded, dtype=np.uint8),
        at_corners=decode_uvs(coded, mesh, vertices, 5000).at_corners,
    )
