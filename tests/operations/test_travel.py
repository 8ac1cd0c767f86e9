"""How far bodies get along the ground: taken away, and kept from one motion to the next."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from mixseq.errors import SettingsError
from mixseq.operations import concatenate, in_place, loop, repeat, shift, transition, travel_of
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.fitting import fit
from mixseq.signals.model import Model
from mixseq.types import Float
from tests.meshes import joined, tetrahedron, tube
from tests.operations.motions import CIRCLE, bar_motion, jumps, spin, spinning

TURN = 2 * np.pi


@cache
def going(speed: float, start: tuple[float, float, float] = (0.0, 0.0, 0.0), fps: float = 12.0) -> Model:
    """A body that goes along x, and rises as it does, for a second."""
    points, faces = tube(5, 4)
    way = np.arange(fps + 1)[:, None, None] / fps * np.array([speed, 0.5, 0.0])
    return fit(MeshSequence.from_arrays(points + way + np.array(start), faces, fps=fps), exact=True, space="lri")


# The curve ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("even", [False, True])
def test_a_body_that_goes_evenly(even: bool) -> None:
    """Up, which is Y, is no travel; nor is where it starts."""
    found = travel_of(going(3.0, (7.0, 1.0, 2.0)), even)
    times = np.linspace(0, 1, 7)
    np.testing.assert_allclose(found(times), times[:, None] * [3.0, 0.0, 0.0], atol=1e-9)


@pytest.mark.parametrize("up_axis", ["X", "Z"])
def test_the_up_axis_is_that_of_the_file(up_axis: str) -> None:
    model = going(3.0)
    turned = replace(model, header=replace(model.header, up_axis=up_axis))
    along = [0.0, 0.5, 0.0] if up_axis == "X" else [3.0, 0.5, 0.0]
    np.testing.assert_allclose(travel_of(turned)([1.0])[0], along, atol=1e-9)


def test_large_parts_count_more() -> None:
    """A body of three times the size has nine times the area: what the small one moves by counts for a tenth."""
    large, small = tetrahedron(), tetrahedron()
    points, faces = joined((3 * large[0], large[1]), (small[0] + 9.0, small[1]))
    frames = np.repeat(points[None], 5, axis=0)
    frames[:, 4:, 0] += np.arange(5.0)[:, None]
    model = fit(MeshSequence.from_arrays(frames, faces), exact=True, space="lri")
    np.testing.assert_allclose(travel_of(model)([model.end])[0], [0.4, 0.0, 0.0], atol=1e-9)


def test_an_even_travel_ends_where_the_true_one_does() -> None:
    model = bar_motion()
    true, even = travel_of(model), travel_of(model, even=True)
    np.testing.assert_allclose(even([0.0, 0.8]), true([0.0, 0.8]), atol=1e-12)
    np.testing.assert_allclose(even([0.4])[0], even([0.8])[0] / 2, atol=1e-12)
    assert np.abs(true([0.4]) - even([0.4])).max() > 1e-3


# In place -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("even", [False, True])
def test_in_place_it_spins_on_the_spot(even: bool) -> None:
    times = np.linspace(0, 1, 25)
    found = in_place(spin(0.1), even).sample(times).points
    np.testing.assert_allclose(found, spinning(TURN * times), atol=CIRCLE)


@pytest.mark.parametrize("even", [False, True])
def test_the_curve_gives_the_motion_back(even: bool) -> None:
    model = bar_motion()
    times = np.linspace(0, 0.8, 21)
    back = in_place(model, even).sample(times).points + travel_of(model, even)(times)[:, None]
    np.testing.assert_allclose(back, model.sample(times).points, atol=1e-9)


# From one motion into another -----------------------------------------------------------------------------


def test_a_loop_goes_on_from_where_it_got_to() -> None:
    model = bar_motion()
    closed = loop(model, travel=True)
    way = travel_of(model)([0.8])[0]
    np.testing.assert_allclose(closed(0.8), closed(0.0) + way, atol=1e-9)
    np.testing.assert_allclose(closed.velocity(0.8), closed.velocity(0.0), atol=1e-6)
    np.testing.assert_allclose(closed.sample([0.3, 0.5]).points, model.sample([0.3, 0.5]).points, atol=1e-9)
    twice = repeat(closed, 0.0, 0.8, times=2, travel=True)
    times = np.linspace(0, 0.8, 9)
    np.testing.assert_allclose(twice.sample(times).points, closed.sample(times).points, atol=1e-9)
    np.testing.assert_allclose(twice.sample(times + 0.8).points, closed.sample(times).points + way, atol=1e-9)


def test_a_loop_in_place_is_a_loop() -> None:
    for even in (False, True):
        closed = in_place(loop(bar_motion(), travel=True), even)
        np.testing.assert_allclose(closed(0.8), closed(0.0), atol=1e-9)
        np.testing.assert_allclose(closed.velocity(0.8), closed.velocity(0.0), atol=1e-6)


def test_one_after_the_other_goes_on() -> None:
    """A body that turns and goes along x does so for twice as long, wherever the second one starts."""
    times = np.linspace(0, 2, 49)
    for second in (spin(0.1), shift(spin(0.1), 5.0)):
        longer = concatenate(spin(0.1), second, travel=True)
        np.testing.assert_allclose(longer.sample(times).points, spinning(TURN * times, 0.1), atol=CIRCLE)


def test_the_second_one_is_moved_along_the_ground_only() -> None:
    both = concatenate(going(2.0), going(2.0, (9.0, 4.0, -3.0)), fade=0.1, travel=True)
    points = tube(5, 4)[0]
    np.testing.assert_allclose(both(0.5), points + np.array([1.0, 0.25, 0.0]), atol=1e-9)
    np.testing.assert_allclose(both(1.5), points + np.array([3.0, 4.25, 0.0]), atol=1e-9)


@pytest.mark.parametrize(("before", "after"), [(3.0, 3.0), (3.0, 0.0), (-1.0, 2.0)])
def test_in_a_transition_the_speed_is_between_both(before: float, after: float) -> None:
    both = transition(going(before), going(after, (9.0, 0.0, -3.0)), at=0.25, duration=0.5, travel=True)
    times = np.linspace(0, both.end, 41)
    x = np.clip((times - 0.25) / 0.5, 0, 1)
    weight = 6 * x**5 - 15 * x**4 + 10 * x**3
    speeds = np.stack([both.velocity(time)[0] for time in times])
    np.testing.assert_allclose(speeds[:, 0], (1 - weight) * before + weight * after, atol=2e-3)
    np.testing.assert_allclose(speeds[:, 2], 0.0, atol=2e-3)
    assert all((jumps(curve) < 1e-8).all() for curve in both.curves)


def test_without_travel_the_body_slides_to_where_the_second_one_is() -> None:
    slid = transition(going(3.0), going(3.0), at=0.25, duration=0.5)
    np.testing.assert_allclose(slid(slid.end), going(3.0)(1.0), atol=1e-9)


EDITS: list[Callable[[Model], object]] = [
    travel_of,
    in_place,
    lambda model: loop(model, travel=True),
    lambda model: concatenate(model, model, travel=True),
    lambda model: transition(model, model, 0.2, 0.2, travel=True),
]


@pytest.mark.parametrize("edit", EDITS)
def test_what_has_no_placement_does_not_travel(edit: Callable[[Model], object]) -> None:
    with pytest.raises(SettingsError, match="the vertex space has no positions of bodies, so nothing can travel"):
        edit(bar_motion("vertex"))


def test_single_frames_do_not_travel() -> None:
    points: Float = tube(5, 4)[0][None]
    model = fit(MeshSequence.from_arrays(points, tube(5, 4)[1]), exact=True, space="lri")
    for even in (False, True):
        np.testing.assert_allclose(travel_of(model, even).values, 0.0, atol=1e-15)
