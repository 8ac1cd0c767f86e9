"""Motions of bones that hang together, held against chains whose motions and joints are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mixseq.rigging.bone_tree import Joints, attach_joints, fit_motions
from mixseq.rigging.bones import Binding, transpose_motion
from mixseq.types import Float
from tests.meshes import rotation

PARENTS = np.array([-1, 0, 1, 1])
PIVOTS = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0.2], [1.5, 1, 0.0]])


def tree(sliding: tuple[int, ...] = ()) -> Joints:
    return Joints(PARENTS, PIVOTS, (PARENTS < 0) | np.isin(np.arange(4), sliding))


def turning(joints: Joints, frames: int = 7, seed: int = 0) -> Float:
    """Motions of which joints that do not slide hold together."""
    rng = np.random.default_rng(seed)
    turns = 0.7 * rng.normal(size=(len(PARENTS), frames, 3))
    rotations = [np.stack([rotation(vector) for vector in bone]) for bone in turns]
    return attach_joints(np.stack([transpose_motion(r, rng.normal(size=(frames, 3))) for r in rotations]), joints)


def followers(count: int = 120, seed: int = 1) -> Binding:
    rng = np.random.default_rng(seed)
    influences = np.stack([rng.permutation(4) for _ in range(count)])
    weights = rng.dirichlet(0.3 * np.ones(4), size=count)
    rest = PIVOTS[influences[:, 0]] + rng.normal(size=(count, 3))
    return Binding(rest, influences, weights, np.zeros(count))


def shown(motions: Float, binding: Binding) -> Float:
    return np.asarray(binding.matrix(len(motions)) @ motions.reshape(-1, motions.shape[2]))


def gaps(motions: Float, joints: Joints) -> Float:
    """How far joints come apart ``(B, 3T)``; 0 for roots."""
    above = np.maximum(joints.parents, 0)
    apart = motions[above] - motions
    gap = np.einsum("bi,bij->bj", joints.pivots, apart[:, :3]) + apart[:, 3]
    return np.where(joints.parents[:, None] < 0, 0.0, gap)


def rotations_of(motions: Float) -> Float:
    return np.asarray(motions[:, :3].reshape(len(motions), 3, -1, 3).transpose(0, 2, 3, 1))


def test_branches_of_subtrees() -> None:
    assert tree().branches.tolist() == [[0, 1, 1, 1], [-1, 1, 2, 3], [-1, -1, 2, -1], [-1, -1, -1, 3]]


def test_attached_joints_hold_together_and_rotations_stay() -> None:
    joints = tree(sliding=(2,))
    loose = turning(Joints.free(4))
    held = attach_joints(loose, joints)
    np.testing.assert_allclose(gaps(held, joints)[[1, 3]], 0, atol=1e-12)
    np.testing.assert_array_equal(held[:, :3], loose[:, :3])
    np.testing.assert_array_equal(held[[0, 2]], loose[[0, 2]])


@pytest.mark.parametrize("sliding", [(), (3,), (1, 2, 3)])
def test_known_motions_are_found(sliding: tuple[int, ...]) -> None:
    joints, binding = tree(sliding), followers()
    known = turning(joints)
    found = turning(joints, seed=5)
    for _ in range(60):
        found, _ = fit_motions(shown(known, binding), binding, found, joints, fit_pivots=False)
    np.testing.assert_allclose(found, known, atol=1e-5)


def test_known_joints_are_found() -> None:
    joints, binding = tree(), followers()
    known = turning(joints, frames=12)
    off = replace(joints, pivots=PIVOTS + 0.1 * np.sin(np.arange(12).reshape(4, 3)))
    found, fitted = known, off
    for _ in range(100):
        found, fitted = fit_motions(shown(known, binding), binding, found, fitted)
    np.testing.assert_allclose(fitted.pivots[1:], PIVOTS[1:], atol=1e-4)
    np.testing.assert_allclose(found, known, atol=1e-4)
    np.testing.assert_allclose(gaps(found, fitted), 0, atol=1e-12)


@pytest.mark.parametrize("sliding", [(), (1,), (1, 2, 3)])
def test_errors_never_grow(sliding: tuple[int, ...]) -> None:
    rng = np.random.default_rng(4)
    joints, binding = tree(sliding), followers()
    tracks = rng.normal(size=(120, 21))
    motions, past = attach_joints(turning(joints), joints), np.inf
    for _ in range(6):
        motions, joints = fit_motions(tracks, binding, motions, joints)
        now = float(np.sum((shown(motions, binding) - tracks) ** 2))
        assert now <= past * (1 + 1e-9)
        past = now
    turns = rotations_of(motions)
    np.testing.assert_allclose(turns @ np.swapaxes(turns, 2, 3), np.broadcast_to(np.eye(3), turns.shape), atol=1e-9)
    assert (np.linalg.det(turns) > 0).all()


def test_no_rotation_alone_is_better() -> None:
    """At the end a small turn of any bone, all below it moving along, raises the error."""
    joints, binding = tree(), followers()
    tracks = shown(turning(joints), binding) + 0.05 * np.random.default_rng(2).normal(size=(120, 21))
    motions = turning(joints, seed=3)
    for _ in range(60):
        motions, joints = fit_motions(tracks, binding, motions, joints)
    least = np.sum((shown(motions, binding) - tracks) ** 2)
    for bone in range(4):
        for axis in np.eye(3):
            turned = turned_about_joint(motions, joints, bone, 1e-3 * axis)
            assert np.sum((shown(turned, binding) - tracks) ** 2) > least


def turned_about_joint(motions: Float, joints: Joints, bone: int, vector: Float) -> Float:
    result = motions.copy()
    own = motions[bone].reshape(4, -1, 3)
    turned = own[:3] @ rotation(vector).T
    result[bone, :3] = turned.reshape(3, -1)
    pivot = joints.pivots[bone]
    place = np.einsum("i,itj->tj", pivot, own[:3]) + own[3]
    result[bone, 3] = (place - np.einsum("i,itj->tj", pivot, turned)).reshape(-1)
    return attach_joints(result, joints)


def test_bones_without_followers_stay() -> None:
    binding = followers()
    binding.weights[:], binding.influences[:, 0] = [1.0, 0, 0, 0], 0
    motions = turning(Joints.free(4))
    moved, _ = fit_motions(np.random.default_rng(0).normal(size=(120, 21)), binding, motions, Joints.free(4))
    np.testing.assert_array_equal(moved[1:], motions[1:])
