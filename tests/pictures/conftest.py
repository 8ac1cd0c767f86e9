"""Parts of the mesh `gem`, and what to draw it on."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

LOW_RESOLUTION = 30
"""Dots per inch of pages in tests, which is a fifth of what users get."""


def set_resolution(monkeypatch: pytest.MonkeyPatch, dots_per_inch: int) -> None:
    """Draw pages with fewer pixels, or more."""
    for module in ("raster", "charts", "sheets"):
        monkeypatch.setattr(f"mixseq.pictures.{module}.DOTS_PER_INCH", dots_per_inch)


@pytest.fixture(autouse=True)
def _low_resolution(monkeypatch: pytest.MonkeyPatch) -> None:
    set_resolution(monkeypatch, LOW_RESOLUTION)


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
