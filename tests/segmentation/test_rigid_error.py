from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from scipy.spatial.transform import Rotation

from mixseq.segmentation.motion import Moments, moments, union_errors
from mixseq.types import Float
from tests.meshes import rotation, seeds


def random_set(rng: np.random.Generator, count: int, frames: int = 4) -> tuple[Float, Float, Float]:
    rest = rng.normal(size=(count, 3))
    moved = np.stack([rest @ rotation(rng.uniform(-2, 2, 3)).T + rng.normal(size=3) for _ in range(frames)])
    moved += 0.2 * rng.normal(size=moved.shape)
    return rest, moved.transpose(1, 0, 2), rng.uniform(0.1, 2.0, count)


def by_scipy(rest: Float, moved: Float, weights: Float) -> float:
    """The same error with SciPy's alignment of centred vectors."""
    error = 0.0
    h = rest - np.average(rest, axis=0, weights=weights)
    for frame in moved.transpose(1, 0, 2):
        x = frame - np.average(frame, axis=0, weights=weights)
        turn = Rotation.align_vectors(x, h, weights=weights)[0].as_matrix()
        error += float(weights @ np.sum((x - h @ turn.T) ** 2, axis=1))
    return error


@settings(max_examples=25, deadline=None)
@given(seed=seeds)
def test_error_is_the_residual_of_the_best_rigid_motion(seed: int) -> None:
    rest, moved, weights = random_set(np.random.default_rng(seed), 7)
    assert moments(rest, moved, weights).error() == pytest.approx(by_scipy(rest, moved, weights), rel=1e-9)


@settings(max_examples=25, deadline=None)
@given(seed=seeds)
def test_motion_has_that_error(seed: int) -> None:
    rest, moved, weights = random_set(np.random.default_rng(seed), 9)
    gathered = moments(rest, moved, weights)
    rotations, translations = gathered.motion()
    np.testing.assert_allclose(np.linalg.det(rotations), 1.0)
    predicted = np.einsum("tij,nj->nti", rotations, rest) + translations
    residual = float(weights @ np.sum((moved - predicted) ** 2, axis=(1, 2)))
    assert gathered.error() == pytest.approx(residual, rel=1e-9)


def test_mirror_images_are_not_rigid() -> None:
    rest = np.random.default_rng(0).normal(size=(8, 3))
    gathered = moments(rest, (rest * [1, 1, -1])[:, None], np.ones(8))
    assert np.linalg.det(gathered.motion()[0][0]) == pytest.approx(1)
    assert gathered.error() == pytest.approx(by_scipy(rest, (rest * [1, 1, -1])[:, None], np.ones(8)))
    assert gathered.error() > 0.1


def test_rigid_motion_has_no_error() -> None:
    rng = np.random.default_rng(1)
    rest = rng.normal(size=(30, 3))
    turns = [rotation(rng.uniform(-3, 3, 3)) for _ in range(5)]
    moved = np.stack([rest @ r.T + [1.0, 2, 3] for r in turns], axis=1)
    gathered = moments(rest, moved, rng.uniform(0.5, 1, 30))
    assert gathered.error() == pytest.approx(0, abs=1e-10)
    np.testing.assert_allclose(gathered.motion()[0], np.stack(turns), atol=1e-10)


@settings(max_examples=15, deadline=None)
@given(seed=seeds)
def test_moments_add_up(seed: int) -> None:
    rest, moved, weights = random_set(np.random.default_rng(seed), 20)
    whole = moments(rest, moved, weights)
    added = moments(rest[:6], moved[:6], weights[:6]) + moments(rest[6:], moved[6:], weights[6:])
    for field in Moments.__dataclass_fields__:
        np.testing.assert_allclose(getattr(added, field), getattr(whole, field), atol=1e-12)
    assert added.error() == pytest.approx(whole.error(), rel=1e-9)


@settings(max_examples=25, deadline=None)
@given(seed=seeds)
def test_errors_of_unions_are_those_of_sums(seed: int) -> None:
    rng = np.random.default_rng(seed)
    one, *others = (moments(*random_set(rng, count)) for count in (4, 1, 7, 2))
    expected = [(one + other).error() for other in others]
    np.testing.assert_allclose(union_errors(one, others), expected, rtol=1e-9)
