"""Bodies as trees of parts."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest

from mixseq.operations.limbs import limb_of, part_poses
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.curve import Curve
from mixseq.signals.fitting import fit
from mixseq.spaces.mixed.mixed_space import MixedSpace
from tests.meshes import bending, joined, tetrahedron, tube
from tests.operations.chains import TIMES, angles, chain


def space_of(order: tuple[int, ...]) -> MixedSpace:
    return chain(order).mixed


@pytest.mark.parametrize("order", list(permutations(range(3))), ids=str)
def test_a_chain_hangs_on_its_largest_bone(order: tuple[int, ...]) -> None:
    above = space_of(order).articulation.parents
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
    space = fit(MeshSequence.from_arrays(points, faces, fps=10), exact=True, parts=labels).mixed
    assert space.articulation.parents.tolist() == [-1, -1, 1]


@pytest.mark.parametrize("order", list(permutations(range(3))), ids=str)
def test_the_stance_is_the_angle_of_the_joint(order: tuple[int, ...]) -> None:
    stance = limb_of(chain(order), order[2]).stance(chain(order), TIMES)
    bends = angles(TIMES)[:, 1]
    np.testing.assert_allclose(stance[:, 0] - stance[0, 0], bends - bends[0], atol=1e-9)
    np.testing.assert_allclose(stance[:, 1:], 0.0, atol=1e-6)  # the reference frame has single precision


@pytest.mark.parametrize("times", [TIMES, np.linspace(0.0, 0.8, 23)], ids=["frames", "between"])
def test_the_same_stance_moves_nothing(times: np.ndarray) -> None:
    model, limb = chain(), limb_of(chain(), 1)
    same = limb.corrections(model, times, limb.stance(model, times))
    np.testing.assert_allclose(same, model.correction(times), atol=1e-12)


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0)], ids=str)
def test_another_stance_is_the_stance_then(order: tuple[int, ...]) -> None:
    model, limb = chain(order), limb_of(chain(order), order[1])
    stance = limb.stance(model, TIMES) + np.array([0.3, -0.2, 0.1, 0.01, 0.0, -0.02])
    moved = replace(model, correction=Curve(TIMES, limb.corrections(model, TIMES, stance)))
    np.testing.assert_allclose(limb.stance(moved, TIMES), stance, atol=1e-9)
    rest = np.setdiff1d(range(3), np.flatnonzero(limb.parts))
    for found, expected in zip(part_poses(moved, TIMES), part_poses(model, TIMES), strict=True):
        np.testing.assert_allclose(found[:, rest], expected[:, rest], atol=1e-12)


def test_joints_belong_to_the_nearest_border() -> None:
    space = space_of((0, 1, 2))
    first, second = (limb_of(chain(), part).joint() for part in (1, 2))
    assert ((first >= 0) & (first <= 1)).all()
    *measured, unposed, poses = np.split(first + second, np.cumsum(space.sizes[:3]))
    for of_joints in measured:
        np.testing.assert_allclose(of_joints, 1.0)
    alone = np.repeat(space.only_part, 3)
    np.testing.assert_allclose(unposed, alone < 0)
    assert not poses.any()
    own = limb_of(chain(), 2).own_shape()
    np.testing.assert_array_equal(own[sum(space.sizes[:2]) :][: space.sizes[2]], alone == 2)
    assert own.sum() == (alone == 2).sum() > 0
    assert len(own) == len(first) == chain().shapes.shape[1]
