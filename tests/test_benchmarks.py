"""Benchmarks: what the coders of compress decode, how rates are read off their points, and other solvers of poses."""

from __future__ import annotations

from typing import get_args

import numpy as np
import pytest

from mixseq.mesh.topology import Topology
from mixseq.sequence.sequence import MeshSequence
from mixseq.spaces.gradient import GradientSpace
from scripts.benchmarks.common.harness import repeat_with_variation
from scripts.benchmarks.compress import CODERS, Point, errors, is_installed, join_loops, rate
from scripts.benchmarks.peers.coders import Coder, step_of
from scripts.benchmarks.peers.packing import from_lzma, numbers, planes, to_lzma, width
from scripts.benchmarks.peers.pca import Pca, Space, components, to_points
from scripts.benchmarks.peers.prediction import prediction, traversal
from scripts.benchmarks.pose import gradient_solver, vertex_solver
from tests.meshes import SEQUENCES, bar, bent, grid, topology_of, torus, tube

STEPPED = [coder for coder in CODERS if coder.name in ("trajectory", "shape")]


def mesh_of(sequence: MeshSequence) -> Topology:
    return Topology(sequence.faces, sequence.vertex_count)


def point(kg: float, bits: float) -> Point:
    return Point(bits, kg, kg / 100, 0.0, 0.0)


def test_numbers_survive_planes_and_lzma() -> None:
    values = np.array([0, -1, 1, -128, 127, 300, -(2**40), 2**40])
    assert width(values[:5]) == 1
    assert width(values[:6]) == 2
    size = width(values)
    np.testing.assert_array_equal(numbers(from_lzma(to_lzma(planes(values, size))), size), values)
    assert planes(np.array([0, -1, 1, 300]), 2).hex() == "0001025800000002"


def test_an_order_starts_with_a_face_and_grows_across_edges() -> None:
    mesh = topology_of(torus(12, 6))
    order = traversal(mesh)
    assert sorted(order) == list(range(mesh.vertex_count))
    assert set(order[:3]) == set(mesh.faces[0])
    neighbours = mesh.vertex_adjacency
    for place in range(1, len(order)):
        assert neighbours[[order[place]]].indices.tolist() != []
        assert set(neighbours[[order[place]]].indices) & set(order[:place])


def test_parallelograms_predict_a_flat_lattice() -> None:
    points, faces = grid(6, 5)
    over_mesh = prediction(Topology(faces, len(points)))
    residuals = over_mesh.residuals(points.astype(np.int64), 2)
    flat = (residuals == 0).all(axis=1)
    assert flat.sum() >= 0.9 * len(points) - 3
    assert not (over_mesh.residuals(points.astype(np.int64), 0) == 0).all(axis=1)[1:].any()


@pytest.mark.parametrize("name", SEQUENCES)
def test_predictions_are_undone_exactly(name: str) -> None:
    sequence = SEQUENCES[name]()
    values = np.random.default_rng(0).integers(-(2**20), 2**20, (sequence.vertex_count, 2))
    over_mesh = prediction(mesh_of(sequence))
    for predictor in range(len(over_mesh.weights)):
        residuals = over_mesh.residuals(values, predictor)
        np.testing.assert_array_equal(over_mesh.values(residuals, predictor), values)


@pytest.mark.parametrize("space", get_args(Space))
def test_all_components_are_the_sequence(space: Space) -> None:
    points = bar().points
    mean, coefficients, vectors = components(points, space)
    lengths = np.maximum(np.linalg.norm(coefficients, axis=0), 1e-9)
    matrix = (coefficients / lengths) @ vectors + mean[:, None]
    np.testing.assert_allclose(to_points(matrix, space, len(points)), points, atol=1e-9)


@pytest.mark.parametrize("coder", STEPPED, ids=lambda coder: coder.name)
@pytest.mark.parametrize("name", ["bar", "folding sheet", "several components", "unused vertices"])
def test_what_is_decoded_has_the_error_of_its_step(coder: Coder, name: str) -> None:
    sequence = SEQUENCES[name]()
    found = []
    for kg in (1.0, 0.01):
        data = coder.encode(sequence, step_of(sequence, kg))
        decoded = coder.decode(mesh_of(sequence), data)
        assert decoded.shape == sequence.points.shape
        found.append(errors(sequence.points, decoded, sequence.diagonal)[0])
        assert coder.signals(mesh_of(sequence), data) == len(data)
    assert found[0] < 3
    assert found[1] < 0.03


def test_a_shift_of_the_whole_is_cheap_in_trajectory_space() -> None:
    sequence = bar(frames=20)
    still = sequence.with_points(np.repeat(sequence.points[:1], 20, axis=0))
    moving = still.with_points(still.points + np.linspace(0, 1, 20)[:, None, None])
    sizes = [len(Pca("trajectory").encode(each, 1e-3)) for each in (still, moving)]
    assert sizes[1] < sizes[0] + 60


@pytest.mark.skipif(not is_installed("DracoPy"), reason="not installed")
def test_draco_gives_back_all_vertices_in_order() -> None:
    coder = next(coder for coder in CODERS if coder.name == "draco")
    sequence = bar()
    data = coder.encode(sequence, 12)
    decoded = coder.decode(mesh_of(sequence), data)
    size = np.ptp(sequence.points.reshape(-1, 3), axis=0).max()
    assert np.abs(decoded - sequence.points).max() <= 0.51 * size / (2**12 - 1)
    assert 0 < coder.signals(mesh_of(sequence), data) < len(data)


def test_rates_lie_on_the_lower_staircase() -> None:
    points = [point(0.1, 4.0), point(1.0, 2.0), point(0.3, 9.0), point(10.0, 1.0)]
    assert rate(points, "kg_percent", 1.0) == pytest.approx(2.0)
    assert rate(points, "kg_percent", 10**-0.5) == pytest.approx(3.0)
    assert rate(points, "max_error", 1e-1) == pytest.approx(1.0)
    assert rate(points, "kg_percent", 50.0) == pytest.approx(1.0)
    assert rate(points, "kg_percent", 0.05) is None
    assert rate([], "kg_percent", 1.0) is None


def test_loops_with_variation_do_not_repeat() -> None:
    sequence = bar(frames=6)
    long = repeat_with_variation(sequence, 4)
    assert len(long) == 24
    away = np.abs(long.points[:6] - long.points[6:12]).max() / sequence.diagonal
    assert 1e-3 < away < 1
    np.testing.assert_array_equal(long.points, repeat_with_variation(sequence, 4).points)


def test_names_may_be_one_word_or_two() -> None:
    assert join_loops(["a", "x10", "b", "c x2"]) == ["a x10", "b", "c x2"]


def test_compared_solvers_find_poses_by_handles() -> None:
    """MeshIK finds the angle of a hinge, vertices find frames."""
    points, faces = tube(8, 21, length=4.0)
    *frames, expected = (bent(points, angle, middle=2.0, blend=0.3) for angle in (*np.linspace(-0.8, 0.8, 9), 0.3))
    bends, topology = np.stack(frames), Topology(faces, len(points))
    ids = np.array([0, 2, 5, int(bends[0, :, 2].argmax())])
    space = GradientSpace(topology, 1.0, bends[0])
    found = gradient_solver(bends, space)(ids, expected[ids], 4)
    np.testing.assert_allclose(found[ids], expected[ids], atol=1e-12)
    assert np.abs(found - expected).max() < 0.02
    for solve in (gradient_solver(bends, space), vertex_solver(bends)):
        np.testing.assert_allclose(solve(ids, bends[2, ids], 2), bends[2], atol=1e-8)
