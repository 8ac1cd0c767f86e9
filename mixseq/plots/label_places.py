"""Placement of labels clear of curves and of each other."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mixseq.arrays import Float
from mixseq.scene.camera import Limits

POINTS = 72.0  # per inch
DISTANCE = 12.0
"""Distance from a dot to the middle of its label, in points."""

ENOUGH = 5.0
"""Room around a label, in points, above which outward places are preferred."""

_CHARACTER = np.array([2.6, 5.0])  # half the width of a character and half the height of a line, in points


def free_places(
    dots: Float, texts: Sequence[str], curve: Float, limits: Limits, inch: float
) -> list[tuple[float, float]]:
    """Find free label places beside dots, preferably outward: dots ``(n, 2)``; curve ``(N, 2)``; limits ``(4,)``."""
    scale = POINTS / inch
    low, high = np.reshape(limits, (2, 2)).T * scale
    centre = curve.mean(axis=0) * scale
    angles = np.arange(16) * np.pi / 8
    compass = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    taken: list[tuple[Float, Float]] = []  # middles and half sizes
    places = []
    for dot, text in zip(dots * scale, texts, strict=True):
        size = _CHARACTER * [len(text), 1]
        offsets = compass * [DISTANCE + size[0] - _CHARACTER[0], DISTANCE]
        middles = dot + offsets
        room = _gaps(middles, size, curve * scale).min(axis=1)
        inside = np.minimum(middles - size - low, high - middles - size).min(axis=1)
        room = np.minimum(room, inside)
        for other, extent in taken:
            room = np.minimum(room, _gaps(middles, size + extent, other[None])[:, 0])
        outward = (compass @ (dot - centre)) / (np.linalg.norm(dot - centre) or 1.0)
        best = int((np.minimum(room, ENOUGH) + outward).argmax())
        taken.append((middles[best], size))
        places.append((float(offsets[best, 0]), float(offsets[best, 1])))
    return places


def _gaps(middles: Float, size: Float, points: Float) -> Float:
    """Return distances ``(n, N)`` of points from boxes of a half size; negative inside."""
    apart = np.abs(points[None] - middles[:, None]) - size
    return np.asarray(apart.max(axis=2))
