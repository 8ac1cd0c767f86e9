"""Parts of the mesh `gem`, and what to draw it on."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray


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
