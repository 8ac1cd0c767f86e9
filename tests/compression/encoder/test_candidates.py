"""Candidates are compared on a coarse mesh, which tells about what the whole one would."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.compression.bitstream.signal_graph import mesh_graph
from mixseq.compression.encoder import search
from mixseq.compression.encoder.components import initial_parts, trajectory_components
from mixseq.compression.encoder.search import BASIS_KINDS, PART_COUNTS, Candidates, coarsen_mesh, step_for_error
from mixseq.compression.encoder.trial import try_step
from mixseq.sequence.sequence import load_frames
from tests.meshes import bar, grid, joined, torus

MESHES = {"torus": torus(40, 30), "grid": grid(30, 20), "two bodies": joined(torus(20, 12), grid(15, 15))}


@pytest.mark.parametrize("mesh", MESHES)
def test_coarse_meshes_are_what_is_coded_first(mesh: str) -> None:
    points, faces = MESHES[mesh]
    vertices, edges = coarsen_mesh(faces, len(points), 200)
    assert 50 < len(vertices) <= 200
    whole, coarse = mesh_graph(faces, len(points)), mesh_graph(edges, len(vertices))
    assert set(vertices) == set(whole.order[: len(vertices)])
    assert coarse.counts.mean() == pytest.approx(whole.counts[: len(vertices)].mean(), rel=0.1)


def test_stray_vertices_stay() -> None:
    points, faces = torus(20, 12)
    vertices, _ = coarsen_mesh(faces, len(points) + 5, 100)
    assert set(range(len(points), len(points) + 5)) <= set(vertices)


@pytest.mark.parametrize("way", [("trajectories", 1), ("trajectories", 6), ("shapes", 1)])
def test_a_coarse_mesh_tells_about_the_same(way: search.Layout, monkeypatch: pytest.MonkeyPatch) -> None:
    sequence = load_frames(bar(sides=24, rings=120, frames=9))
    graph = mesh_graph(sequence.header.faces, sequence.header.vertex_count)
    monkeypatch.setattr(search, "COARSE_VERTICES", 1200)
    labels = initial_parts(sequence, PART_COUNTS)
    ways = Candidates(sequence.header.faces, graph, labels, trajectory_components(sequence, 1e-3), 1e-3, 1.0)
    whole, coarse = ways.on_mesh(ways.whole_mesh, way), ways.on_mesh(ways.coarse_mesh, way)
    assert 0.2 < coarse.share < 0.5 < whole.share == 1
    assert step_for_error(coarse, 1.0) == pytest.approx(step_for_error(whole, 1.0), rel=0.1)
    trials = [try_step(sequence, one, step_for_error(whole, 1.0)) for one in (whole, coarse)]
    assert trials[1].error == pytest.approx(trials[0].error, rel=0.3)
    assert 0.6 < trials[1].size / trials[0].size < 2.0


def test_small_meshes_are_not_made_coarser() -> None:
    sequence = load_frames(bar(sides=6, rings=20, frames=5))
    graph = mesh_graph(sequence.header.faces, sequence.header.vertex_count)
    ways = Candidates(sequence.header.faces, graph, {}, trajectory_components(sequence, 1e-3), 1e-3, 0.1)
    assert ways.part_counts[0] == 1
    coarse = ways.on_mesh(ways.coarse_mesh, (BASIS_KINDS[0], 1))
    np.testing.assert_array_equal(coarse.graph.order, graph.order)
