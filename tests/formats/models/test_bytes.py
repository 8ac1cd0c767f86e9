"""Models in HDF5 take fewer bytes than the frames that they are of."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mixseq
from tests.meshes import bar, coarse_walk


@pytest.mark.parametrize(("settings", "most"), [({}, 0.5), ({"exact": True}, 1.3)], ids=str)
def test_models_take_few_bytes(settings: dict[str, Any], most: float, tmp_path: Path) -> None:
    """Beside coordinates in single precision."""
    walk = coarse_walk(frames=24)
    mixseq.save(tmp_path / "walk.h5", mixseq.fit(walk, **settings))
    assert (tmp_path / "walk.h5").stat().st_size < most * 4 * walk.points.size


@pytest.mark.realdata
@pytest.mark.exhaustive
@pytest.mark.parametrize("name", ["cat_poses", "lion_poses", "q_wolf_gallop"])
@pytest.mark.parametrize(("settings", "most"), [({}, 1.0), ({"exact": True}, 2.0)], ids=str)
def test_models_of_real_animations_take_few_bytes(
    name: str, settings: dict[str, Any], most: float, tmp_path: Path, data: Path
) -> None:
    sequence = mixseq.read(data / "npz" / f"{name}.npz")
    mixseq.save(tmp_path / "model.h5", mixseq.fit(sequence, **settings))
    assert (tmp_path / "model.h5").stat().st_size < most * 4 * sequence.points.size


def test_signals_are_rounded_to_a_step_far_below_the_tolerance() -> None:
    model = mixseq.fit(bar(), tolerance=1e-3, parts=2)
    for values in (model.shapes, model.placement.values, model.correction.values):
        np.testing.assert_array_equal(values, np.round(values * 2**20) / 2**20)
    exact = mixseq.fit(bar(), exact=True, parts=2)
    for values in (exact.shapes, exact.placement.values):
        np.testing.assert_array_equal(values, np.round(values * 2**38) / 2**38)
    np.testing.assert_array_equal(exact.correction(exact.times), 0.0)


def test_scores_are_rounded_to_steps_times_their_size() -> None:
    """Modes that hardly count change angles by as much as others."""
    time = mixseq.fit(bar(), exact=True, parts=2).time
    sizes = 2.0 ** np.floor(np.log2(np.abs(time.values[::2]).max(axis=0)))
    assert sizes.min() < 0.1 * sizes.max()
    np.testing.assert_array_equal(time.values, np.round(time.values / sizes * 2**38) / 2**38 * sizes)
