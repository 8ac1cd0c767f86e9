"""What skins and morphs show, at their frames and between them, and which are none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mixseq
from mixseq.errors import InvalidSequenceError, SettingsError
from mixseq.rigging.rigs import Morph, Skeleton, Skin, remove_sign_flips, rotation_matrices
from mixseq.sequence.sequence import MeshSequence
from tests.meshes import rotation, tetrahedron

POINTS, FACES = tetrahedron()
HEADER = MeshSequence.from_arrays(np.stack([POINTS] * 3), FACES, fps=10).header


def quaternion(vector: tuple[float, float, float]) -> list[float]:
    angle = float(np.linalg.norm(vector))
    axis = np.asarray(vector) / angle if angle else np.zeros(3)
    return [*(np.sin(angle / 2) * axis).tolist(), float(np.cos(angle / 2))]


def a_skin() -> Skin:
    """Two bones, of which the second turns a quarter about z every frame and moves up, and a target."""
    target = np.zeros((1, 4, 3))
    target[0, 2] = [0, 0, 1]
    return Skin(
        header=HEADER,
        rest=POINTS,
        skeleton=Skeleton.from_pivots(np.array([[0.0, 0, 0], [1, -1, -1]])),
        rotations=np.array([[[0, 0, 0, 1], quaternion((0, 0, t * np.pi / 2))] for t in range(3)]),
        translations=np.array([[[0.0, 0, 0], [1, -1, -1 + t]] for t in range(3)]),
        influences=np.array([[0, 0, 0, 0], [1, 0, 0, 0], [0, 1, 0, 0], [1, 0, 0, 0]]),
        weights=np.array([[1.0, 0, 0, 0], [1, 0, 0, 0], [0.25, 0.75, 0, 0], [1, 0, 0, 0]]),
        targets=target,
        target_weights=np.array([[0.0], [2], [1]]),
    )


def a_morph() -> Morph:
    targets = np.zeros((2, 4, 3))
    targets[0, 1], targets[1, :, 2] = [1, 0, 0], 1.0
    return Morph(HEADER, POINTS, targets, np.array([[0.0, 0], [1, 0], [1, -2]]))


def test_a_skin_follows_its_formula() -> None:
    shown = a_skin().points()
    np.testing.assert_allclose(shown[0], POINTS, atol=1e-12)
    np.testing.assert_allclose(shown[1, 0], POINTS[0], atol=1e-12)  # bone 0 stays
    np.testing.assert_allclose(shown[1, 1], [1, -1, 0], atol=1e-12)  # on the pivot
    turned = rotation((0, 0, np.pi / 2)) @ (POINTS[3] - POINTS[1]) + POINTS[1] + [0, 0, 1]
    np.testing.assert_allclose(shown[1, 3], turned, atol=1e-12)
    corrected = POINTS[2] + [0, 0, 2]
    turned = rotation((0, 0, np.pi / 2)) @ (corrected - POINTS[1]) + POINTS[1] + [0, 0, 1]
    np.testing.assert_allclose(shown[1, 2], 0.25 * corrected + 0.75 * turned, atol=1e-12)


def test_a_morph_follows_its_formula() -> None:
    shown = a_morph().points()
    np.testing.assert_allclose(shown[0], POINTS)
    np.testing.assert_allclose(shown[2, 1], POINTS[1] + [1, 0, -2])
    np.testing.assert_allclose(shown[2, 0], POINTS[0] + [0, 0, -2])


@pytest.mark.parametrize("make", [a_skin, a_morph])
def test_rigs_stream_and_are_compared_like_sequences(make: Callable[[], Skin | Morph]) -> None:
    rig = make()
    blocks = list(rig.blocks(2))
    assert [len(block) for block in blocks] == [2, 1]
    np.testing.assert_array_equal(np.concatenate(blocks), rig.points())
    same = MeshSequence.from_header(rig.header, rig.points())
    assert mixseq.compare(same, rig).max_error == 0


@pytest.mark.parametrize("make", [a_skin, a_morph])
def test_at_its_own_times_a_rig_is_what_it_was(make: Callable[[], Skin | Morph]) -> None:
    rig = make()
    np.testing.assert_allclose(rig.resampled(HEADER.times).points(), rig.points(), atol=1e-14)


def test_between_frames_bones_turn_evenly_and_move_straight() -> None:
    between = a_skin().resampled([0.025, 0.1 + 0.1 / 3], fps=40)
    assert between.header.fps == 40
    np.testing.assert_allclose(between.rotations[0, 1], quaternion((0, 0, np.pi / 8)), atol=1e-12)
    np.testing.assert_allclose(between.rotations[1, 1], quaternion((0, 0, 2 * np.pi / 3)), atol=1e-12)
    np.testing.assert_allclose(between.translations[:, 1, 2], [-0.75, 1 / 3], atol=1e-12)
    np.testing.assert_allclose(between.target_weights[:, 0], [0.5, 2 - 1 / 3], atol=1e-12)
    np.testing.assert_allclose(a_morph().resampled([0.15]).weights, [[1, -1]], atol=1e-12)


def test_between_frames_children_stay_at_their_joints() -> None:
    flat = a_skin()
    places = np.array([[[0.0, 0, 0], [1, -1, -1]], [[0, 0, 0], [1, 1, -1]], [[0, 0, 0], [-1, 1, -1]]])
    turns = np.array([[quaternion((0, 0, t * np.pi / 2))] * 2 for t in range(3)])
    whole = replace(flat, rotations=turns, translations=places)
    tree = replace(whole, skeleton=replace(flat.skeleton, parents=np.array([-1, 0])))
    np.testing.assert_allclose(tree.points(), whole.points(), atol=1e-12)
    between = tree.resampled([0.05]).translations[0, 1]
    np.testing.assert_allclose(between, [np.sqrt(2), 0, -1], atol=1e-12)  # on an arc about the parent
    np.testing.assert_allclose(whole.resampled([0.05]).translations[0, 1], [1, 0, -1], atol=1e-12)


def test_bones_turn_the_shorter_way() -> None:
    skin = a_skin()
    turned = replace(skin, rotations=skin.rotations * np.array([1, -1, 1])[:, None, None])
    times = np.linspace(0, 0.2, 7)
    np.testing.assert_allclose(turned.resampled(times).points(), skin.resampled(times).points(), atol=1e-12)


def test_one_frame_is_resampled_to_itself() -> None:
    skin = a_skin().resampled([0.1])
    np.testing.assert_array_equal(skin.resampled([0.1]).points(), skin.points())


@pytest.mark.parametrize("make", [a_skin, a_morph])
def test_times_outside_are_refused(make: Callable[[], Skin | Morph]) -> None:
    for times in ([-0.1, 0.1], [0.0, 0.3]):
        with pytest.raises(SettingsError, match=r"leave those of the frames, 0 s to 0\.2 s"):
            make().resampled(times)
    with pytest.raises(InvalidSequenceError, match="times must increase"):
        make().resampled([0.1, 0.1])


def test_quaternions_are_rotations() -> None:
    for vector in ((0.3, -1.2, 2.0), (0.0, 0, 3.1), (0.0, 0, 0)):
        np.testing.assert_allclose(rotation_matrices(np.array(quaternion(vector))), rotation(vector), atol=1e-14)


def test_signs_do_not_jump() -> None:
    """A body that turns twice: after one turn its quaternion is the negative of the first."""
    path = np.array([quaternion((0, 0, angle)) for angle in np.linspace(0, 4 * np.pi, 33)])
    shuffled = path * np.where(np.arange(33) % 3, 1, -1)[:, None]
    np.testing.assert_allclose(remove_sign_flips(shuffled), path, atol=1e-14)


def test_arrays_are_read_only() -> None:
    with pytest.raises(ValueError, match="read-only"):
        a_skin().rest[0] = 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"rest": POINTS[:2]}, r"rest have shape \(2, 3\); \(4, 3\) is expected"),
        ({"rotations": np.ones((3, 2, 3))}, r"rotations have shape \(3, 2, 3\)"),
        ({"rotations": np.ones((3, 2, 4))}, r"frame 0: the quaternion of bone 0 has length 2"),
        ({"translations": np.full((3, 2, 3), np.nan)}, "translations have entries that are not finite"),
        ({"influences": np.full((4, 4), 2)}, "vertex 0 follows bone 2, but bones are 0 to 1"),
        ({"influences": np.zeros((4, 3))}, r"influences have shape \(4, 3\)"),
        ({"weights": np.full((4, 4), 0.2)}, "the weights of vertex 0 are .* not negative and add to one"),
        ({"weights": np.tile([1.5, -0.5, 0, 0], (4, 1))}, "the weights of vertex 0 are"),
        ({"target_weights": np.zeros((3, 2))}, r"target_weights have shape \(3, 2\)"),
    ],
)
def test_what_is_no_skin_is_refused(change: dict[str, object], message: str) -> None:
    with pytest.raises(InvalidSequenceError, match=message):
        replace(a_skin(), **change)  # type: ignore[arg-type]


def test_what_is_no_morph_is_refused() -> None:
    with pytest.raises(InvalidSequenceError, match=r"weights have shape \(3, 1\); \(3, 2\) is expected"):
        replace(a_morph(), weights=np.zeros((3, 1)))


# Bones in a tree, and motions of the world and relative to parents

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
    rotations, translations = arm().local_rest()
    np.testing.assert_allclose(translations, [[0, 0, 0], [1, 0, 0]])
    np.testing.assert_allclose(rotations, arm().axes)
    rotations, translations = replace(arm(), axes=arm().axes[[1, 1]]).local_rest()
    np.testing.assert_allclose(translations, [[0, 0, 0], [0, -1, 0]], atol=1e-15)
    np.testing.assert_allclose(rotations[1], [0, 0, 0, 1], atol=1e-15)


def test_what_turns_as_a_whole_stands_still_below_its_root() -> None:
    turn = [0, 0, HALF, HALF]
    rotations, translations = arm().to_local(np.array([[turn, turn]]), np.array([[[5.0, 0, 0], [5, 1, 0]]]))
    np.testing.assert_allclose(rotations[0], [turn, arm().axes[1]], atol=1e-15)
    np.testing.assert_allclose(translations[0], [[5, 0, 0], [1, 0, 0]], atol=1e-15)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 1000), count=st.integers(1, 9))
def test_world_and_local_are_one_motion(seed: int, count: int) -> None:
    skeleton, rng = random_skeleton(seed, count), np.random.default_rng(seed + 1)
    turns = rng.normal(size=(3, count, 4))
    turns /= np.linalg.norm(turns, axis=2, keepdims=True)
    places = rng.normal(size=(3, count, 3))
    rotations, translations = skeleton.to_world(*skeleton.to_local(turns, places))
    np.testing.assert_allclose(rotation_matrices(rotations), rotation_matrices(turns), atol=1e-12)
    np.testing.assert_allclose(translations, places, atol=1e-12)


def test_flat_bones_move_in_the_world() -> None:
    flat = Skeleton.from_pivots(np.eye(3))
    assert (flat.names, flat.parents.tolist()) == (("bone_000", "bone_001", "bone_002"), [-1, -1, -1])
    turns = np.tile([0.5, 0.5, 0.5, 0.5], (2, 3, 1))
    rotations, translations = flat.to_local(turns, np.ones((2, 3, 3)))
    np.testing.assert_allclose(rotations, turns)
    np.testing.assert_array_equal(translations, np.ones((2, 3, 3)))


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
        Skeleton.from_pivots(np.zeros((0, 3)))
