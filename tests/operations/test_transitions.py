"""From one motion into another, and what is between them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from mixseq.choices import SpaceName
from mixseq.compression.numbering import walk_numbering
from mixseq.errors import InvalidSequenceError, MixseqWarning, SettingsError
from mixseq.mesh.rotations import quat_to_matrix
from mixseq.operations import blend, concatenate, cut, into, repeat, reverse, shift, transition
from mixseq.operations.sections import blend_placements
from mixseq.operations.transitions import match_spaces
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.curve import Curve
from mixseq.signals.fitting import fit
from mixseq.signals.model import Model
from mixseq.spaces.temporal import Poses
from mixseq.types import Float
from tests.meshes import bar, bending, rotation, tube
from tests.operations.chains import chain, labels
from tests.operations.motions import CIRCLE, bar_motion, jets, jumps, spin, spinning

SPACES: list[SpaceName] = ["mixed", "vertex"]


def swing_sequence() -> MeshSequence:
    mesh = tube(5, 15)
    points = bending(mesh, 11, angle=-0.8, wobble=0.1)[::-1] + np.array([1.0, 0, 0])
    return MeshSequence.from_arrays(points, mesh[1], fps=20)


@cache
def swing(space: SpaceName = "mixed") -> Model:
    """Another motion of the bar, 0 to 0.5 s, with parts and a space of its own."""
    return fit(swing_sequence(), exact=True, space=space)


def step(x: Float) -> Float:
    return np.asarray(6 * x**5 - 15 * x**4 + 10 * x**3)


# One space ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("space", SPACES)
def test_another_space_has_the_same_frames(space: SpaceName) -> None:
    model = into(swing(), bar_motion(space).space)
    assert model.space is bar_motion(space).space
    np.testing.assert_allclose(model.sample().points, swing_sequence().points, atol=1e-9)
    assert into(model, model.space) is model


def test_both_have_the_key_shapes_of_both() -> None:
    first, second = match_spaces(bar_motion(), swing())
    assert first.space is second.space
    np.testing.assert_array_equal(first.shapes, second.shapes)
    assert first.pose is second.pose
    assert len(first.shapes) == 9 + 11
    np.testing.assert_allclose(first.vectors, bar_motion().vectors, atol=1e-12)
    np.testing.assert_allclose(second.sample().points, swing_sequence().points, atol=1e-9)
    times = np.linspace(0, 0.8, 20)
    np.testing.assert_allclose(first.curve(times), bar_motion().curve(times), atol=1e-11)


def test_sections_of_one_model_share_already() -> None:
    model = bar_motion()
    first, second = match_spaces(cut(model, 0, 0.4), cut(model, 0.3, 0.8))
    assert len(first.shapes) == len(model.shapes)
    np.testing.assert_array_equal(second.time.values, cut(model, 0.3, 0.8).time.values)


@pytest.mark.parametrize(
    ("other", "message"),
    [
        (bar(sides=6, rings=15), "'small' has 77 vertices, 'bar' 92, or other faces; two models of one mesh"),
        (
            MeshSequence.from_arrays(bar(5, 15).points, bar(5, 15).faces[:-1], name="bar"),
            "'small' has 77 vertices, 'bar' 77, or other faces",
        ),
    ],
)
def test_other_meshes_are_refused(other: MeshSequence, message: str) -> None:
    small = MeshSequence.from_arrays(bar(5, 15).points, bar(5, 15).faces, name="small")
    one, two = (fit(sequence, exact=True, space="vertex") for sequence in (small, other))
    for edit in (concatenate, lambda a, b: blend(a, b, 0.5), lambda a, b: transition(a, b, 0.1, 0.1)):
        with pytest.raises(InvalidSequenceError, match=message):
            edit(one, two)


def test_meshes_with_other_numbers_are_renumbered() -> None:
    """As compressed files of order="free" have them; a turn of both is its own mean."""
    walk = MeshSequence.from_arrays(bar(5, 15).points[:, ::-1], 76 - bar(5, 15).faces)
    numbering = walk_numbering(walk.polygons, [77], vertices=True)
    free = numbering.renumber_frames(walk)
    assert numbering.order == "free"
    one, two = (fit(sequence, exact=True, space="vertex") for sequence in (walk, free))
    with pytest.warns(MixseqWarning, match="^vertices and faces of .* have other numbers in"):
        np.testing.assert_allclose(blend(one, two, 0.5).sample().points, walk.points, atol=1e-9)
    with pytest.warns(MixseqWarning, match="^vertices and faces of .* have other numbers in"):
        np.testing.assert_allclose(blend(two, one, 0.5).sample().points, free.blocks(99).__next__(), atol=1e-9)


# concatenate ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("space", SPACES)
def test_one_after_the_other(space: SpaceName) -> None:
    a, b = bar_motion(space), swing()
    both = concatenate(a, b, fade=0.15)
    assert (both.start, both.end) == pytest.approx((0, 1.3))
    np.testing.assert_allclose(both.times, [*np.arange(8) / 10, *(0.8 + np.arange(11) / 20)])
    assert all((jumps(curve) < 1e-9).all() for curve in both.curves)
    points = both.sample().points
    np.testing.assert_allclose(points[:7], bar(5, 15, 9).points[:7], atol=1e-9)
    np.testing.assert_allclose(points[-8:], swing_sequence().points[-8:], atol=1e-9)
    assert both.header.fps == 10


def test_what_was_cut_apart_fits_together() -> None:
    model = bar_motion(knots=2)
    whole = concatenate(cut(model, 0, 0.33), cut(model, 0.33, 0.8))
    times = np.linspace(0, 0.8, 50)
    np.testing.assert_allclose(whole.curve(times), model.curve(times), atol=1e-10)
    np.testing.assert_allclose(whole.times, model.times)


# transition -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("space", SPACES)
@pytest.mark.parametrize(("at", "duration"), [(0.3, 0.4), (0.27, 0.31), (0.0, 0.5), (0.5, 0.3), (0.3, 0.01)])
def test_a_transition(space: SpaceName, at: float, duration: float) -> None:
    a, b = bar_motion(space), into(swing(space), bar_motion(space).space)
    over = transition(a, b, at, duration)
    assert over.end == pytest.approx(at + 0.5)
    outside = np.linspace(0, at, 20), np.linspace(at + duration, at + 0.5, 20)
    one, other = match_spaces(a, shift(b, at))
    for curve, before, after in zip(over.curves, one.curves, other.curves, strict=True):
        assert (jumps(curve) < 1e-9).all()
        for times, kept in zip(outside, (before, after), strict=True):
            if times[0] == times[-1]:
                continue  # there is nothing on this side
            size = np.abs(jets(kept, times)).max(axis=(1, 2), initial=0.0)[:, None, None] + 1
            np.testing.assert_allclose(jets(curve, times) / size, jets(kept, times) / size, atol=1e-9)
        inside = np.linspace(at, at + duration, 200)
        weight = step((inside - at) / duration)[:, None]
        expected = (1 - weight) * before(inside) + weight * after(inside)
        if curve is over.placement:
            found = over.space.unpack_placements(curve(inside))
            means = over.space.unpack_placements(blend_placements(over.space, before(inside), after(inside), weight))
            turns, others = (quat_to_matrix(poses.rotations) for poses in (found, means))
            np.testing.assert_allclose(turns, others, atol=1e-4)
            np.testing.assert_allclose(found.centres, means.centres, atol=1e-4)
        else:
            size = np.abs(expected).max(initial=1.0)
            np.testing.assert_allclose(curve(inside) / size, expected / size, atol=1e-4)
    points = over.sample([at, at + duration]).points
    np.testing.assert_allclose(points, [a(at), b(duration)], atol=1e-9)


def test_frames_of_a_transition() -> None:
    over = transition(bar_motion(), swing(), 0.32, 0.2)
    np.testing.assert_allclose(over.times, [*np.arange(6) / 10, *(0.52 + np.arange(7) / 20)], atol=1e-12)
    over = transition(bar_motion(), swing(), 0.3, 0.2)
    np.testing.assert_allclose(over.times, [*np.arange(5) / 10, *(0.5 + np.arange(7) / 20)], atol=1e-12)


def test_into_itself_nothing_happens() -> None:
    model = bar_motion()
    over = transition(model, cut(model, 0.3, 0.8), 0.3, 0.2)
    times = np.linspace(0, 0.8, 60)
    np.testing.assert_allclose(over.curve(times), model.curve(times), atol=1e-8)


def test_the_second_motion_is_entered_at_a_time() -> None:
    entered = transition(bar_motion(), swing(), 0.2, 0.1, enter=0.15)
    np.testing.assert_allclose(entered(0.4), swing()(0.35), atol=1e-9)
    assert entered.end == pytest.approx(0.2 + 0.5 - 0.15)


def test_turns_go_on_in_a_transition() -> None:
    """A body that is at three quarters of a turn passes over into one at no turn, and goes on to a whole one."""
    over = transition(spin(), spin(), at=0.75, duration=0.25)
    moments = np.linspace(0, 1.75, 85)
    weight = step(np.clip((moments - 0.75) / 0.25, 0, 1))
    angles = 2 * np.pi * (moments + 0.25 * weight)
    np.testing.assert_allclose(over.sample(moments).points, spinning(angles), atol=CIRCLE)


def negated(model: Model) -> Model:
    """The same motion, its quaternions with the other sign."""
    turns, centres = model.space.unpack_placements(model.placement.values)
    values = model.space.pack_placements(Poses(-turns, centres))
    return replace(model, placement=Curve(model.placement.times, values))


@pytest.mark.parametrize("edit", [concatenate, lambda a, b: transition(a, b, 0.2, 0.3), lambda a, b: blend(a, b, 0.4)])
def test_signs_of_quaternions_do_not_matter(edit: Callable[[Model, Model], Model]) -> None:
    a, b = bar_motion(), reverse(bar_motion())
    times = edit(a, b).times
    np.testing.assert_allclose(edit(a, negated(b)).sample(times).points, edit(a, b).sample(times).points, atol=1e-12)


@pytest.mark.parametrize("edit", [concatenate, lambda a, b: transition(a, b, 0.2, 0.3), lambda a, b: blend(a, b, 0.4)])
def test_signs_of_quaternions_of_parts_do_not_matter(edit: Callable[[Model, Model], Model]) -> None:
    a, b = chain(), reverse(chain())
    shapes = np.array(b.shapes)
    start = b.space.shape_dim - b.space.pose_dim
    shapes[:, start + 4 : start + 8] *= -1  # of part 1
    times = edit(a, b).times
    np.testing.assert_allclose(
        edit(a, replace(b, shapes=shapes)).sample(times).points, edit(a, b).sample(times).points, atol=1e-9
    )


@pytest.mark.parametrize("angle", [1.0, 2.0, np.pi])
def test_parts_stay_together_however_a_body_turns(angle: float) -> None:
    """From one motion into another that looks elsewhere: joints bend as if it looked the same way."""
    np.testing.assert_allclose(lengths_in_transition(angle), lengths_in_transition(0.0), atol=1e-3)


@cache
def lengths_in_transition(angle: float) -> Float:
    """Edge lengths of a chain on the way into its motion backwards, turned by an angle."""
    model = chain()
    points = model.sample().points[::-1] @ rotation((0.0, 0.0, angle)).T
    other = fit(MeshSequence.from_header(model.header, points), exact=True, parts=labels())
    over = transition(model, into(other, model.space), 0.2, 0.6)
    ends = over.sample(np.linspace(0.2, 0.8, 25)).points[:, model.mixed.topology.edges]
    return np.asarray(np.linalg.norm(ends[:, :, 0] - ends[:, :, 1], axis=2))


@pytest.mark.parametrize(
    ("at", "duration", "message"),
    [
        (0.9, 0.1, "at is 0.9 s; the model is from 0 to 0.8 s"),
        (0.5, 0.4, "duration is 0.4 s; the first model has 0.3 s"),
        (0.1, 0.6, "duration is 0.6 s; the second model has 0.5 s"),
        (0.1, 0.0, "duration is 0.0; a positive number"),
        (0.1, np.nan, "duration is nan; a positive number"),
        (0.1, 1e-6, "duration is 1e-06 s; give a longer one"),
        (np.nan, 0.1, "at is nan s"),
    ],
)
def test_transitions_have_time(at: float, duration: float, message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        transition(bar_motion(), swing(), at, duration)


# blend ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("space", SPACES)
@pytest.mark.parametrize("as_curve", [False, True])
def test_all_or_nothing_gives_the_inputs(space: SpaceName, as_curve: bool) -> None:
    a, b = bar_motion(space), reverse(bar_motion(space))
    for weight, expected in ((0.0, a), (1.0, b)):
        given = Curve(np.array([0.0, 0.8]), np.full((2, 1), weight)) if as_curve else weight
        mixed = blend(a, b, given)
        np.testing.assert_array_equal(mixed.times, a.times)
        np.testing.assert_allclose(mixed.sample().points, expected.sample().points, atol=1e-9)
        times = np.linspace(0, 0.8, 40)
        np.testing.assert_allclose(mixed.curve(times), expected.curve(times), atol=1e-11)


def test_all_or_nothing_in_other_spaces() -> None:
    a, b = bar_motion(), shift(swing(), 0.2)
    np.testing.assert_allclose(blend(a, b, 0.0).times, [0.2, 0.3, 0.4, 0.5, 0.6, 0.7])
    np.testing.assert_allclose(blend(a, b, 0.0).sample().points, bar(5, 15, 9).points[2:8], atol=1e-9)
    np.testing.assert_allclose(blend(a, b, 1.0).sample().points, swing_sequence().points[::2], atol=1e-9)


def test_half_is_the_mean_of_the_vertices() -> None:
    a, b = bar_motion("vertex"), into(swing(), bar_motion("vertex").space)
    mixed = blend(a, b, 0.5)
    for time in (0.0, 0.13, 0.4, 0.5):
        np.testing.assert_allclose(mixed(time), (a(time) + b(time)) / 2, atol=1e-10)


@pytest.mark.parametrize("weight", [0.25, 0.5, 0.8])
def test_a_body_that_spins_blends_with_one_at_rest(weight: float) -> None:
    """Three turns, of which so many are left: there is no time at which quaternions cancel."""
    spins = repeat(spin(), 0, 1, 3)
    rest = Curve(spins.placement.times, np.repeat(spins.placement.values[:1], len(spins.placement.times), axis=0))
    mixed = blend(spins, replace(spins, placement=rest), weight)
    times = np.linspace(0, 3, 73)
    np.testing.assert_allclose(mixed.sample(times).points, spinning(2 * np.pi * (1 - weight) * times), atol=CIRCLE)


def test_a_weight_over_time() -> None:
    a, b = bar_motion("vertex"), reverse(bar_motion("vertex"))
    weight = Curve(np.array([0.0, 0.3, 0.5, 0.8]), np.array([[0.0], [0.9], [0.3], [1.0]]))
    mixed = blend(a, b, weight)
    for time in (0.0, 0.13, 0.4, 0.77, 0.8):
        share = weight([time]).item()
        np.testing.assert_allclose(mixed(time), (1 - share) * a(time) + share * b(time), atol=1e-5)


def test_blends_need_time_and_a_weight() -> None:
    a, b = bar_motion(), swing()
    with pytest.raises(SettingsError, match="no time in common; shift one of them"):
        blend(a, shift(b, 0.8), 0.5)
    with pytest.raises(SettingsError, match="weight is nan; a number is expected"):
        blend(a, b, np.nan)
    with pytest.raises(SettingsError, match="weight is a curve of 2 coordinates; one is expected"):
        blend(a, b, Curve(np.array([0.0, 1.0]), np.zeros((2, 2))))
    with pytest.raises(SettingsError, match=r"weight is a curve from 0.2 to 1 s; 0 to 0.5 s are expected"):
        blend(a, b, Curve(np.array([0.2, 1.0]), np.zeros((2, 1))))
