"""More or less of a motion, of all parts and of single modes."""

from __future__ import annotations

from functools import cache
from itertools import permutations

import numpy as np
import pytest

from mixseq.arrays import Float
from mixseq.errors import SettingsError
from mixseq.geometry.rigid import kabsch
from mixseq.operations import exaggerate
from mixseq.operations.exaggeration import check_gain
from mixseq.sequence import MeshSequence
from mixseq.signals import Model, fit
from tests.meshes import joined, rotation, tube
from tests.operations.chains import TIMES, angles, bone, chain, frames
from tests.operations.motions import bar_motion

# All parts ------------------------------------------------------------------------------------------------


def off(found: Float, expected: Float) -> float:
    """How far a frame ``(V, 3)`` is from another one, wherever both are."""
    turn, shift = kabsch(found, expected)
    return float(np.abs(found @ turn.T + shift - expected).max())


@pytest.mark.parametrize("order", list(permutations(range(3))), ids=str)
@pytest.mark.parametrize("gain", [1.6, 0.0, -1.0])
def test_all_joints_bend_by_so_much_more(order: tuple[int, ...], gain: float) -> None:
    """Whichever way round parts are numbered."""
    mean = angles(TIMES).mean(axis=0)
    expected = frames(mean + gain * (angles(TIMES) - mean))
    points = exaggerate(chain(order), gain).sample().points
    bones = np.concatenate([bone(number) for number in range(3)])
    assert max(map(off, points[:, bones], expected[:, bones])) < 1e-9


def test_the_middle_of_a_body_stays() -> None:
    """The middle bone is the one as seen from which the others move least."""
    points = exaggerate(chain(), 1.6).sample().points
    np.testing.assert_allclose(points[:, bone(1)], chain().sample().points[:, bone(1)], atol=1e-9)


HINGE = np.array([0.4, 0.0, 4.5])
"""Where the arm turns about the y axis: off its own axis, and not where it is nearest to the trunk."""


@cache
def robot(turns: tuple[float, ...]) -> Model:
    """A trunk, and an arm that no edge connects with it, turned by angles; on the arm a hand, turned by the same."""
    trunk, arm, hand = tube(6, 5), tube(5, 4, length=1.5, radius=0.2), tube(4, 3, length=0.5, radius=0.1)
    faces = joined(joined(trunk, arm), hand)[1]
    still = np.repeat(trunk[0][None], len(turns), axis=0)
    rest = np.concatenate([arm[0], hand[0] + np.array([0.0, 0.0, 1.6])]) + np.array([0.0, 0.0, 4.4])
    moved = np.stack([(rest - HINGE) @ rotation((0.0, turn, 0.0)).T + HINGE for turn in turns])
    points = np.concatenate([still, moved], axis=1) + np.arange(len(turns))[:, None, None] * [0.1, 0.0, 0.0]
    return fit(MeshSequence.from_arrays(points, faces, fps=10), exact=True)


def test_parts_that_no_edge_connects_turn_in_joints_that_their_motion_tells() -> None:
    swing = 0.3 + 0.5 * np.sin(np.arange(9.0))
    more = swing.mean() + 2.0 * (swing - swing.mean())
    points = exaggerate(robot(tuple(swing)), 2.0).sample().points
    np.testing.assert_allclose(points, robot(tuple(more)).sample().points, atol=5e-3)


def test_what_spins_spins_as_before() -> None:
    model = robot(tuple(np.linspace(0.0, 9.0, 13)))
    np.testing.assert_allclose(exaggerate(model, 2.0).sample().points, model.sample().points, atol=1e-9)


def test_no_part_turns_by_more_than_half_a_turn_from_its_mean() -> None:
    swing = np.linspace(-1.5, 1.5, 9)
    points = exaggerate(robot(tuple(swing)), 100.0).sample().points
    expected = robot(tuple(swing * np.pi / 1.5)).sample().points
    np.testing.assert_allclose(points, expected, atol=5e-3)


# Modes ----------------------------------------------------------------------------------------------------


def test_once_is_the_motion() -> None:
    for modes in (None, [0], []):
        edited = exaggerate(bar_motion(), 1.0, modes)
        np.testing.assert_array_equal(edited.time.values, bar_motion().time.values)
        assert edited.placement is bar_motion().placement


@pytest.mark.parametrize("gain", [-1.0, 0.0, 0.5, 2.0])
def test_vertices_keep_their_mean_path(gain: float) -> None:
    """In the vertex space: x - mean is scaled, at frames and between them."""
    model = bar_motion("vertex")
    mean = model.sample().points.mean(axis=0)
    edited = exaggerate(model, gain)
    for time in (0.0, 0.13, 0.8):
        np.testing.assert_allclose(edited(time), mean + gain * (model(time) - mean), atol=1e-10)


def test_modes_are_scaled_one_by_one() -> None:
    model = bar_motion()
    edited = exaggerate(model, 3.0, modes=[1])
    times = np.linspace(0, 0.8, 30)
    expected = model.time(times)
    mean = model.time(model.times)[:, 1].mean()
    expected[:, 1] = mean + 3 * (expected[:, 1] - mean)
    np.testing.assert_allclose(edited.time(times), expected, atol=1e-12)
    np.testing.assert_array_equal(edited.placement.values, model.placement.values)


def test_frozen_modes_do_not_move() -> None:
    values = exaggerate(bar_motion(), 0.0, modes=[0, 2]).time.values
    np.testing.assert_allclose(np.ptp(values[:, [0, 2]], axis=0), 0, atol=1e-15)
    assert (np.ptp(values[:, [1, 3]], axis=0) > 1e-3).all()


def test_gains_are_finite_and_modes_there() -> None:
    with pytest.raises(SettingsError, match="gain is inf; a number is expected"):
        exaggerate(bar_motion(), np.inf)
    for mode in (-1, 99):
        with pytest.raises(SettingsError, match=f"there is no mode {mode}; the model has 8, from 0 on"):
            exaggerate(bar_motion(), 2.0, modes=[0, mode])


@pytest.mark.parametrize("gain", [1001.0, -1e200, np.inf, np.nan])
def test_gains_that_no_motion_survives_are_refused(gain: float) -> None:
    with pytest.raises(SettingsError, match="a number is expected, at most 1000 in size"):
        check_gain(gain)
