"""Limbs that do more, less or nothing: against a chain of bones whose true poses are known."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest

from mixseq.errors import SettingsError
from mixseq.operations.limbs import exaggerate_part, find_limb, hold, part_poses
from mixseq.operations.sections import smoothstep
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.curve import Curve
from mixseq.signals.fitting import fit
from mixseq.signals.model import Model
from mixseq.spaces.mixed.mixed_space import MixedSpace
from mixseq.types import Float
from tests.meshes import bar, bending, joined, tetrahedron, tube
from tests.operations.chains import TIMES, angles, bone, chain, frames

BETWEEN = np.linspace(0.0, 0.8, 21)

PIVOT = 1e-6
"""Pivots are those of the reference frame of the space, which has single precision."""


@pytest.mark.parametrize("order", list(permutations(range(3))), ids=str)
@pytest.mark.parametrize("gain", [2.0, 0.0, -1.0])
def test_a_joint_bends_by_so_much_more(order: tuple[int, ...], gain: float) -> None:
    """Whichever way round parts are numbered."""
    bends = angles(TIMES)
    mean = bends[:, 0].mean()
    bends[:, 0] = mean + gain * (bends[:, 0] - mean)
    edited = exaggerate_part(chain(order), order[1], gain)
    points, expected = edited.sample().points, frames(bends)
    for number in range(3):
        np.testing.assert_allclose(points[:, bone(number)], expected[:, bone(number)], atol=PIVOT)
    assert np.abs(points - expected).max() < 0.1  # in the bends, which are 0.3 long and 0.5 thick


def test_edits_move_only_the_limb() -> None:
    model = chain()
    edited = exaggerate_part(model, 2, 1.7)
    bends = angles(TIMES)
    bends[:, 1] = bends[:, 1].mean() + 1.7 * (bends[:, 1] - bends[:, 1].mean())
    points = edited.sample().points
    np.testing.assert_allclose(points[:, bone(2)], frames(bends)[:, bone(2)], atol=PIVOT)
    below = model.header.vertex_count - 2 - 20 * 8  # rings under the second joint, and the faces that it bends
    np.testing.assert_allclose(points[:, :below], model.sample().points[:, :below], atol=1e-9)


def test_between_frames_the_rest_hardly_moves() -> None:
    model, rest = chain(), bone(0)
    edited = exaggerate_part(model, 1, 2.0)
    assert np.abs(edited.sample(BETWEEN).points - model.sample(BETWEEN).points)[:, rest].max() < 1e-3


@pytest.mark.parametrize("part", [1, 2])
@pytest.mark.parametrize("knots", [None, 2])
def test_gain_one_is_the_identity(part: int, knots: int | None) -> None:
    model = chain()
    if knots is not None:
        model = fit(model.sample(), knots=knots, parts=model.decomposition.part_of_face)
    edited = exaggerate_part(model, part, 1.0)
    np.testing.assert_allclose(edited.sample(BETWEEN).points, model.sample(BETWEEN).points, atol=1e-9)


def wheel() -> tuple[Model, Float]:
    """The chain with a first joint that turns by more than a full circle, and its joint_pose at the frames."""
    model = chain()
    still = replace(
        model, time=Curve(model.time.times, np.repeat(model.time.values[:1], len(model.time.times), axis=0))
    )
    joint_pose = np.zeros((9, 6))
    joint_pose[:, 0] = np.linspace(0.1, 7.1, 9)
    return replace(
        still, correction=Curve(TIMES, find_limb(model, 1).corrections(still, TIMES, joint_pose))
    ), joint_pose


@pytest.mark.parametrize("gain", [2.0, -3.0, 20.0])
def test_whole_turns_are_scaled_as_turns(gain: float) -> None:
    """A joint's vector is unwrapped, and twice as far is twice as far: also by several turns from frame to frame."""
    model, joint_pose = wheel()
    limb = find_limb(model, 1)
    np.testing.assert_allclose(limb.joint_pose(model, TIMES), joint_pose, atol=1e-9)
    more = limb.joint_pose(exaggerate_part(model, 1, gain), TIMES)
    np.testing.assert_allclose(more - more[0], gain * (joint_pose - joint_pose[0]), atol=1e-9 * abs(gain))


def test_a_joint_that_turned_is_held_where_it_is() -> None:
    """Not a whole turn before: what it is at a time does not depend on what other times are asked for."""
    model, _ = wheel()
    limb = find_limb(model, 1)
    np.testing.assert_allclose(limb.joint_pose(model, np.array([0.55]))[0, 0], 4.9, atol=0.05)
    times = np.linspace(0.0, 0.8, 41)
    turns = limb.joint_pose(hold(model, 1, 0.55, 0.5, 0.6, 0.2), times)[:, 0]
    assert (np.diff(turns) > -1e-3).all()  # it slows down and goes on, and is never wound back
    np.testing.assert_allclose(turns[[0, -1]], [0.1, 7.1], atol=1e-9)


# Hold -----------------------------------------------------------------------------------------------------


def held(times: Float, still: float, start: float, end: float, fade: float) -> Float:
    """Angles with the first joint held."""
    bends = angles(times)
    rest = smoothstep(times, start - fade, start) * (1.0 - smoothstep(times, end, end + fade))
    bends[:, 0] += rest * (angles(np.array([still]))[0, 0] - bends[:, 0])
    return bends


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0)], ids=str)
def test_a_joint_that_is_held_bends_no_more(order: tuple[int, ...]) -> None:
    edited = hold(chain(order), order[1], 0.2, 0.3, 0.5, 0.2)
    points, expected = edited.sample().points, frames(held(TIMES, 0.2, 0.3, 0.5, 0.2))
    for number in range(3):
        np.testing.assert_allclose(points[:, bone(number)], expected[:, bone(number)], atol=PIVOT)


def test_held_limbs_keep_their_shape() -> None:
    """From the first bone one sees the frame that is held, the joint too, and between frames."""
    model, lower = chain(), bone(0)
    edited = hold(model, 2, 0.2, 0.3, 0.5, 0.2)
    limb = find_limb(model, 2)
    times = np.linspace(0.3, 0.5, 11)
    joint_pose = limb.joint_pose(edited, times)
    still = limb.joint_pose(model, np.array([0.2]))
    np.testing.assert_allclose(joint_pose, np.repeat(still, 11, axis=0), atol=1e-4)
    upper = np.arange(8 * 30, 8 * 50)  # rings of the second bone and the third
    here, there = edited(0.4), model(0.2)
    np.testing.assert_allclose(lengths(here[upper]), lengths(there[upper]), atol=2e-3)
    np.testing.assert_allclose(edited(0.4)[lower], model(0.4)[lower], atol=1e-9)


def lengths(points: Float) -> Float:
    """Distances between all pairs of points."""
    return np.asarray(np.linalg.norm(points[:, None] - points[None], axis=2))


def test_before_and_after_nothing_changes() -> None:
    model = chain()
    edited = hold(model, 1, 0.35, 0.33, 0.47, 0.11)
    times = BETWEEN[(BETWEEN <= 0.22) | (BETWEEN >= 0.58)]
    np.testing.assert_allclose(edited.sample(times).points, model.sample(times).points, atol=1e-9)
    assert np.abs(edited(0.47) - model(0.47)).max() > 0.1


@pytest.mark.parametrize(("start", "end"), [(0.0, 0.4), (0.4, 0.8), (0.0, 0.8)])
def test_hold_at_the_ends_has_no_fade(start: float, end: float) -> None:
    model = chain()
    edited = hold(model, 1, 0.2, start, end, 0.2)
    limb = find_limb(model, 1)
    still = limb.joint_pose(model, np.array([0.2]))
    times = np.linspace(start, end, 9)
    np.testing.assert_allclose(limb.joint_pose(edited, times), np.repeat(still, 9, axis=0), atol=1e-4)
    assert (edited.start, edited.end) == (model.start, model.end)


def test_a_model_of_one_frame_is_at_rest_anyway() -> None:
    sequence = chain().sample([0.3])
    model = fit(sequence, exact=True, parts=chain().decomposition.part_of_face)
    for edited in (hold(model, 1, 0.3, 0.3, 0.3), exaggerate_part(model, 1, 2.0)):
        np.testing.assert_allclose(edited.sample().points, sequence.points, atol=1e-9)


def test_holding_twice_equals_holding_once() -> None:
    once = hold(chain(), 1, 0.2, 0.3, 0.5, 0.2)
    twice = hold(once, 1, 0.4, 0.35, 0.45, 0.05)
    np.testing.assert_allclose(twice.sample().points, once.sample().points, atol=1e-4)


def test_the_model_keeps_its_frames_and_smoothness() -> None:
    model = chain()
    edited = hold(model, 1, 0.2, 0.3, 0.5, 0.1)
    np.testing.assert_array_equal(edited.times, model.times)
    np.testing.assert_array_equal(edited.shapes[: len(model.shapes)], model.shapes)
    np.testing.assert_allclose(edited.curve(TIMES[:2]), model.curve(TIMES[:2]), atol=1e-12)


# Refusals -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("part", "message"),
    [
        (3, "there is no part 3; the model has 3, from 0 on"),
        (-1, "there is no part -1"),
        (0, "part 0 is the root of its body; give a part with a parent"),
    ],
)
def test_parts_that_do_not_turn(part: int, message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        exaggerate_part(chain(), part, 2.0)
    with pytest.raises(SettingsError, match=message):
        hold(chain(), part, 0.2, 0.1, 0.3)


def test_spaces_without_linked_parts() -> None:
    sequence = bar(sides=5, rings=15, frames=3)
    with pytest.raises(SettingsError, match="the vertex space has no parts; fit a model with space='mixed'"):
        exaggerate_part(fit(sequence, exact=True, space="vertex"), 0, 2.0)
    with pytest.raises(SettingsError, match="the free placement ignores poses of parts"):
        exaggerate_part(fit(sequence, exact=True, placement="free"), 0, 2.0)
    with pytest.raises(SettingsError, match="part 0 has no neighbours"):
        exaggerate_part(fit(sequence, exact=True, parts=1), 0, 2.0)


@pytest.mark.parametrize("gain", [np.nan, np.inf])
def test_gains_that_are_no_numbers(gain: float) -> None:
    with pytest.raises(SettingsError, match=f"gain is {gain}; a number from -1000 to 1000 is expected"):
        exaggerate_part(chain(), 1, gain)


@pytest.mark.parametrize(
    ("times", "message"),
    [
        ((0.9, 0.1, 0.3, 0.1), "time is 0.9 s; the model is from 0 to 0.8 s"),
        ((0.2, -0.1, 0.3, 0.1), "start is -0.1 s"),
        ((0.2, 0.1, 1.3, 0.1), "end is 1.3 s"),
        ((0.2, 0.3, 0.1, 0.1), "the start, 0.3 s, is after the end, 0.1 s"),
        ((0.2, 0.1, 0.3, 0.0), "fade is 0.0; a positive number of seconds"),
        ((0.2, 0.1, 0.3, np.nan), "fade is nan"),
    ],
)
def test_times_that_make_no_sense(times: tuple[float, float, float, float], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        hold(chain(), 1, *times)


# Bodies as trees of parts


def space_of(order: tuple[int, ...]) -> MixedSpace:
    return chain(order).mixed


@pytest.mark.parametrize("order", list(permutations(range(3))), ids=str)
def test_a_chain_hangs_on_its_largest_bone(order: tuple[int, ...]) -> None:
    above = space_of(order).articulation.parents
    assert [int(above[order[number]]) for number in range(3)] == [-1, order[0], order[1]]
    limb = find_limb(chain(order), order[1])
    assert np.flatnonzero(limb.part_mask).tolist() == sorted(order[1:])
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
    joint_pose = find_limb(chain(order), order[2]).joint_pose(chain(order), TIMES)
    bends = angles(TIMES)[:, 1]
    np.testing.assert_allclose(joint_pose[:, 0] - joint_pose[0, 0], bends - bends[0], atol=1e-9)
    np.testing.assert_allclose(joint_pose[:, 1:], 0.0, atol=1e-6)  # the reference frame has single precision


@pytest.mark.parametrize("times", [TIMES, np.linspace(0.0, 0.8, 23)], ids=["frames", "between"])
def test_the_same_stance_moves_nothing(times: np.ndarray) -> None:
    model, limb = chain(), find_limb(chain(), 1)
    same = limb.corrections(model, times, limb.joint_pose(model, times))
    np.testing.assert_allclose(same, model.correction(times), atol=1e-12)


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0)], ids=str)
def test_another_stance_is_the_stance_then(order: tuple[int, ...]) -> None:
    model, limb = chain(order), find_limb(chain(order), order[1])
    joint_pose = limb.joint_pose(model, TIMES) + np.array([0.3, -0.2, 0.1, 0.01, 0.0, -0.02])
    moved = replace(model, correction=Curve(TIMES, limb.corrections(model, TIMES, joint_pose)))
    np.testing.assert_allclose(limb.joint_pose(moved, TIMES), joint_pose, atol=1e-9)
    rest = np.setdiff1d(range(3), np.flatnonzero(limb.part_mask))
    for found, expected in zip(part_poses(moved, TIMES), part_poses(model, TIMES), strict=True):
        np.testing.assert_allclose(found[:, rest], expected[:, rest], atol=1e-12)


def test_joints_belong_to_the_nearest_border() -> None:
    space = space_of((0, 1, 2))
    first, second = (find_limb(chain(), part).joint_weights() for part in (1, 2))
    assert ((first >= 0) & (first <= 1)).all()
    *measured, unposed, poses = np.split(first + second, np.cumsum(space.block_sizes[:3]))
    for of_joints in measured:
        np.testing.assert_allclose(of_joints, 1.0)
    alone = np.repeat(space.rigid_part_of_vertex, 3)
    np.testing.assert_allclose(unposed, alone < 0)
    assert not poses.any()
    own = find_limb(chain(), 2).part_weights()
    np.testing.assert_array_equal(own[sum(space.block_sizes[:2]) :][: space.block_sizes[2]], alone == 2)
    assert own.sum() == (alone == 2).sum() > 0
    assert len(own) == len(first) == chain().shapes.shape[1]
