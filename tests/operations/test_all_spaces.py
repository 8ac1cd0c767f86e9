"""Operations know shape spaces by their contract: they do in all of them what they do in one."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from mixseq import operations
from mixseq.choices import SPACES, SpaceName
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
