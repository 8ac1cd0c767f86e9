r"""Extremities of a body: tips of limbs, tail, nose and ears, the maxima of the mean distance along the surface.

The area-weighted mean distance along the surface to all of it (Hilaga et al. 2001) is least in the trunk and has a
maximum at every tip, in any pose. Its *prominence*, as of a summit, is the least descent on the way to a higher one
(0-dimensional persistence; Edelsbrunner, Letscher and Zomorodian 2002). The surroundings of an extremity have a heat
kernel signature (Sun, Ovsjanikov and Guibas 2009),

.. math:: h_t(v) = \sum_{i \ge 1} e^{-2 t \lambda_i} \phi_i(v)^2 .
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mixseq.arrays import Float, Index
from mixseq.correspondence.coarse_surface import CoarseSurface
from mixseq.segmentation.diffusion import Diffusion

SAMPLES = 100
"""Number of far-apart points for the mean distance."""

LEAST = 0.004
"""Prominence, in roots of the area, below which a maximum may be noise; ears have 0.006 to 0.05."""

HEAT_TIMES = np.geomspace(0.002, 0.1, 6)
"""Times of heat kernel signatures, in units of the area: from ears to limbs."""

FALL, FLAT = 0.01, 0.25
"""Fall of the mean distance at which an extremity ends, and the search radius for it."""

EIGENVECTORS = 80
"""Number of eigenvectors of signatures; later ones have decayed at the first of the times."""


@dataclass(frozen=True, eq=False)
class Extremities:
    """Extremities of a surface, the most prominent first."""

    vertices: Index  # (e,) where they are, as numbered in the mesh
    points: Float  # (e, 3) the same, in the unit of the coarse surface
    prominences: Float  # (e,) their prominences; all lengths are in roots of the area
    # (e,) how far from it the mean distance is as large but for 0.01: 0.02 to 0.07 of a hoof; a round head has more, so
    # that where its tip is remains open.
    radii: Float
    distances: Float  # (e, e) distances along the surface between them
    signatures: Float  # (e, 6) logarithms of their heat kernel signatures

    @classmethod
    def of(cls, surface: CoarseSurface) -> Extremities:
        """Find the extremities of a surface."""
        values = mean_distance(surface)
        peaks, prominences = maxima(values, surface)
        peaks, prominences = peaks[prominences >= LEAST], prominences[prominences >= LEAST]
        diffusion = Diffusion(surface.points, surface.mesh.topology)
        signatures = np.log(diffusion.heat_kernel(HEAT_TIMES, EIGENVECTORS)[peaks])
        distances = surface.distances(peaks)
        flat = (values >= values[peaks, None] - FALL) & (distances < FLAT)
        radii = np.where(flat, distances, 0.0).max(axis=1)
        places = surface.vertices[peaks], surface.points[peaks]
        return cls(*places, prominences, radii, distances[:, peaks], signatures)


def far_apart(surface: CoarseSurface, count: int) -> tuple[Index, Float]:
    """Choose vertices ``(k,)`` far from each other (Gonzalez 1985), with their distances ``(k, n)``."""
    sample = int(surface.distances(np.array([0]))[0].argmax())
    samples: list[int] = []
    rows: list[Float] = []
    nearest = np.full(len(surface.vertices), np.inf)
    for _ in range(min(count, len(surface.vertices))):
        samples.append(sample)
        rows.append(surface.distances(np.array([sample]))[0])
        nearest = np.minimum(nearest, rows[-1])
        sample = int(nearest.argmax())
    return np.array(samples), np.array(rows)


def mean_distance(surface: CoarseSurface) -> Float:
    """Return the mean distance ``(n,)`` of every vertex along a surface to all of it."""
    distances = far_apart(surface, SAMPLES)[1]
    areas = np.bincount(distances.argmin(axis=0), surface.mesh.vertex_areas, len(distances))
    return np.asarray(areas @ distances / areas.sum())


def maxima(values: Float, surface: CoarseSurface) -> tuple[Index, Float]:
    """Find the maxima ``(m,)`` of values ``(n,)`` on a surface, with their prominences ``(m,)``."""
    adjacency = surface.mesh.topology.vertex_adjacency.tocsr()
    peak = np.full(len(values), -1)  # of the island that a vertex is on, while the sea falls
    islands: dict[int, list[int]] = {}
    found: list[tuple[int, float]] = []
    for vertex in np.argsort(-values, kind="stable").tolist():
        around = adjacency.indices[adjacency.indptr[vertex] : adjacency.indptr[vertex + 1]]
        joined = sorted({int(each) for each in peak[around] if each >= 0}, key=lambda each: -values[each])
        highest = joined[0] if joined else vertex
        islands.setdefault(highest, []).append(vertex)
        peak[vertex] = highest
        for lower in joined[1:]:
            found.append((lower, float(values[lower] - values[vertex])))
            members = islands.pop(lower)
            peak[members] = highest
            islands[highest] += members
    found += [(highest, float(values[highest] - values.min())) for highest in islands]
    found.sort(key=lambda each: (-each[1], each[0]))
    return np.array([vertex for vertex, _ in found]), np.array([prominence for _, prominence in found])
