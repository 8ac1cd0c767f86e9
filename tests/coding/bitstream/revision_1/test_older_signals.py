"""Predictions: exact where signals before taught them to be, the same for who codes and who decodes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from numpy.typing import NDArray

from mixseq.arrays import Float, Index
from mixseq.coding.bitstream.revision_1.signal_kernels import (
    contexts,
    learn,
    nearest,
    roughness,
    smooth,
    solve,
    surroundings,
)
from mixseq.coding.bitstream.revision_1.signals import CONTEXTS, FIRST, GROWTH, Predictor, bounds
from mixseq.coding.bitstream.signal_graph import SignalGraph, mesh_graph, path_graph
from tests.meshes import Mesh, grid, joined, seeds, tetrahedron, torus, tube

pytestmark = pytest.mark.slow

MARGIN = 0.45
"""The encoder of that day rounded up from 1 - margin."""

OUTERMOST = 1 - MARGIN
"""The most that rounding leaves, in steps."""


def graph_of(mesh: Mesh) -> SignalGraph:
    return mesh_graph(mesh[1], len(mesh[0]))


def teach(predictor: Predictor, signal: Float) -> None:
    """Let a predictor know a signal, in the order of vertices, without rounding it."""
    predictor.begin()
    predictor.values[:] = signal[predictor.graph.order]
    predictor.finish()


def quantise(predictor: Predictor, place: int, signal: Float) -> int:
    """Return the number of a node as an encoder rounded it, and note the value that it stands for."""
    one = slice(place, place + 1)
    predictor.restore(one, np.zeros(1, dtype=np.int64))
    off = float(signal[place] - predictor.values[place])
    number = int(np.sign(off) * np.floor(abs(off) + MARGIN))
    predictor.restore(one, np.array([number]))
    return number


def quantised(predictor: Predictor, signal: Float) -> tuple[Index, Float]:
    """Numbers and values of a signal, in the order of nodes."""
    predictor.begin()
    nodes = signal[predictor.graph.order]
    numbers = np.array([quantise(predictor, node, nodes) for node in range(len(nodes))])
    return numbers, predictor.finish().copy()


def affinely_known(graph: SignalGraph, points: Float) -> NDArray[np.bool_]:
    """Whether nodes are affine combinations of their neighbours that are not too large, by least squares."""
    ordered = points[graph.order]
    known = np.zeros(graph.size, dtype=bool)
    for node in range(graph.size):
        beside = ordered[graph.neighbours[node, : graph.counts[node]]]
        if len(beside):
            corners = np.vstack([beside.T, np.ones(len(beside))])
            here = np.append(ordered[node], 1)
            weights = np.linalg.lstsq(corners, here, rcond=1e-9)[0]
            known[node] = np.abs(corners @ weights - here).max() < 1e-9 and np.abs(weights).max() < 3
    return known


@pytest.mark.parametrize(("mesh", "share"), [(torus(12, 8), 0.4), (tube(8, 12), 0.4), (grid(9, 7), 0.6)])
def test_affine_signals_are_predicted(mesh: Mesh, share: float) -> None:
    """Once x, y and z are known, so is every affine function of them, at all vertices that their neighbours span."""
    points, graph = 1e6 * mesh[0], graph_of(mesh)
    predictor = Predictor(graph)
    for coordinate in points.T[np.ptp(points, axis=0) > 0]:
        teach(predictor, coordinate)
    known = affinely_known(graph, mesh[0])
    assert known.mean() > share
    signal = (points @ [0.3, -0.8, 0.5] + 7e5)[graph.order]
    numbers = np.empty(graph.size, dtype=np.int64)
    for node in range(graph.size):
        predictor.values[:] = signal  # of neighbours, without the errors of their own numbers
        numbers[node] = quantise(predictor, node, signal)
    assert not numbers[known].any()
    assert abs(numbers[0] - signal[0]) <= OUTERMOST


def test_the_parallelogram_rule_is_a_case_of_it() -> None:
    """A vertex with three neighbours in a plane: the weights of the parallelogram are the only ones."""
    corner = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    gram = np.zeros(6)
    neighbours = np.array([[0, 0, 0], [0, 0, 0], [0, 0, 0], [0, 1, 2]])
    counts = np.array([0, 0, 0, 3])
    for coordinate in corner.T:
        learn(coordinate, 1.0, neighbours, counts, gram)
    weights = np.zeros((4, 3))
    solve(gram, 1e-9, np.full((4, 3), 1 / 3), counts, weights)
    np.testing.assert_allclose(weights[3], [-1, 1, 1], atol=1e-7)


# Least squares ----------------------------------------------------------------------------------------------


def constrained(gram: Float, ridge: float, start: Float) -> Float:
    """The minimum of w G w + ridge |w - start|^2 with a sum of one, from its optimality system."""
    size = len(start)
    system = np.zeros((size + 1, size + 1))
    system[:size, :size] = gram + ridge * np.eye(size)
    system[size, :size] = system[:size, size] = 1
    return np.linalg.solve(system, np.append(ridge * start, 1))[:size]


@settings(max_examples=30, deadline=None)
@given(seed=seeds)
def test_weights_are_those_of_numpy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    nodes, most, signals, ridge = 5, 6, int(rng.integers(1, 9)), float(rng.uniform(0.1, 3))
    counts = np.array([0, 1, 2, 4, 6])
    neighbours = rng.integers(0, nodes, (nodes, most))
    start = rng.dirichlet(np.ones(most), nodes) * (np.arange(most) < counts[:, None])
    gram = np.zeros(int((counts * (counts + 1) // 2).sum()))
    products = np.zeros((nodes, most, most))
    for _ in range(signals):
        values, trust = rng.normal(size=nodes), float(rng.uniform(0.1, 1))
        learn(values, trust, neighbours, counts, gram)
        apart = values[neighbours] - values[:, None]
        products += trust * apart[:, :, None] * apart[:, None, :]
    weights = np.full((nodes, most), 9.0)
    solve(gram, ridge, start, counts, weights)
    for node, count in enumerate(counts):
        if count:
            expected = constrained(products[node, :count, :count], ridge, start[node, :count])
            np.testing.assert_allclose(weights[node, :count], expected, atol=1e-9)
        assert (weights[node, count:] == 9).all()


@pytest.mark.parametrize("size", [1e3, 1e8, 1e12])
def test_signals_of_very_many_steps_are_no_harm(size: float) -> None:
    """Then Gram matrices are singular but for rounding: weights that are any would make numbers that no word holds."""
    mesh = torus(12, 8)
    graph = graph_of(mesh)
    predictor = Predictor(graph)
    rng = np.random.default_rng(0)
    for signal in [*(size * mesh[0].T), *(1e-3 * size * rng.normal(size=(4, len(mesh[0]))))]:
        numbers, values = quantised(predictor, signal)
        assert np.abs(numbers).max() < 100 * size
        assert np.abs(values - signal[graph.order]).max() <= OUTERMOST + 1e-15 * 100 * size
    assert np.abs(predictor._weights).max() < 100
    np.testing.assert_allclose(predictor._weights[1:].sum(axis=1), 1, atol=1e-6)


# Rounding ---------------------------------------------------------------------------------------------------


MESHES = {
    "torus": torus(9, 6),
    "tube": tube(6, 9),
    "grid": grid(7, 5),
    "components": joined(tube(5, 6), tetrahedron(), grid(3, 3)),
}


@pytest.mark.parametrize("name", [*MESHES, "path"])
def test_who_decodes_has_the_same_bits(name: str) -> None:
    graph = path_graph(50) if name == "path" else graph_of(MESHES[name])
    coding, decoding = Predictor(graph), Predictor(graph)
    rng = np.random.default_rng(5)
    for scale in 3.0 ** -np.arange(12) * 1e4:
        signal = np.cumsum(rng.normal(scale=scale, size=graph.size))
        nodes = signal[graph.order]
        numbers, values = quantised(coding, signal)
        decoding.begin()
        for batch in graph.batches:
            decoding.restore(batch, numbers[batch])
        np.testing.assert_array_equal(decoding.finish(), values)
        assert np.abs(values - nodes).max() <= OUTERMOST + 1e-9


def test_signals_that_are_alike_get_ever_cheaper() -> None:
    """Smooth bumps on a torus: later ones leave less than the first."""
    mesh = torus(24, 10)
    predictor = Predictor(graph_of(mesh))
    rng = np.random.default_rng(1)
    left = []
    for _ in range(20):
        direction, phase = rng.normal(size=3), rng.uniform(0, 6)
        numbers, _ = quantised(predictor, 60 * np.sin(mesh[0] @ direction * 0.6 + phase))
        left.append(np.abs(numbers[24:]).mean())
    assert np.mean(left[-10:]) < 0.7 * np.mean(left[:3])


# Nodes that are alike ---------------------------------------------------------------------------------------


def test_similar_nodes_are_those_of_a_search_of_all() -> None:
    graph, rng = graph_of(torus(9, 6)), np.random.default_rng(2)
    values = rng.normal(size=(graph.size, 3))
    found, sizes = np.zeros((graph.size, 4), dtype=np.int64), np.zeros(graph.size, dtype=np.int64)
    nearest(values, graph.neighbours, graph.counts, graph.size, 4, found, sizes)
    for node in range(graph.size):
        beside = set(graph.neighbours[node, : graph.counts[node]].tolist())
        others = [other for other in range(node) if other not in beside]
        others.sort(key=lambda other: float(np.square(values[node] - values[other]).sum()))
        assert found[node, : sizes[node]].tolist() == others[:4]


def test_later_nodes_look_only_near_their_neighbours() -> None:
    graph, rng = graph_of(torus(12, 9)), np.random.default_rng(2)
    values = rng.normal(size=(graph.size, 3))
    found, sizes = np.zeros((graph.size, 4), dtype=np.int64), np.zeros(graph.size, dtype=np.int64)
    nearest(values, graph.neighbours, graph.counts, 20, 4, found, sizes)
    assert sizes[-20:].min() > 0
    for node in range(graph.size):
        beside = graph.neighbours[node, : graph.counts[node]].tolist()
        some = found[node, : sizes[node]].tolist()
        assert len(set(some)) == len(some)
        assert not set(some) & set(beside)
        assert all(other < node for other in some)


def test_more_neighbours_come_behind_those_there_are() -> None:
    graph = graph_of(grid(3, 3))
    sizes = np.minimum(np.arange(graph.size), 2)
    more = graph.with_more(np.tile([0, 1], (graph.size, 1)), sizes)
    np.testing.assert_array_equal(more.counts, graph.counts + sizes)
    np.testing.assert_array_equal(more.weights[:, :-2], graph.weights)
    assert not more.weights[:, -2:].any()
    for node in range(graph.size):
        count = graph.counts[node]
        expected = [*graph.neighbours[node, :count], *[0, 1][: sizes[node]]]
        assert more.neighbours[node, : more.counts[node]].tolist() == expected


def test_the_same_shape_twice_is_coded_once() -> None:
    """Two components that move alike: once that is known, the second one is predicted from the first."""
    mesh = joined(torus(9, 6), torus(9, 6))
    predictor, rng = Predictor(graph_of(mesh)), np.random.default_rng(1)
    for _ in range(20):
        numbers, _ = quantised(predictor, np.tile(50 * rng.normal(size=54), 2))
    once = np.abs(numbers[:20]).mean()
    assert np.count_nonzero(numbers[-50:] == 0) > 0.3 * 50
    assert once > 10


# What is known around a node --------------------------------------------------------------------------------


def test_contexts_are_intervals_of_a_geometric_series() -> None:
    np.testing.assert_allclose(bounds(), FIRST * GROWTH ** np.arange(CONTEXTS - 1), rtol=1e-12)
    graph = graph_of(torus(9, 6))
    rng = np.random.default_rng(3)
    sizes, activity, around = rng.exponential(scale=[[3], [1], [30]], size=(3, graph.size))
    shares = np.array([0.5, 0.3, 0.2])
    first, last = graph.batches[-1].start, graph.batches[-1].stop
    means = surroundings(first, last, sizes, activity, graph.neighbours, graph.counts)
    expected = 0.5 * means + 0.3 * activity[first:last] + 0.2 * around[first:last]
    found = contexts(first, last, sizes, activity, around, shares, bounds(), graph.neighbours, graph.counts)
    np.testing.assert_array_equal(found, np.searchsorted(bounds(), expected))
    assert len(set(found.tolist())) > 3


def test_surroundings_are_neighbours_that_are_done() -> None:
    neighbours = np.array([[0, 0], [0, 0], [0, 1], [1, 2], [2, 3]])
    counts = np.array([0, 1, 2, 2, 2])
    sizes, activity = np.array([3.0, 5, 100, 100, 100]), np.array([0.0, 0, 0, 0, 7])
    found = surroundings(2, 5, sizes, activity, neighbours, counts)
    assert found.tolist() == [4, 5, 7]  # of 0 and 1; of 1 alone; of none, so its own activity


def test_means_of_neighbours_on_a_path() -> None:
    graph = path_graph(6)
    values = np.arange(6.0) ** 2
    means = smooth(values[graph.order], graph.ring, graph.ring_starts)
    expected = np.array([1, 2, 5, 10, 17, 16])
    np.testing.assert_array_equal(means, expected[graph.order])


def test_roughness_is_the_mean_square_of_differences() -> None:
    neighbours = np.array([[0], [0], [1]])
    assert roughness(np.array([1.0, 3, 6]), neighbours, np.array([0, 1, 1])) == (4 + 9) / 2
    assert roughness(np.array([1.0]), neighbours[:1], np.array([0])) == 0
