"""Means of placements: turns in proportion."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.choices import SpaceName
from mixseq.mesh.rotations import matrices, rotations_of, vectors
from mixseq.operations.sections import mean, mean_placements
from mixseq.types import Float
from tests.operations.chains import TIMES, chain
from tests.operations.motions import bar_motion, spin

COUNT = len(TIMES)
LATER = TIMES[::-1]


def shares(value: float) -> Float:
    return np.full((COUNT, 1), value)


@pytest.mark.parametrize("space", ["mixed", "gradient"])
@pytest.mark.parametrize("share", [0.0, 1.0])
def test_all_or_nothing_gives_one_of_them(space: SpaceName, share: float) -> None:
    """Also the length of quaternions: curves through more knots are the same curves."""
    model = bar_motion(space)
    both = 1.1 * model.placement(TIMES), model.placement(LATER)
    found, expected = mean_placements(model.space, *both, shares(share)), both[int(share)]
    turns, others = (model.space.poses(each).rotations for each in (found, expected))
    signs = np.where(np.einsum("tgi,tgi->tg", turns, others) < 0, -1.0, 1.0)[:, :, None]
    np.testing.assert_allclose(signs * turns, others, atol=1e-12)
    np.testing.assert_allclose(
        model.space.poses(found).centres, model.space.poses(expected).centres, atol=1e-12
    )


def test_a_body_turns_along_the_shortest_way() -> None:
    model = chain()
    one, other = (model.placement(times) for times in (TIMES, LATER))
    found = model.space.poses(mean_placements(model.space, one, other, shares(0.3)))
    turns, others = (rotations_of(model.space.poses(each).rotations[:, 0]) for each in (one, other))
    expected = turns @ matrices(0.3 * vectors(np.swapaxes(turns, 1, 2) @ others))
    np.testing.assert_allclose(rotations_of(found.rotations[:, 0]), expected, atol=1e-12)
    here, there = (model.space.poses(each).centres[:, 0] for each in (one, other))
    np.testing.assert_allclose(found.centres[:, 0], mean(here, there, shares(0.3)), atol=1e-12)


def test_whole_turns_count() -> None:
    model = spin()
    times = model.placement.times
    turning = model.placement.values
    still = np.repeat(turning[:1], len(times), axis=0)
    found = mean_placements(model.space, turning, still, np.full((len(times), 1), 0.5))
    cosines = np.abs(model.space.poses(found).rotations[:, 0] @ turning[0, :4])
    np.testing.assert_allclose(
        cosines, np.abs(np.cos(np.pi * times / 2)), atol=1e-9
    )  # a quarter of the angle
