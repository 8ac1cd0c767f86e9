"""Every node comes once, after those it is predicted from, whatever the mesh."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from itertools import pairwise

import numpy as np
import pytest

from mixseq.compression.bitstream.signal_graph import (
    MAX_NEIGHBOURS,
    MAX_ROOT_NEIGHBOURS,
    SignalGraph,
    edge_neighbours,
    mesh_graph,
    path_graph,
    renumber_adjacency,
    update_adjacency,
)
from mixseq.mesh.topology import Topology
from mixseq.types import Index, IntArray
from tests.meshes import SEQUENCES, joined, pages, tetrahedron, torus

NONE = np.zeros((0, 3), dtype=np.int64)


def fan(spokes: int) -> Index:
    """A wheel without a rim beyond its hub, vertex 0."""
    rim = 1 + np.arange(spokes)
    return np.stack([np.zeros(spokes, dtype=np.int64), rim, np.roll(rim, -1)], axis=1)


def of_sequence(name: str) -> tuple[Index, int]:
    sequence = SEQUENCES[name]()
    return sequence.faces.astype(np.int64), sequence.vertex_count


MESHES: dict[str, Callable[[], tuple[Index, int]]] = {
    "one vertex": lambda: (NONE, 1),
    "no faces": lambda: (NONE, 20),
    "one triangle": lambda: (np.array([[0, 1, 2]]), 3),
    "a triangle that is a point": lambda: (np.array([[1, 1, 1]]), 3),
    "fan": lambda: (fan(100), 101),
    "fans": lambda: (joined((np.zeros((101, 3)), fan(100)), (np.zeros((31, 3)), fan(30)))[1], 132),
    "book": lambda: (pages(5)[1], len(pages(5)[0])),
    "torus": lambda: (torus(20, 12)[1], 240),
    "forty tetrahedra": lambda: (joined(*[tetrahedron()] * 40)[1], 160),
    **{name: lambda name=name: of_sequence(name) for name in SEQUENCES if name not in ("float32", "still")},  # type: ignore[misc]
}


@cache
def graph_of(name: str) -> SignalGraph:
    return mesh_graph(*MESHES[name]())


@pytest.mark.parametrize("name", MESHES)
def test_every_vertex_comes_once(name: str) -> None:
    graph, (_, count) = graph_of(name), MESHES[name]()
    np.testing.assert_array_equal(np.sort(graph.order), np.arange(count))
    assert graph.size == count


@pytest.mark.parametrize("name", MESHES)
def test_neighbours_come_before(name: str) -> None:
    graph = graph_of(name)
    known = np.arange(graph.neighbours.shape[1]) < graph.counts[:, None]
    assert (graph.neighbours[known] < np.nonzero(known)[0]).all()
    assert (graph.counts[1:] > 0).all()
    assert graph.counts[0] == 0
    assert (graph.counts <= MAX_NEIGHBOURS).all()
    for node, count in enumerate(graph.counts):
        assert len(set(graph.neighbours[node, :count])) == count


@pytest.mark.parametrize("name", MESHES)
def test_weights_add_to_one(name: str) -> None:
    graph = graph_of(name)
    known = np.arange(graph.neighbours.shape[1]) < graph.counts[:, None]
    assert not graph.weights[~known].any()
    np.testing.assert_allclose(graph.weights[1:].sum(axis=1), 1, atol=1e-15)


@pytest.mark.parametrize("name", MESHES)
def test_the_ring_is_that_of_the_mesh(name: str) -> None:
    graph, (faces, count) = graph_of(name), MESHES[name]()
    edges = Topology(faces, count).edges if len(faces) else np.zeros((0, 2), dtype=np.int64)
    expected = {(a, b) for one, other in edges.tolist() if one != other for a, b in ((one, other), (other, one))}
    found = {
        (int(graph.order[node]), int(graph.order[other]))
        for node in range(count)
        for other in graph.ring[graph.ring_starts[node] : graph.ring_starts[node + 1]]
    }
    assert found == expected
    assert len(graph.ring) == len(expected)


def test_vertices_lie_between_known_ones() -> None:
    """On a closed surface nearly all vertices have neighbours around them, at half or twice the distance."""
    graph = graph_of("torus")
    assert (graph.counts >= 3).mean() > 0.95


def test_the_order_is_that_of_the_connectivity() -> None:
    """Faces in another order, turned over, or twice, are the same edges."""
    faces = torus(9, 7)[1]
    one = mesh_graph(faces, 63)
    other = mesh_graph(np.concatenate([faces[::-1, ::-1], faces[:5]]).astype(np.int32), 63)
    for name in ("order", "neighbours", "counts", "weights", "ring", "ring_starts"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
        assert not getattr(one, name).flags.writeable


def test_a_hub_stays_to_the_end() -> None:
    graph = graph_of("fan")
    assert int(np.flatnonzero(graph.order == 0)[0]) < MAX_ROOT_NEIGHBOURS


# Frames -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 8, 9, 13, 24, 33, 64, 100, 128])
def test_every_frame_comes_once_after_its_neighbours(count: int) -> None:
    graph = path_graph(count)
    np.testing.assert_array_equal(np.sort(graph.order), np.arange(count))
    assert graph.order[0] == 0
    assert graph.order[min(1, count - 1)] == count - 1
    for node in range(1, count):
        assert (graph.neighbours[node, : graph.counts[node]] < node).all()
        assert graph.counts[node] > 0
    assert len(graph.ring) == 2 * (count - 1)


@pytest.mark.parametrize("count", [4, 7, 16, 30, 101])
def test_cubics_are_reproduced_inside(count: int) -> None:
    """By Lagrange's polynomial of four frames; of three near the ends, so quadratics there."""
    graph = path_graph(count)
    frames = graph.order / count
    for degree in range(4):
        signal = frames**degree
        predicted = (graph.weights * signal[graph.neighbours]).sum(axis=1)
        exact = (graph.weights != 0).sum(axis=1) > degree
        np.testing.assert_allclose(predicted[exact], signal[exact], atol=1e-13)
    assert ((graph.weights != 0).sum(axis=1) < 4).sum() <= 2 + 2 * np.log2(count)


def test_frames_in_the_middle_have_the_weights_of_the_textbook() -> None:
    graph = path_graph(9)  # frames 0, 8, then 4, then 2 and 6, then 1, 3, 5, 7
    node = int(np.flatnonzero(graph.order == 3)[0])
    assert graph.order[graph.neighbours[node]].tolist() == [0, 2, 4, 6, 1, 8]
    np.testing.assert_array_equal(graph.weights[node], np.array([-1, 9, 9, -1, 0, 0]) / 16)


def test_frames_are_predicted_from_both_sides() -> None:
    graph = path_graph(40)
    for node in range(2, graph.size):
        beside = graph.order[graph.neighbours[node, : graph.counts[node]]]
        assert beside.min() < graph.order[node] < beside.max()


def test_neighbours_are_sorted() -> None:
    edges = np.array([[3, 5], [1, 0], [1, 2], [3, 1], [1, 3], [4, 4], [0, 3], [0, 1]], np.int32)
    starts, beside = edge_neighbours(edges, 6)
    assert rows(starts, beside) == [[1, 3], [0, 2, 3], [1], [0, 1, 5], [], [3]]
    left = np.array([True, False, True, True, True, True])
    added = np.array([[2, 0], [3, 2], [0, 3]], np.int32)
    assert rows(*update_adjacency(starts, beside, left, added)) == [[2, 3], [], [0, 3], [0, 2, 5], [], [3]]
    starts, beside = edge_neighbours(np.zeros((0, 2), np.int32), 2)
    assert starts.tolist() == [0, 0, 0]
    assert beside.size == 0


def test_nodes_are_renumbered() -> None:
    order, place = np.array([2, 0, 3, 1]), np.array([1, 3, 0, 2])
    starts, beside = edge_neighbours(np.array([[0, 1], [1, 2], [2, 3]], np.int32), 4)
    other = renumber_adjacency(starts, beside, order, place)
    assert rows(*other) == [[3, 2], [3], [0], [1, 0]]
    assert rows(*renumber_adjacency(*other, place, order)) == rows(starts, beside)


def rows(starts: IntArray, beside: IntArray) -> list[list[int]]:
    return [beside[a:b].tolist() for a, b in pairwise(starts)]
