"""What operations do to the residual layer of a model is what the table of the documentation says."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from mixseq import operations
from mixseq.operations.script import OPERATIONS
from mixseq.signals.fitting import fit
from mixseq.signals.model import Model
from mixseq.types import Float
from tests.operations.motions import bar_motion

DOCS = Path(__file__).parents[2] / "docs/editing.md"


@dataclass(frozen=True)
class Rising:
    """One displacement of all vertices, growing with time."""

    count: int

    def at(self, times: Float) -> Float:
        return np.broadcast_to(0.01 * times[:, None, None], (len(times), self.count, 3))

    def rates(self, times: Float) -> Float:
        return np.full((len(times), self.count, 3), 0.01)


def with_layer(model: Model) -> Model:
    return replace(model, residual_layer=Rising(model.header.vertex_count))


def hanging(model: Model) -> int:
    """A part that hangs on another one."""
    return int(np.flatnonzero(model.mixed.articulation.parents >= 0)[0])


def moved(model: Model, time: float) -> Float:
    """A frame, one vertex moved."""
    points = model(time).copy()
    points[0] += 0.01
    return points


def swapped(model: Model, key: int) -> Model:
    """The model with a vertex of a key moved, where the key is a frame."""
    return operations.swap_key(model, key, moved(model, model.times[model.key_frames[key]]))


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
    "swap_key": lambda model: swapped(model, int(model.key_frames.argmax())),
    "with_shapes": lambda model: operations.with_shapes(model, operations.key_poses(model)),
    "sketch": lambda model: operations.sketch(model, model.embedding(model.times[:4]), 0.5),
}


def documented() -> dict[str, str]:
    """What the table says, by the names of operations."""
    rows = re.findall(r"^\| \[(`.*?)\]\(#.*\| ([a-z ]+) \|$", DOCS.read_text(encoding="utf-8"), re.MULTILINE)
    return {name: does for names, does in rows for name in re.findall(r"`(\w+)`", names)}


def test_the_table_has_all_operations() -> None:
    assert documented().keys() == EDITS.keys() == OPERATIONS.keys() | {"into", "with_shapes"}


@pytest.mark.parametrize("name", EDITS)
def test_the_table_is_true(name: str) -> None:
    plain = fit(bar_motion().sample(), exact=True, pose="keys") if name == "swap_key" else bar_motion()
    model = with_layer(plain)
    edited = EDITS[name](model)
    match documented()[name]:
        case "kept":
            assert edited.residual_layer is model.residual_layer
        case "left out":
            assert edited.residual_layer is None
        case "retimed":
            assert edited.residual_layer is not None
            np.testing.assert_allclose(edited.residual_layer.at(np.array([1.0])), 0.005)
        case "encoded":
            assert edited.residual_layer is None
            np.testing.assert_allclose(edited.sample().points, model.sample().points, atol=1e-9)
        case other:
            pytest.fail(f"the table says {other!r}")
