"""Parts that hang together by pivots."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given, settings

from mixseq.retargeting.limbs import ArticulatedBody
from mixseq.retargeting.parts import REACH, Pivots, PivotSolver
from mixseq.segmentation.joints import decompose
from mixseq.types import Float
from tests.meshes import joined, rigid_motions, rotation, seeds, tetrahedron, topology_of, tube
from tests.retargeting.pairs import gradients


def body(seed: int, extra: int = 0, parts: int = 7) -> tuple[PivotSolver, Float, Float]:
    """A random tree of parts, with some loops; rotations of its parts and gaps at its pivots."""
    rng = np.random.default_rng(seed)
    order = rng.permutation(parts)
    pairs = [(order[k], order[rng.integers(k)]) for k in range(1, parts)]
    pairs += [tuple(rng.choice(parts, 2, replace=False)) for _ in range(extra)]
    count = len(pairs)
    pivots, centres = rng.normal(size=(count, 3)), rng.normal(size=(parts, 3))
    made = PivotSolver(
        ArticulatedBody(centres, np.array(pairs), pivots, int(rng.integers(parts))),
        rng.uniform(0.5, 2.0, count),
        rng.uniform(0.1, 1.0, count),
    )
    turns = np.stack([rotation(vector) for vector in 2 * rng.normal(size=(parts, 3))])
    return made, turns, 0.3 * rng.normal(size=(count, 3))


def test_an_elbow_by_hand() -> None:
    ends = np.array([[0.5, 0, 0], [1.75, 0, 0]])
    arm = PivotSolver(
        ArticulatedBody(ends, np.array([[0, 1]]), np.array([[1.0, 0, 0]]), 0), np.ones(1), np.ones(1)
    )
    turns = np.stack([np.eye(3), rotation((0, 0, np.pi / 2))])
    bent = arm.place(turns, np.zeros((1, 3)), np.array([0.5, 0, 0]))
    np.testing.assert_allclose(bent, [[0.5, 0, 0], [1.0, 0.75, 0]], atol=1e-12)
    # The first part is away from the second by the gap.
    opened = arm.place(turns, np.array([[0, 0, 0.1]]), np.array([0.5, 1, 0]))
    np.testing.assert_allclose(opened, [[0.5, 1, 0], [1.0, 1.75, -0.1]], atol=1e-12)


@given(seeds)
@settings(max_examples=30, deadline=None)
def test_a_tree_has_exactly_the_gaps_it_should(seed: int) -> None:
    tree, turns, gaps = body(seed)
    root = np.array([5.0, -2.0, 1.0])
    placed = tree.place(turns, gaps, root)
    assert np.array_equal(placed[tree.body.root], root)
    np.testing.assert_allclose(tree.body.gaps(turns, placed), gaps, atol=1e-10)


@given(seeds)
@settings(max_examples=30, deadline=None)
def test_loops_are_solved_by_least_squares(seed: int) -> None:
    """Weighted by the squares of the lengths of boundaries."""
    loops, turns, gaps = body(seed, extra=4)
    root = np.array([1.0, 2.0, 3.0])
    placed = loops.place(turns, gaps, root)
    # Gaps are affine in the centres: of these the matrix and the rest, one number at a time.
    still = np.zeros((7, 3))
    still[loops.body.root] = root
    others = [part for part in range(7) if part != loops.body.root]
    matrix = np.stack(
        [
            loops.body.gaps(turns, still + np.outer(np.arange(7) == part, [1.0, 0, 0]))[:, 0]
            - loops.body.gaps(turns, still)[:, 0]
            for part in others
        ],
        axis=1,
    )
    weights = loops.lengths[:, None]
    wanted = np.linalg.lstsq(weights * matrix, weights * (gaps - loops.body.gaps(turns, still)), rcond=None)[
        0
    ]
    np.testing.assert_allclose(placed[others], wanted, atol=1e-9)


@given(seeds, rigid_motions)
@settings(max_examples=30, deadline=None)
def test_a_rigid_motion_of_the_world_moves_all_parts(seed: int, motion: tuple[Float, Float]) -> None:
    turn, shift = motion
    loops, turns, gaps = body(seed, extra=3)
    root = np.array([1.0, 0.5, -0.5])
    placed = loops.place(turns, gaps, root)
    moved = loops.place(turn @ turns, gaps @ turn.T, turn @ root + shift)
    np.testing.assert_allclose(moved, placed @ turn.T + shift, atol=1e-9)


def test_at_rest_parts_are_at_rest() -> None:
    loops, turns, gaps = body(3, extra=3)
    turns = np.tile(np.eye(3), (7, 1, 1))
    np.testing.assert_allclose(loops.body.gaps(turns, loops.body.centres), 0.0, atol=1e-12)
    placed = loops.place(turns, np.zeros_like(gaps), loops.body.centres[loops.body.root])
    np.testing.assert_allclose(placed, loops.body.centres, atol=1e-10)


def test_one_part_is_where_it_is_put() -> None:
    none = np.zeros(0)
    one = ArticulatedBody(np.ones((1, 3)), np.zeros((0, 2), dtype=np.int64), np.zeros((0, 3)), 0)
    alone = PivotSolver(one, none, none)
    placed = alone.place(np.eye(3)[None], np.zeros((0, 3)), np.array([3.0, 4, 5]))
    assert placed.tolist() == [[3.0, 4, 5]]
    assert alone.body.gaps(np.eye(3)[None], placed).shape == (0, 3)


def test_boundaries_of_no_length_still_hold() -> None:
    tree, turns, gaps = body(4)
    thin = replace(tree, lengths=tree.lengths * (np.arange(6) % 2), radii=np.zeros(6))
    placed = thin.place(turns, gaps, np.ones(3))
    np.testing.assert_allclose(thin.body.gaps(turns, placed), gaps, atol=1e-9)


def test_gaps_stay_within_the_reach_of_their_boundaries() -> None:
    tree, _, gaps = body(5)
    smooth = np.random.default_rng(0).normal(size=gaps.shape)
    np.testing.assert_allclose(tree.within_reach(smooth, smooth), smooth)
    reach = REACH * tree.radii
    for size in (1e-4, 1.0, 1e4):
        away = tree.within_reach(smooth + size * gaps, smooth) - smooth
        assert (np.linalg.norm(away, axis=1) <= np.minimum(reach, size * np.linalg.norm(gaps, axis=1))).all()
        # Along the difference, and nearly it where it is small.
        np.testing.assert_allclose(np.cross(away, gaps), 0.0, atol=1e-9)
    small = tree.within_reach(smooth + 1e-5 * gaps, smooth) - smooth
    np.testing.assert_allclose(small, 1e-5 * gaps, rtol=1e-4)
    rigid = replace(tree, radii=np.zeros(len(gaps)))
    np.testing.assert_allclose(rigid.within_reach(gaps, smooth), smooth)
    # Pieces that nothing but a vertex holds may be far away.
    np.testing.assert_allclose(rigid.within_reach(1e6 * gaps, smooth), smooth)
    np.testing.assert_array_equal(rigid.within_reach(smooth, smooth), smooth)


def test_two_bones_and_an_eye() -> None:
    """The bones meet in an octagon, the eye is held by a vertex."""
    mesh = joined(tube(8, 33, radius=0.3), (0.1 * tetrahedron()[0] + [0.0, 0.45, 3.5], tetrahedron()[1]))
    points, faces = mesh
    labels = (points[faces].mean(axis=1)[:, 2] > 2).astype(np.int64)
    labels[-4:] = 2
    pivots = Pivots.of(gradients(mesh, mesh), decompose(topology_of(mesh), labels, 3))
    assert pivots.pairs.tolist() == [[0, 1], [2, 1]]
    middle, held = pivots.points(points)
    np.testing.assert_allclose(middle, [0.0, 0.0, 2.0], atol=1e-12)
    assert (points[-4:] == held).all(axis=1).any()
    lengths, radii = pivots.sizes(points)
    np.testing.assert_allclose(lengths, [8 * 0.6 * np.sin(np.pi / 8), 0.0])
    np.testing.assert_allclose(radii, [0.3 * np.cos(np.pi / 8), 0.0])
