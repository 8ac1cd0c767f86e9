"""Measure how good a correspondence is: coverage, distances, flipped triangles, markers that were missed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mixseq.arrays import Float
from mixseq.correspondence.markers import Markers, Pairing
from mixseq.correspondence.matching import Matches, MatchingSettings
from mixseq.correspondence.triangle_mesh import ClosestPoints, TriangleMesh


@dataclass(frozen=True, eq=False)
class Quality:
    """How good a correspondence is. Distances are in diagonals of the target.

    Attributes
    ----------
    source_coverage : float
        Share of the source's area that, registered, lies on the target: within the distance and the angle of matches.
    target_coverage : float
        Share of the target's area whose triangles found a match themselves.
    mean, p99, largest : float
        Distances of the target's vertices from the registered source: mean, 99th percentile, maximum.
    flipped : int
        Triangles of the target whose normal is against that of their triangle of the registered source.
    filled_vertices, filled_faces : int
        How many took over the match of a neighbour.
    followers : int
        Components of the target that follow a vertex; vertices that no triangle uses are none.
    marker_distances : (n,) float64
        Distances of marked vertices of the registered source from the vertices of the target that they should be at.
    markers : Markers
        The markers.
    """

    source_coverage: float
    target_coverage: float
    mean: float
    p99: float
    largest: float
    flipped: int
    filled_vertices: int
    filled_faces: int
    followers: int
    marker_distances: Float
    markers: Markers

    def worst_markers(self, count: int = 5) -> list[tuple[str, float]]:
        """Names and distances of the markers that were missed by most, the worst first."""
        order = np.argsort(-self.marker_distances, kind="stable")[:count]
        return [(self.markers.name(int(k)), float(self.marker_distances[k])) for k in order]


def assess(
    registered: TriangleMesh,
    target: TriangleMesh,
    pairings: tuple[Pairing, ...],
    markers: Markers,
    matches: Matches,
    settings: MatchingSettings,
) -> Quality:
    """Measure a correspondence that was found by `match` with these settings."""
    size = target.diagonal
    correspondence = matches.correspondence
    covered = 0.0
    for pairing in pairings:
        own = pairing.source_faces
        goal = ClosestPoints(target, pairing.target_faces)
        found = goal.query(registered.centroids[own], registered.face_normals[own], settings.largest_angle)
        near = found.distances <= settings.largest_distance * size
        covered += float(registered.face_areas[own[near]].sum())
    # One zero if nothing was found, which the coverage tells.
    distances = (
        matches.distances[matches.found_vertices] / size if matches.found_vertices.any() else np.zeros(1)
    )
    mapped = correspondence.faces >= 0
    cosines = np.einsum(
        "fc,fc->f", target.face_normals[mapped], registered.face_normals[correspondence.faces[mapped]]
    )
    first = target.faces[:, 0]
    following = target.topology.component_of_vertex[first[~correspondence.matched[first]]]
    gaps = registered.points[markers.source] - target.points[markers.target]
    return Quality(
        covered / max(float(registered.face_areas.sum()), 1e-300),
        float(target.face_areas[matches.found_faces].sum() / max(float(target.face_areas.sum()), 1e-300)),
        float(distances.mean()),
        float(np.percentile(distances, 99)),
        float(distances.max()),
        int((cosines < 0).sum()),
        int((correspondence.matched & ~matches.found_vertices).sum()),
        int((mapped & ~matches.found_faces).sum()),
        len(np.unique(following)),
        np.linalg.norm(gaps, axis=1) / size,
        markers,
    )
