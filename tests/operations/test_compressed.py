"""Edits of a compressed model are those of an exact model of its decoded frames."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

import mixseq
from mixseq import operations
from mixseq.compression.compressed_model import CompressedModel
from mixseq.operations.script import OPERATIONS
from mixseq.signals.fitting import fit
from mixseq.signals.model import Model
from mixseq.types import Float
from tests.operations.motions import bar_motion

BOUND = 1e-3
"""Bound of the compressed model, in diagonals."""


@cache
def compressed() -> CompressedModel:
    return CompressedModel.from_sequence(mixseq.compress(bar_motion().sample(), max_error=BOUND))


@cache
def decoded() -> Model:
    """An exact model of the decoded frames."""
    return fit(compressed().sample(), exact=True)


def hanging(model: Model) -> int:
    """A part that hangs on another one."""
    return int(np.flatnonzero(model.mixed.articulation.parents >= 0)[0])


def moved(model: Model, time: float) -> Float:
    """A frame, one vertex moved."""
    points = model(time).copy()
    points[0] += 0.01
    return points


EDITS: dict[str, Callable[[Model], Model]] = {
    "cut": lambda model: operations.cut(model, 0.1, 0.5),
    "repeat": lambda model: operations.repeat(model, 0.2, 0.6),
    "loop": operations.loop,
    "shift": lambda model: operations.shift(model, 1.0),
    "speed": lambda model: operations.speed(model, 2.0),
    "reverse": operations.reverse,
    "retime": lambda model: operations.retime(model, [[0.0, 0.0], [1.0, 0.5]]),
    "concatenate": lambda model: operations.concatenate(model, model),
    "transition": lambda model: operations.transition(model, model, 0.2, 0.3),
    "blend": lambda model: operations.blend(model, model, 0.25),
    "into": lambda model: operations.into(model, bar_motion("vertex").space),
    "in_place": operations.in_place,
    "exaggerate": lambda model: operations.exaggerate(model, 1.1),
    "exaggerate_part": lambda model: operations.exaggerate_part(model, hanging(model), 1.1),
    "hold": lambda model: operations.hold(model, hanging(model), 0.2, 0.3, 0.4),
    "smooth": lambda model: operations.smooth(model, 0.1),
    "sculpt": lambda model: operations.sculpt(model, 0.3, moved(model, 0.3)),
    "drag": lambda model: operations.drag(model, 0.3, model.embedding([0.3])[0] + 0.01),
    "with_shapes": lambda model: operations.with_shapes(model, operations.key_poses(model)),
    "sketch": lambda model: operations.sketch(model, model.embedding(model.times[:4]), 0.5),
}


@pytest.mark.parametrize("name", EDITS)
def test_edits_are_those_of_the_decoded_frames(name: str) -> None:
    edited, expected = EDITS[name](compressed()), EDITS[name](decoded())
    assert type(edited) is Model
    np.testing.assert_allclose(edited.times, expected.times, atol=1e-12)
    times = np.linspace(edited.start, edited.end, 9)
    np.testing.assert_allclose(edited.sample(times).points, expected.sample(times).points, atol=1e-9)


def test_all_operations_are_tried() -> None:
    # swap_key is for models fitted with key shapes that are frames; those of compressed models are modes.
    assert EDITS.keys() | {"swap_key"} == OPERATIONS.keys() | {"into", "with_shapes"}


@pytest.mark.parametrize(
    "edit",
    [
        lambda model: operations.shift(model, 0.0),
        lambda model: operations.speed(model, 1.0),
        lambda model: operations.reverse(operations.reverse(model)),
        lambda model: operations.exaggerate(model, 1.0),
        lambda model: operations.cut(model, model.start, model.end),
    ],
)
def test_edits_that_change_nothing_keep_the_bound(edit: Callable[[Model], Model]) -> None:
    frames = bar_motion().sample()
    assert mixseq.compare(frames, edit(compressed()).sample()).max_error <= BOUND * (1 + 1e-6)


def test_cuts_keep_the_bound() -> None:
    frames = bar_motion().sample()
    section = operations.cut(compressed(), frames.times[2], frames.times[5])
    expected = frames.with_points(frames.points)
    off = np.linalg.norm(section.sample().points - expected.points[2:6], axis=2).max()
    assert off <= BOUND * bar_motion().space.scale * (1 + 1e-6)
