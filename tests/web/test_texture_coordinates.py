"""Texture coordinates and hard edges that Python coded come out of JavaScript as they went in, damage in one error."""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mixseq.compression.bitstream.corner_values import MAX_COORDINATE, code_uvs, decode_uvs, to_grid
from mixseq.compression.bitstream.corners import decode_hard_edges, encode_hard_edges
from mixseq.compression.encoder.uvs import encode_uvs
from mixseq.errors import FormatError
from mixseq.mesh.polygons import Polygons
from mixseq.types import Index
from tests.compression.bitstream.test_texture_coordinates import bumpy, golden_uvs, plane
from tests.web.conftest import Node
from tests.web.test_connectivity import GOLDEN, SHAPES, shuffled, soups, vertices_of, with_flipped_bits

DECODE = """
import { readFileSync } from "fs";
import { MixseqError } from "decoder/errors.js";
import { decodeHardEdges } from "decoder/corner_values.js";
import { decodeUvs } from "decoder/corner_values.js";
const told = [], decode = { uvs: decodeUvs, edges: decodeHardEdges };
for (const [kind, bytes, counts, corners, vertices] of JSON.parse(readFileSync(process.argv[2]))) {
  try {
    const mesh = [Uint32Array.from(counts), Uint32Array.from(corners), vertices];
    told.push([...decode[kind](Uint8Array.from(Buffer.from(bytes, "base64")), ...mesh)]);
  } catch (error) {
    if (!(error instanceof MixseqError)) throw error;
    told.push(error.message);
  }
}
console.log(JSON.stringify(told));
"""


def decoded(node: Node, folder: Path, kind: str, cases: Sequence[tuple[Polygons, bytes]]) -> list[list[int] | str]:
    """What JavaScript finds."""
    given = [
        (kind, b64encode(data).decode(), mesh.counts.tolist(), mesh.indices.tolist(), vertices_of(mesh))
        for mesh, data in cases
    ]
    path = folder / "cases.json"
    path.write_text(json.dumps(given), encoding="utf-8")
    told: list[list[int] | str] = json.loads(node(DECODE, path))
    return told


def uvs_come_back(
    node: Node, folder: Path, cases: Sequence[tuple[Polygons, Index]], encode: Callable[..., bytes] = encode_uvs
) -> None:
    coded = [(mesh, encode(mesh, vertices_of(mesh), numbers)) for mesh, numbers in cases]
    for (_, numbers), found in zip(cases, decoded(node, folder, "uvs", coded), strict=True):
        assert found == numbers.reshape(-1).tolist()


def plain_uvs(mesh: Polygons, vertex_count: int, numbers: Index) -> bytes:
    """Code coordinates without a search for copies, which numbers at random have none of."""
    return code_uvs(mesh, vertex_count, numbers).data


def numbers_of(polygons: Polygons, seed: int, largest: int = 1500) -> Index:
    """Coordinates of vertices at random, and a few corners of others."""
    random = np.random.default_rng(seed)
    numbers = random.integers(-largest // 3, largest, (vertices_of(polygons), 2))[polygons.indices]
    some = random.random(len(numbers)) < 0.1
    numbers[some] = random.integers(0, largest, (some.sum(), 2))
    return numbers


def copies(size: int, turn: complex, mirrored: bool) -> tuple[Polygons, Index]:
    """A bumpy piece, and the same again, turned, scaled, mirrored, all of it so large."""
    polygons, uvs = plane(9, 11)
    at = size / 8000 * (bumpy(uvs) @ [1, 1j])
    away = turn * (np.conj(at) if mirrored else at) + size * (0.5 + 0.03j)
    faces = polygons.triangles[:, ::-1] if mirrored else polygons.triangles
    both = Polygons.from_triangles(np.concatenate([polygons.triangles, faces + len(uvs)]))
    values = np.concatenate([at, away])[both.indices]
    return both, np.rint(np.stack([values.real, values.imag], axis=1)).astype(np.int64)


def test_golden_coordinates_come_back(node: Node, tmp_path: Path) -> None:
    with np.load(GOLDEN / "uvs.npz") as kept:
        mesh, data = Polygons(kept["counts"], kept["indices"]), kept["data"].tobytes()
        numbers = to_grid(kept["at_corners"], int(kept["steps"]))
    assert numbers is not None
    assert decoded(node, tmp_path, "uvs", [(mesh, data)]) == [numbers.reshape(-1).tolist()]


def test_any_coordinates_come_back(node: Node, tmp_path: Path) -> None:
    meshes = [*SHAPES.values(), *(shuffled(each, seed) for seed, each in enumerate(SHAPES.values()))]
    uvs_come_back(node, tmp_path, [(mesh, numbers_of(mesh, seed)) for seed, mesh in enumerate(meshes)], plain_uvs)


def test_any_coordinates_on_any_polygons_come_back(node: Node, tmp_path: Path) -> None:
    sizes = [3, 700, MAX_COORDINATE]
    uvs_come_back(
        node,
        tmp_path,
        [(mesh, numbers_of(mesh, seed, sizes[seed % 3])) for seed, mesh in enumerate(soups(40))],
        plain_uvs,
    )


def test_copies_come_back(node: Node, tmp_path: Path) -> None:
    """Regions that are moved, turned, scaled, and mirrored."""
    turns = (1, 1j, 0.5 * np.exp(0.4j), 0.97 * np.exp(2j))
    sizes = 4096, 1 << 25
    cases = [copies(sizes[n % 2], turn, back) for n, turn in enumerate(turns) for back in (False, True)]
    uvs_come_back(node, tmp_path, [golden_uvs(), *cases])


def test_quotients_of_large_products_are_exact(node: Node) -> None:
    """Halves, and what is just below: products have up to 60 bits, more than a double holds."""
    random = np.random.default_rng(5)
    cases = []
    for _ in range(200):
        whole, quotient = 2 * int(random.integers(1, 1 << 32)), int(random.integers(-(1 << 27), 1 << 27))
        cases += [[whole, quotient, whole // 2 - below, 1, whole] for below in (0, 1)]
    script = """
    import { nearest } from "decoder/uv_seams.js";
    console.log(JSON.stringify(JSON.parse(process.argv[2]).map((each) => nearest(...each))));
    """
    expected = [(2 * (a * b + c * d) + whole) // (2 * whole) for a, b, c, d, whole in cases]
    assert json.loads(node(script, json.dumps(cases))) == expected


def test_hard_edges_come_back(node: Node, tmp_path: Path) -> None:
    random, coded, expected = np.random.default_rng(4), [], []
    for mesh in (*SHAPES.values(), *soups(20)):
        numbers = mesh.indices * 3 + random.integers(0, 3, mesh.indices.size)
        data = encode_hard_edges(mesh, vertices_of(mesh), numbers)
        if data is not None:
            coded.append((mesh, data))
            expected.append(decode_hard_edges(data, mesh, vertices_of(mesh)).tolist())
    assert len(coded) > 20
    assert decoded(node, tmp_path, "edges", coded) == expected


def test_damage_ends_in_one_error(node: Node, tmp_path: Path) -> None:
    mesh, numbers = golden_uvs()
    sound = encode_uvs(mesh, vertices_of(mesh), numbers)
    damaged = [*with_flipped_bits(sound, 60), *(sound[:end] for end in range(0, len(sound), 17))]
    found = decoded(node, tmp_path, "uvs", [(mesh, data) for data in damaged])
    for data, told in zip(damaged, found, strict=True):
        assert told == in_python(data, mesh) or isinstance(told, str)
    assert all("damaged" in told for told in found if isinstance(told, str))


def in_python(data: bytes, mesh: Polygons) -> Any:
    try:
        numbers = to_grid(decode_uvs(data, mesh, vertices_of(mesh), 1000).at_corners, 1000)
    except FormatError:
        return None
    return None if numbers is None else numbers.reshape(-1).tolist()
