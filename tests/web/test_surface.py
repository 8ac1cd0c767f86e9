"""What LZMA compressed comes out of JavaScript as it went in: surfaces of compressed sequences, with all they have."""

from __future__ import annotations

import hashlib
import json
import lzma
from base64 import b64encode
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mixseq
from mixseq.coding.encoder.compress import compress
from mixseq.sequence import MeshSequence
from mixseq.surface import CornerValues, FaceSet, Surface, by_first_use
from tests.meshes import bar
from tests.web.conftest import Node
from tests.web.played import played, write_container
from tests.web.test_connectivity import with_flipped_bits

pytestmark = pytest.mark.slow

FILTERS = [{"id": lzma.FILTER_LZMA2, "preset": 9}]

UNPACK = """
import { createHash } from "node:crypto";
import { readFileSync } from "node:fs";
import { MixseqError } from "decoder/errors.js";
import { unpackLzma2 } from "decoder/lzma.js";
const told = [];
for (const packed of JSON.parse(readFileSync(process.argv[2]))) {
  try {
    const bytes = unpackLzma2(new Uint8Array(Buffer.from(packed, "base64")), 1e7);
    told.push(createHash("sha256").update(bytes).digest("hex"));
  } catch (error) {
    if (!(error instanceof MixseqError)) throw error;
    told.push(error.message);
  }
}
console.log(JSON.stringify(told));
"""


def packed(data: bytes) -> bytes:
    return lzma.compress(data, lzma.FORMAT_RAW, filters=FILTERS)


def unpacked(node: Node, folder: Path, cases: list[bytes]) -> list[str]:
    """The SHA-256 of what JavaScript finds, or its error."""
    path = folder / "cases.json"
    path.write_text(json.dumps([b64encode(each).decode() for each in cases]), encoding="utf-8")
    told: list[str] = json.loads(node(UNPACK, path))
    return told


def test_bytes_come_back(node: Node, tmp_path: Path) -> None:
    """Nothing, repetitions, noise that is stored as it is, numbers, text; also several chunks, of all kinds."""
    random = np.random.default_rng(0)
    noise, steps = random.bytes(200_000), np.cumsum(random.integers(-3, 4, 50_000)).astype("<i4").tobytes()
    text = Path(__file__).read_bytes()
    few = random.integers(0, 4, 300_000).astype(np.uint8).tobytes()
    cases = [
        b"",
        b"a",
        b"abc" * 1000,
        noise,
        steps,
        text,
        bytes(3_000_000),
        few,
        text * 40 + noise + text + few,
    ]
    expected = [hashlib.sha256(each).hexdigest() for each in cases]
    assert unpacked(node, tmp_path, [packed(each) for each in cases]) == expected


def test_damage_ends_in_one_error(node: Node, tmp_path: Path) -> None:
    sound = packed(Path(__file__).read_bytes())
    damaged = [*with_flipped_bits(sound, 300), *(sound[:end] for end in range(0, len(sound), 97))]
    found = unpacked(node, tmp_path, damaged)
    assert all("damaged" in each or len(each) == 64 for each in found)
    assert all("damaged" in each for each in found[300:])


def test_what_is_too_large_is_not_unpacked(node: Node, tmp_path: Path) -> None:
    [told] = unpacked(node, tmp_path, [packed(bytes(20_000_000))])
    assert "20000000 bytes" in told


def with_surface(surface: Surface) -> MeshSequence:
    sequence = bar(frames=3)
    return MeshSequence.from_header(replace(sequence.header, surface=surface), sequence.points)


def test_coordinates_and_edges_that_are_kept_as_they_are(node: Node, tmp_path: Path) -> None:
    """Coordinates on no grid, and normals that vertices share, with face sets before them."""
    corners = bar().faces.size
    random = np.random.default_rng(2)
    uvs = CornerValues(
        random.random((40, 2)).astype(np.float32), random.integers(0, 40, corners).astype(np.int32)
    )
    hard = random.integers(0, 9, corners).astype(np.int32)
    sets = (FaceSet("red", np.arange(5), "paint"),)
    coded = compress(
        with_surface(Surface(uvs=uvs, hard_edges=hard, face_sets=sets)), max_error=1e-3, uv_error=0
    )
    assert coded.parameters.uv_steps is None
    found = played(node, tmp_path, coded, np.zeros(1))
    assert found.uvs.tobytes() == uvs.at_corners.tobytes()
    np.testing.assert_array_equal(found.hard_edges, by_first_use(hard))


def test_surfaces_have_all_arrays(node: Node, tmp_path: Path) -> None:
    path = Path(__file__).parents[1] / "formats/golden/compressed-v1-uvs.h5"
    write_container(tmp_path, path)
    script = """
    import { readFileSync } from "node:fs";
    import { open } from "decoder/sequence.js";
    import { hardEdgesOf, surfaceOf } from "decoder/surface.js";
    const read = (name) => readFileSync(`${process.argv[2]}/${name}`);
    const sequence = open(read("text").toString("latin1"), new Uint8Array(read("streams")));
    console.log(JSON.stringify([Object.keys(surfaceOf(sequence)), Array.from(hardEdgesOf(sequence) ?? [])]));
    """
    names, edges = json.loads(node(script, tmp_path))
    surface = mixseq.load(path).header.surface
    assert edges == ([] if surface.hard_edges is None else surface.hard_edges.tolist())
    assert ("hard_edges" in names) == (surface.hard_edges is not None)
