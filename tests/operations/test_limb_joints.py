"""Bodies as trees of parts."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest

from mixseq.operations.limb_joints import limb_of
from mixseq.sequence import MeshSequence
from mixseq.signals import fit
from mixseq.spaces.mixed import AnchoredSpace
from tests.meshes import bending, joined, tetrahedron, tube
from tests.operations.chains import TIMES, angles, chain


def space_of(order: tuple[int, ...]) -> AnchoredSpace:
    space = chain(order).space
    assert isinstance(space, AnchoredSpace)
    return space


@pytest.mark.parametrize("order", list(permutations(range(3))), ids=str)
def test_a_chain_hangs_on_its_largest_bone(order: tuple[int, ...]) -> None:
    above = space_of(order).parents
    assert [int(above[order[number]]) for number in range(3)] == [-1, order[0], order[1]]
    limb = limb_of(chain(order), order[1])
    assert np.flatnonzero(limb.parts).tolist() == sorted(order[1:])
    assert (limb.part, limb.parent) == (order[1], order[0])


def test_every_component_has_a_root() -> None:
    mesh, moon = tube(6, 25), tetrahedron()
    points = np.concatenate([bending(mesh), np.repeat(moon[0][None], 5, axis=0) + 9.0], axis=1)
    faces = joined(mesh, moon)[1]
    height = points[0][faces][:, :, 2].mean(axis=1)
    labels = np.where(height > 7.0, 0, np.where(height > 1.6, 1, 2))
    space = fit(MeshSequence.from_arrays(points, faces, fps=10), exact=True, parts=labels).space
    assert isinstance(space, AnchoredSpace)
    assert space.parents.tolist() == [-1, -1, 1]


@pytest.mark.parametrize("order", list(permutations(range(3))), ids=str)
def test_the_stance_is_the_angle_of_the_joint(order: tuple[int, ...]) -> None:
    stance = limb_of(chain(order), order[2]).stance(chain(order).placement, TIMES)
    bends = angles(TIMES)[:, 1]
    np.testing.assert_allclose(stance[:, 0] - stance[0, 0], bends - bends[0], atol=1e-9)
    np.testing.assert_allclose(stance[:, 1:], 0.0, atol=1e-9)


@pytest.mark.parametrize("times", [TIMES, np.linspace(0.0, 0.8, 23)], ids=["frames", "between"])
def test_the_same_stance_moves_nothing(times: np.ndarray) -> None:
    limb, whole = limb_of(chain(), 1), chain().placement
    np.testing.assert_allclose(limb.moved(whole, times, limb.stance(whole, times)), whole(times), atol=1e-12)


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0)], ids=str)
def test_another_stance_is_the_stance_then(order: tuple[int, ...]) -> None:
    limb, whole = limb_of(chain(order), order[1]), chain(order).placement
    stance = limb.stance(whole, TIMES) + np.array([0.3, -0.2, 0.1, 0.01, 0.0, -0.02])
    moved = type(whole)(TIMES, limb.moved(whole, TIMES, stance))
    np.testing.assert_allclose(limb.stance(moved, TIMES), stance, atol=1e-9)


def test_joints_belong_to_the_nearest_border() -> None:
    space = space_of((0, 1, 2))
    first, second = (limb_of(chain(), part).joint() for part in (1, 2))
    assert ((first >= 0) & (first <= 1)).all()
    *measured, unposed, sides = np.split(first + second, np.cumsum(space.sizes[:3]))[:4]
    for of_joints in (*measured, sides[: space.sizes[3]]):
        np.testing.assert_allclose(of_joints, 1.0)
    alone = np.repeat(space.frames.alone, 3)
    np.testing.assert_allclose(unposed, alone < 0)
    own = limb_of(chain(), 2).own_shape()
    np.testing.assert_array_equal(own[sum(space.sizes[:2]) :][: space.sizes[2]], alone == 2)
    assert own.sum() == (alone == 2).sum() > 0
    assert len(own) == len(first) == chain().shapes.shape[1]
