"""Compute what charts of a model show, for pictures and as JSON for pages.

Values are distances in the shape space in diagonals, without the placement of parts. Let :math:`C` be the centred
frames ``(T, k)`` in pose space, and :math:`G = L L^T` the Gram matrix of unit steps along its coordinates (the identity
for principal components). The *singular values* of a model are the singular values of :math:`C L`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mixseq.operations.sketch import default_reach
from mixseq.signals.model import Model
from mixseq.signals.pose import Plane
from mixseq.types import Float, IntArray, evenly_spaced

MAX_COORDINATES = 5
"""Largest number of coordinates drawn over time; the coordinates with the largest movement are drawn."""

RANK_TOLERANCE = 1e-13
"""Fraction of the largest singular value below which singular values count as rounding errors."""

MAX_CHART_POINTS = 800
"""Largest number of points of a chart line, about two per pixel."""

MAX_CHART_FRAMES = 300
"""Largest number of frames that are drawn as dots."""

HANDLE_COUNT = 13
"""Number of draggable points of the time curve, evenly spaced in time; more would crowd a small chart."""

INITIAL_KEY_COUNT = 5
"""Initial number of keys of a retiming."""

SIGNIFICANT_DIGITS = 5
"""Significant digits of the largest chart value, sufficient for a screen of 4000 pixels."""


def chart_data(model: Model, plane: Plane | None = None) -> dict[str, Any]:
    """Return the chart data of a model as values that JSON can hold."""
    start, end = model.start, model.end
    has_motion = end > start and model.time.dim > 0
    times = dense_times(model) if end > start else np.array([start])
    times = times[evenly_spaced(len(times), MAX_CHART_POINTS)]
    frames = model.times[evenly_spaced(len(model.times), MAX_CHART_FRAMES)]
    handles = np.linspace(start, end, HANDLE_COUNT) if has_motion else np.zeros(0)
    coordinate_ids, units = largest_coordinates(model)
    lines = model.time(times)[:, coordinate_ids] * units
    keys = np.linspace(start, end, INITIAL_KEY_COUNT).tolist() if end > start else []
    path = model.embedding(times, plane)
    extent = float(np.abs(path).max(initial=0.0))
    positions = _round(model.embedding(handles, plane), extent)
    return {
        "start": start,
        "end": end,
        "fps": model.header.fps,
        "times": _round(times, end - start),
        "path": _round(path, extent),
        "frames": _round(model.embedding(frames, plane), extent),
        "frameTimes": _round(frames, end - start),
        "handles": [{"time": time, "at": at} for time, at in zip(handles.tolist(), positions, strict=True)],
        "reach": default_reach(model),
        "coefficients": [
            {"name": f"coordinate {number + 1}", "values": _round(line, float(np.abs(lines).max()))}
            for number, line in zip(coordinate_ids.tolist(), lines.T, strict=True)
        ],
        "keys": [[time, time] for time in keys],
    }


def _round(values: Float, largest: float) -> list[Any]:
    """Round values to the decimals that give `largest` `SIGNIFICANT_DIGITS` digits, and return them as lists."""
    decimals = SIGNIFICANT_DIGITS - int(np.ceil(np.log10(largest))) if largest > 0 else SIGNIFICANT_DIGITS
    rounded: list[Any] = (np.round(values, min(max(decimals, 0), 15)) + 0.0).tolist()
    return rounded


def largest_coordinates(model: Model) -> tuple[IntArray, Float]:
    """Return the time-signal coordinates ``(n,)`` with the largest movement, and their units ``(n,)`` in diagonals."""
    units = np.sqrt(np.diagonal(_step_gram(model)))
    sizes = units * np.linalg.norm(_centred(model), axis=0)
    coordinate_ids = np.sort(np.argsort(-sizes, kind="stable")[:MAX_COORDINATES])
    return coordinate_ids, units[coordinate_ids]


def singular_values(model: Model) -> Float:
    """Return the singular values ``(r,)`` of a model's modes in diagonals, in descending order."""
    if not model.time.dim:
        return np.zeros(0)
    squares, directions = np.linalg.eigh(_step_gram(model))
    roots = directions * np.sqrt(np.maximum(squares, 0.0))
    sizes = np.linalg.svd(_centred(model) @ roots, compute_uv=False)
    return np.asarray(sizes[sizes > RANK_TOLERANCE * max(sizes.max(initial=0.0), np.finfo(np.float64).tiny)])


def dense_times(model: Model) -> Float:
    """Return times ``(N,)`` from the start to the end of a model, dense enough for smooth lines."""
    knots = max(len(model.times), len(model.time.times))
    return np.linspace(model.start, model.end, min(max(400, 20 * knots), 20_000))


def _centred(model: Model) -> Float:
    coordinates = model.time(model.times)
    return np.asarray(coordinates - coordinates.mean(axis=0))


def _step_gram(model: Model) -> Float:
    """Return the Gram matrix ``(k, k)`` of unit steps along the coordinates of pose space."""
    shapes, metric = model.shapes, model.space.shape_weights
    steps = model.pose.matrix @ ((shapes - shapes.mean(axis=0)) * metric)
    return np.asarray(steps @ steps.T)
