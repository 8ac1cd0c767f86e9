"""Resampling: motions that cubic curves reproduce, so that every frame and velocity is known."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike

from mixseq.compression.compressed_model import CompressedModel
from mixseq.compression.encoder.compress import compress
from mixseq.errors import SettingsError
from mixseq.operations.resampling import plan, resample
from mixseq.operations.retiming import Retiming
from mixseq.sequence.header import MAX_FRAME_COUNT, SequenceHeader
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.curve import Curve
from mixseq.signals.fitting import fit
from mixseq.signals.model import Model
from mixseq.types import Float
from tests.meshes import bar

TRIANGLE = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
POWERS = np.random.default_rng(5).normal(size=(4, 3, 3))


def place(times: ArrayLike) -> Float:
    """A triangle whose corners move along cubic parabolas."""
    t = np.asarray(times, dtype=np.float64)
    return np.asarray(TRIANGLE + np.einsum("pt,pvi->tvi", t ** np.arange(4)[:, None], POWERS))


def speed_at(times: ArrayLike) -> Float:
    """The derivative of `place`."""
    t = np.asarray(times, dtype=np.float64)
    return np.asarray(np.einsum("pt,pvi->tvi", [0 * t, 1 + 0 * t, 2 * t, 3 * t**2], POWERS))


def model_at(times: ArrayLike, fps: float = 10.0) -> Model:
    """The spline through the frames, which are its only knots: so it is the parabola."""
    sequence = MeshSequence.from_arrays(place(times), [[0, 1, 2]], times, fps)
    return fit(sequence, knots=max(sequence.frame_count - 4, 0), space="vertex")


class Wheel:
    """A rig, open only while its file is: the triangle turns about z by one radian per second, from 1 to 3 s."""

    header = MeshSequence.from_arrays([TRIANGLE] * 3, [[0, 1, 2]], [1, 2, 3], 1.0).header
    can_evaluate = True

    def blocks(self, size: int = 16) -> Iterator[Float]:
        return self.blocks_at(self.header.times, size)

    def blocks_at(self, times: ArrayLike, size: int = 16) -> Iterator[Float]:
        for start in range(0, len(turned := self.turned(times)), size):
            yield turned[start : start + size]

    def velocity_blocks_at(self, times: ArrayLike, size: int = 16) -> Iterator[Float]:
        yield from self.blocks_at(np.add(times, np.pi / 2), size)

    @staticmethod
    def turned(times: ArrayLike) -> Float:
        c, s = np.cos(times), np.sin(times)
        turns = np.moveaxis(np.array([[c, -s, 0 * c], [s, c, 0 * c], [0 * c, 0 * c, 0 * c]]), 2, 0)
        return np.asarray(TRIANGLE @ turns.swapaxes(1, 2))


@pytest.mark.parametrize(
    ("settings", "sources", "slope"),
    [
        ({"fps": 4}, 1 + np.arange(9) / 4, 1),
        ({"fps": 3, "speed": 0.5, "reverse": True}, 3 - np.arange(13) / 6, -0.5),
        ({"start": 1.5, "end": 1.75, "fps": 8}, [1.5, 1.625, 1.75], 1),
        ({"retiming": Retiming.through([0, 2], [2, 1.5]), "fps": 2}, 2 - np.arange(5) / 8, -0.25),
    ],
)
def test_rigs_are_evaluated(settings: dict[str, Any], sources: ArrayLike, slope: float) -> None:
    """A model of three frames, a radian apart, would be far from the arc."""
    got = resample(Wheel(), velocities=True, **settings)
    np.testing.assert_allclose(got.points, Wheel.turned(sources), atol=1e-12)
    assert got.velocities is not None
    np.testing.assert_allclose(got.velocities, slope * Wheel.turned(np.add(sources, np.pi / 2)), atol=1e-12)
    np.testing.assert_array_equal(resample(Wheel(), **settings).points, got.points)


def test_rigs_have_a_first_and_a_last_frame() -> None:
    with pytest.raises(SettingsError, match=r"the retiming goes beyond the source: time 3.5 s is outside the sequence"):
        resample(Wheel(), retiming=Retiming.through([0, 1], [3, 3.5]))


@pytest.fixture(scope="module")
def model() -> Model:
    """Frames at 0, 0.1, ..., 0.8 s."""
    return model_at(np.arange(9) / 10)


@pytest.mark.parametrize(
    ("settings", "times", "sources", "slope"),
    [
        ({}, np.arange(9) / 10, np.arange(9) / 10, 1),
        ({"fps": 25}, np.arange(21) / 25, np.arange(21) / 25, 1),
        ({"fps": 3}, np.arange(3) / 3, np.arange(3) / 3, 1),
        ({"speed": 0.5}, np.arange(17) / 10, np.arange(17) / 20, 0.5),
        ({"speed": 3}, np.arange(3) / 10, 0.3 * np.arange(3), 3),
        ({"reverse": True}, np.arange(9) / 10, 0.8 - np.arange(9) / 10, -1),
        ({"start": 0.2, "end": 0.5}, [0.2, 0.3, 0.4, 0.5], [0.2, 0.3, 0.4, 0.5], 1),
        ({"start": 0.15, "end": 0.45}, [0.15, 0.25, 0.35, 0.45], [0.15, 0.25, 0.35, 0.45], 1),
        ({"start": 0.12, "end": 0.18}, [0.12], [0.12], 1),
        ({"start": 0.6, "speed": 0.5, "reverse": True}, 0.6 + np.arange(5) / 10, 0.8 - np.arange(5) / 20, -0.5),
        ({"start": 0.3, "end": 0.3, "speed": 2}, [0.3], [0.3], 2),
        ({"retiming": Retiming.hold(0.33, 1, 1.2)}, [1, 1.1, 1.2], [0.33] * 3, 0),
        ({"retiming": Retiming.through([-0.1, 0.3], [0, 0.8])}, [-0.1, 0, 0.1, 0.2, 0.3], 0.2 * np.arange(5), 2),
    ],
    ids=lambda value: ", ".join(value) if isinstance(value, dict) else "",
)
def test_frames_and_velocities(
    model: Model, settings: dict[str, Any], times: ArrayLike, sources: ArrayLike, slope: float
) -> None:
    plain, moving = resample(model, **settings), resample(model, velocities=True, **settings)
    assert plain.velocities is None
    assert moving.velocities is not None
    assert plain.fps == settings.get("fps", 10)
    for sequence in (plain, moving):
        assert sequence.times == pytest.approx(np.asarray(times), abs=1e-14)
        np.testing.assert_allclose(sequence.points, place(sources), atol=1e-12)
    np.testing.assert_allclose(moving.velocities, slope * speed_at(sources), atol=1e-6)


def test_velocities_are_per_second_of_the_output(model: Model) -> None:
    retiming = Retiming.through([0, 0.5, 1], [0.1, 0.8, 0.2])
    planned = plan(model, fps=40, retiming=retiming)
    times, step = planned.header.times[1:-1], 1e-5
    differences = (place(retiming(times + step)) - place(retiming(times - step))) / (2 * step)
    velocities = np.concatenate([rates for _, rates in planned.moving_blocks(size=7)])
    np.testing.assert_allclose(velocities[1:-1], differences, atol=1e-4)
    assert planned.slopes[:2].min() > 0 > planned.slopes[-2:].max()


def test_frames_start_at_the_first_pose() -> None:
    model = model_at([0.03, 0.1, 0.26, 0.37])
    planned = plan(model)
    assert planned.header.times == pytest.approx([0.03, 0.13, 0.23, 0.33])
    assert (planned.retiming.start, planned.retiming.end) == (0.03, 0.37)
    assert plan(model, reverse=True).sources == pytest.approx([0.37, 0.27, 0.17, 0.07])
    assert plan(model_at(3 + np.arange(5) / 10)).header.times == pytest.approx([3, 3.1, 3.2, 3.3, 3.4])
    assert plan(model_at(np.arange(5) / 10 - 1)).header.times == pytest.approx([-1, -0.9, -0.8, -0.7, -0.6])


@pytest.mark.parametrize(("fps", "frame_count", "last"), [(60, 53, 1 + 52 * 0.4), (23.976, 22, 22), (25, 22, 21.16)])
def test_the_first_pose_and_the_last_that_fits_are_kept(fps: float, frame_count: int, last: float) -> None:
    """Frames 1 to 22 at 24 Hz: at 24000/1001 Hz, the last frame is .021 frames after the end, whose pose it shows."""
    model = model_at(np.arange(1, 23) / 24, 24)
    planned = plan(model, fps)
    assert planned.header.frame_count == frame_count
    assert planned.sources[[0, -1]] * 24 == pytest.approx([1, last])
    assert np.diff(planned.header.times) == pytest.approx(1 / planned.header.fps)


def test_the_ends_are_held(model: Model) -> None:
    planned = plan(model, start=-0.2, end=1.0, hold=True)
    assert planned.header.times == pytest.approx(np.arange(-2, 11) / 10)
    assert planned.sources == pytest.approx(np.clip(np.arange(-2, 11) / 10, 0, 0.8))
    assert planned.slopes.tolist() == [0, 0, *[1] * 9, 0, 0]
    late = plan(model, retiming=Retiming.through([0, 1], [0.5, 1.5], smooth=False), hold=True)
    assert late.sources == pytest.approx(np.minimum(0.5 + np.arange(11) / 10, 0.8))
    held = resample(model, end=1.0, hold=True)
    np.testing.assert_allclose(held.points[-3:], place([0.8] * 3), atol=1e-12)
    with pytest.raises(SettingsError, match=r"time 0.9 s is outside the sequence, .* hold \(--hold\)"):
        plan(model, retiming=Retiming.through([0, 1], [0.5, 1.5], smooth=False))


def test_samples_of_a_shutter() -> None:
    model = model_at(np.arange(9) / 10)
    for angle, count, offsets in ((180, 3, [-0.25, 0, 0.25]), (90, 2, [-0.125, 0, 0.125]), (360, 3, [-0.5, 0, 0.5])):
        frames = np.arange(2, 5)
        numbers = np.unique((frames[:, None] + offsets).reshape(-1))
        got = resample(model, start=0.2, end=0.4, shutter=angle, shutter_samples=count, velocities=True)
        assert got.times * 10 == pytest.approx(numbers)  # also before the start and after the end of the section
        np.testing.assert_allclose(got.points, place(numbers / 10), atol=1e-12)
        assert got.velocities is not None
        np.testing.assert_allclose(got.velocities, speed_at(numbers / 10), atol=1e-6)
    whole = plan(model, shutter=(180, 3))
    assert whole.sources[[0, 1, -1]] == pytest.approx([0, 0.025, 0.8])  # nothing is extrapolated
    held = plan(model, shutter=(180, 3), hold=True)
    assert held.header.times[[0, -1]] == pytest.approx([-0.025, 0.825])
    slow = plan(model, speed=0.5, shutter=(180, 3))
    assert slow.sources[:4] == pytest.approx([0, 0.0125, 0.0375, 0.05])
    curve = plan(model, retiming=Retiming.through([0, 0.2], [0.1, 0.5]), shutter=(180, 3))
    assert curve.header.times == pytest.approx(np.array([0, 0.25, 0.75, 1, 1.25, 1.75, 2]) / 10)
    for shutter in ((0, 3), (361, 3), (180, 1), (180, 65)):
        with pytest.raises(SettingsError, match="up to 360 degrees and 2 to 64 samples are expected"):
            plan(model, shutter=shutter)


@pytest.mark.parametrize(("fps", "exact"), [(25, 25.0), (23.976, 24000 / 1001), (Fraction(24000, 1001), 24000 / 1001)])
def test_frames_are_conformed(fps: float, exact: float) -> None:
    numbers = np.array([1001, 1002, 1002.5, 1004])
    header = MeshSequence.from_arrays(place(numbers / 1000), [[0, 1, 2]], numbers / 24, 24).header
    sequence = MeshSequence.from_header(header, place(numbers / 1000), place(numbers))
    got = resample(sequence, conform=fps)
    assert got.fps == exact
    assert got.times * exact == pytest.approx(numbers, abs=1e-9)
    np.testing.assert_array_equal(got.points, sequence.points)
    assert got.velocities is not None
    np.testing.assert_allclose(got.velocities, place(numbers) * exact / 24)
    model = model_at(np.arange(9) / 10)
    np.testing.assert_array_equal(resample(model, conform=5).points, model.sample().points)
    assert resample(model, conform=5).times == pytest.approx(np.arange(9) / 5)
    with pytest.raises(SettingsError, match="conform keeps all frames"):
        resample(sequence, conform=fps, speed=2)
    with pytest.raises(SettingsError, match="conform is -1"):
        resample(sequence, conform=-1)


@pytest.mark.parametrize("fps", [24, 23.976, 30, 30000 / 1001, 59.94])
def test_no_frame_is_lost_to_rounding(fps: float) -> None:
    times = np.arange(50) / fps
    typed = np.array([float(f"{time:.5f}") for time in times])
    late = (2_000_000 + np.arange(50)) / fps
    assert plan(model_at(times, fps)).header.frame_count == plan(model_at(late, fps)).header.frame_count == 50
    planned = plan(model_at(typed, fps))
    assert planned.header.frame_count == 50
    np.testing.assert_allclose(planned.sources, times, atol=1e-5)


def test_its_own_frames_stay_as_they_are(model: Model) -> None:
    assert np.array_equal(resample(model).points, model.sample().points)


def test_a_model_in_the_mixed_space() -> None:
    model = fit(bar(sides=5, rings=9, frames=4), exact=True)
    slow = resample(model, speed=0.5, reverse=True)
    expected = np.stack([model(time) for time in 0.3 - np.arange(7) / 20])
    np.testing.assert_allclose(slow.points, expected, atol=1e-9)


def test_resampling_keeps_the_mesh() -> None:
    bent = bar(sides=5, rings=9, frames=4)
    header = SequenceHeader(
        polygons=bent.polygons,
        vertex_count=bent.vertex_count,
        times=bent.times,
        up_axis="Z",
        metres_per_unit=0.01,
        name="bent",
    )
    model = fit(MeshSequence.from_header(header, bent.points), exact=True, space="vertex")
    output = resample(model, fps=7)
    assert (output.up_axis, output.metres_per_unit, output.name, output.fps) == ("Z", 0.01, "bent", 7)
    assert output.polygons.same_as(bent.polygons)


def test_motion_of_vertices_alone() -> None:
    bent = bar(sides=5, rings=15, frames=5)
    expected = resample(fit(bent, exact=True, space="vertex"), fps=30).points
    assert np.abs(resample(bent, fps=30).points - expected).max() > 1e-3
    for source in (bent, fit(bent, exact=True)):
        np.testing.assert_allclose(resample(source, fps=30, between="vertices").points, expected, atol=1e-9)
    small = CompressedModel.from_sequence(compress(bent, max_error=1e-3))
    played = resample(small, fps=30, between="vertices", velocities=True)
    np.testing.assert_array_equal(played.points, small.playback.sample(played.times).points)
    assert small.__dict__["_fitted"] is None
    with pytest.raises(SettingsError, match="between='vertices' is the vertex space; leave it out, or space='edge'"):
        fit(bent, space="edge", between="vertices")
    with pytest.raises(SettingsError, match="between and cuts are for frames"):
        resample(small, between="hold")


def test_frames_are_decoded_on_demand(model: Model) -> None:
    told: list[tuple[int, int]] = []
    planned = plan(model, fps=50)
    blocks = planned.blocks(16, lambda done, total, what: told.append((done, total)))
    assert told == []
    assert len(next(blocks)) == 16
    assert [len(block) for block in blocks] == [16, 9]
    assert told == [(16, 41), (32, 41), (41, 41)]
    assert [len(points) for points, _ in planned.moving_blocks(20)] == [20, 20, 1]


def test_a_model_may_last_longer_than_its_frames(model: Model) -> None:
    longer = Curve(np.linspace(-0.2, 1.1, 14), model.time(np.linspace(0, 0.8, 14)))
    placement = Curve(longer.times, np.zeros((14, model.placement.dim)))
    wide = Model(model.header, model.space, longer, model.pose, model.shapes, placement)
    assert plan(wide).header.times[[0, -1]] == pytest.approx([0, 0.8])
    assert plan(wide, start=-0.2, end=1.1).header.frame_count == 14


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"fps": 0}, "fps is 0"),
        ({"fps": -1}, "fps is -1"),
        ({"fps": np.nan}, "fps is nan"),
        ({"speed": 0}, "speed is 0; a positive number"),
        ({"speed": -1}, "speed is -1"),
        (
            {"start": -0.5},
            r"time -0.5 s is outside the sequence, 0 to 0.8 s \(frames 0 to 8\); motions are not extrapolated",
        ),
        ({"end": 0.9}, "time 0.9 s is outside the sequence, 0 to 0.8 s"),
        ({"end": np.nan}, "time nan s is outside"),
        ({"start": 0.5, "end": 0.4}, "no time between the start, 0.5 s, and the end, 0.4 s"),
        ({"speed": 1e-9}, f"8e.* frames, more than {MAX_FRAME_COUNT:,}; give fewer fps or more speed"),
        ({"fps": 1e300}, "more than"),
        (
            {"retiming": Retiming.through([0, 1], [0.2, 1])},
            "the retiming goes beyond the source: time 0.84 s is outside the sequence, 0 to 0.8 s",
        ),
        ({"retiming": Retiming.hold(-1, 0, 1)}, "goes beyond the source: time -1 s is outside"),
        ({"retiming": Retiming.hold(0, 0, 1), "speed": 2}, "leave out start, end, speed and reverse"),
        ({"retiming": Retiming.hold(0, 0, 1), "reverse": True}, "leave out start, end, speed and reverse"),
        ({"retiming": Retiming.hold(0, 0, 1), "start": 0}, "leave out start, end, speed and reverse"),
        ({"retiming": Retiming.hold(0, 0, 1), "end": 0}, "leave out start, end, speed and reverse"),
    ],
    ids=lambda value: ", ".join(value) if isinstance(value, dict) else "",
)
def test_refusals(model: Model, settings: dict[str, Any], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        resample(model, **settings)
