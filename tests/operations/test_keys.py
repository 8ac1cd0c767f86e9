"""Exchanging key shapes."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from mixseq.errors import InvalidSequenceError, SettingsError
from mixseq.operations import swap_key
from mixseq.sequence import MeshSequence
from mixseq.signals import Model, fit
from tests.meshes import bar, rotation

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


def test_where_a_key_stands_does_not_matter() -> None:
    moved: NDArray[np.float64] = SEQUENCE.points[2] @ rotation((0.3, -1.0, 0.5)).T + [5.0, 6, 7]
    np.testing.assert_allclose(swap_key(keyed("mixed"), 2, moved).sample().points, SEQUENCE.points, atol=1e-8)


def test_a_new_key_shows_in_its_frame_and_no_other() -> None:
    x = np.array(SEQUENCE.points[4])
    x[3] += [0.1, 0.0, 0.0]
    swapped = swap_key(keyed("vertex"), 4, x).sample().points
    np.testing.assert_allclose(swapped[4], x, atol=1e-12)
    np.testing.assert_allclose(
        np.delete(swapped, 4, axis=0), np.delete(SEQUENCE.points, 4, axis=0), atol=1e-12
    )


@pytest.mark.parametrize("key", [-1, 6])
def test_unknown_keys_are_refused(key: int) -> None:
    with pytest.raises(SettingsError, match=f"key is {key}; the model has key shapes 0 to 5"):
        swap_key(keyed("vertex"), key, SEQUENCE.points[0])


@pytest.mark.parametrize("points", [np.zeros((4, 3)), np.full((67, 3), np.nan)])
def test_other_meshes_are_refused(points: NDArray[np.float64]) -> None:
    with pytest.raises(InvalidSequenceError, match="new key shape"):
        swap_key(keyed("vertex"), 0, points)
