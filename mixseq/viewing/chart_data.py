"""A model's signals as charts on a page draw them: plain numbers, as many and as exact as a screen can show."""

from __future__ import annotations

from typing import Any

import numpy as np

from mixseq.arrays import Float, evenly
from mixseq.operations.dragging import default_reach
from mixseq.plots.model_charts import dense_times, largest_coordinates
from mixseq.signals import Model
from mixseq.signals.mds_embedding import Plane

POINTS = 800
"""So many points make lines that look like curves; ours, about two for every pixel of a chart."""

FRAMES = 300
"""No more dots than this; ours."""

HANDLES = 13
"""Points of the curve that can be dragged, evenly spaced in time; ours: as many as keep apart on a small chart."""

KEYS = 5
"""Keys of the retiming to begin with; ours."""

DIGITS = 5
"""So many digits of the largest number: a screen of 4000 pixels shows no more."""


def signals_of(model: Model, plane: Plane | None = None) -> dict[str, Any]:
    """Return what the charts of a page draw of a model, ready for JSON."""
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
    """Choose `most` of the values, evenly, the first and the last among them; all if there are no more."""
    return values[evenly(len(values), most)]


def _rounded(values: Float, largest: float) -> list[Any]:
    """Return values as lists, rounded to `DIGITS` digits of the largest."""
    decimals = DIGITS - int(np.ceil(np.log10(largest))) if largest > 0 else DIGITS
    rounded: list[Any] = (np.round(values, min(max(decimals, 0), 15)) + 0.0).tolist()
    return rounded
