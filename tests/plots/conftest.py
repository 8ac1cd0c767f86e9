"""A mesh that can be counted by hand, and what to draw it on."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mixseq.sequence import MeshSequence


@pytest.fixture
def gem() -> MeshSequence:
    """A stretching octahedron, long in x, that lasts 8 / 24 s."""
    points = np.array([[2, 0, 0], [-2, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1.0]])
    faces = [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]]
    stretch = 1 + 0.2 * np.sin(np.linspace(0, 2, 9))[:, None, None]
    return MeshSequence.from_arrays(points * stretch, faces, name="gem")


@pytest.fixture
def parts() -> NDArray[np.int64]:
    return np.array([0, 0, 1, 1, 0, 0, 1, 1])


@pytest.fixture
def joints() -> NDArray[np.int64]:
    return np.array([0, -1, -1, 0, -1, -1, -1, -1])


@pytest.fixture
def ax() -> Any:
    figure = pytest.importorskip("matplotlib.figure").Figure()
    return figure.add_subplot()
