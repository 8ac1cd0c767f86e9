"""The shadow: where it falls and how dark it is."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from mixseq.pictures.raster import ground_shadow
from mixseq.pictures.scene import View

LIMITS = (-2.0, 2.0, -1.0, 1.0)
TILE = np.array([[-0.02, 0, -0.01], [-0.02, 0, 0.01], [0.04, 0, 0]])
FACE = np.array([[0, 1, 2]])


def alpha(points: NDArray[np.float64], floor: float = 0.0, elevation: float = 40.0) -> NDArray[np.float64]:
    return ground_shadow(points, FACE, floor, View(0, elevation), LIMITS)[..., 3]


def test_pixels_are_square() -> None:
    assert alpha(TILE).shape == (120, 240)


def test_shadow_lies_below_the_mesh() -> None:
    row, column = np.unravel_index(np.argmax(alpha(TILE + np.array([1, 0, 0]))), (120, 240))
    assert column == pytest.approx(180, abs=2)
    assert row == pytest.approx(60, abs=2)


def test_shadow_fades_with_height() -> None:
    near, far = alpha(TILE), alpha(TILE, floor=-0.5)
    assert 0 < far.max() < 0.6 * near.max()


def test_shadow_ends_softly_at_the_frame() -> None:
    everywhere = alpha(TILE + np.array([1.95, 0, 0]))
    assert everywhere.max() > 0
    assert not everywhere[:, [0, -1]].any() and not everywhere[[0, -1]].any()


def test_no_mesh_no_shadow() -> None:
    assert not alpha(np.zeros((3, 3)), elevation=0.0).any()
