"""Frames from how they stand to each other: exact where they can agree, the best where they cannot, and smooth."""

from __future__ import annotations

import numpy as np

from mixseq.mesh.rotations import inverse, normalised, product
from mixseq.mesh.topology import connected
from mixseq.shells.face_frames import FrameGraph, bridging
from mixseq.types import Float
from tests.meshes import topology_of, torus

TOPOLOGY = topology_of(torus(10, 6))
COUNT, PAIRS = len(TOPOLOGY.faces), TOPOLOGY.hinge_faces


def graph(*known: int) -> FrameGraph:
    marks = np.zeros(COUNT, dtype=bool)
    marks[list(known)] = True
    return FrameGraph(PAIRS, np.ones(len(PAIRS)), marks)


def some_frames(seed: int = 0) -> Float:
    return normalised(np.random.default_rng(seed).normal(size=(COUNT, 4)))


def turns_between(frames: Float) -> Float:
    return product(inverse(frames[PAIRS[:, 0]]), frames[PAIRS[:, 1]])


def misfit(frames: Float, turns: Float) -> float:
    """Sum of squared sines of half the angles between pairs."""
    off = product(inverse(product(frames[PAIRS[:, 0]], turns)), frames[PAIRS[:, 1]])
    return float(np.square(off[:, 1:]).sum())


def perturbed(turns: Float, size: float) -> Float:
    rng = np.random.default_rng(7)
    return normalised(
        product(turns, normalised(np.array([1.0, 0, 0, 0]) + size * rng.normal(size=turns.shape)))
    )


def assert_same(first: Float, second: Float, atol: float) -> None:
    np.testing.assert_allclose(np.abs((first * second).sum(axis=1)), 1.0, atol=atol)


def test_chains_are_exact_where_frames_agree() -> None:
    frames = some_frames()
    for known in ([0], [17], [3, 80]):
        assert_same(graph(*known).chained(turns_between(frames), frames[known]), frames, 1e-13)


def test_averages_keep_what_fits() -> None:
    frames = some_frames()
    assert_same(graph(4).averaged(frames, turns_between(frames), 3), frames, 1e-13)


def test_averages_fit_better_than_chains_and_keep_what_is_known() -> None:
    frames, net = some_frames(), graph(4)
    turns = perturbed(turns_between(frames), 0.1)
    chained = net.chained(turns, frames[[4]])
    better = [misfit(net.averaged(chained, turns, rounds), turns) for rounds in range(4)]
    assert better[1] < 0.5 * better[0] and better[3] <= better[2] <= better[1]
    assert_same(net.averaged(chained, turns, 3)[[4]], frames[[4]], 1e-12)


def test_averages_are_those_of_least_misfit() -> None:
    """No small turn of any frame fits better."""
    frames, net = some_frames(), graph(0)
    turns = perturbed(turns_between(frames), 0.05)
    best = net.averaged(net.chained(turns, frames[[0]]), turns, 40)
    least = misfit(best, turns)
    rng = np.random.default_rng(2)
    for _ in range(20):
        step = np.zeros((COUNT, 4))
        step[:, 0] = 1.0
        step[rng.integers(1, COUNT), 1:] = 1e-3 * rng.normal(size=3)
        assert misfit(product(normalised(step), best), turns) >= least * (1 - 1e-9)


def test_frames_are_smooth_even_where_a_pair_is_half_a_turn_off() -> None:
    """One turn of a pair goes once around; the frames do not jump."""
    frames, net = some_frames(), graph(0)
    turns = perturbed(turns_between(frames), 0.05)
    path = []
    for angle in np.linspace(0.0, 2.0 * np.pi, 200):
        around = turns.copy()
        around[50] = product(turns[50], np.array([np.cos(angle / 2), np.sin(angle / 2), 0, 0]))
        path.append(net.averaged(net.chained(around, frames[[0]]), around, 2))
    cosines = np.abs((np.array(path[1:]) * np.array(path[:-1])).sum(axis=2))
    assert np.degrees(2 * np.arccos(np.minimum(cosines, 1.0))).max() < 6.0
    assert_same(path[0], path[-1], 1e-9)


def test_what_is_connected() -> None:
    assert connected(5, np.array([[0, 3], [3, 1]])).tolist() == [0, 0, 1, 0, 2]
    assert connected(2, np.zeros((0, 2), dtype=np.int64)).tolist() == [0, 1]


def test_pairs_that_are_not_sound_make_no_circles() -> None:
    """One leads to what no sound pair reaches, however many there are; between what sound ones connect none does."""
    pairs = np.array([[0, 1], [1, 2], [2, 3], [3, 0], [1, 3], [3, 4], [4, 5]])
    sound = np.array([True, True, False, False, False, False, False])
    assert bridging(6, pairs, sound).tolist() == [True, True, True, False, False, True, True]
    assert bridging(6, pairs, np.ones(7, dtype=bool)).all()
    assert not bridging(6, pairs[:0], sound[:0]).size
