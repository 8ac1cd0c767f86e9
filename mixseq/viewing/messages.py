"""Messages from the page to Python: JSON from a browser, validated before use."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np

from mixseq.arrays import Float

MOST_POINTS = 5000
"""Largest number of points of a stroke, or keys of a retiming."""


LARGEST = 1e6
"""Largest time in seconds, and largest coordinate in diagonals."""


@dataclass(frozen=True)
class Drawn:
    """The page has drawn a frame."""


@dataclass(frozen=True)
class Seek:
    """Go to a time of the model, in seconds."""

    time: float


@dataclass(frozen=True, eq=False)
class Drag:
    """A drag of the time curve at a time to a place ``(2,)`` of the embedding; `done` at its end."""

    time: float
    to: Float
    done: bool


@dataclass(frozen=True, eq=False)
class Sketch:
    """A curve ``(N, 2)`` drawn in the embedding."""

    points: Float


@dataclass(frozen=True, eq=False)
class Retime:
    """Keys ``(n, 2)`` of a retiming, output and source times; `done` at the end of a drag."""

    keys: Float
    done: bool


Message = Drawn | Seek | Drag | Sketch | Retime


def message_of(text: str) -> Message | None:
    """Parse a message, None if it is not valid."""
    try:
        said = json.loads(text)
        match said:
            case {"kind": "drawn"}:
                return Drawn()
            case {"kind": "seek", "time": time}:
                return Seek(_number(time))
            case {"kind": "drag", "time": time, "to": to, "done": bool(done)}:
                return Drag(_number(time), _pairs([to])[0], done)
            case {"kind": "sketch", "points": points}:
                return Sketch(_pairs(points))
            case {"kind": "retime", "keys": keys, "done": bool(done)}:
                return Retime(_pairs(keys), done)
    except (ValueError, TypeError, RecursionError):
        return None
    return None


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= LARGEST:
        raise ValueError
    return float(value)


def _pairs(rows: Any) -> Float:
    if not isinstance(rows, list) or not 0 < len(rows) <= MOST_POINTS:
        raise ValueError
    if any(not isinstance(row, list) or len(row) != 2 for row in rows):
        raise ValueError
    return np.array([[_number(value) for value in row] for row in rows])
