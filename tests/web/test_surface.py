"""Surfaces of compressed sequences come out of JavaScript with all they have."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mixseq
from mixseq.compression.encoder.compress import compress
from mixseq.mesh.surface import CornerValues, FaceSet, Surface, renumber_by_first_use
from mixseq.sequence.sequence import MeshSequence
from tests.meshes import bar
from tests.web.conftest import Node
from tests.web.played import played, write_container

pytestmark = pytest.mark.slow


def with_surface(surface: Surface) -> MeshSequence:
    sequence = bar(frames=3)
    return MeshSequence.from_header(replace(sequence.header, surface=surface), sequence.points)


def test_coordinates_and_edges_that_are_kept_as_they_are(node: Node, tmp_path: Path) -> None:
    """Coordinates on no grid, and normals that vertices share, with face sets before them."""
    corners = bar().faces.size
    random = np.random.default_rng(2)
    uvs = CornerValues(random.random((40, 2)).astype(np.float32), random.integers(0, 40, corners).astype(np.int32))
    hard = random.integers(0, 9, corners).astype(np.int32)
    sets = (FaceSet("red", np.arange(5), "paint"),)
    coded = compress(with_surface(Surface(uvs=uvs, hard_edges=hard, face_sets=sets)), max_error=1e-3, uv_error=0)
    assert coded.parameters.uv_steps is None
    found = played(node, tmp_path, coded, np.zeros(1))
    assert found.uvs.tobytes() == uvs.at_corners.tobytes()
    np.testing.assert_array_equal(found.hard_edges, renumber_by_first_use(hard))


def test_surfaces_have_all_arrays(node: Node, tmp_path: Path) -> None:
    path = Path(__file__).parents[1] / "formats/golden/compressed-v1-uvs.h5"
    write_container(tmp_path, path)
    script = """
    import { readFileSync } from "node:fs";
    import { open } from "decoder/sequence.js";
    import { hardEdgesOf, surfaceOf } from "decoder/surface.js";
    const read = (name) => readFileSync(`${process.argv[2]}/${name}`);
    const sequence = await open(read("text").toString("latin1"), new Uint8Array(read("streams")));
    console.log(JSON.stringify([Object.keys(surfaceOf(sequence)), Array.from(hardEdgesOf(sequence) ?? [])]));
    """
    names, edges = json.loads(node(script, tmp_path))
    surface = mixseq.load(path).header.surface
    assert edges == ([] if surface.hard_edges is None else surface.hard_edges.tolist())
    assert ("hard_edges" in names) == (surface.hard_edges is not None)
