"""Operating points of coders, and their rates at given errors."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Measure = Literal["kg_percent", "max_error"]

SLACK = 1.01
"""An error that is so little above a target counts as the target."""


@dataclass(frozen=True)
class Point:
    """A setting of a coder: bytes without connectivity and all bytes, bits per vertex and frame, errors, seconds."""

    setting: str
    signals: int
    total: int
    bits: float
    kg_percent: float
    max_error: float
    encode: tuple[float, ...]
    decode: tuple[float, ...]


def errors(original: NDArray[Any], decoded: NDArray[Any], diagonal: float) -> tuple[float, float]:
    """Return the KG error in percent, and the largest error of a vertex in diagonals."""
    x = original.astype(np.float64)
    away = decoded - x
    kg = 100 * np.linalg.norm(away) / np.linalg.norm(x - x.mean(axis=1, keepdims=True))
    return float(kg), float(np.sqrt(np.square(away).sum(axis=2).max()) / diagonal)


def rate(points: Iterable[Point], measure: Measure, target: float) -> float | None:
    """Return bits per vertex and frame at an error: between points linear in its logarithm, on their lower staircase.

    With a target larger than all errors it is the rate of the cheapest point, which keeps the target; None if no point
    reaches it.
    """
    stairs = staircase(points, measure)
    if not stairs or stairs[0][0] > SLACK * target:
        return None
    error, bits_at = np.array(stairs).T
    return float(np.interp(np.log(target), np.log(np.maximum(error, 1e-300)), bits_at))


def staircase(points: Iterable[Point], measure: Measure) -> list[tuple[float, float]]:
    """Return errors and bits of the points that none beats in both, by growing error."""
    stairs: list[tuple[float, float]] = []
    for error, bits in sorted((getattr(point, measure), point.bits) for point in points):
        if not stairs or bits < stairs[-1][1]:
            stairs.append((error, bits))
    return stairs
