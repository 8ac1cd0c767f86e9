"""Frames edited by hand: spaces grow by what the edit needs, and key shapes are exchanged."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from mixseq.errors import InvalidSequenceError, SettingsError
from mixseq.operations import swap_key
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.fitting import fit
from mixseq.signals.model import Model
from tests.meshes import bar

pytestmark = pytest.mark.slow


SEQUENCE: MeshSequence = bar(sides=5, rings=15, frames=6)


@cache
def keyed(space: str) -> Model:
    return fit(SEQUENCE, exact=True, pose="keys", space=space)  # type: ignore[arg-type]


@pytest.mark.parametrize("space", ["mixed", "vertex"])
def test_the_same_key_changes_nothing(space: str) -> None:
    model = keyed(space)
    for key in (0, 3, 5):  # all frames are keys
        swapped = swap_key(model, key, SEQUENCE.points[key])
        np.testing.assert_allclose(swapped.sample().points, SEQUENCE.points, atol=1e-9)


def test_vertices_that_were_not_moved_stay() -> None:
    """In a model of few keys too, in the frame of the key; the others follow by their weight."""
    model = fit(SEQUENCE, rank=3, pose="keys")
    assert len(model.key_frames) == 4
    frame = int(model.key_frames[1])
    x = model(float(model.times[frame]))
    bump = 0.2 * np.exp(-20 * np.square(x - x[10]).sum(axis=1))[:, None] * [1.0, 0, 0]
    swapped = swap_key(model, 1, x + bump)
    np.testing.assert_allclose(swapped(float(model.times[frame])), x + bump, atol=1e-6)
    other = int(model.key_frames[3])
    np.testing.assert_allclose(swapped.sample().points[other], model.sample().points[other], atol=1e-9)


def test_keys_that_are_no_frames_are_refused() -> None:
    model = fit(SEQUENCE, rank=2)
    assert (model.key_frames == -1).all()
    with pytest.raises(SettingsError, match="key shape 1 is no frame of the model; fit one with pose='keys'"):
        swap_key(model, 1, SEQUENCE.points[0])


def test_a_new_key_shows_in_its_frame_and_no_other() -> None:
    x = np.array(SEQUENCE.points[4])
    x[3] += [0.1, 0.0, 0.0]
    swapped = swap_key(keyed("vertex"), 4, x).sample().points
    np.testing.assert_allclose(swapped[4], x, atol=1e-12)
    np.testing.assert_allclose(np.delete(swapped, 4, axis=0), np.delete(SEQUENCE.points, 4, axis=0), atol=1e-12)


@pytest.mark.parametrize("key", [-1, 6])
def test_unknown_keys_are_refused(key: int) -> None:
    with pytest.raises(SettingsError, match=f"key is {key}; the model has key shapes 0 to 5"):
        swap_key(keyed("vertex"), key, SEQUENCE.points[0])


@pytest.mark.parametrize("points", [np.zeros((4, 3)), np.full((67, 3), np.nan)])
def test_other_meshes_are_refused(points: NDArray[np.float64]) -> None:
    with pytest.raises(InvalidSequenceError, match="edited points"):
        swap_key(keyed("vertex"), 0, points)
