"""Footskate cleanup of articulated bodies."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest

from mixseq.errors import MixseqWarning, SettingsError
from mixseq.mesh.rotations import matrix_to_rotvec, rotvec_to_matrix
from mixseq.retargeting.contacts import remove_footskate
from mixseq.retargeting.limbs import ArticulatedBody, Contact, leg_length, rotate_limbs
from tests.retargeting.walkers import BONES, CYCLE, Walk, body, hung, walk

ACCELERATION = 1.05
"""Feet, joints and centres accelerate by at most so many times the largest acceleration there was before."""


def bends(points: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(points, 2, axis=0), axis=-1).max())


@pytest.mark.parametrize(("legs", "travel"), [(1.4, 1.0), (1.0, 0.8), (0.7, 1.0), (1.0, 1.1)])
def test_contacts_do_not_slide_in_stances(legs: float, travel: float) -> None:
    scene = walk(legs, travel)
    result = scene.planted()
    for group in result.report.groups:
        assert group.before > 0.02
        assert group.after < 1e-9
        for stance in group.stances:
            foot = scene.feet(result.rotations, result.centres)[stance.frames, int(group.name == "right")]
            np.testing.assert_allclose(foot, np.broadcast_to(foot[0], foot.shape), atol=1e-12)
    joints = scene.joints(result.rotations, result.centres)
    np.testing.assert_allclose(joints[0], joints[1], atol=1e-9)
    turned = result.rotations @ np.swapaxes(result.rotations, -1, -2)
    np.testing.assert_allclose(turned, np.broadcast_to(np.eye(3), turned.shape), atol=1e-12)


@pytest.mark.parametrize(("legs", "travel"), [(1.4, 1.0), (1.0, 0.8), (0.7, 1.0)])
def test_corrections_are_smooth(legs: float, travel: float) -> None:
    scene = walk(legs, travel)
    result = scene.planted()
    before, after = (scene.rotations, scene.centres), (result.rotations, result.centres)
    assert bends(scene.feet(*after)) < ACCELERATION * bends(scene.feet(*before))
    assert bends(scene.joints(*after)[0]) < ACCELERATION * bends(scene.joints(*before)[0])
    assert bends(result.centres) < ACCELERATION * bends(scene.centres)


def test_fitting_strides_are_unchanged() -> None:
    scene = walk(1.4)
    # The foot's length is not scaled by the walker, so that the ratio is only close to that of the bones.
    lengths = leg_length(scene.target, scene.contacts), leg_length(scene.source, scene.source_contacts)
    assert lengths[0] / lengths[1] == pytest.approx(1.4, abs=0.01)
    fitting = walk(1.4, 1.4)
    result = fitting.planted()
    assert result.rotations is fitting.rotations
    assert result.centres is fitting.centres
    assert [len(group.stances) for group in result.report.groups] == [3, 3]
    assert [(group.before, group.after, group.residual) for group in result.report.groups] == 2 * [(0.0, 0.0, 0.0)]
    assert result.report.shift == result.report.turn == 0.0


def test_body_travel_follows_leg_length() -> None:
    """The travel that strides ask for is found, although the transfer had another: legs need not turn by much."""
    result, fitting = walk(1.4, 1.0).planted(), walk(1.4, 1.4)
    way, right = (np.diff(each[[10, -10], 0, 0])[0] for each in (result.centres, fitting.centres))
    assert way == pytest.approx(right, rel=0.02)
    assert result.report.turn < 2.0


def test_upwards_the_body_keeps_its_height() -> None:
    scene = walk(1.4, 1.0)
    height = scene.planted().centres[:, 0, 1]
    assert np.abs(height - scene.centres[:, 0, 1]).max() < 0.005


def test_a_foot_in_the_air_keeps_to_its_path() -> None:
    """Only the right foot is stated; frames far from its stances only go along with the body."""
    whole = walk(1.0, 0.9, frames=2 * CYCLE)
    late = [np.concatenate([np.repeat(path[28:29], 60, axis=0), path[28:]]) for path in whole.paths]
    motions = [
        np.concatenate([np.repeat(each[28:29], 60, axis=0), each[28:]]) for each in (whole.rotations, whole.centres)
    ]
    scene = replace(whole, rotations=motions[0], centres=motions[1], paths=late[:1], contacts=whole.contacts[:1])
    result = scene.planted()
    assert result.report.groups[0].stances[0].start > 60
    np.testing.assert_array_equal(result.rotations[:40], scene.rotations[:40])
    shift = result.centres[:40] - scene.centres[:40]
    np.testing.assert_allclose(shift, np.broadcast_to(shift[:, :1], shift.shape), atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 0.7, -2.5])
def test_commutes_with_motions_over_the_ground(angle: float) -> None:
    scene = walk(1.3, 1.0)
    rotation, shift = rotvec_to_matrix(np.array([0.0, angle, 0.0])), np.array([3.0, 0.0, -8.0])
    result, moved = scene.planted(), scene.moved(rotation, shift).planted()
    np.testing.assert_allclose(moved.rotations, rotation @ result.rotations, atol=1e-8)
    np.testing.assert_allclose(moved.centres, result.centres @ rotation.T + shift, atol=1e-8)


def test_any_axis_may_point_up() -> None:
    scene = walk(1.3, 1.0)
    result = scene.planted()
    turn = np.roll(np.eye(3), 1, axis=0)  # x to y, y to z
    turned = replace(scene.moved(turn, np.zeros(3)), axis=2).planted()
    np.testing.assert_allclose(turned.centres, result.centres @ turn.T, atol=1e-8)


def test_time_may_run_backwards() -> None:
    scene = walk(1.3, 1.0)
    back = replace(
        scene, rotations=scene.rotations[::-1], centres=scene.centres[::-1], paths=[path[::-1] for path in scene.paths]
    )
    np.testing.assert_allclose(back.planted().centres[::-1], scene.planted().centres, atol=1e-8)


def test_toes_follow_the_foot() -> None:
    """A part below the one on the ground moves with it as one body."""
    scene = walk(1.4, 1.0)
    walker = scene.target
    toe = np.array([[0.05, 0.0, -0.05]])
    longer = ArticulatedBody(
        np.concatenate([walker.centres, toe]),
        np.concatenate([walker.pairs, [[3, 7]]]),
        np.concatenate([walker.pivots, toe - [0.015, 0.0, 0.0]]),
        0,
    )
    rotations = np.concatenate([scene.rotations, scene.rotations[:, 3:4]], axis=1)
    centres = hung(longer, rotations, scene.centres[:, 0])
    grown = replace(scene, target=longer, rotations=rotations, centres=centres)
    result, plain = grown.planted(), scene.planted()
    np.testing.assert_allclose(result.centres[:, :7], plain.centres, atol=1e-12)

    def relative(rotations: np.ndarray, centres: np.ndarray) -> np.ndarray:
        return np.asarray(np.einsum("tji,tj->ti", rotations[:, 3], centres[:, 7] - centres[:, 3]))

    np.testing.assert_allclose(relative(result.rotations, result.centres), relative(rotations, centres), atol=1e-12)


def test_gaps_of_joints_turn_with_the_part_above() -> None:
    """Where parts of the source slide in a joint, those of the target do so as before."""
    scene = walk(1.4, 1.0)
    gap = 0.01 * np.sin(np.arange(len(scene.centres)) / 9)[:, None] * [1.0, 0.0, 0.5]
    centres = scene.centres.copy()
    centres[:, 2:4] += np.einsum("tij,tj->ti", scene.rotations[:, 1], gap)[:, None]
    result = replace(scene, centres=centres).planted()
    knee, other = scene.joints(result.rotations, result.centres)[:, :, 1]
    open_by = np.einsum("tji,tj->ti", result.rotations[:, 1], knee - other)
    np.testing.assert_allclose(open_by, gap, atol=1e-9)
    assert result.report.groups[0].after < 1e-9


def test_a_swinging_bar() -> None:
    """A pendulum of two bars, its lower end planted in the source while its top goes on."""
    frames, lengths = 60, np.array([0.25, 0.25])
    angle = 0.5 + 0.2 * np.sin(np.linspace(0.0, 3.0, frames))
    rotations = np.tile(np.eye(3), (frames, 3, 1, 1))
    for part, sign in ((1, 1.0), (2, -1.0)):
        turn = sign * angle
        rotations[:, part, 0, 0] = rotations[:, part, 1, 1] = np.cos(turn)
        rotations[:, part, 1, 0], rotations[:, part, 0, 1] = np.sin(turn), -np.sin(turn)

    def chain(scale: float) -> tuple[ArticulatedBody, Contact]:
        knee, end = -scale * lengths[0], -scale * lengths.sum()
        heights = np.array([0.125, knee / 2, (knee + end) / 2])
        centres = np.stack([np.zeros(3), heights, np.zeros(3)], axis=1)
        pivots = np.array([[0.0, 0, 0], [0, knee, 0]])
        return ArticulatedBody(centres, np.array([[0, 1], [1, 2]]), pivots, 0), Contact(
            "end", np.array([[0.0, end, 0.0]]), np.array([2])
        )

    source, foot = chain(1.0)
    root = np.zeros((frames, 3))
    root[:, 1] = 0.5 * np.cos(angle) + 0.125  # the end stays in the origin
    path = source.pose_points(foot.points, foot.parts, rotations, hung(source, rotations, root))
    np.testing.assert_allclose(path, 0.0, atol=1e-12)
    target, end = chain(1.4)
    ours = hung(target, rotations, root + np.array([0.0, 0.2, 0.0]))
    result = remove_footskate(target, rotations, ours, [end], [path], 1, 24.0)
    (group,) = result.report.groups
    assert [(each.start, each.stop) for each in group.stances] == [(0, frames)]
    assert group.before > 0.02
    assert group.after < 1e-9
    assert group.residual < 1e-12
    joints = [target.pose_points(target.pivots, side, result.rotations, result.centres) for side in target.pairs.T]
    np.testing.assert_allclose(joints[0], joints[1], atol=1e-9)


def test_a_contact_on_the_root_moves_the_body_only() -> None:
    frames = 30
    walker = ArticulatedBody(np.zeros((1, 3)), np.zeros((0, 2), np.int64), np.zeros((0, 3)), 0)
    rotations, centres = np.tile(np.eye(3), (frames, 1, 1, 1)), np.zeros((frames, 1, 3))
    centres[:, 0, 0] = np.linspace(0.0, 1.0, frames)
    base = Contact("base", np.zeros((1, 3)), np.zeros(1, np.int64))
    result = remove_footskate(walker, rotations, centres, [base], [np.zeros((frames, 1, 3))], 2, 24.0)
    assert result.report.groups[0].before == pytest.approx(1.0)
    assert result.report.groups[0].after < 0.05
    np.testing.assert_array_equal(result.rotations, rotations)


@pytest.mark.parametrize("frames", [1, 2, 3])
def test_short_sequences(frames: int) -> None:
    scene = walk(1.4, 0.5, frames)
    result = scene.planted()
    assert result.centres.shape == scene.centres.shape
    assert max(group.after for group in result.report.groups if group.stances) < 1e-9


def test_input_arrays_are_unchanged() -> None:
    scene = walk()
    rotations, centres = scene.rotations.copy(), scene.centres.copy()
    scene.planted()
    np.testing.assert_array_equal(scene.rotations, rotations)
    np.testing.assert_array_equal(scene.centres, centres)


def test_warns_of_a_contact_that_never_rests() -> None:
    scene = walk()
    walking = scene.paths[1] - np.arange(len(scene.centres))[:, None, None] * [0.25 / CYCLE, 0.0, 0.0]
    with pytest.warns(MixseqWarning, match="contact 'right' never rests"):
        result = replace(scene, paths=[scene.paths[0], walking]).planted()
    assert result.report.groups[1].stances == ()
    assert result.report.groups[0].after < 1e-9


def fox(legs: float) -> Walk:
    """The walking fox with longer legs, its way as long as before."""
    from mixseq.creature import (
        BONE_HEADS,
        BONE_NAMES,
        BONE_PARENTS,
        BONE_TAILS,
        LEGS,
        STANCE_TRAVEL_METRES,
        pose_skeleton,
    )
    from mixseq.creature import STANCE_FRACTION as ON_GROUND

    phase = np.arange(96) / 48
    rotations, _ = pose_skeleton(phase)
    bones = {BONE_NAMES.index(name) for leg in LEGS for name in (leg.upper, leg.lower, leg.pastern, leg.paw)}

    def at_rest(scale: float) -> tuple[ArticulatedBody, list[Contact]]:
        sizes = np.where([bone in bones for bone in range(len(BONE_NAMES))], scale, 1.0)
        heads = BONE_HEADS.copy()
        for bone, above in enumerate(BONE_PARENTS):
            if above >= 0:
                heads[bone] = heads[above] + sizes[above] * (BONE_HEADS[bone] - BONE_HEADS[above])
        tails = heads + sizes[:, None] * (BONE_TAILS - BONE_HEADS)
        links = np.array([(BONE_PARENTS[bone], bone) for bone in range(1, len(BONE_NAMES))])
        walker = ArticulatedBody((heads + tails) / 2, links, heads[1:], 0)
        paws = [BONE_NAMES.index(leg.paw) for leg in LEGS]
        return walker, [Contact(BONE_NAMES[paw], tails[[paw]], np.array([paw])) for paw in paws]

    source, source_contacts = at_rest(1.0)
    target, contacts = at_rest(legs)
    _, heads = pose_skeleton(phase)
    root = heads[:, 0] + np.einsum("tij,j->ti", rotations[:, 0], source.centres[0] - BONE_HEADS[0])
    root = root + phase[:, None] * [STANCE_TRAVEL_METRES / ON_GROUND, 0.0, 0.0]  # over the ground, not on the spot
    # The fox's pasterns turn in the air as it likes: its own skeleton tells where paws are.
    places = heads + np.einsum("tbij,bj->tbi", rotations, BONE_TAILS - BONE_HEADS)
    places += phase[:, None, None] * [STANCE_TRAVEL_METRES / ON_GROUND, 0.0, 0.0]
    paths = [places[:, contact.parts] for contact in source_contacts]
    centres = hung(target, rotations, root + target.centres[0] - source.centres[0])
    contacts, paths = [replace(each, points=each.points / 2) for each in contacts], [path / 2 for path in paths]
    target = replace(target, centres=target.centres / 2, pivots=target.pivots / 2)
    return Walk(source, target, source_contacts, contacts, rotations, centres / 2, paths, 48.0)


def test_a_fox_on_long_legs() -> None:
    scene = fox(1.4)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        result = scene.planted()
    for group in result.report.groups:
        assert len(group.stances) in (2, 3)
        assert group.before > 0.1
        assert group.after < 1e-9
        assert group.residual < 1e-3
    before, after = (scene.rotations, scene.centres), (result.rotations, result.centres)
    assert bends(scene.feet(*after)) < ACCELERATION * bends(scene.feet(*before))
    assert bends(result.centres) < ACCELERATION * bends(scene.centres)


# Parts that hang on each other


def contact(parts: list[int], name: str = "sole") -> Contact:
    return Contact(name, np.zeros((len(parts), 3)), np.array(parts, dtype=np.int64))


def test_limbs_lead_from_the_root_to_the_ground() -> None:
    walker, (left, right) = body(1.0)
    assert walker.limb(left) == (1, 2, 3)
    assert walker.limb(right) == (4, 5, 6)
    assert replace(walker, root=3).limb(right) == (2, 1, 0, 4, 5, 6)


def test_vertices_on_several_parts_belong_to_the_first_that_carries_all() -> None:
    walker, _ = body(1.0)
    assert walker.limb(contact([3, 2, 3])) == (1, 2)
    assert walker.limb(contact([0, 0])) == ()


def test_pivots_may_form_loops() -> None:
    walker, (left, _) = body(1.0)
    loop = replace(walker, pairs=np.concatenate([walker.pairs, [[1, 3]]]), pivots=np.zeros((7, 3)))
    assert loop.limb(left) == (1, 3)  # the shorter way


def test_legs_are_as_long_as_their_bones() -> None:
    walker, (left, _) = body(1.4)
    middle = np.hypot(1.4 * BONES["foot"], left.points.mean(axis=0)[0])
    assert leg_length(walker, [left]) == pytest.approx(1.4 * (BONES["thigh"] + BONES["shank"]) + middle)
    assert leg_length(walker, [contact([0])]) == pytest.approx(np.linalg.norm(walker.centres[0]))


def test_placed_points_follow_their_parts() -> None:
    walker = ArticulatedBody(np.array([[1.0, 0, 0], [3, 0, 0]]), np.array([[0, 1]]), np.array([[2.0, 0, 0]]), 0)
    quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    rotations, centres = np.stack([np.eye(3), quarter])[None], np.array([[[1.0, 0, 0], [2, 1, 0]]])
    both = walker.pose_points(np.array([[2.0, 0, 0], [2, 0, 0]]), [0, 1], rotations, centres)
    np.testing.assert_allclose(both, [[[2, 0, 0], [2, 0, 0]]], atol=1e-15)


def test_contacts_on_unused_vertices_are_refused() -> None:
    walker, _ = body(1.0)
    loose = replace(walker, pairs=walker.pairs[1:], pivots=walker.pivots[1:])
    with pytest.raises(SettingsError, match="follow part 3, which is not connected to the root"):
        loose.limb(contact([3]))


def test_refuses_a_contact_on_several_limbs() -> None:
    with pytest.raises(SettingsError, match=r"'sole' are on several limbs \(parts 3, 6\); give one contact"):
        body(1.0)[0].limb(contact([3, 6]))


# Limbs that reach for a point

FADE = np.sin(np.linspace(0.0, np.pi, 81)) ** 2


def leg(bend: float, frames: int = 1) -> np.ndarray:
    """Levers (frames, 1, 3, 3) of a leg of length 1 with a foot; thigh and shank are off the vertical by `bend`."""
    s, c = 0.5 * np.sin(bend), 0.5 * np.cos(bend)
    return np.tile(np.array([[s, -c, 0], [-s, -c, 0], [0.1, -0.05, 0]]), (frames, 1, 1, 1))


def ends(levers: np.ndarray, turns: np.ndarray) -> np.ndarray:
    return np.asarray(np.einsum("nkij,ngkj->ngi", turns, levers))


ANKLE = np.array([1.0, 1.0, 0.0])


@pytest.mark.parametrize("move", [[0.1, 0, 0], [0, 0.05, 0], [0, -0.05, 0], [0, 0, 0.1], [0.05, 0.02, 0.05]], ids=str)
def test_a_bent_leg_reaches_its_goal(move: list[float]) -> None:
    levers = leg(0.6)
    turns, left = rotate_limbs(levers, np.array([[move]]), ANKLE)
    np.testing.assert_allclose(left, 0.0, atol=1e-12)
    np.testing.assert_allclose(ends(levers, turns) - levers.sum(axis=2), [[move]], atol=1e-12)
    np.testing.assert_array_equal(turns[:, 2], np.eye(3)[None])  # the sole stays level
    np.testing.assert_allclose(turns @ np.swapaxes(turns, -1, -2), np.tile(np.eye(3), (1, 3, 1, 1)), atol=1e-14)


def test_one_bone_swings_like_a_pendulum() -> None:
    angle = 0.3
    levers = np.array([[[[0.0, -2.0, 0.0]]]])
    swung = 2.0 * np.array([np.sin(angle), -np.cos(angle), 0.0])
    turns, left = rotate_limbs(levers, (swung - levers[0, 0])[None], np.ones(1))
    direction = ends(levers, turns)[0, 0] / 2.0
    # The move along the bone is not made by turning it; across it, all is.
    assert np.degrees(np.arccos(direction @ swung / 2.0)) < 3.0
    np.testing.assert_allclose(ends(levers, turns) - levers[:, :, 0] + left, (swung - levers[0, 0])[None], atol=1e-15)


def test_zero_moves_cause_no_rotation() -> None:
    turns, left = rotate_limbs(leg(0.3), np.zeros((1, 1, 3)), ANKLE)
    np.testing.assert_array_equal(turns, np.tile(np.eye(3), (1, 3, 1, 1)))
    np.testing.assert_array_equal(left, 0.0)


def test_a_contact_without_a_limb_is_unchanged() -> None:
    moves = np.array([[[1.0, 2, 3]]])
    np.testing.assert_array_equal(rotate_limbs(np.zeros((1, 1, 2, 3)), moves, np.ones(2))[1], moves)


def test_limb_solution_commutes_with_rotations() -> None:
    rng = np.random.default_rng(0)
    levers, moves, world = (leg(0.4, 5), 0.05 * rng.normal(size=(5, 1, 3)), rotvec_to_matrix(rng.normal(size=3)))
    turns, left = rotate_limbs(levers, moves, ANKLE)
    turned, other = rotate_limbs(levers @ world.T, moves @ world.T, ANKLE)
    np.testing.assert_allclose(other, left @ world.T, atol=1e-12)
    np.testing.assert_allclose(turned, world @ turns @ world.T, atol=1e-11)


def test_two_limbs_share_a_part() -> None:
    """A trunk with two legs: one foot moves, the other keeps its place."""
    levers = np.zeros((1, 2, 5, 3))
    levers[0, :, 0] = [0.4, 0.0, 0.0]
    levers[0, 0, 1:3] = levers[0, 1, 3:5] = leg(0.5)[0, 0, :2]
    moves = np.array([[[0.05, 0.03, 0.02], [0, 0, 0]]])
    turns, left = rotate_limbs(levers, moves, np.array([0.25, 1, 1, 1, 1]))
    np.testing.assert_allclose(left, 0.0, atol=1e-12)
    np.testing.assert_allclose(ends(levers, turns) - levers.sum(axis=2), moves, atol=1e-12)
    bent = np.linalg.norm(matrix_to_rotvec(turns[0]), axis=1)
    assert bent[0] < bent[1:3].max()  # the leg rather than the trunk


@pytest.mark.parametrize("bend", [0.0, 1e-6, 1e-3, 0.03, 0.1, 0.2, 0.3, 0.5])
def test_knees_do_not_pop(bend: float) -> None:
    """However straight the leg is: the knee accelerates at most four times as much as the foot is asked to."""
    for move in [[0, 0.1, 0], [0, -0.1, 0], [0, 0.03, 0], [0, -0.03, 0], [0.2, 0, 0]]:
        levers, moves = leg(bend, len(FADE)), FADE[:, None, None] * np.array(move)
        turns, left = rotate_limbs(levers, moves, ANKLE)
        knees = np.einsum("nij,nj->ni", turns[:, 0], levers[:, 0, 0])
        asked = np.linalg.norm(np.diff(moves[:, 0], 2, axis=0), axis=1).max()
        assert np.linalg.norm(np.diff(knees, 2, axis=0), axis=1).max() < 4.0 * asked
        assert np.linalg.norm(np.diff(left[:, 0], 2, axis=0), axis=1).max() < 4.0 * asked


def test_legs_that_are_too_short_stretch_out() -> None:
    levers = leg(0.6)
    turns, left = rotate_limbs(levers, np.array([[[0.0, -3.0, 0.0]]]), ANKLE)
    assert np.isfinite(turns).all()
    np.testing.assert_allclose(ends(levers, turns) - levers.sum(axis=2) + left, [[[0.0, -3.0, 0.0]]], atol=1e-12)
