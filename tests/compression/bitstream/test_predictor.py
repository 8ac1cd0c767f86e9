"""Predictions of signals over a graph: exact where earlier signals taught them, the same in whatever order sums are."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from mixseq.compression.bitstream import predictor as module
from mixseq.compression.bitstream.predictor import (
    MAX_SLOPE_NEIGHBOURS,
    MAX_STENCIL_NODES,
    MIN_STEP_UNITS,
    ROUGHNESS_SCALE,
    SIMILAR_VERTICES,
    SIMILARITY_SEARCH_SIGNALS,
    UNIFORM_STEP_SIGNALS,
    UNITS_PER_STEP,
    Predictor,
    Stencils,
    graph_stencils,
    group_nodes,
    level_steps,
    new_gram,
)
from mixseq.compression.bitstream.signal_graph import (
    SignalGraph,
    coarser_levels,
    mesh_graph,
    mesh_neighbours,
    new_neighbours,
    path_graph,
)
from mixseq.runtime.jit import compiled
from mixseq.types import Float, Index
from tests.meshes import Mesh, grid, joined, seeds, tetrahedron, torus, tube


def graph_of(mesh: Mesh) -> SignalGraph:
    return mesh_graph(mesh[1], len(mesh[0]))


GRAPHS = {
    "torus": graph_of(torus(9, 6)),
    "components": graph_of(joined(tube(5, 6), tetrahedron(), grid(3, 3))),
    "vertices without faces": mesh_graph(np.array([[3, 4, 5]]), 30),
    "one vertex": mesh_graph(np.zeros((0, 3), dtype=np.int64), 1),
    "one frame": path_graph(1),
    "a hundred frames": path_graph(100),
}


@compiled
def expected(node: int, neighbours: NDArray[np.int32], counts: NDArray[np.int32], weights: Float, values: Index) -> int:
    """Return what is predicted of a node."""
    return module.predict(node, neighbours, counts, weights, values)


def code(predictor: Predictor, signal: Float) -> Index:
    """Numbers of a signal in steps, in the order of nodes; the predictor learns it."""
    numbers = np.zeros(len(signal), dtype=np.int64)
    known = predictor.neighbours, predictor.counts, predictor.weights, predictor.values
    for node, target in enumerate(np.rint(UNITS_PER_STEP * signal).astype(np.int64).tolist()):
        predicted = expected(node, *known)
        numbers[node] = round((target - predicted) / int(predictor.steps[node]))
        predictor.values[node] = predicted + predictor.steps[node] * numbers[node]
    predictor.finish()
    return numbers


def decode(predictor: Predictor, numbers: Index) -> Index:
    """Values that numbers stand for."""
    known = predictor.neighbours, predictor.counts, predictor.weights, predictor.values
    for node, number in enumerate(numbers.tolist()):
        predictor.values[node] = expected(node, *known) + predictor.steps[node] * number
    values = predictor.values.copy()
    predictor.finish()
    return values


# Predictions --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", GRAPHS)
def test_who_decodes_has_the_same_values(name: str) -> None:
    graph, rng = GRAPHS[name], np.random.default_rng(5)
    coding, decoding = Predictor(graph), Predictor(graph)
    for scale in 2.0 ** -np.arange(20) * 1e4:
        signal = np.cumsum(rng.normal(scale=scale, size=graph.size))
        numbers = code(coding, signal)
        values = decode(decoding, numbers)
        np.testing.assert_array_equal(values, coding.values)
        assert np.abs(values / UNITS_PER_STEP - signal).max() <= 0.5 + 0.5 / UNITS_PER_STEP
    np.testing.assert_array_equal(decoding.weights, coding.weights)


def test_at_first_a_node_is_what_its_stencil_says() -> None:
    predictor = Predictor(GRAPHS["torus"])
    predictor.values[:] = UNITS_PER_STEP * np.arange(54) ** 2
    of_last = graph_stencils(GRAPHS["torus"])
    beside = of_last.neighbours[53, : of_last.counts[53]]
    known = predictor.neighbours, predictor.counts, predictor.weights, predictor.values
    mean = float(of_last.weights[53, : of_last.counts[53]] @ predictor.values[beside])
    assert expected(53, *known) == round(mean)
    assert expected(0, *known) == 0


def test_affine_signals_are_predicted_once_the_coordinates_are_known() -> None:
    points, faces = torus(12, 8)
    graph = mesh_graph(faces, len(points))
    predictor = Predictor(graph)
    for coordinate in points.T:
        code(predictor, 1e4 * coordinate[graph.order])
    numbers = code(predictor, 1e4 * (points @ [0.3, -0.8, 0.5])[graph.order] + 7e3)
    assert np.median(np.abs(numbers[10:])) <= 1
    unlearned = code(Predictor(graph), 1e4 * (points @ [0.3, -0.8, 0.5])[graph.order] + 7e3)
    assert np.median(np.abs(unlearned[10:])) > 100


def test_the_same_shape_twice_is_coded_once() -> None:
    """Two components that move alike: once that is known, the second one is predicted from the first."""
    predictor, rng = Predictor(graph_of(joined(torus(9, 6), torus(9, 6)))), np.random.default_rng(1)
    graph = graph_of(joined(torus(9, 6), torus(9, 6)))
    for _ in range(30):
        numbers = code(predictor, np.tile(50 * rng.normal(size=54), 2)[graph.order])
    assert np.count_nonzero(np.abs(numbers[-50:]) <= 1) > 0.3 * 50
    assert np.abs(numbers[:20]).mean() > 10


def test_frames_of_a_motion_that_comes_back_predict_each_other() -> None:
    graph, rng = path_graph(128), np.random.default_rng(1)
    predictor = Predictor(graph)
    for _ in range(40):
        numbers = code(predictor, np.tile(50 * rng.normal(size=16), 8)[graph.order])
    assert np.median(np.abs(numbers[8:])) == 0
    assert np.abs(numbers).max() > 50


@pytest.mark.parametrize("name", GRAPHS)
def test_damaged_values_do_no_harm(name: str) -> None:
    """Predictions stay whole numbers within bounds; the largest words wrap around."""
    graph, rng = GRAPHS[name], np.random.default_rng(7)
    predictor = Predictor(graph)
    words = np.iinfo(np.int64)
    for round_ in range(40):
        few = rng.random(graph.size) < 0.2
        some = np.where(few, rng.integers(words.min, words.max, graph.size), rng.integers(-9, 9, graph.size))
        predictor.values[:] = words.min if round_ % 5 == 0 else some
        known = predictor.neighbours, predictor.counts, predictor.weights, predictor.values
        for node in range(graph.size):
            assert abs(expected(node, *known)) <= 2**50
        predictor.finish()


def test_weights_that_are_no_numbers_predict_bounds() -> None:
    predictor = Predictor(GRAPHS["torus"])
    predictor.weights[:] = np.nan
    known = predictor.neighbours, predictor.counts, predictor.weights, predictor.values
    assert expected(53, *known) == -(2**50)


def test_steps_of_later_signals_are_smaller_on_coarse_levels() -> None:
    assert level_steps(16).tolist() == [40, 45, 51, 51, *[57] * 4, *[64] * 8]
    assert level_steps(1).tolist() == [UNITS_PER_STEP]
    assert level_steps(1 << 12).min() == MIN_STEP_UNITS
    predictor = Predictor(GRAPHS["torus"], 2)
    for _ in range(2 * UNIFORM_STEP_SIGNALS):
        assert (predictor.steps == UNITS_PER_STEP).all()
        predictor.finish()
    np.testing.assert_array_equal(predictor.steps, level_steps(54))


def test_steps_over_time_are_equal() -> None:
    predictor = Predictor(path_graph(50))
    for _ in range(UNIFORM_STEP_SIGNALS + 1):
        predictor.finish()
    assert (predictor.steps == UNITS_PER_STEP).all()


# Exactness ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["torus", "components", "a hundred frames"])
def test_all_but_the_weights_is_exact(name: str) -> None:
    """Sums of whole numbers, in another order and with Python's own, are the same bits."""
    graph, rng = GRAPHS[name], np.random.default_rng(3)
    predictor = Predictor(graph)
    for scale in 1e4 * 0.7 ** np.arange(16):
        code(predictor, np.cumsum(rng.normal(scale=scale, size=graph.size)))
    weights = predictor.weights * 2**24
    np.testing.assert_array_equal(weights, np.rint(weights))
    many = predictor.counts > 1
    assert (weights[many].sum(axis=1) == 2**24).all()
    predictor.values[:] = rng.integers(-(2**26), 2**26, graph.size)
    known = predictor.neighbours, predictor.counts, predictor.weights, predictor.values
    for node in range(graph.size):
        beside = predictor.neighbours[node, : predictor.counts[node]]
        exact = sum(
            int(weights[node, i]) * int(predictor.values[other]) for i, other in reversed(list(enumerate(beside)))
        )
        assert expected(node, *known) == (exact + 2**23) >> 24


def test_gram_matrices_are_exact() -> None:
    """Learned in the opposite order they have the same bits."""
    graph, rng = GRAPHS["torus"], np.random.default_rng(3)
    neighbours, counts = graph.neighbours, graph.counts
    signals = [np.rint(UNITS_PER_STEP * scale * rng.normal(size=54)) for scale in 1e5 * 0.5 ** np.arange(24)]
    grams = []
    for order in (signals, signals[::-1]):
        blocks = group_nodes(counts)
        gram = new_gram(blocks)
        for signal in order:
            trust = module.compute_trust(signal, ROUGHNESS_SCALE * UNITS_PER_STEP**2, neighbours, counts)
            some = signal[None], np.array([trust])
            module.accumulate_gram(*some, blocks, neighbours, gram)
        grams.append(gram)
    np.testing.assert_array_equal(grams[0], grams[1])
    assert grams[0].any()


def test_matrices_that_are_computed_again_give_the_same_weights(monkeypatch: pytest.MonkeyPatch) -> None:
    """Large graphs keep signals, some time, and then matrices."""
    signals = 1e4 * np.random.default_rng(4).normal(size=(12, 54)) * 0.7 ** np.arange(12)[:, None]
    monkeypatch.setattr(module, "MAX_REPLAYED_SIGNALS", 9)
    monkeypatch.setattr(module, "BLOCKS_PER_REPLAY", 2)
    weights: list[list[Float]] = []
    for nodes in (100, 1):
        monkeypatch.setattr(module, "MIN_REPLAYED_NODES", nodes)
        predictor = Predictor(GRAPHS["torus"])
        weights.append([])
        for signal in signals:
            predictor.values[:] = np.rint(signal)
            predictor.finish()
            weights[-1].append(predictor.weights.copy())
    for kept, replayed in zip(*weights, strict=True):
        np.testing.assert_array_equal(kept, replayed)
    assert not np.array_equal(weights[0][9], weights[0][-1])


def test_trust_is_a_power_of_two() -> None:
    neighbours, counts = np.array([[0], [0], [1]], dtype=np.int32), np.array([0, 1, 1], dtype=np.int32)
    for rough, expected_trust in [(0.0, 1.0), (4.9, 1.0), (5.1, 0.5), (19.9, 0.5), (20.1, 0.25), (1e6, 2.0**-17)]:
        signal = np.array([0.0, np.sqrt(rough), 0.0])  # a mean square of rough
        assert module.compute_trust(signal, 10.0, neighbours, counts) == expected_trust
    assert module.compute_trust(signal[:1], 10.0, neighbours, counts[:1]) == 1


# Weights ------------------------------------------------------------------------------------------------------


def constrained(gram: Float, ridge: float, start: Float) -> Float:
    """The minimum of w G w + ridge |w - start|^2 with a sum of one, from its optimality system."""
    size = len(start)
    system = np.zeros((size + 1, size + 1))
    system[:size, :size] = gram + ridge * np.eye(size)
    system[size, :size] = system[:size, size] = 1
    return np.linalg.solve(system, np.append(ridge * start, 1))[:size]


@settings(max_examples=30, deadline=None)
@given(seed=seeds, nodes=st.integers(1, 80))
def test_weights_are_those_of_numpy(seed: int, nodes: int) -> None:
    """In blocks that are full, or not, of nodes with any number of neighbours."""
    rng = np.random.default_rng(seed)
    most, ridge = 7, float(rng.uniform(0.1, 3))
    counts = rng.integers(0, most + 1, nodes).astype(np.int32)
    neighbours = rng.integers(0, nodes, (nodes, most)).astype(np.int32)
    start = rng.dirichlet(np.ones(most), nodes) * (np.arange(most) < counts[:, None])
    start /= np.maximum(start.sum(axis=1), 1e-9)[:, None]
    blocks = group_nodes(counts)
    gram = new_gram(blocks)
    products = np.zeros((nodes, most, most))
    signals = rng.normal(size=(int(rng.integers(1, 9)), nodes))
    trusts = rng.uniform(0.1, 1, len(signals))
    module.accumulate_gram(signals, trusts, blocks, neighbours, gram)
    for values, trust in zip(signals, trusts, strict=True):
        apart = values[neighbours] - values[:, None]
        products += trust * apart[:, :, None] * apart[:, None, :]
    weights = np.full((nodes, most), 9.0)
    module.solve_weights(ridge, blocks, gram, start, weights)
    for node, count in enumerate(counts):
        if count > 1:
            wanted = constrained(products[node, :count, :count], ridge, start[node, :count])
            np.testing.assert_allclose(weights[node, :count], wanted, atol=1e-6)
            assert (weights[node, count:] == 9).all()
        else:
            assert (weights[node] == 9).all()


def test_the_parallelogram_rule_is_a_case_of_it() -> None:
    """A vertex with three neighbours in a plane: the weights of the parallelogram are the only ones."""
    corner = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    neighbours = np.array([[0, 0, 0], [0, 0, 0], [0, 0, 0], [0, 1, 2]], dtype=np.int32)
    blocks = group_nodes(np.array([0, 0, 0, 3], dtype=np.int32))
    gram = new_gram(blocks)
    weights = np.zeros((4, 3))
    module.accumulate_gram(corner.T.copy(), np.ones(3), blocks, neighbours, gram)
    module.solve_weights(1e-9, blocks, gram, np.full((4, 3), 1 / 3), weights)
    np.testing.assert_allclose(weights[3], [-1, 1, 1], atol=1e-7)


@pytest.mark.parametrize(("many", "lanes"), [(20, module.LANES_PER_SMALL_BLOCK), (2000, module.LANES_PER_BLOCK)])
def test_blocks_are_of_nodes_with_equally_many_neighbours(many: int, lanes: int) -> None:
    counts = np.array([0, 1, *[3] * many, 2], dtype=np.int32)
    members, sizes, _ = group_nodes(counts)
    assert members.shape[1] == lanes
    assert sizes.tolist() == [2] + [3] * -(-many // lanes)
    assert set(members[0].tolist()) == {many + 2}
    assert set(members[1:].reshape(-1).tolist()) == set(range(2, many + 2))


@pytest.mark.parametrize("size", [1e3, 1e6, 1e9])
def test_signals_of_very_many_steps_are_no_harm(size: float) -> None:
    """Then Gram matrices are singular but for rounding: weights that are any would make numbers that no word holds."""
    mesh = torus(12, 8)
    graph = graph_of(mesh)
    predictor = Predictor(graph)
    rng = np.random.default_rng(0)
    for signal in [*(size * mesh[0].T), *(1e-3 * size * rng.normal(size=(4, len(mesh[0]))))]:
        assert np.abs(code(predictor, signal[graph.order])).max() < 100 * size
    assert np.abs(predictor.weights).max() < 100


# Nodes that are alike -----------------------------------------------------------------------------------------


def search(graph: SignalGraph, signals: Float, exhaustive: int) -> list[list[int]]:
    """Four nodes that are nearest to each."""
    similar, found = np.zeros((graph.size, 4), dtype=np.int32), np.zeros(graph.size, dtype=np.int32)
    neighbours, counts = graph.neighbours, graph.counts
    module.find_similar_nodes(signals, neighbours, counts, exhaustive, similar, found)
    return [row[:count].tolist() for row, count in zip(similar, found, strict=True)]


@pytest.mark.parametrize("exhaustive", [1000, 20])
def test_similar_nodes_are_those_of_a_search_of_all_that_are_looked_at(exhaustive: int) -> None:
    """Of equally near ones the first."""
    graph = graph_of(torus(12, 9))
    signals = np.random.default_rng(2).integers(-3, 4, (3, graph.size)).astype(np.float64)
    found = search(graph, signals, exhaustive)
    for node in range(graph.size):
        beside = graph.neighbours[node, : graph.counts[node]].tolist()
        looked: list[int] = list(range(node))
        if node >= exhaustive:
            looked = [
                other for one in beside for other in [*graph.neighbours[one, : graph.counts[one]].tolist(), *found[one]]
            ]
        others = [other for other in dict.fromkeys(looked) if other not in beside]
        others.sort(key=lambda other: float(np.square(signals[:, node] - signals[:, other]).sum()))
        assert found[node] == others[:4]
    assert max(map(len, found)) == 4


def test_similar_nodes_come_behind_the_neighbours_of_the_graph() -> None:
    graph, rng = GRAPHS["components"], np.random.default_rng(2)
    predictor = Predictor(graph)
    for _ in range(SIMILARITY_SEARCH_SIGNALS):
        code(predictor, 20 * rng.normal(size=graph.size))
    assert (predictor.counts - graph.counts).max() == SIMILAR_VERTICES
    for node in range(graph.size):
        beside = predictor.neighbours[node, : predictor.counts[node]].tolist()
        assert beside[: graph.counts[node]] == graph.neighbours[node, : graph.counts[node]].tolist()
        assert len(set(beside)) == len(beside)
        assert all(other < node for other in beside)


# Weights to begin with: what bends a mesh least

MESHES = {
    "torus": torus(24, 10),
    "tube": tube(8, 12),
    "grid": grid(9, 7),
    "components": joined(tube(5, 6), tetrahedron(), grid(3, 3)),
}


def predicted(found: Stencils, values: Float) -> Float:
    """What stencils say of values ``(N,)`` in the order of nodes."""
    used = np.arange(found.weights.shape[1]) < found.counts[:, None]
    return np.asarray((np.where(used, found.weights, 0.0) * values[found.neighbours]).sum(axis=1))


@pytest.mark.parametrize("name", MESHES)
def test_nodes_before_a_node_with_weights_that_add_up_to_one(name: str) -> None:
    graph = graph_of(MESHES[name])
    found = graph_stencils(graph)
    assert found.counts.max() <= MAX_STENCIL_NODES
    assert found.counts[0] == 0
    for node in range(1, graph.size):
        count = found.counts[node]
        nodes: list[int] = found.neighbours[node, :count].tolist()
        assert count > 0
        assert max(nodes) < node
        assert len(set(nodes)) == count
        assert set(graph.neighbours[node, : graph.counts[node]].tolist()) <= set(nodes)
        assert found.weights[node, :count].sum() == pytest.approx(1, abs=MAX_STENCIL_NODES * 2.0**-25)


def test_curved_surfaces_are_predicted_better_than_by_means() -> None:
    points, faces = MESHES["torus"]
    graph = mesh_graph(faces, len(points))
    fine = slice(graph.size // 3, None)
    means = Stencils(graph.neighbours, graph.counts, graph.weights)
    for values in points[graph.order].T:
        off, of_means = (
            np.square(values - predicted(one, values))[fine].sum() for one in (graph_stencils(graph), means)
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
    monkeypatch.setattr(module, "MAX_STENCIL_NODES", 60)
    points, faces = torus(24, 10)
    count, graph = len(points), mesh_graph(faces, len(points))
    values = np.random.default_rng(0).normal(size=count)
    found = predicted(graph_stencils(graph), values[graph.order])
    first = next(coarser_levels(*mesh_neighbours(faces, count), *new_neighbours(count)))
    ring = [set(first.adjacent[a:b].tolist()) for a, b in pairwise(first.starts)]
    left = [set(first.new_adjacent[a:b].tolist()) for a, b in pairwise(first.new_starts)]
    for vertex in first.removed.tolist():
        beside = {vertex: dict.fromkeys(ring[vertex], 1)}
        for one in ring[vertex]:
            kept = {other for other in left[one] if other in ring[one] or other not in ring[vertex]}
            beside[one] = {vertex: 1} | {other: 1 if other in ring[one] else 2 for other in kept}
        below, at, above = (energy(value, vertex, values, beside) for value in (-1.0, 0.0, 1.0))
        lowest = (below - above) / (2 * (below + above - 2 * at))
        assert found[graph.order == vertex] == pytest.approx(lowest, abs=60 * 2.0**-24)  # weights are rounded


def test_on_a_line_levels_are_alike() -> None:
    """A mesh of triangles without area, with the edges of a closed line."""
    count = 128
    steps = np.arange(count)
    graph = mesh_graph(np.stack([steps, np.roll(steps, 1), steps], axis=1), count)
    found = graph_stencils(graph)
    regular = 0
    for node in range(graph.size):
        beside = found.neighbours[node, : found.counts[node]]
        offsets = (graph.order[beside] - graph.order[node] + count // 2) % count - count // 2
        order = np.argsort(offsets)
        if offsets[order].tolist() in [[-3 * k, -k, k, 3 * k] for k in (1, 2, 4, 8)]:
            np.testing.assert_allclose(found.weights[node, order], [-1 / 12, 7 / 12, 7 / 12, -1 / 12], atol=2.0**-24)
            regular += 1
    assert regular == 64 + 32 + 16 + 8


def test_hubs_cost_no_time_and_do_no_harm() -> None:
    rim = np.arange(1, 40 * MAX_SLOPE_NEIGHBOURS)
    graph = mesh_graph(np.stack([0 * rim, rim, np.roll(rim, 1)], axis=1), len(rim) + 1)
    found = graph_stencils(graph)
    assert found.counts.max() < 8  # nothing from the other side of the hub
    np.testing.assert_allclose(predicted(found, np.ones(graph.size))[1:], 1)


def test_frames_keep_their_own_weights() -> None:
    graph = path_graph(50)
    np.testing.assert_allclose(graph_stencils(graph).weights[:, :6], graph.weights, rtol=0, atol=2.0**-25)
    np.testing.assert_array_equal(graph_stencils(graph).counts, graph.counts)
