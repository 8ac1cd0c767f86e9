"""What charts draw of a model."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.fitting import fit
from mixseq.signals.model import Model
from mixseq.viewer.session import FRAMES, HANDLES, POINTS, signals_of


@pytest.fixture(scope="module")
def line() -> MeshSequence:
    """A triangle whose tip moves by 0, 2, 4, 6 fifths of its diagonal, at 2 frames per second from 1 s on."""
    points = np.repeat([[[0, 0, 0], [3, 0, 0], [0, 4, 0.0]]], 4, axis=0)
    points[:, 2, 2] = [0, 2, 4, 6]
    return MeshSequence.from_arrays(points, [[0, 1, 2]], times=np.array([1, 1.5, 2, 2.5]), fps=2)


@pytest.fixture(scope="module")
def still(line: MeshSequence) -> Model:
    return fit(line.with_points(np.repeat(line.points[:1], 4, axis=0)), exact=True, space="vertex")


def test_a_line(line: MeshSequence) -> None:
    signals = signals_of(fit(line, exact=True, space="vertex"))
    assert json.loads(json.dumps(signals)) == signals
    assert (signals["start"], signals["end"]) == (1.0, 2.5)
    path, times = np.array(signals["path"]), np.array(signals["times"])
    assert times[0] == 1.0 and times[-1] == 2.5 and len(times) == len(path)
    speed = 6 / 1.5 / line.diagonal
    np.testing.assert_allclose(np.abs(path[:, 0] - path[0, 0]), speed * (times - 1), atol=1e-4)
    np.testing.assert_allclose(path[:, 1], 0, atol=1e-12)
    assert signals["frameTimes"] == [1, 1.5, 2, 2.5]
    np.testing.assert_allclose(
        np.array(signals["frames"])[:, 0], np.linspace(path[0, 0], path[-1, 0], 4), atol=1e-4
    )


def test_handles_are_on_the_path(line: MeshSequence) -> None:
    model = fit(line, exact=True, space="vertex")
    handles = signals_of(model)["handles"]
    times = [handle["time"] for handle in handles]
    np.testing.assert_allclose(times, np.linspace(1, 2.5, HANDLES))
    np.testing.assert_allclose([handle["at"] for handle in handles], model.embedding(times), atol=1e-5)


def test_coefficients_are_in_diagonals(line: MeshSequence) -> None:
    (only,) = signals_of(fit(line, exact=True, space="vertex"))["coefficients"]
    assert only["name"] == "coordinate 1"
    assert abs(only["values"][-1] - only["values"][0]) == pytest.approx(6 / line.diagonal, rel=1e-4)


def test_the_largest_coefficients(bar_model: Model) -> None:
    coefficients = signals_of(bar_model)["coefficients"]
    numbers = [int(each["name"].removeprefix("coordinate ")) for each in coefficients]
    assert numbers == sorted(numbers) and 1 in numbers and len(numbers) <= 5


def test_keys_leave_all_as_it_is(bar_model: Model) -> None:
    keys = signals_of(bar_model)["keys"]
    assert len(keys) == 5 and all(output == source for output, source in keys)
    assert keys[0][0] == bar_model.start and keys[-1][0] == bar_model.end


def test_a_model_that_does_not_move(still: Model) -> None:
    signals = signals_of(still)
    assert signals["coefficients"] == signals["handles"] == []
    assert not np.any(signals["path"]) and len(signals["keys"]) == 5


def test_a_single_frame(line: MeshSequence) -> None:
    single = MeshSequence.from_arrays(line.points[:1], line.faces, times=line.times[:1], fps=2)
    signals = signals_of(fit(single, exact=True, space="vertex"))
    assert signals["start"] == signals["end"] == 1.0 and signals["times"] == signals["frameTimes"] == [1.0]
    assert signals["path"] == signals["frames"] == [[0, 0]]
    assert signals["handles"] == signals["keys"] == []


def test_long_models_are_thinned(line: MeshSequence) -> None:
    count = 1001
    points = np.repeat(line.points[:1], count, axis=0).astype(np.float64)
    points[:, 2, 2] = np.sin(np.arange(count) / 40)
    long = MeshSequence.from_arrays(points, line.faces, fps=25)
    signals = signals_of(fit(long, knots=20, rank=1, space="vertex"))
    assert len(signals["times"]) == len(signals["path"]) <= POINTS
    assert len(signals["frames"]) == FRAMES and signals["frameTimes"][-1] == 40.0
    assert len(json.dumps(signals)) < 60_000


def test_numbers_are_no_longer_than_a_screen_needs(bar_model: Model) -> None:
    signals = signals_of(replace(bar_model))
    assert max(len(str(abs(value))) for point in signals["path"] for value in point) <= 8
