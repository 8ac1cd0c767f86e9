"""How a target stands to its source."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixseq.errors import InvalidSequenceError
from mixseq.mesh.rigid import kabsch
from mixseq.retargeting.sources import Alignment, _quarter_turns, align
from mixseq.types import Float
from tests.meshes import grid, rigid_motions, rotation, seeds, tube

QUARTER = rotation((np.pi / 2, 0, 0))


def angle(a: Float, b: Float) -> float:
    """Between two rotations, in degrees."""
    return float(np.degrees(2 * np.arcsin(min(1.0, np.linalg.norm(a - b) / np.sqrt(8)))))


def cloud(seed: int, count: int = 40) -> Float:
    return np.random.default_rng(seed).normal(size=(count, 3)) * [3.0, 2.0, 1.0]


@given(rigid_motions, st.floats(0.01, 100.0), seeds)
@settings(max_examples=50, deadline=None)
def test_a_copy_tells_its_rotation_and_its_scale(
    motion: tuple[Float, Float], scale: float, seed: int
) -> None:
    turn, shift = motion
    source = cloud(seed)
    weights = np.random.default_rng(seed).uniform(0.1, 1.0, len(source))
    found = align(source, scale * source @ turn.T + shift, weights)
    np.testing.assert_allclose(found.rotation, turn, atol=1e-9)
    assert found.scale == pytest.approx(scale, rel=1e-12)


@pytest.mark.parametrize("number", range(24))
def test_another_body_a_little_askew_stands_as_its_source(number: int) -> None:
    turn = _quarter_turns()[number]
    source = cloud(3, 200)
    # A hump and a neck: as if the body leant, although it stands upright.
    other = source * [1.0, 1.4, 0.7] + 0.25 * source[:, [1]] * [1.0, 0.0, 0.0]
    best = kabsch(source, other)[0]
    assert 2.0 < angle(best, np.eye(3)) < 20.0
    assert np.array_equal(align(source, other @ turn.T, np.ones(200)).rotation, turn)


def test_a_body_that_is_clearly_turned_is_not_straightened() -> None:
    turn = rotation((0.0, np.radians(35.0), 0.0))
    source = cloud(1, 200)
    other = (source * [1.0, 1.1, 0.9]) @ turn.T
    assert angle(align(source, other, np.ones(200)).rotation, turn) < 5.0


@given(seeds)
@settings(max_examples=30, deadline=None)
def test_a_mirrored_body_is_turned_and_not_mirrored(seed: int) -> None:
    source = cloud(seed)
    found = align(source, source * [-1.0, 1.0, 1.0], np.ones(len(source)))
    assert np.linalg.det(found.rotation) == pytest.approx(1.0)
    np.testing.assert_allclose(found.rotation @ found.rotation.T, np.eye(3), atol=1e-12)


@given(seeds)
@settings(max_examples=30, deadline=None)
def test_exchanged_the_scale_is_the_inverse(seed: int) -> None:
    source, target = cloud(seed), 2.5 * cloud(seed + 1) + 7.0
    weights = np.random.default_rng(seed).uniform(size=len(source))
    there, back = align(source, target, weights), align(target, source, weights)
    assert there.scale * back.scale == pytest.approx(1.0, rel=1e-12)


def test_points_of_no_weight_do_not_count() -> None:
    source = cloud(5)
    target = 2.0 * source @ QUARTER.T
    target[::2] += 50.0
    found = align(source, target, np.arange(len(source)) % 2 * np.float64(1.0))
    np.testing.assert_allclose(found.rotation, QUARTER, atol=1e-12)
    assert found.scale == pytest.approx(2.0)


@pytest.mark.parametrize("points", [grid(3, 4)[0], tube(6, 5)[0], np.outer([0.0, 1, 3], [1.0, 2, 2])])
def test_sheets_tubes_and_lines_stand_as_they_are(points: Float) -> None:
    """Whatever the points leave free is not turned."""
    found = align(points, 3.0 * points, np.ones(len(points)))
    np.testing.assert_allclose(found.rotation, np.eye(3), atol=1e-7)
    assert found.scale == pytest.approx(3.0)


def test_the_quarter_turns_are_24_rotations() -> None:
    turns = np.stack(_quarter_turns())
    assert len(np.unique(turns, axis=0)) == 24
    np.testing.assert_array_equal(turns @ np.swapaxes(turns, 1, 2), np.tile(np.eye(3), (24, 1, 1)))
    np.testing.assert_allclose(np.linalg.det(turns), 1.0)


def test_shifts_points_and_matrices_are_carried() -> None:
    alignment = Alignment(QUARTER, 2.0)
    np.testing.assert_allclose(alignment.shifted(np.array([[1.0, 2, 3]])), [[2.0, -6, 4]], atol=1e-12)
    np.testing.assert_allclose(alignment.turned_points(np.array([1.0, 2, 3])), [1.0, -3, 2], atol=1e-12)
    # A turn about y is one about z, where y points there.
    np.testing.assert_allclose(
        alignment.turned(rotation((0, 0.3, 0))[None]), [rotation((0, 0, 0.3))], atol=1e-12
    )


def test_points_in_one_place_are_refused() -> None:
    points, place = cloud(2), np.ones((40, 3))
    with pytest.raises(InvalidSequenceError, match="of the source is in one place"):
        align(place, points, np.ones(40))
    with pytest.raises(InvalidSequenceError, match="of the target is in one place"):
        align(points, place, np.ones(40))
    with pytest.raises(InvalidSequenceError, match="no area at rest"):
        align(points, points, np.zeros(40))
