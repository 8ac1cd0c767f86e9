"""Examine markers while they are set: their consistency, and a map that is found in a second.

The map is that of `correspond`, between decimated meshes and stopped while still stiff: then it cannot reach
inconsistent markers, and its distance from them is their residual. The full map reaches all.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np

from mixseq.arrays import Float, Index, IntArray
from mixseq.correspondence.checks import Suspicion, suspicions
from mixseq.correspondence.correspond import CorrespondenceSettings, correspond_and_assess
from mixseq.correspondence.decimation import decimate
from mixseq.correspondence.markers import Markers
from mixseq.correspondence.registration import RegistrationSettings
from mixseq.errors import MixseqWarning, SettingsError
from mixseq.sequence import MeshSequence

FEWEST = 10
"""Least number of markers for a map with meaningful residuals."""

COUNT = 1200
"""Number of vertices of the decimated meshes."""

STIFF = CorrespondenceSettings(RegistrationSettings(softest=1e-2, steps=5))


@dataclass(frozen=True, eq=False)
class Examination:
    """Results of examining markers."""

    suspicions: tuple[Suspicion, ...] = ()  # markers inconsistent with the others
    # (n,) how far a stiff map stays from every marker, in diagonals of the target; none if there are fewer than ten, or
    # no map was found.
    residuals: Float | None = None
    coverage: float = 0.0  # share of the target's area covered by the map
    refusal: str = ""  # why there is no map; empty otherwise

    @property
    def suspects(self) -> frozenset[int]:
        """Numbers of the markers that do not fit the others."""
        return frozenset(int(number) for each in self.suspicions for number in each.numbers)


def examine(source: MeshSequence, target: MeshSequence, markers: Markers) -> Examination:
    """Examine markers of two meshes, each in its first frame; problems are returned, not raised."""
    x, y = (np.asarray(each.points[0], np.float64) for each in (source, target))
    diagonal = float(np.linalg.norm(np.ptp(y, axis=0)))
    found = tuple(suspicions(markers, x[markers.source], y[markers.target], diagonal))
    if len(markers) < FEWEST:
        return Examination(found)
    own, first = _thinned(x, source.faces, np.unique(markers.source))
    other, second = _thinned(y, target.faces, np.unique(markers.target))
    coarse = Markers(np.searchsorted(own, markers.source), np.searchsorted(other, markers.target))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MixseqWarning)  # suspicions are reported, and the map is a stiff one
        try:
            quality = correspond_and_assess(first, second, coarse, settings=STIFF).quality
        except SettingsError as error:
            return Examination(found, refusal=str(error))
    return Examination(found, quality.marker_distances, quality.target_coverage)


def _thinned(points: Float, faces: IntArray, keep: Index) -> tuple[Index, MeshSequence]:
    """Return the remaining vertices ``(n,)`` of a mesh, and a mesh of them."""
    kept, coarse = decimate(points, faces.astype(np.int64), COUNT, keep)
    return kept, MeshSequence.from_arrays(points[None, kept], coarse)
