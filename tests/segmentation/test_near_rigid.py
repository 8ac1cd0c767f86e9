"""How near-rigid parts are."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.segmentation.methods import near_rigid_errors


def test_near_rigid_errors() -> None:
    """Two triangles turn as a book's pages: each alone is rigid, together they are not; one that stretches is soft."""
    angle = np.linspace(0, 1, 4)
    points = np.zeros((4, 6, 3))
    points[:, 1, 0], points[:, 2, 1] = 1, 1
    points[:, 3] = points[:, 0] + [0, 0, 5]
    points[:, 4] = points[:, 3] + np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    points[:, 5] = points[:, 3] + np.stack([-np.sin(angle), np.cos(angle), 0 * angle], axis=1)
    faces = np.array([[0, 1, 2], [3, 4, 5]])
    parts, whole = near_rigid_errors(points, faces, np.array([0, 1]))
    np.testing.assert_allclose(parts, 0, atol=1e-5)
    assert whole < 1e-5
    parts, whole = near_rigid_errors(points, faces, np.array([0, 0]))
    assert parts[0] == pytest.approx(whole)
    assert whole > 1
    points[1:, 1, 0] = 1.3
    parts, _ = near_rigid_errors(points, faces, np.array([0, 1]))
    assert parts[0] > 5 > 1e-5 > parts[1]
