"""Operations know shape spaces by their contract: they do in all of them what they do in one."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import mixseq
from mixseq import operations
from mixseq.choices import SPACES, SpaceName
from mixseq.errors import SettingsError
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.fitting import fit
from mixseq.signals.model import Model
from tests.meshes import bar

pytestmark = pytest.mark.slow

FORTH: MeshSequence = bar(sides=4, rings=9, frames=8)
BACK: MeshSequence = FORTH.with_points(FORTH.points[::-1].copy())


@cache
def models(space: SpaceName) -> tuple[Model, Model]:
    return fit(FORTH, exact=True, space=space), fit(BACK, exact=True, space=space)


EDITS: dict[str, Callable[[Model, Model], Model]] = {
    "cut": lambda a, b: operations.cut(a, 0.1, 0.5),
    "repeat": lambda a, b: operations.repeat(a, 0.2, 0.6, times=2),
    "loop": lambda a, b: operations.loop(a, fade=0.2),
    "reverse": lambda a, b: operations.reverse(a),
    "speed": lambda a, b: operations.speed(a, 2.0),
    "retime": lambda a, b: operations.retime(a, [[0.0, 0.0], [0.5, 0.7], [1.0, 0.2]]),
    "drag": lambda a, b: operations.drag(a, 0.3, a.embedding([0.3])[0] + 0.01),
    "in_place": lambda a, b: a if a.space.name == "vertex" else operations.in_place(a),
    "smooth": lambda a, b: operations.smooth(a, 0.1),
    "exaggerate": lambda a, b: operations.exaggerate(a, 1.1),
    "concatenate": lambda a, b: operations.concatenate(a, b),
    "transition": lambda a, b: operations.transition(a, b, 0.2, 0.3),
    "blend": lambda a, b: operations.blend(a, b, 0.25),
}


@pytest.mark.parametrize("space", SPACES)
@pytest.mark.parametrize("name", EDITS)
def test_edits_stay_in_the_space(name: str, space: SpaceName, tmp_path: Path) -> None:
    edited = EDITS[name](*models(space))
    assert edited.space.name == space
    provenance = edited.header.provenance
    assert provenance is not None
    assert provenance.edited is (name != "in_place" or space != "vertex")
    points = edited.sample().points
    assert np.isfinite(points).all()
    mixseq.save(tmp_path / "edited.h5", edited)
    np.testing.assert_array_equal(mixseq.load(tmp_path / "edited.h5").sample().points, points)


@pytest.mark.parametrize("space", SPACES)
def test_transitions_keep_frames_outside_the_blend(space: SpaceName) -> None:
    """A transition is the first model before, and the second one after."""
    a, b = models(space)
    both = operations.transition(a, b, 0.2, 0.3)
    np.testing.assert_allclose(both(0.1), FORTH.points[1], atol=1e-6)
    np.testing.assert_allclose(both(0.7), BACK.points[5], atol=1e-6)
    after = operations.concatenate(a, b, fade=0.05)
    np.testing.assert_allclose(after(0.3), FORTH.points[3], atol=1e-6)
    np.testing.assert_allclose(after(1.2), BACK.points[5], atol=1e-6)


@pytest.mark.parametrize("space", SPACES)
def test_reversed_models_have_the_same_frames(space: SpaceName) -> None:
    backwards = operations.reverse(models(space)[0])
    np.testing.assert_allclose(backwards.sample().points, BACK.points, atol=1e-6)


@pytest.mark.parametrize("space", SPACES)
def test_a_change_by_hand_arrives(space: SpaceName) -> None:
    model, _ = models(space)
    changed = model(0.3)
    changed[-4:] += [0.0, 0.05, 0.0]
    edited = operations.sculpt(model, 0.3, changed)
    np.testing.assert_allclose(edited(0.3), changed, atol=0.02)


@pytest.mark.parametrize("space", ["vertex", "gradient", "lri", "edge"])
def test_edits_of_parts_need_parts(space: SpaceName) -> None:
    model, _ = models(space)
    with pytest.raises(SettingsError, match=r"space='mixed'|mixed space"):
        operations.hold(model, 0, 0.1, 0.2, 0.4)
    with pytest.raises(SettingsError, match=r"space='mixed'|mixed space"):
        operations.exaggerate_part(model, 0, 1.5)
