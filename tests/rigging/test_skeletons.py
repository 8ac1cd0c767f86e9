"""Bones in a tree, and motions of the world and relative to parents."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixseq.errors import InvalidSequenceError
from mixseq.rigging.rigs import Skeleton, rotation_matrices

HALF = np.sqrt(0.5)


def arm() -> Skeleton:
    """A lower arm at x = 1 whose axes are turned a quarter about z, below an upper one at the origin."""
    return Skeleton(
        ("upper", "lower"),
        parents=np.array([-1, 0]),
        pivots=np.array([[0.0, 0, 0], [1, 0, 0]]),
        axes=np.array([[0, 0, 0, 1.0], [0, 0, HALF, HALF]]),
    )


def random_skeleton(seed: int, count: int) -> Skeleton:
    rng = np.random.default_rng(seed)
    axes = rng.normal(size=(count, 4))
    return Skeleton(
        tuple(f"b{bone}" for bone in range(count)),
        parents=np.array([rng.integers(-1, bone) for bone in range(count)]),
        pivots=rng.normal(size=(count, 3)),
        axes=axes / np.linalg.norm(axes, axis=1, keepdims=True),
    )


def test_at_rest_joints_stand_in_the_axes_of_their_parents() -> None:
    rest = arm().local_rest()
    np.testing.assert_allclose(rest.translations, [[0, 0, 0], [1, 0, 0]])
    np.testing.assert_allclose(rest.rotations, arm().axes)
    turned = replace(arm(), axes=arm().axes[[1, 1]]).local_rest()
    np.testing.assert_allclose(turned.translations, [[0, 0, 0], [0, -1, 0]], atol=1e-15)
    np.testing.assert_allclose(turned.rotations[1], [0, 0, 0, 1], atol=1e-15)


def test_what_turns_as_a_whole_stands_still_below_its_root() -> None:
    turn = [0, 0, HALF, HALF]
    local = arm().to_local(np.array([[turn, turn]]), np.array([[[5.0, 0, 0], [5, 1, 0]]]))
    np.testing.assert_allclose(local.rotations[0], [turn, arm().axes[1]], atol=1e-15)
    np.testing.assert_allclose(local.translations[0], [[5, 0, 0], [1, 0, 0]], atol=1e-15)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 1000), count=st.integers(1, 9))
def test_world_and_local_are_one_motion(seed: int, count: int) -> None:
    skeleton, rng = random_skeleton(seed, count), np.random.default_rng(seed + 1)
    turns = rng.normal(size=(3, count, 4))
    turns /= np.linalg.norm(turns, axis=2, keepdims=True)
    places = rng.normal(size=(3, count, 3))
    rotations, translations = skeleton.to_world(skeleton.to_local(turns, places))
    np.testing.assert_allclose(rotation_matrices(rotations), rotation_matrices(turns), atol=1e-12)
    np.testing.assert_allclose(translations, places, atol=1e-12)


def test_flat_bones_move_in_the_world() -> None:
    flat = Skeleton.flat(np.eye(3))
    assert (flat.names, flat.parents.tolist()) == (("bone_000", "bone_001", "bone_002"), [-1, -1, -1])
    turns = np.tile([0.5, 0.5, 0.5, 0.5], (2, 3, 1))
    local = flat.to_local(turns, np.ones((2, 3, 3)))
    np.testing.assert_allclose(local.rotations, turns)
    np.testing.assert_array_equal(local.translations, np.ones((2, 3, 3)))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"names": ("upper",)}, r"parents have shape \(2,\); \(1,\) is expected"),
        ({"names": ("arm", "arm")}, "the name 'arm' of a bone is empty or occurs twice"),
        ({"names": ("arm", "")}, "the name '' of a bone is empty or occurs twice"),
        ({"parents": np.array([1, -1])}, "the parent of bone 0 is 1; a bone before it, or -1"),
        ({"parents": np.array([-1, 1])}, "the parent of bone 1 is 1"),
        ({"parents": np.array([-2, 0])}, "the parent of bone 0 is -2"),
        ({"pivots": np.zeros((2, 2))}, r"pivots have shape \(2, 2\); \(2, 3\) is expected"),
        ({"pivots": np.full((2, 3), np.nan)}, "pivots have entries that are not finite"),
        ({"axes": np.zeros((2, 4))}, "the axes of bone 'upper' have length 0; unit quaternions"),
    ],
)
def test_what_is_no_skeleton(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidSequenceError, match=message):
        replace(arm(), **changes)


def test_a_skeleton_has_bones() -> None:
    with pytest.raises(InvalidSequenceError, match="a skeleton has no bones"):
        Skeleton.flat(np.zeros((0, 3)))
