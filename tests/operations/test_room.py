"""Edits of compressed sequences: their space grows by what the edit needs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import mixseq
from mixseq.coding.decode import to_model
from mixseq.creature import walk_cycle
from mixseq.errors import InvalidSequenceError
from mixseq.operations import cut, reverse, shift
from mixseq.operations.room import with_room
from mixseq.operations.sculpt import sculpt
from mixseq.signals.model import Model
from mixseq.spaces.basis import BasisSpace


@pytest.fixture(scope="module")
def model() -> Model:
    found = to_model(mixseq.compress(walk_cycle(frames=8), max_error=1e-2))
    assert isinstance(found.space, BasisSpace)
    return found


def test_room_changes_nothing_but_the_space(model: Model) -> None:
    time = float(model.times[3])
    edited = model(time)
    edited[5] += (0.3, -0.2, 0.1)
    roomy = with_room(model, time, edited)
    assert roomy.space.dim == model.space.dim + 9
    for t in (model.times[0], 0.5 * (model.times[2] + model.times[3])):
        np.testing.assert_allclose(roomy(t), model(t), atol=1e-12 * model.space.scale)


def test_displacement_along_one_axis_takes_one_field(model: Model) -> None:
    edited = model(model.times[3])
    edited[5, 1] += 0.3
    assert with_room(model, model.times[3], edited).space.dim == model.space.dim + 3


def test_sculpted_vertex_is_where_it_was_put(model: Model) -> None:
    time = float(model.times[3])
    edited = model(time)
    edited[5] += (0.3, -0.2, 0.1)
    sculpted = sculpt(model, time, edited)
    np.testing.assert_allclose(sculpted(time), edited, atol=1e-9)
    moved = sculpted(model.times[6]) - model(model.times[6])
    np.testing.assert_allclose(moved[5], (0.3, -0.2, 0.1), atol=1e-9)
    np.testing.assert_allclose(np.delete(moved, 5, axis=0), 0, atol=1e-9)


def test_other_spaces_have_room() -> None:
    fitted = mixseq.fit(walk_cycle(frames=4), space="vertex")
    assert with_room(fitted, 0.0, fitted(0.0)) is fitted


def test_points_of_another_mesh_are_refused(model: Model) -> None:
    with pytest.raises(InvalidSequenceError, match="shape"):
        with_room(model, 0.0, np.zeros((3, 3)))


def test_corrections_stay_with_their_times(model: Model) -> None:
    """Where an edit changes times, corrections are left out: at other times they would do harm."""
    times, signals = model.times, replace(model, corrections=None)
    for edited, original in (
        (reverse(model), times[::-1]),
        (shift(model, 0.25), times),
        (cut(model, times[2], times[-1]), times[2:]),
    ):
        for mine, other in zip(edited.times, original, strict=True):
            np.testing.assert_allclose(edited(mine), signals(other), atol=1e-9)
    assert model.corrections is not None
