"""Links keep parts together between frames, and change nothing at frames."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.geometry.rotations import continuous_vectors, matrices
from mixseq.reconstruction.agreement import solve, spins, velocities
from mixseq.reconstruction.links import Boundaries, Links, Poses, complete, make_links
from mixseq.segmentation import segment_by_labels
from mixseq.topology import Topology
from tests.meshes import Float, tube

LENGTH, RINGS = 4.0, 9


def two_bones(angles: Float) -> tuple[Float, Float, Links]:
    """A tube of two rigid halves; the upper one bends about the x axis through the middle.

    Returns rotation vectors, centres and links. The bend is in radians.
    """
    rest, faces = tube(6, RINGS, LENGTH)
    topology = Topology(faces, len(rest))
    upper = (rest[faces][:, :, 2].mean(axis=1) > LENGTH / 2).astype(np.int64)
    labels = segment_by_labels(upper, topology)
    pivot = np.array([0.0, 0.0, LENGTH / 2])
    vectors = np.zeros((len(angles), 2, 3))
    top = int(labels[np.argmax(rest[faces][:, :, 2].mean(axis=1))])
    vectors[:, top, 0] = angles
    turned = matrices(vectors)
    centres = np.zeros((2, 3))
    centres[top, 2], centres[1 - top, 2] = 3.0, 1.0
    translations = np.einsum("tpij,pj->tpi", turned, centres - pivot) + pivot
    above = rest[:, 2] > LENGTH / 2
    local = rest - np.where(above[:, None], centres[top], centres[1 - top])
    part = np.where(above, top, 1 - top)
    points = np.einsum("tvij,vj->tvi", turned[:, part], local) + translations[:, part]
    boundaries = Boundaries.of(topology, labels)
    middles = np.stack([boundaries.middles(frame) for frame in points])
    links = make_links(boundaries.parts, middles, vectors, translations, np.full(2, 0.8))
    return vectors, translations, links


def half_way(poses: Poses) -> Poses:
    """The mean of two frames."""
    return Poses(*(block.mean(axis=0, keepdims=True) for block in poses))


def worst(values: Float) -> float:
    return float(np.abs(values).max())


def pivot_gap(links: Links, rotations: Float, translations: Float) -> Float:
    """Distances ``(N, n)`` between both ends of every pivot."""
    ends = [
        np.einsum("tnij,nj->tni", rotations[:, part], links.pivots[:, side]) + translations[:, part]
        for side, part in enumerate(links.parts.T)
    ]
    return np.asarray(np.linalg.norm(ends[0] - ends[1], axis=2))


def wild(parts: int = 5, frames: int = 7, seed: int = 0) -> tuple[Links, Poses]:
    """A ring of parts that move at will, and what links say of them."""
    rng = np.random.default_rng(seed)
    pairs = np.sort(np.stack([np.arange(parts), (np.arange(parts) + 1) % parts], axis=1), axis=1)
    rests = matrices(rng.normal(size=(parts, 3)))
    links = Links(
        pairs,
        rng.normal(size=(parts, 2, 3)),
        rests,
        rng.uniform(0.5, 2, (parts, 2)),
        rng.uniform(0.5, 9, (parts, 2)),
    )
    vectors = np.cumsum(rng.normal(scale=0.3, size=(frames, parts, 3)), axis=0)
    return links, complete(links, vectors, rng.normal(size=(frames, parts, 3)))


def test_the_pivot_of_two_bones_is_found() -> None:
    vectors, centres, links = two_bones(np.linspace(0, np.pi / 2, 6))
    assert links.parts.tolist() == [[0, 1]]
    turned = matrices(vectors)
    for side in (0, 1):
        where = np.einsum("tij,j->ti", turned[:, side], links.pivots[0, side]) + centres[:, side]
        # Along the axis, x, nothing but the prior tells; there it is the middle.
        np.testing.assert_allclose(where, [[0, 0, LENGTH / 2]] * 6, atol=0.02)
    assert worst(complete(links, vectors, centres).gaps) < 0.02


def test_half_a_right_angle_keeps_the_pivot_together() -> None:
    vectors, centres, links = two_bones(np.array([0.0, np.pi / 2]))
    middle = half_way(complete(links, vectors, centres))
    drifted = pivot_gap(links, matrices(middle.rotations), middle.translations)
    rotations, translations = solve(links, middle)
    assert drifted.min() > 0.2
    assert pivot_gap(links, rotations, translations).max() < 0.1 * drifted.min()
    bend = np.linalg.norm(continuous_vectors(np.swapaxes(rotations[:, 0], 1, 2) @ rotations[:, 1]))
    assert bend == pytest.approx(np.pi / 4, abs=0.02)


@pytest.mark.parametrize("seed", range(5))
def test_what_agrees_is_not_changed(seed: int) -> None:
    links, poses = wild(seed=seed)
    rotations, translations = solve(links, poses)
    assert worst(rotations - matrices(poses.rotations)) < 1e-13
    assert worst(translations - poses.translations) < 1e-13


def test_rigid_motions_leave_links_alone_and_go_through() -> None:
    links, poses = wild()
    turn, shift = matrices(np.array([0.3, -1.2, 0.7])), np.array([1.0, 2.0, 3.0])
    moved = complete(
        links,
        continuous_vectors(turn @ matrices(poses.rotations)),
        poses.translations @ turn.T + shift,
        poses.turns[0],
    )
    np.testing.assert_allclose(moved.turns, poses.turns, atol=1e-12)
    np.testing.assert_allclose(moved.gaps, poses.gaps, atol=1e-12)
    loose = Poses(poses.rotations, poses.translations, poses.turns + 0.2, poses.gaps - 0.1)
    rotations, translations = solve(links, loose)
    again, there = solve(links, moved._replace(turns=loose.turns, gaps=loose.gaps))
    np.testing.assert_allclose(again, turn @ rotations, atol=1e-12)
    np.testing.assert_allclose(there, translations @ turn.T + shift, atol=1e-12)


@pytest.mark.parametrize("parts", [1, 4])
def test_derivatives_are_difference_quotients(parts: int) -> None:
    links, poses = wild(parts=4, frames=3, seed=2)
    if parts == 1:
        links = Links.none(4)
        poses = complete(links, poses.rotations, poses.translations)
    rng = np.random.default_rng(3)
    loose = Poses(*(block + 0.3 * rng.normal(size=block.shape) for block in poses))
    rates = Poses(*(rng.normal(size=block.shape) for block in poses))
    step = 1e-5

    def at(time: float) -> tuple[Float, Float]:
        return solve(links, Poses(*(b + time * r for b, r in zip(loose, rates, strict=True))))

    (before, was), (after, will) = at(-step), at(step)
    now, _ = solve(links, loose)
    turning = (after - before) / (2 * step) @ np.swapaxes(now, -1, -2)
    measured = np.stack([turning[..., 2, 1], turning[..., 0, 2], turning[..., 1, 0]], axis=-1)
    world, speed = velocities(links, loose, rates)
    np.testing.assert_allclose(world, measured, atol=1e-7)
    np.testing.assert_allclose(speed, (will - was) / (2 * step), atol=1e-7)


@pytest.mark.parametrize("size", [0.0, 1e-9, 9e-4, 1.1e-3, 2.0, 9.0])
def test_spins_of_small_and_large_vectors(size: float) -> None:
    vector, rate = size * np.array([0.6, 0.0, -0.8]), np.array([0.3, 1.0, 0.2])
    step = 1e-6
    turning = (matrices(vector + step * rate) - matrices(vector - step * rate)) / (2 * step)
    turning = turning @ matrices(vector).T
    measured = [turning[2, 1], turning[0, 2], turning[1, 0]]
    np.testing.assert_allclose(spins(vector, rate), measured, atol=1e-8)


def test_parts_that_do_not_touch_are_not_linked() -> None:
    one, faces = tube(5, 6)
    points = np.stack([np.concatenate([one, one + np.array([3.0, 0, z])]) for z in (0.0, 1.0, 4.0)])
    topology = Topology(np.concatenate([faces, faces + len(one)]), 2 * len(one))
    labels = np.repeat([0, 1], len(faces))
    vectors = np.zeros((3, 2, 3))
    centres = points.reshape(3, 2, -1, 3).mean(axis=2)
    boundaries = Boundaries.of(topology, labels)
    middles = np.stack([boundaries.middles(frame) for frame in points])
    links = make_links(boundaries.parts, middles, vectors, centres, np.ones(2))
    assert len(links) == 0
    poses = complete(links, vectors, centres)
    assert poses.turns.shape == poses.gaps.shape == (3, 0, 3)
    rotations, translations = solve(links, half_way(poses))
    np.testing.assert_array_equal(rotations, np.tile(np.eye(3), (1, 2, 1, 1)))
    np.testing.assert_allclose(translations[0], centres.mean(axis=0))


def test_two_turns_are_two_turns() -> None:
    angles = np.linspace(0, 4 * np.pi, 25)
    vectors, centres, links = two_bones(angles)
    poses = complete(links, vectors, centres)
    sizes = np.linalg.norm(np.diff(poses.turns[:, 0], axis=0), axis=1)
    np.testing.assert_allclose(sizes, angles[1], atol=1e-9)
    rotations, translations = solve(links, poses)
    assert worst(rotations - matrices(vectors)) < 1e-12
    middle = Poses(*((block[:-1] + block[1:]) / 2 for block in poses))
    rotations, translations = solve(links, middle)
    bends = continuous_vectors(np.swapaxes(rotations[:, 0], 1, 2) @ rotations[:, 1])
    np.testing.assert_allclose(np.diff(np.linalg.norm(bends, axis=1)), angles[1], atol=1e-3)
    assert pivot_gap(links, rotations, translations).max() < 0.02


def test_blocks_of_frames_go_on_where_the_one_before_ended() -> None:
    links, poses = wild(frames=9)
    rest = complete(links, poses.rotations[4:], poses.translations[4:], poses.turns[3])
    np.testing.assert_allclose(rest.turns, poses.turns[4:], atol=1e-12)


def test_curves_that_are_known_better_count_more() -> None:
    still, moving = (two_bones(angles)[-1] for angles in (np.zeros(6), np.array([0, 1, 0, 1, 0, 1.0])))
    assert (still.own_weights >= moving.own_weights).all()
    assert still.weights[0, 0] > moving.weights[0, 0]
    # The pivot holds: its gap is known far better than where the upper half is.
    assert moving.weights[0, 1] > 10 * moving.own_weights[:, 1].min()
