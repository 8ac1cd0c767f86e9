"""Sketches: through the place of a frame it is that frame, and weights are sane everywhere."""

from __future__ import annotations

import warnings
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mixseq
from mixseq.errors import MixseqWarning, SettingsError
from mixseq.operations.sketch import cardinal_weights, sketch
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.fitting import fit
from mixseq.signals.model import Model
from mixseq.types import Float
from tests.meshes import bent, rotation, seeds, tube

KINDS = ["anchored", "free", "vertex"]


@cache
def model_of(kind: str = "anchored", frames: int = 12) -> Model:
    """A bar that bends back and forth while it swells and shrinks: a loop in the embedding."""
    points, faces = tube(6, 21)
    shapes = []
    for phase in np.linspace(0, 2 * np.pi, frames, endpoint=False):
        swollen = points * (1 + 0.15 * np.cos(phase) * np.sin(points[:, 2:]) * [1, 1, 0])
        shapes.append(bent(swollen, 0.6 + 0.5 * np.sin(phase)) @ rotation((0.0, 0.2 * phase, 0.1)).T + [0, 0, phase])
    sequence = MeshSequence.from_arrays(np.stack(shapes), faces, fps=10, name="swelling bar")
    if kind == "vertex":
        return fit(sequence, exact=True, space="vertex")
    return fit(sequence, exact=True, placement="free" if kind == "free" else "anchored", parts=2)


@pytest.mark.parametrize("kind", KINDS)
def test_sketch_through_a_frame_gives_that_frame(kind: str) -> None:
    model = model_of(kind)
    frames = [3, 7, 8, 1]
    places = model.embedding(model.times[frames])
    sketched = sketch(model, places, 1.5)
    lengths = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1)))
    for frame, time in zip(frames, 1.5 * lengths / lengths[-1], strict=True):
        np.testing.assert_allclose(sketched(time), model(model.times[frame]), atol=1e-9)


def test_sketch_along_the_layout_approximates_the_motion() -> None:
    model = model_of()
    dense = np.linspace(model.start, model.end, 101)
    places = model.embedding(dense)
    sketched = sketch(model, places, 2.0)
    lengths = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1)))
    apart = sketched.time(2.0 * lengths / lengths[-1]) - model.time(dense)
    size = np.linalg.norm(model.time(model.times), axis=1).max()
    assert np.linalg.norm(apart, axis=1).max() < 0.05 * size


def test_the_layout_of_a_sketch_is_the_curve() -> None:
    """Weights reproduce constants, and cardinal interpolation of places nearly the places."""
    model = model_of()
    angle = np.linspace(0.3, 3.0, 9)
    centre, size = model.embedding(model.times).mean(axis=0), np.ptp(model.embedding(model.times), axis=0)
    curve = centre + 0.3 * size * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    sketched = sketch(model, curve, 1.0)
    drawn = sketched.embedding(np.linspace(0, 1, 9), model.plane)
    assert np.abs(drawn[[0, -1]] - curve[[0, -1]]).max() < 0.05 * size.max()


def test_one_point_is_a_pose_that_is_held() -> None:
    model = model_of()
    sketched = sketch(model, model.embedding(model.times[[4]]), 0.5)
    assert sketched.times.tolist() == [0.0, 0.1, 0.2, 0.3, 0.4, 0.5]
    for time in (0.0, 0.22, 0.5):
        np.testing.assert_allclose(sketched(time), model(model.times[4]), atol=1e-9)


def test_points_that_are_drawn_twice_are_one() -> None:
    model = model_of()
    places = model.embedding(model.times[:5])
    once, twice = sketch(model, places, 1.0), sketch(model, np.repeat(places, 2, axis=0), 1.0)
    np.testing.assert_array_equal(once.time.values, twice.time.values)


def test_frames_are_at_the_rate_of_the_model() -> None:
    sketched = sketch(model_of(), model_of().embedding(model_of().times), 0.95)
    np.testing.assert_allclose(sketched.times, np.arange(10) / 10)
    assert (sketched.start, sketched.end) == (0.0, 0.95)


def test_a_still_sequence_is_still() -> None:
    model = model_of()
    points = np.repeat(model(0.0)[None], 3, axis=0)
    still = fit(MeshSequence.from_arrays(points, model.header.polygons, fps=10), exact=True)
    sketched = sketch(still, [[0.0, 0.0], [1.0, 0.0]], 1.0)
    np.testing.assert_allclose(sketched(0.7), points[0], atol=1e-9)


def test_a_cycle_that_is_stored_twice_needs_no_warning() -> None:
    model = model_of()
    points = np.concatenate([model.sample().points] * 2)
    twice = fit(MeshSequence.from_arrays(points, model.header.polygons, fps=10), exact=True, parts=2)
    sketched = sketch(twice, twice.embedding(twice.times[:5]), 1.0)
    np.testing.assert_allclose(sketched(0.0), points[0], atol=1e-9)


def test_ambiguous_positions_cause_a_warning() -> None:
    """The same shapes elsewhere: the embedding shows shapes only."""
    model = model_of()
    points = np.concatenate([model.sample().points, model.sample().points + 5.0])
    twice = fit(MeshSequence.from_arrays(points, model.header.polygons, fps=10), exact=True, parts=2)
    with pytest.warns(MixseqWarning, match="12 frames share their position in the embedding with an earlier frame"):
        sketched = sketch(twice, twice.embedding(twice.times[:5]), 1.0)
    np.testing.assert_allclose(sketched(0.0), points[0], atol=1e-9)


def test_distant_curves_cause_a_warning() -> None:
    model = model_of()
    places = model.embedding(model.times)
    size = np.linalg.norm(np.ptp(places, axis=0))
    near, far = (np.array([places[0], places[0] + [0.0, reach * size]]) for reach in (0.4, 3.0))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sketch(model, near, 1.0)
    with pytest.warns(MixseqWarning, match="the drawn curve goes to .*, far from all frames"):
        sketch(model, far, 1.0)


@pytest.mark.parametrize(
    ("curve", "duration", "message"),
    [
        ([[0.0, 0.0, 0.0]], 1.0, r"the drawn curve has shape \(1, 3\); \(N, 2\) is expected"),
        (np.zeros((0, 2)), 1.0, r"has shape \(0, 2\)"),
        ([[0.0, 0.0], [np.nan, 0.0]], 1.0, "point 1 of the drawn curve is not finite"),
        ([[0.0, 0.0]], 0.0, "duration is 0.0; a positive number of seconds"),
        ([[0.0, 0.0]], np.inf, "duration is inf"),
    ],
)
def test_invalid_curves_are_refused(curve: Float, duration: float, message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        sketch(model_of(), curve, duration)


@pytest.mark.realdata
def test_a_gallop_drawn_through_its_frames(data: Path) -> None:
    """Between the frames it is nearer to the motion than frames blended two by two."""
    gallop = mixseq.read(data / "npz" / "fox_run.npz")
    model = fit(gallop, exact=True)
    places = model.embedding(model.times)
    sketched = sketch(model, places, model.end)
    lengths = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1)))
    arrival = model.end * lengths / lengths[-1]
    middle = (model.times[1:] + model.times[:-1]) / 2
    motion = model.sample(middle).points
    drawn = sketched.sample((arrival[1:] + arrival[:-1]) / 2).points
    straight = (gallop.points[1:] + gallop.points[:-1]) / 2
    assert np.linalg.norm(drawn - motion) < 0.7 * np.linalg.norm(straight - motion)


# Weights --------------------------------------------------------------------------------------------------


@given(seeds, st.integers(1, 40), st.sampled_from(["cloud", "line", "grid", "close pairs"]))
@settings(max_examples=60, deadline=None)
def test_weights_are_cardinal_and_add_up_to_one(seed: int, count: int, kind: str) -> None:
    rng = np.random.default_rng(seed)
    places = 10.0 ** rng.uniform(-4, 4) * rng.normal(size=(count, 2))
    if kind == "line":
        places[:, 1] = 3.0
    elif kind == "grid":
        places = np.stack(np.divmod(np.arange(count), 6), axis=1).astype(float)
    elif kind == "close pairs":
        places = np.concatenate([places, places + 1e-4 * np.ptp(places) * rng.normal(size=(count, 2)) + 1e-9])
    weights = cardinal_weights(places)
    np.testing.assert_allclose(weights(places), np.eye(len(places)), atol=1e-8)
    anywhere = places.mean(axis=0) + 3.0 * np.ptp(places) * rng.normal(size=(20, 2))
    np.testing.assert_allclose(weights(anywhere).sum(axis=1), 1.0, atol=1e-8)


def test_weights_of_two_places_run_from_one_to_the_other() -> None:
    weights = cardinal_weights(np.array([[0.0, 0.0], [1.0, 0.0]]))
    along = weights(np.stack([np.linspace(0, 1, 11), np.zeros(11)], axis=1))
    assert (np.diff(along[:, 1]) > 0).all()
    np.testing.assert_allclose(along[:, 0], along[::-1, 1], atol=1e-12)
    np.testing.assert_allclose(weights(np.array([[0.5, 9.0]])), 0.5)


def test_weights_are_bounded_far_away() -> None:
    angle = np.arange(20) * 2 * np.pi / 20
    weights = cardinal_weights(np.stack([np.cos(angle), 0.5 * np.sin(angle)], axis=1))
    around = np.stack([np.cos(np.linspace(0, 6.3, 50)), np.sin(np.linspace(0, 6.3, 50))], axis=1)
    sizes = [np.abs(weights(reach * around)).sum(axis=1).max() for reach in (2.0, 20.0, 2e5)]
    assert max(sizes) < 6.0
    assert sizes[2] - sizes[1] < 0.2  # they have a limit


def test_weights_have_no_kink_at_a_place() -> None:
    weights = cardinal_weights(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [-1.0, 0.3]]))
    step = 1e-4
    ahead, here, behind = weights(np.array([[step, 0.0], [0.0, 0.0], [-step, 0.0]]))
    assert np.abs(ahead - 2 * here + behind).max() / step < 1e-2
