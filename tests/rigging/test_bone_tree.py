"""The tree of bones, held against chains whose joints are known."""

from __future__ import annotations

import numpy as np
import pytest

import mixseq
from mixseq.rigging.bone_tree import bone_tree
from mixseq.rigging.bones import Binding, transposed
from mixseq.rigging.fitting import fit_skin
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import Float, Index
from tests.meshes import joined, rotation, tetrahedron, tube

HEIGHTS = (1.0, 2.0, 3.0)
"""Where the chain bends."""


def motions_of_chain(frames: int = 9) -> tuple[Float, Float]:
    """Four bones along z, each turning against the one below: rotations ``(4, T, 3, 3)``, translations."""
    rng = np.random.default_rng(7)
    turns = np.empty((4, frames, 3, 3))
    shifts = np.empty((4, frames, 3))
    for frame in range(frames):
        turn, shift = rotation(rng.normal(size=3)), rng.normal(size=3)
        for bone in range(4):
            if bone:
                joint = np.array([0, 0, HEIGHTS[bone - 1]])
                own = turn @ rotation(0.5 * rng.normal(size=3))
                turn, shift = own, turn @ joint + shift - own @ joint
            turns[bone, frame], shifts[bone, frame] = turn, shift
    return turns, shifts


def chain() -> tuple[Index, Binding, Float]:
    """A tube whose vertices follow the bone at their height, blended over a short way."""
    points, faces = tube(8, 41)
    turns, shifts = motions_of_chain()
    share = np.clip((points[:, 2:] - HEIGHTS) / 0.2 + 0.5, 0, 1)
    weights = np.diff(np.concatenate([np.ones((len(points), 1)), share, np.zeros((len(points), 1))], axis=1))
    binding = Binding(points, np.tile(np.arange(4), (len(points), 1)), -weights, np.zeros(len(points)))
    return faces, binding, np.stack([transposed(r, t) for r, t in zip(turns, shifts, strict=True)])


def test_a_chain_is_found_with_its_joints() -> None:
    order, joints = bone_tree(*chain())
    links = {frozenset((int(order[b]), int(order[a]))) for b, a in enumerate(joints.parents) if a >= 0}
    assert links == {frozenset((0, 1)), frozenset((1, 2)), frozenset((2, 3))}
    assert order[0] in (1, 2)  # the middle, so that no bone is more than two joints away
    assert joints.sliding.tolist() == [True, False, False, False]
    assert (joints.parents < np.arange(4)).all()
    for bone, parent in enumerate(joints.parents.tolist()):
        if parent >= 0:
            height = HEIGHTS[min(order[bone], order[parent])]
            np.testing.assert_allclose(joints.pivots[bone], [0, 0, height], atol=0.02)


def test_a_joint_that_never_turns_is_where_bones_touch() -> None:
    faces, binding, motions = chain()
    still = np.repeat(motions[:1], 4, axis=0)
    order, joints = bone_tree(faces, binding, still)
    for bone, parent in enumerate(joints.parents.tolist()):
        if parent >= 0:
            height = HEIGHTS[min(order[bone], order[parent])]
            np.testing.assert_allclose(joints.pivots[bone], [0, 0, height], atol=0.1)


def test_components_hang_from_what_they_move_with() -> None:
    """An ornament next to the lowest bone, but moving with the highest one."""
    faces, binding, motions = chain()
    points, all_faces = joined(
        (binding.rest, faces), (0.1 * tetrahedron()[0] + [0.7, 0, 0.5], tetrahedron()[1])
    )
    more = len(points) - len(binding.rest)
    influences = np.concatenate([binding.influences, np.tile([4, 0, 0, 0], (more, 1))])
    weights = np.concatenate([binding.weights, np.tile([1.0, 0, 0, 0], (more, 1))])
    whole = Binding(points, influences, weights, np.zeros(len(points)))
    order, joints = bone_tree(all_faces, whole, np.concatenate([motions, motions[3:]]))
    ornament = int(np.flatnonzero(order == 4)[0])
    assert order[joints.parents[ornament]] == 3


def test_one_bone_is_a_root() -> None:
    faces, binding, motions = chain()
    whole = Binding(binding.rest, 0 * binding.influences, np.eye(4)[0] + 0 * binding.weights, binding.errors)
    order, joints = bone_tree(faces, whole, motions[:1])
    assert order.tolist() == [0]
    assert joints.parents.tolist() == [-1]
    np.testing.assert_allclose(joints.pivots[0], binding.rest.mean(axis=0), atol=1e-12)


@pytest.mark.slow
def test_a_skin_hangs_in_the_tree_and_its_joints_hold() -> None:
    faces, binding, motions = chain()
    frames = np.asarray(binding.matrix(4) @ motions.reshape(16, -1)).reshape(len(binding.rest), -1, 3)
    sequence = MeshSequence.from_arrays(frames.swapaxes(0, 1), faces)
    height = binding.rest[faces, 2].mean(axis=1)
    skin = fit_skin(sequence, np.searchsorted(HEIGHTS, height), rounds=200)
    assert (skin.skeleton.parents < 0).sum() == 1
    spread = np.ptp(skin.local().translations, axis=0).max(axis=1) / sequence.diagonal
    assert (spread[1:] < 1e-9).all()  # rotations only
    assert mixseq.compare(sequence, skin).kg_percent < 0.05
