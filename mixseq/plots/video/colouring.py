"""Colours that change over a film: by a number at every vertex, against the first frame or against an original.

What the numbers are tells `mixseq.plots.measures`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol, get_args

import numpy as np

from mixseq.arrays import Float
from mixseq.errors import SettingsError
from mixseq.plots.layout import matplotlib_module
from mixseq.plots.measures import MEASURES, Measure, distances
from mixseq.plots.video.timing import Track
from mixseq.sequence import bounding_diagonal

Colour = Literal["clay", "parts", "error", "strain", "curvature"]
COLOURS: tuple[Colour, ...] = get_args(Colour)

SMALLEST = 1e-12
"""The colour scale goes at least so far: rounding has no colours."""


class Timed(Protocol):
    """A number at every vertex, which may depend on the frame of the film."""

    def __call__(self, points: Float, frame: int) -> Float:
        """Return numbers ``(V,)`` of the pose that a frame of the film shows."""

    def largest(self, values: Float) -> float:
        """Return what of a frame's numbers the colour scale must reach."""


@dataclass(frozen=True, eq=False)
class Change:
    """What a measure finds since the first frame of a film.

    Attributes
    ----------
    measure : Measure
        Measures against that frame.
    """

    measure: Measure

    @classmethod
    def of(cls, track: Track, colour: str) -> Change:
        """Measure what a colour of `MEASURES` shows."""
        return cls(MEASURES[colour].of(track.pose(0), track.header.faces))

    def __call__(self, points: Float, frame: int) -> Float:
        """Return numbers ``(V,)``; the pose alone decides."""
        return self.measure(points)

    def largest(self, values: Float) -> float:
        """Return what the measure takes for the largest."""
        return self.measure.largest(values)


@dataclass(frozen=True, eq=False)
class Error:
    """Distance from an original.

    Attributes
    ----------
    original : Track
        The original in the same film.
    unit : float
        Its diagonal.
    """

    original: Track
    unit: float

    @classmethod
    def of(cls, track: Track, original: Track, name: str) -> Error:
        """Measure the errors of a track.

        Raises
        ------
        SettingsError
            If it is another mesh; `name` is what it is called.
        """
        if not np.array_equal(track.header.faces, original.header.faces) or (
            track.header.vertex_count != original.header.vertex_count
        ):
            raise SettingsError(
                f"{name} has {len(track.header.faces)} triangles of {track.header.vertex_count} vertices, the original "
                f"{len(original.header.faces)} of {original.header.vertex_count}, or in another order; errors need one "
                "mesh"
            )
        return cls(original, bounding_diagonal(original.poses[0:1][0]) or 1.0)

    def __call__(self, points: Float, frame: int) -> Float:
        """Return distances ``(V,)`` in diagonals of the original's first frame."""
        return distances(points, self.original.pose(frame), self.unit)

    def largest(self, values: Float) -> float:
        """All count."""
        return float(values.max())


def colour_scale() -> Float:
    """Return the colours ``(256, 3)`` from zero to the largest number, as those of the errors on paper."""
    scale = matplotlib_module("cm").ScalarMappable(None, "viridis").get_cmap()
    return np.asarray(scale(np.arange(256))[:, :3], dtype=np.float64)
