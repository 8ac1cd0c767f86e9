"""Weights to begin with: what bends a mesh least."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from mixseq.compression.bitstream import predictor as module
from mixseq.compression.bitstream.predictor import HUB, WIDEST, Stencils, stencils
from mixseq.compression.bitstream.signal_graph import (
    MOST,
    SignalGraph,
    coarser_levels,
    mesh_graph,
    mesh_neighbours,
    path_graph,
)
from mixseq.types import Float
from tests.meshes import Mesh, grid, joined, tetrahedron, torus, tube

MESHES = {
    "torus": torus(24, 10),
    "tube": tube(8, 12),
    "grid": grid(9, 7),
    "components": joined(tube(5, 6), tetrahedron(), grid(3, 3)),
}


def graph_of(mesh: Mesh) -> SignalGraph:
    return mesh_graph(mesh[1], len(mesh[0]))


def predicted(found: Stencils, values: Float) -> Float:
    """What stencils say of values ``(N,)`` in the order of nodes."""
    used = np.arange(found.weights.shape[1]) < found.counts[:, None]
    return np.asarray((np.where(used, found.weights, 0.0) * values[found.neighbours]).sum(axis=1))


@pytest.mark.parametrize("name", MESHES)
def test_nodes_before_a_node_with_weights_that_add_up_to_one(name: str) -> None:
    graph = graph_of(MESHES[name])
    found = stencils(graph)
    assert found.counts.max() <= WIDEST
    assert found.counts[0] == 0
    for node in range(1, graph.size):
        count = found.counts[node]
        nodes: list[int] = found.neighbours[node, :count].tolist()
        assert count > 0
        assert max(nodes) < node
        assert len(set(nodes)) == count
        assert set(graph.neighbours[node, : graph.counts[node]].tolist()) <= set(nodes)
        assert found.weights[node, :count].sum() == pytest.approx(1, abs=1e-12)


def test_curved_surfaces_are_predicted_better_than_by_means() -> None:
    points, faces = MESHES["torus"]
    graph = mesh_graph(faces, len(points))
    fine = slice(graph.size // 3, None)
    means = Stencils(graph.neighbours, graph.counts, graph.weights)
    for values in points[graph.order].T:
        off, of_means = (
            np.square(values - predicted(one, values))[fine].sum() for one in (stencils(graph), means)
        )
        assert off < 0.5 * of_means


def energy(value: float, vertex: int, values: Float, beside: dict[int, dict[int, int]]) -> float:
    """Squares of the mean slopes at vertices, of which one has a value, with the lengths of edges."""
    now = values.copy()
    now[vertex] = value
    return sum(
        float(np.mean([(now[other] - now[one]) / length for other, length in others.items()])) ** 2
        for one, others in beside.items()
    )


def test_the_mesh_is_bent_least(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of vertices that go first: the value is the minimum of the energy, which is a parabola."""
    monkeypatch.setattr(module, "WIDEST", 60)
    points, faces = torus(24, 10)
    count, graph = len(points), mesh_graph(faces, len(points))
    values = np.random.default_rng(0).normal(size=count)
    found = predicted(stencils(graph), values[graph.order])
    unused = np.zeros((count, MOST), dtype=np.int64), np.zeros(count, dtype=np.int64)
    first = next(coarser_levels(*mesh_neighbours(faces, count), *unused))
    ring = [set(first.beside[a:b].tolist()) for a, b in pairwise(first.starts)]
    left = [set(first.new_beside[a:b].tolist()) for a, b in pairwise(first.new_starts)]
    for vertex in first.gone.tolist():
        beside = {vertex: dict.fromkeys(ring[vertex], 1)}
        for one in ring[vertex]:
            kept = {other for other in left[one] if other in ring[one] or other not in ring[vertex]}
            beside[one] = {vertex: 1} | {other: 1 if other in ring[one] else 2 for other in kept}
        below, at, above = (energy(value, vertex, values, beside) for value in (-1.0, 0.0, 1.0))
        lowest = (below - above) / (2 * (below + above - 2 * at))
        assert found[graph.order == vertex] == pytest.approx(lowest)


def test_on_a_line_levels_are_alike() -> None:
    """A mesh of triangles without area, with the edges of a closed line."""
    count = 128
    steps = np.arange(count)
    graph = mesh_graph(np.stack([steps, np.roll(steps, 1), steps], axis=1), count)
    found = stencils(graph)
    regular = 0
    for node in range(graph.size):
        beside = found.neighbours[node, : found.counts[node]]
        offsets = (graph.order[beside] - graph.order[node] + count // 2) % count - count // 2
        order = np.argsort(offsets)
        if offsets[order].tolist() in [[-3 * k, -k, k, 3 * k] for k in (1, 2, 4, 8)]:
            np.testing.assert_allclose(found.weights[node, order], [-1 / 12, 7 / 12, 7 / 12, -1 / 12])
            regular += 1
    assert regular == 64 + 32 + 16 + 8


def test_hubs_cost_no_time_and_do_no_harm() -> None:
    rim = np.arange(1, 40 * HUB)
    graph = mesh_graph(np.stack([0 * rim, rim, np.roll(rim, 1)], axis=1), len(rim) + 1)
    found = stencils(graph)
    assert found.counts.max() < 8  # nothing from the other side of the hub
    np.testing.assert_allclose(predicted(found, np.ones(graph.size))[1:], 1)


def test_frames_keep_their_own_weights() -> None:
    graph = path_graph(50)
    np.testing.assert_array_equal(stencils(graph).weights[:, :6], graph.weights)
    np.testing.assert_array_equal(stencils(graph).counts, graph.counts)


def test_stencils_are_made_once() -> None:
    graph = graph_of(grid(3, 3))
    assert stencils(graph) is stencils(graph)
