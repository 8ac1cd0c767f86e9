"""Frames from how they stand to each other: exact where they can agree, the best where they cannot, and smooth."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixseq.mesh.measures import dihedral_angles, edge_lengths
from mixseq.mesh.rotations import matrix_to_quat, normalise_quat, quat_conjugate, quat_multiply, quat_to_matrix
from mixseq.mesh.topology import connected_components
from mixseq.shells.face_frames import FrameGraph, HingeFrames, bridging_mask, flat_triangles, triangle_frames
from mixseq.types import Float
from tests.meshes import Mesh, flipped, grid, pages, rotation, topology_of, torus, tube

TOPOLOGY = topology_of(torus(10, 6))
COUNT, PAIRS = len(TOPOLOGY.faces), TOPOLOGY.hinge_faces.astype(np.int64)


def graph(*known: int) -> FrameGraph:
    marks = np.zeros(COUNT, dtype=bool)
    marks[list(known)] = True
    return FrameGraph(PAIRS, np.ones(len(PAIRS)), marks)


def some_frames(seed: int = 0) -> Float:
    return normalise_quat(np.random.default_rng(seed).normal(size=(COUNT, 4)))


def turns_between(frames: Float) -> Float:
    return quat_multiply(quat_conjugate(frames[PAIRS[:, 0]]), frames[PAIRS[:, 1]])


def misfit(frames: Float, turns: Float) -> float:
    """Sum of squared sines of half the angles between pairs."""
    off = quat_multiply(quat_conjugate(quat_multiply(frames[PAIRS[:, 0]], turns)), frames[PAIRS[:, 1]])
    return float(np.square(off[:, 1:]).sum())


def perturbed(turns: Float, size: float) -> Float:
    rng = np.random.default_rng(7)
    return normalise_quat(
        quat_multiply(turns, normalise_quat(np.array([1.0, 0, 0, 0]) + size * rng.normal(size=turns.shape)))
    )


def assert_same(first: Float, second: Float, atol: float) -> None:
    np.testing.assert_allclose(np.abs((first * second).sum(axis=1)), 1.0, atol=atol)


def test_chains_are_exact_where_frames_agree() -> None:
    frames = some_frames()
    for known in ([0], [17], [3, 80]):
        assert_same(graph(*known).chain(turns_between(frames), frames[known]), frames, 1e-13)


def test_averages_keep_what_fits() -> None:
    frames = some_frames()
    assert_same(graph(4).average(frames, turns_between(frames), 3), frames, 1e-13)


def test_averages_fit_better_than_chains_and_keep_what_is_known() -> None:
    frames, net = some_frames(), graph(4)
    turns = perturbed(turns_between(frames), 0.1)
    chained = net.chain(turns, frames[[4]])
    better = [misfit(net.average(chained, turns, rounds), turns) for rounds in range(4)]
    assert better[1] < 0.5 * better[0] and better[3] <= better[2] <= better[1]
    assert_same(net.average(chained, turns, 3)[[4]], frames[[4]], 1e-12)


def test_averages_are_those_of_least_misfit() -> None:
    """No small turn of any frame fits better."""
    frames, net = some_frames(), graph(0)
    turns = perturbed(turns_between(frames), 0.05)
    best = net.average(net.chain(turns, frames[[0]]), turns, 40)
    least = misfit(best, turns)
    rng = np.random.default_rng(2)
    for _ in range(20):
        step = np.zeros((COUNT, 4))
        step[:, 0] = 1.0
        step[rng.integers(1, COUNT), 1:] = 1e-3 * rng.normal(size=3)
        assert misfit(quat_multiply(normalise_quat(step), best), turns) >= least * (1 - 1e-9)


def test_frames_are_smooth_even_where_a_pair_is_half_a_turn_off() -> None:
    """One turn of a pair goes once around; the frames do not jump."""
    frames, net = some_frames(), graph(0)
    turns = perturbed(turns_between(frames), 0.05)
    path = []
    for angle in np.linspace(0.0, 2.0 * np.pi, 200):
        around = turns.copy()
        around[50] = quat_multiply(turns[50], np.array([np.cos(angle / 2), np.sin(angle / 2), 0, 0]))
        path.append(net.average(net.chain(around, frames[[0]]), around, 2))
    cosines = np.abs((np.array(path[1:]) * np.array(path[:-1])).sum(axis=2))
    assert np.degrees(2 * np.arccos(np.minimum(cosines, 1.0))).max() < 6.0
    assert_same(path[0], path[-1], 1e-9)


def test_what_is_connected() -> None:
    assert connected_components(5, np.array([[0, 3], [3, 1]])).tolist() == [0, 0, 1, 0, 2]
    assert connected_components(2, np.zeros((0, 2), dtype=np.int64)).tolist() == [0, 1]


def test_pairs_that_are_not_sound_make_no_circles() -> None:
    """One leads to what no sound pair reaches, however many there are; between what sound ones connect none does."""
    pairs = np.array([[0, 1], [1, 2], [2, 3], [3, 0], [1, 3], [3, 4], [4, 5]])
    sound = np.array([True, True, False, False, False, False, False])
    assert bridging_mask(6, pairs, sound).tolist() == [True, True, True, False, False, True, True]
    assert bridging_mask(6, pairs, np.ones(7, dtype=bool)).all()
    assert not bridging_mask(6, pairs[:0], sound[:0]).size


# Triangles from lengths, their frames, and how frames of neighbours stand to each other

MESHES: list[Mesh] = [
    tube(6, 9),
    torus(9, 6),
    grid(5, 5),
    pages(3, 5, 3),
    (tube(6, 9)[0], flipped(tube(6, 9)[1])),
    (tube(5, 6)[0], np.where(np.arange(len(tube(5, 6)[1]))[:, None] % 3, tube(5, 6)[1], tube(5, 6)[1][:, ::-1])),
]


@given(st.lists(st.floats(0.1, 10.0), min_size=3, max_size=3))
def test_sides_have_their_lengths_where_there_is_a_triangle(sides: list[float]) -> None:
    lengths = np.array(sides)
    (flat,) = flat_triangles(lengths[None])
    found = np.linalg.norm(np.roll(flat, -1, axis=0) - flat, axis=1)
    np.testing.assert_allclose(found[[0, 2]], lengths[[0, 2]], rtol=1e-9)
    if 2 * lengths.max() < lengths.sum():
        np.testing.assert_allclose(found, lengths, rtol=1e-6)
    else:
        assert flat[2, 1] == pytest.approx(0.0, abs=1e-6)


def test_frames_turn_with_triangles() -> None:
    rng = np.random.default_rng(3)
    x, faces = rng.normal(size=(40, 3)), np.arange(39).reshape(-1, 3)
    turn = rotation((0.3, -2.0, 1.0))
    turned = quat_multiply(matrix_to_quat(turn), triangle_frames(x, faces))
    same = np.abs((turned * triangle_frames(x @ turn.T, faces)).sum(axis=1))
    np.testing.assert_allclose(same, 1.0, atol=1e-12)
    sides = x[faces[:, 1]] - x[faces[:, 0]]
    along = quat_to_matrix(triangle_frames(x, faces))[:, :, 0]
    np.testing.assert_allclose(along * np.linalg.norm(sides, axis=1)[:, None], sides, atol=1e-12)


@pytest.mark.parametrize(
    "corners",
    [
        [[0, 0, 0]] * 3,
        [[0, 0, 0], [1, 1, 1], [2, 2, 2]],
        [[0, 0, 0], [0, 0, 0], [1, 0, 0]],
        [[1, 2, 3], [1, 2, 4], [1, 2, 3]],
    ],
)
def test_triangles_without_area_have_frames(corners: list[list[int]]) -> None:
    (frame,) = triangle_frames(np.array(corners, dtype=np.float64), np.array([[0, 1, 2]]))
    assert np.linalg.norm(frame) == pytest.approx(1.0)
    matrix = quat_to_matrix(frame)
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-12)


@pytest.mark.parametrize("mesh", MESHES)
def test_frames_differ_by_what_lengths_and_angles_tell(mesh: Mesh) -> None:
    topology = topology_of(mesh)
    x = mesh[0] + 0.05 * np.random.default_rng(1).normal(size=mesh[0].shape)
    flat = flat_triangles(edge_lengths(x, topology.edges)[topology.face_edges])
    turns = HingeFrames(topology.faces, topology.hinges, topology.hinge_faces).rotations(
        flat, dihedral_angles(x, topology.hinges)
    )
    frames = triangle_frames(x, topology.faces)
    expected = quat_multiply(frames[topology.hinge_faces[:, 0]], turns)
    same = np.abs((expected * frames[topology.hinge_faces[:, 1]]).sum(axis=1))
    np.testing.assert_allclose(same, 1.0, atol=1e-10)
