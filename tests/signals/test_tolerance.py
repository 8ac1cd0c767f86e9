"""A tolerance is a promise; rank and knots do what they say."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mixseq
from mixseq.choices import SPACES, SpaceName
from mixseq.errors import ReconstructionError, SettingsError
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals import detail
from mixseq.signals.curve import Curve
from mixseq.signals.detail import EXACT_TOLERANCE, VISUALLY_LOSSLESS_TOLERANCE, verify_tolerance
from mixseq.signals.fitting import fit
from mixseq.signals.model import Model
from mixseq.signals.pose import PoseMap
from mixseq.spaces.temporal import insert_midpoints
from tests.meshes import SEQUENCES, bar, rotation, tetrahedron

pytestmark = pytest.mark.slow

LONG = bar(sides=5, rings=13, frames=30)


@cache
def exact_model() -> Model:
    return fit(LONG, exact=True)


@pytest.mark.parametrize("space", ["mixed", "vertex"])
@pytest.mark.parametrize("bound", [1e-1, 1e-2, 1e-4])
def test_the_promise_is_kept(space: str, bound: float) -> None:
    model = fit(LONG, tolerance=bound, space=space)  # type: ignore[arg-type]
    assert mixseq.compare(LONG, model.sample()).max_error <= bound
    assert len(model.shapes) < 30
    assert len(model.time.times) < 30


@pytest.mark.parametrize("space", SPACES)
def test_the_promise_is_kept_of_far_more_frames_than_coordinates(space: SpaceName) -> None:
    mesh = tetrahedron()
    turns = np.random.default_rng(0).standard_normal((3, 3))
    waves = np.sin(np.arange(100)[:, None] / [17, 11, 7])
    moved = np.stack([mesh[0] @ rotation(wave @ turns).T for wave in waves])
    moved += 0.1 * np.sin(np.arange(100)[:, None, None] / 5 + np.arange(12).reshape(4, 3))
    many = MeshSequence.from_arrays(moved, mesh[1], fps=24)
    if space in ("mixed", "vertex"):  # the search for a tolerance is the same in all spaces
        assert mixseq.compare(many, fit(many, tolerance=1e-3, space=space).sample()).max_error <= 1e-3
    exact = fit(many, exact=True, space=space)
    assert len(exact.shapes) <= exact.space.shape_dim + 1 < 100
    assert mixseq.compare(many, exact.sample()).max_error < 1e-10


def test_without_settings_models_are_lossless_to_the_eye() -> None:
    model = fit(LONG)
    assert 1e-6 < mixseq.compare(LONG, model.sample()).max_error <= 5e-4


def test_no_model_is_decoded_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three frames have so few models that the search comes back to them."""
    tried: list[Model] = []

    def largest_error(model: Model, *others: Any) -> float:
        tried.append(model)
        return found(model, *others)

    found = detail.largest_error
    monkeypatch.setattr(detail, "largest_error", largest_error)
    short = bar(sides=5, rings=13, frames=3)
    model = fit(short)
    assert mixseq.compare(short, model.sample()).max_error <= 5e-4
    values = [(each.time.values.tobytes(), each.placement.values.tobytes()) for each in tried]
    assert len(set(values)) == len(values) < 4


@pytest.mark.parametrize("name", SEQUENCES)
def test_the_promise_is_kept_on_awkward_meshes(name: str) -> None:
    sequence = SEQUENCES[name]()
    assert mixseq.compare(sequence, fit(sequence, tolerance=1e-3).sample()).max_error <= 1e-3


@pytest.mark.realdata
@pytest.mark.parametrize("name", ["q_wolf_gallop", pytest.param("robotexpressive_dance", marks=pytest.mark.exhaustive)])
def test_the_promise_is_kept_on_real_data(data: Path, name: str) -> None:
    sequence = mixseq.read(data / "npz" / f"{name}.npz")
    assert mixseq.compare(sequence, fit(sequence, tolerance=1e-3).sample()).max_error <= 1e-3


def test_rank_truncates_shapes_but_not_placement() -> None:
    errors = []
    for rank in (0, 2, 29):
        model = fit(LONG, rank=rank)
        assert len(model.shapes) == rank + 1
        for curve in (model.placement, model.correction):
            np.testing.assert_array_equal(curve.times, insert_midpoints(insert_midpoints(LONG.times)))
        errors.append(mixseq.compare(LONG, model.sample()).kg_percent)
    assert errors == sorted(errors, reverse=True)
    assert errors[0] > 0.1
    assert errors[-1] < 1e-10
    assert len(fit(LONG, rank=1000, space="vertex").shapes) <= 30


def test_exact_models_are_exact() -> None:
    assert mixseq.compare(LONG, exact_model().sample()).max_error < 1e-10


def test_knots_by_number_and_by_time() -> None:
    model = fit(LONG, knots=3, space="vertex")
    inner = model.time.times[2:-2]
    assert len(inner) == 3
    np.testing.assert_allclose(inner, np.interp([7.25, 14.5, 21.75], np.arange(30), LONG.times))
    chosen = LONG.times[[5, 9, 20]]
    np.testing.assert_array_equal(fit(LONG, knots=chosen).placement.times[2:-2], chosen)
    assert mixseq.compare(LONG, fit(LONG, knots=26, space="vertex").sample()).max_error < 1e-12


@pytest.mark.parametrize(
    ("knots", "message"),
    [
        (-1, "knots is -1"),
        (27, "30 frames allow 0 to 26"),
        ([-1.0, 0.5], "must be between 0 and 2.9"),
        (np.linspace(0.1, 2.8, 27), "30 frames allow 26"),
        ([0.51, 0.52, 0.53, 0.54, 0.55, 0.56], "no frames between the knots near"),
    ],
)
def test_knots_that_frames_cannot_tell_of_are_refused(knots: object, message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        fit(LONG, knots=knots, space="vertex")  # type: ignore[arg-type]


def test_signals_must_fit_together() -> None:
    model = fit(LONG, rank=2, space="vertex")
    parts: dict[str, Any] = {
        "header": model.header,
        "space": model.space,
        "time": model.time,
        "pose": model.pose,
        "shapes": model.shapes,
        "placement": model.placement,
    }
    wrong = {
        "shapes": (model.shapes[:2], "key shapes have shape"),
        "pose": (PoseMap.from_key_count(4), "key shapes have shape"),
        "time": (Curve(model.time.times, model.time.values[:, :1]), "time signal has 1 coordinates; 2 are"),
        "placement": (Curve(model.time.times, model.time.values), "placement signal has 2 coordinates; 0 are"),
        "correction": (Curve(model.time.times, model.time.values), "correction signal has 2 coordinates; 0 are"),
        "header": (model.header.with_times([0.0, 99.0]), "frames are from 0 to 99 s, the time signal only"),
    }
    for name, (value, message) in wrong.items():
        with pytest.raises(SettingsError, match=message):
            Model(**{**parts, name: value})


def test_vertex_models_have_no_parts() -> None:
    with pytest.raises(SettingsError, match="the vertex space has no parts"):
        _ = fit(LONG, rank=2, space="vertex").decomposition


@pytest.mark.parametrize("settings", [{"exact": True}, {"tolerance": 1e-9}, {"tolerance": 1e-9, "space": "vertex"}])
def test_what_doubles_have_no_digits_for_is_refused(settings: dict[str, Any]) -> None:
    far = MeshSequence.from_arrays(LONG.points[:4] + 1e9, LONG.polygons)
    message = r"off by .* diagonals, more than 1e-0.: coordinates are up to .* move the sequence to the origin"
    with pytest.raises(SettingsError, match=message):
        fit(far, **settings)
    assert mixseq.compare(far, fit(far, tolerance=1e-3).sample()).max_error <= 1e-3


def test_growth_that_leaves_too_few_digits_is_refused() -> None:
    growing = LONG.points * np.geomspace(1e-6, 1e6, 30)[:, None, None]
    with pytest.raises(SettingsError, match=r"more than 0\.0001: vertices move up to \S+e\+11 diagonals") as error:
        fit(LONG.with_points(growing), tolerance=1e-4, space="vertex")
    assert str(error.value).startswith(repr(LONG.header.name))
    assert "origin" not in str(error.value)


def test_a_model_that_is_off_is_never_returned() -> None:
    model = fit(LONG, rank=1, space="vertex")
    with pytest.raises(
        ReconstructionError, match="more than 1e-08; give a larger tolerance, or another space or placement"
    ):
        verify_tolerance(model, LONG, EXACT_TOLERANCE)
    assert verify_tolerance(model, LONG, 1.0) is model


def test_one_frame() -> None:
    still = MeshSequence.from_arrays(LONG.points[:1], LONG.polygons)
    for space in ("mixed", "vertex"):
        model = fit(still, space=space, exact=True)
        np.testing.assert_allclose(model.sample().points, still.points, atol=1e-9)
        assert mixseq.compare(still, fit(still, space=space).sample()).max_error <= VISUALLY_LOSSLESS_TOLERANCE
