"""Models: exact at the frames, smooth between them, silent outside."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from mixseq.choices import PLACEMENTS, PlacementName
from mixseq.errors import SettingsError
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.fitting import fit
from mixseq.signals.model import Model
from mixseq.spaces.temporal import insert_midpoints, select_operator
from tests.meshes import bar, rotation, tube

UNEVEN = [-0.5, 0.0, 0.15, 0.75, 2.0]


def small(frames: int = 5, times: list[float] | None = None) -> MeshSequence:
    sequence = bar(sides=5, rings=15, frames=frames)
    return MeshSequence.from_arrays(
        sequence.points, sequence.polygons, times, fps=10, up_axis="Z", metres_per_unit=0.01, name="small"
    )


@cache
def model_of(placement: PlacementName = "anchored", frames: int = 5, uneven: bool = False) -> Model:
    return fit(small(frames, UNEVEN if uneven else None), exact=True, placement=placement)


@pytest.mark.parametrize("placement", PLACEMENTS)
@pytest.mark.parametrize("uneven", [False, True])
def test_the_frames_are_the_frames(placement: PlacementName, uneven: bool) -> None:
    model = model_of(placement, uneven=uneven)
    sequence = small(5, UNEVEN if uneven else None)
    sampled = model.sample()
    np.testing.assert_array_equal(sampled.times, sequence.times)
    np.testing.assert_allclose(sampled.points, sequence.points, atol=1e-9)
    assert sampled.polygons.same_as(sequence.polygons)
    assert (sampled.fps, sampled.up_axis, sampled.metres_per_unit, sampled.name) == (10, "Z", 0.01, "small")
    np.testing.assert_array_equal(model.curve(sequence.times), model.vectors)
    np.testing.assert_array_equal(model(float(sequence.times[2])), sampled.points[2])


@pytest.mark.parametrize("frames", [1, 2, 3])
def test_few_frames(frames: int) -> None:
    model = model_of(frames=frames)
    np.testing.assert_allclose(model.sample().points, small(frames).points, atol=1e-9)
    twice = model.sample(fps=20)
    assert twice.frame_count == 2 * frames - 1
    np.testing.assert_allclose(twice.points[::2], small(frames).points, atol=1e-9)


def test_between_two_frames_shapes_go_straight() -> None:
    model = model_of(frames=2)
    count = model.space.shape_dim
    quarter, (first, last) = model.curve([0.025])[0], model.vectors
    np.testing.assert_allclose(quarter[:count], (0.75 * first + 0.25 * last)[:count], atol=1e-14)


@pytest.mark.parametrize("placement", PLACEMENTS)
@pytest.mark.parametrize("uneven", [False, True])
def test_middles_between_frames_are_predicted(placement: PlacementName, uneven: bool) -> None:
    """By the operator that predicts the vertices best, as seen from bodies: all of them, as the mesh is small."""
    model, sequence = model_of(placement, uneven=uneven), small(5, UNEVEN if uneven else None)
    space = model.space
    middles = (sequence.times[1:] + sequence.times[:-1]) / 2
    size, end = space.shape_dim, space.shape_dim + space.placement_dim
    vectors, found = model.vectors, model.curve(middles)
    points = sequence.points.astype(np.float64)
    held = space.to_body_axes(points, np.arange(points.shape[1]), vectors[:, size:end])
    operator = select_operator(sequence.times, held.reshape(5, -1))
    np.testing.assert_allclose(found[:, :size], operator.weights_at(middles).interpolate(vectors[:, :size]), atol=1e-11)
    poses = vectors[:, size - space.pose_dim : size]
    targets, placed = space.interpolate_poses(operator, poses, vectors[:, size:end], middles)
    corrections = space.pose_corrections(found[:, size - space.pose_dim : size], targets)
    expected = np.concatenate([placed, corrections], axis=1)
    np.testing.assert_allclose(found[:, size:], expected, atol=2.0**-24)  # corrections between frames are rounded


@pytest.mark.parametrize("uneven", [False, True])
def test_between_knots_signals_follow_the_cubic_spline(uneven: bool) -> None:
    """Shapes through frames and middles, placement and correction through quarters."""
    model = model_of(uneven=uneven)
    times, middles = np.linspace(model.times[0], model.times[-1], 23), insert_midpoints(model.times)
    for columns, knots in (
        (slice(0, model.space.shape_dim), middles),
        (slice(model.space.shape_dim, None), insert_midpoints(middles)),
    ):
        spline = CubicSpline(knots, model.curve(knots)[:, columns], bc_type="not-a-knot")
        np.testing.assert_allclose(model.curve(times)[:, columns], spline(times), atol=1e-11)


def test_a_turning_body_turns_evenly() -> None:
    """Key shapes of a rigid body at 0, 40, ..., 720 degrees; between them it stands at the angles between."""
    mesh = tube(5, 4)
    centred = mesh[0] - mesh[0].mean(axis=0)
    axis = np.array([2.0, 1, -2]) / 3
    turns = np.radians(np.arange(0, 721, 40.0))
    points = np.stack([centred @ rotation(axis * turn).T for turn in turns])
    sampled = fit(MeshSequence.from_arrays(points, mesh[1], fps=10), exact=True).sample(fps=20)
    assert sampled.frame_count == 2 * len(turns) - 1
    for frame, turn in enumerate(np.radians(np.arange(0, 721, 20.0))):
        np.testing.assert_allclose(sampled.points[frame], centred @ rotation(axis * turn).T, atol=1e-9)


@pytest.mark.parametrize("placement", PLACEMENTS)
def test_twice_the_rate_contains_the_originals(placement: PlacementName) -> None:
    model = model_of(placement)
    twice = model.sample(fps=20)
    assert twice.frame_count == 9
    assert twice.fps == 20
    np.testing.assert_allclose(twice.times, np.arange(9) / 20)
    np.testing.assert_allclose(twice.points[::2], small().points, atol=1e-9)
    step = np.abs(np.diff(twice.points, axis=0)).max()
    assert step < 0.8 * np.abs(np.diff(small().points, axis=0)).max()


def test_header_at_is_the_header_of_the_sample() -> None:
    model = model_of(uneven=True)
    for times, fps in ((None, None), (None, 4.0), ([0.0, 0.2, 1.0], None), ([0.5], 30.0)):
        header, sampled = model.header_at(times, fps), model.sample(times, fps)
        np.testing.assert_array_equal(header.times, sampled.times)
        assert header.fps == sampled.fps == (fps or 10)
        assert header.frame_count == len(sampled.points)
    np.testing.assert_allclose(model.header_at(fps=4).times, -0.5 + np.arange(11) / 4)
    np.testing.assert_allclose(model.header_at(fps=0.7).times, [-0.5, -0.5 + 1 / 0.7])


@settings(max_examples=50, deadline=None)
@given(fps=st.floats(0.05, 5000.0), frames=st.sampled_from([2, 3, 5]))
def test_every_rate_covers_the_sequence(fps: float, frames: int) -> None:
    model = model_of(frames=frames)
    times = model.header_at(fps=fps).times
    last = model.times[-1]
    assert times[0] == model.times[0]
    assert times[-1] <= last
    assert last - times[-1] < 1 / fps * (1 + 1e-5)
    np.testing.assert_allclose(np.diff(times), 1 / fps, rtol=1e-4)


@pytest.mark.parametrize("time", [-0.01, 0.41, np.nan, np.inf, -np.inf])
def test_models_do_not_extrapolate(time: float) -> None:
    model = model_of()
    for ask in (
        lambda: model(time),
        lambda: model.curve([0.1, time]),
        lambda: model.sample([0.1, time]),
        lambda: next(model.blocks([time])),
    ):
        with pytest.raises(SettingsError, match=rf"time {time:g} s is outside the sequence, 0 to 0.4 s"):
            ask()


def test_rounding_at_the_ends_is_forgiven() -> None:
    model = model_of()
    np.testing.assert_array_equal(model.curve([0.4 + 1e-12]), model.vectors[-1:])
    np.testing.assert_array_equal(model.curve([-1e-12]), model.vectors[:1])


@pytest.mark.parametrize("fps", [0.0, -24.0, np.nan, np.inf])
def test_the_rate_is_checked(fps: float) -> None:
    with pytest.raises(SettingsError, match=r"fps is .*; a positive number is expected"):
        model_of().sample(fps=fps)


@pytest.mark.parametrize("size", [1, 2, 100])
def test_blocks_are_the_sample(size: int) -> None:
    model = model_of()
    times = np.linspace(0, 0.4, 5)
    told: list[int] = []
    blocks = list(model.blocks(times, size, lambda done, total, what: told.append(done)))
    assert max(map(len, blocks)) <= size
    np.testing.assert_allclose(np.concatenate(blocks), model.sample(times).points, atol=1e-12)
    assert told[-1] == 5
    assert len(told) == len(blocks)


def test_no_times_give_nothing() -> None:
    model = fit(bar(sides=5, rings=9, frames=3), exact=True)
    assert model.curve([]).shape == model.rates([]).shape == (0, model.space.dim)
    assert model.embedding([]).shape == (0, 2)


def test_repr_tells_what_it_is() -> None:
    model = model_of("free")
    assert repr(model) == (
        f"Model('small': 0 to 0.4 s, 5 key shapes, mixed space of dim {model.space.dim}, 9 + 17 knots)"
    )


@pytest.mark.parametrize("placement", PLACEMENTS)
@pytest.mark.parametrize("time", [0.0, 0.13, 0.2, 0.4])
def test_velocities_are_the_derivative(placement: PlacementName, time: float) -> None:
    model = model_of(placement)
    step = 1e-5
    before, after = max(time - step, 0.0), min(time + step, 0.4)
    quotient = (model(after) - model(before)) / (after - before)
    velocity = model.velocity(time)
    assert np.abs(velocity - quotient).max() < 2e-3 * np.abs(quotient).max()
    sampled = model.sample([0.0, time] if time else [0.0], velocities=True)
    assert sampled.velocities is not None
    np.testing.assert_allclose(sampled.velocities[-1], velocity, atol=1e-9)
    np.testing.assert_array_equal(sampled.points[-1], model(time))


def test_a_turning_body_has_the_velocities_of_its_turn() -> None:
    mesh = tube(5, 4)
    centred = mesh[0] - mesh[0].mean(axis=0)
    turns = np.radians(np.arange(0, 721, 40.0))
    points = np.stack([centred @ rotation(np.array([0, 0, turn])).T for turn in turns])
    model = fit(MeshSequence.from_arrays(points, mesh[1], fps=10), exact=True)
    rate = np.radians(400.0)
    for time in (0.0, 0.33, 1.27):
        x = model(time)
        expected = rate * np.stack([-x[:, 1], x[:, 0], 0 * x[:, 2]], axis=1)
        np.testing.assert_allclose(model.velocity(time), expected, atol=2e-3 * rate)


def test_a_tail_that_twists_by_half_a_turn_goes_on_twisting() -> None:
    """Key shapes every 45 degrees up to 180 on the far bone; the frames between are twisted between."""
    sides, rings = 6, 25
    mesh = tube(sides, rings)
    along = np.clip((mesh[0][:, 2] - 1.5) / 1.0, 0, 1)
    keys = np.radians([0, 45, 90, 135, 180, 225, 270])

    def twisted(turn: float) -> NDArray[np.float64]:
        return np.stack([rotation(np.array([0, 0, turn * a])) @ x for a, x in zip(along, mesh[0], strict=True)])

    points = np.stack([twisted(turn) for turn in keys])
    model = fit(MeshSequence.from_arrays(points, mesh[1], fps=1), exact=True)
    for time in (0.5, 2.5, 3.5, 5.5):
        expected = twisted(np.radians(45 * time))
        far = along == 1
        assert np.abs(model(time)[far] - expected[far]).max() < 1e-3
        assert np.abs(model(time) - expected).max() < 0.05


def test_frames_by_number() -> None:
    model = model_of()
    np.testing.assert_array_equal(model.sample(frames=range(1, 3)).points, model.sample().points[1:3])
    for frames in ([5], [-1], []):
        with pytest.raises(SettingsError, match="the sequence has frames 0 to 4"):
            model.sample(frames=frames)
    with pytest.raises(SettingsError, match="either times or frames"):
        model.sample([0.1], frames=[1])


def test_rates_that_make_too_many_frames_are_refused() -> None:
    with pytest.raises(SettingsError, match="more than 10,000,000 frames"):
        model_of().header_at(fps=1e12)


def test_several_times_are_one_array(bar_model: Model) -> None:
    times = [0.0, 0.05, 0.3]
    np.testing.assert_array_equal(bar_model(times), [bar_model(time) for time in times])
    np.testing.assert_array_equal(bar_model.velocity(times), [bar_model.velocity(time) for time in times])
    assert bar_model([]).shape == bar_model.velocity([]).shape == (0, 77, 3)
