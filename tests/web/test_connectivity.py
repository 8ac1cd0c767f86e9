"""Polygons that Python coded come out of JavaScript as they went in, and damage ends in one error."""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest

from mixseq.compression.bitstream.connectivity import decode_polygons, encode_polygons
from mixseq.mesh.polygons import Polygons
from tests.compression.bitstream.test_connectivity import polygons_of
from tests.compression.bitstream.test_polygon_walk import quads
from tests.meshes import flipped, grid, joined, pages, tetrahedron, torus, tube
from tests.web.conftest import Node

GOLDEN = Path(__file__).parents[1] / "compression" / "golden"

Case = tuple[Polygons, int]

DECODE = """
import { readFileSync } from "fs";
import { decodePolygons } from "decoder/connectivity.js";
import { MixseqError } from "decoder/errors.js";
const told = [];
for (const [bytes, ...counts] of JSON.parse(readFileSync(process.argv[2]))) {
  try {
    const mesh = decodePolygons(Uint8Array.from(Buffer.from(bytes, "base64")), ...counts);
    told.push([[...mesh.counts], [...mesh.corners]]);
  } catch (error) {
    if (!(error instanceof MixseqError)) throw error;
    told.push(error.message);
  }
}
console.log(JSON.stringify(told));
"""


def shuffled(polygons: Polygons, seed: int) -> Polygons:
    """Polygons and vertices in no order, each polygon begun anywhere."""
    random = np.random.default_rng(seed)
    rows = np.split(polygons.indices, np.cumsum(polygons.counts)[:-1])
    order, numbers = random.permutation(len(rows)), random.permutation(polygons.indices.max() + 1)
    corners = np.concatenate([np.roll(rows[each], random.integers(9)) for each in order])
    return Polygons(polygons.counts[order], numbers[corners])


def soups(count: int) -> Iterator[Polygons]:
    """Polygons of any vertices: edges of many, vertices twice in one, the same ones again."""
    random = np.random.default_rng(count)
    for _ in range(count):
        counts = random.integers(3, 9, random.integers(1, 60))
        yield Polygons(counts, random.integers(0, random.integers(1, 40), counts.sum()))


SHAPES = {
    "tetrahedron": Polygons.from_triangles(tetrahedron()[1]),
    "grid": Polygons.from_triangles(grid(20, 30)[1]),
    "quads": quads(20, 30),
    "tube": Polygons.from_triangles(tube(8, 25)[1]),
    "three at an edge": Polygons.from_triangles(pages(3)[1]),
    "several components": Polygons.from_triangles(joined(tube(6, 9), tetrahedron(), tube(5, 7))[1]),
    "turned over": Polygons.from_triangles(flipped(tube(8, 25)[1])),
    "many sides": polygons_of([0, 1, 2, 3], [3, 2, 4], [2, 1, 5, 6, 7, 4], [0, 3, 8], list(range(8, 300))),
    "a hundred at a vertex": polygons_of(*[[0, i, i + 1] for i in range(1, 200, 2)]),
    "a hundred at an edge": polygons_of(*[[0, 1, i] for i in range(2, 100)], *[[1, 0, i] for i in range(2, 70)]),
    "large steps": polygons_of(*[[i, 40000 - i, (i * 7919) % 40000] for i in range(300)]),
}


def with_flipped_bits(sound: bytes, count: int) -> Iterator[bytes]:
    """Bytes of which one bit is another one, every time."""
    for bit in np.random.default_rng(count).permutation(8 * len(sound))[:count].tolist():
        data = bytearray(sound)
        data[bit // 8] ^= 1 << bit % 8
        yield bytes(data)


def coded(cases: list[Case]) -> list[list[object]]:
    """What JavaScript is given."""
    return [
        [b64encode(encode_polygons(polygons, count)).decode(), len(polygons.counts), polygons.indices.size, count]
        for polygons, count in cases
    ]


def decoded(node: Node, folder: Path, given: Sequence[Sequence[object]]) -> list[list[list[int]] | str]:
    """What JavaScript finds."""
    path = folder / "cases.json"
    path.write_text(json.dumps(given), encoding="utf-8")
    told: list[list[list[int]] | str] = json.loads(node(DECODE, path))
    return told


def come_back(node: Node, folder: Path, cases: list[Case]) -> None:
    for (polygons, _), found in zip(cases, decoded(node, folder, coded(cases)), strict=True):
        assert found == [polygons.counts.tolist(), polygons.indices.tolist()]


def vertices_of(polygons: Polygons) -> int:
    return int(polygons.indices.max()) + 1


def test_golden_meshes_come_back(node: Node, tmp_path: Path) -> None:
    meshes = [Polygons(kept["counts"], kept["indices"]) for kept in map(np.load, sorted(GOLDEN.glob("*.npz")))]
    come_back(node, tmp_path, [(each, vertices_of(each) + unused) for each in meshes for unused in (0, 7)])


def test_meshes_of_all_kinds_come_back(node: Node, tmp_path: Path) -> None:
    come_back(node, tmp_path, [(each, vertices_of(each) + unused) for each in SHAPES.values() for unused in (0, 5)])


def test_meshes_without_order_come_back(node: Node, tmp_path: Path) -> None:
    meshes = [shuffled(each, seed) for seed, each in enumerate(SHAPES.values())]
    large = shuffled(Polygons.from_triangles(torus(60, 40)[1]), 3)
    come_back(node, tmp_path, [(each, vertices_of(each)) for each in (*meshes, large)])


def test_any_polygons_come_back(node: Node, tmp_path: Path) -> None:
    come_back(node, tmp_path, [(each, vertices_of(each)) for each in soups(60)])


def test_no_polygons_are_no_bytes(node: Node, tmp_path: Path) -> None:
    assert decoded(node, tmp_path, [["", 0, 0, 0], ["", 0, 0, 7]]) == [[[], []], [[], []]]


def test_damage_ends_in_one_error(node: Node, tmp_path: Path) -> None:
    """Bytes with a bit flipped, ends cut off, and other bytes are refused, or are polygons of the right size."""
    polygons, random = SHAPES["tube"], np.random.default_rng(1)
    corners, vertices = polygons.indices.size, vertices_of(polygons)
    sound = encode_polygons(polygons, vertices)
    damaged = [*with_flipped_bits(sound, 300), *(sound[:end] for end in range(0, len(sound), 3))]
    damaged += [random.bytes(60) for _ in range(20)]
    cases = [[b64encode(data).decode(), len(polygons.counts), corners, vertices] for data in damaged]
    for data, found in zip(damaged, decoded(node, tmp_path, cases), strict=True):
        if isinstance(found, str):
            assert "damaged" in found
            continue
        again = decode_polygons(data, len(polygons.counts), corners, vertices)
        assert found == [again.counts.tolist(), again.indices.tolist()]


@pytest.mark.parametrize(
    "counts", [(5, 14, 9), (-1, 0, 4), (4, 12, -1), (4, 12, 0), (0, 0, 4), (3, 9, 4), (1.5, 12, 4)]
)
def test_numbers_of_another_mesh_are_refused(node: Node, tmp_path: Path, counts: tuple[float, ...]) -> None:
    data = b64encode(encode_polygons(SHAPES["tetrahedron"], 4)).decode()
    [found] = decoded(node, tmp_path, [[data, *counts]])
    assert isinstance(found, str)
    assert "damaged" in found
