r"""Colours that change over a film: by a number at every vertex.

- **error**: distance from the same vertex of an original at the same time, :math:`|A_{tv} - B_{tv}| / d`, in diagonals.
- **strain**: mean over the edges of a vertex of :math:`|l / \bar l - 1|`, with :math:`\bar l` their lengths in the
  first frame of the film.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol, get_args

import numpy as np

from mixseq.errors import SettingsError
from mixseq.geometry.lengths_angles import edge_lengths
from mixseq.plots.camera import Array
from mixseq.plots.layout import matplotlib_module
from mixseq.plots.video.timing import Track
from mixseq.sequence import IntArray, bounding_diagonal
from mixseq.topology import Topology

Colour = Literal["clay", "parts", "error", "strain"]
COLOURS: tuple[Colour, ...] = get_args(Colour)

SMALLEST = 1e-12
"""The colour scale goes at least so far: rounding has no colours."""


class Measure(Protocol):
    """A number at every vertex."""

    def __call__(self, points: Array, frame: int) -> Array:
        """Return numbers ``(V,)`` of the pose that a frame of the film shows."""

    def largest(self, values: Array) -> float:
        """Return what of a frame's numbers the colour scale must reach."""


@dataclass(frozen=True, eq=False)
class Strain:
    """Strain against a pose.

    Attributes
    ----------
    edges : (E, 2) int
        Edges of the mesh.
    lengths : (E,) float
        Their lengths in that pose.
    """

    edges: IntArray
    lengths: Array

    @classmethod
    def of(cls, track: Track) -> Strain:
        """Measure against the first frame of a film."""
        edges = Topology(track.header.faces, track.header.vertex_count).edges
        return cls(edges, edge_lengths(track.pose(0), edges))

    def __call__(self, points: Array, frame: int) -> Array:
        """Return strains ``(V,)``; edges without a length count as not strained."""
        now = edge_lengths(points, self.edges)
        known = self.lengths > 0
        strain = np.abs(np.divide(now, self.lengths, out=np.ones_like(now), where=known) - 1)
        ends, count = self.edges.ravel(), len(points)
        sums = np.bincount(ends, np.repeat(strain, 2), count)
        return np.asarray(sums / np.maximum(np.bincount(ends, minlength=count), 1))

    def largest(self, values: Array) -> float:
        """Leave out a hundredth: one sliver should not darken all others."""
        return float(np.quantile(values, 0.99))


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

    def __call__(self, points: Array, frame: int) -> Array:
        """Return distances ``(V,)`` in diagonals of the original's first frame."""
        return np.asarray(np.linalg.norm(points - self.original.pose(frame), axis=1) / self.unit)

    def largest(self, values: Array) -> float:
        """All count."""
        return float(values.max())


def colour_scale() -> Array:
    """Return the colours ``(256, 3)`` from zero to the largest number, as those of the errors on paper."""
    scale = matplotlib_module("cm").ScalarMappable(None, "viridis").get_cmap()
    return np.asarray(scale(np.arange(256))[:, :3], dtype=np.float64)
