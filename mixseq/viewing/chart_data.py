"""Chart data of a model's signals for a page: plain numbers, at the resolution of a screen."""

from __future__ import annotations

from typing import Any

import numpy as np

from mixseq.arrays import Float, evenly
from mixseq.operations.dragging import default_reach
from mixseq.plots.model_charts import dense_times, largest_coordinates
from mixseq.signals import Model
from mixseq.signals.mds_embedding import Plane

POINTS = 800
"""Points of a line, about two for every pixel of a chart."""

FRAMES = 300
"""Largest number of dots."""

HANDLES = 13
"""Draggable points of the curve, evenly spaced in time, distinguishable on a small chart."""

KEYS = 5
"""Initial number of keys of the retiming."""

DIGITS = 5
"""Digits of the largest number, enough for a screen of 4000 pixels."""


def signals_of(model: Model, plane: Plane | None = None) -> dict[str, Any]:
    """Return the chart data of a model, ready for JSON."""
    start, end = model.start, model.end
    moves = end > start and model.time.dim > 0
    times = _evenly_chosen(dense_times(model), POINTS) if end > start else np.array([start])
    frames = _evenly_chosen(model.times, FRAMES)
    handles = np.linspace(start, end, HANDLES) if moves else np.zeros(0)
    chosen, units = largest_coordinates(model)
    lines = model.time(times)[:, chosen] * units
    keys = np.linspace(start, end, KEYS).tolist() if end > start else []
    path = model.embedding(times, plane)
    step = float(np.abs(path).max(initial=0.0))
    return {
        "start": start,
        "end": end,
        "fps": model.header.fps,
        "times": _rounded(times, end - start),
        "path": _rounded(path, step),
        "frames": _rounded(model.embedding(frames, plane), step),
        "frameTimes": _rounded(frames, end - start),
        "handles": [
            {"time": time, "at": at}
            for time, at in zip(
                handles.tolist(), _rounded(model.embedding(handles, plane), step), strict=True
            )
        ],
        "reach": default_reach(model),
        "coefficients": [
            {"name": f"coordinate {number + 1}", "values": _rounded(line, float(np.abs(lines).max()))}
            for number, line in zip(chosen.tolist(), lines.T, strict=True)
        ],
        "keys": [[time, time] for time in keys],
    }


def _evenly_chosen(values: Float, most: int) -> Float:
    """Return at most `most` evenly spaced values, with the first and the last."""
    return values[evenly(len(values), most)]


def _rounded(values: Float, largest: float) -> list[Any]:
    """Return values as lists, rounded to `DIGITS` digits of the largest."""
    decimals = DIGITS - int(np.ceil(np.log10(largest))) if largest > 0 else DIGITS
    rounded: list[Any] = (np.round(values, min(max(decimals, 0), 15)) + 0.0).tolist()
    return rounded
