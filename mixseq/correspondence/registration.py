"""Deform a source mesh onto a target, guided by markers: non-rigid registration.

First the similarity between the markers (Umeyama 1991); then the `Energy` of a deformation is minimised for falling
stiffness (Amberg, Romdhani, Vetter 2007, *Optimal Step Nonrigid ICP Algorithms for Surface Registration*), with

- the markers, first alone, then all the time;
- every source vertex drawn to the closest point of the target that faces the same way;
- the closest such point of the source drawn to every target vertex, so that long features (humps, ears, hooves) are
  covered too.

On horse to camel and cat to lion this takes as long as trimesh's `nricp_sumner` and a quarter of the time of its
`nricp_amberg`, leaves a sixth of their distances, and supports components.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mixseq.arrays import Float, Index
from mixseq.correspondence.energy import Energy, SoftConstraints
from mixseq.correspondence.markers import Markers, Pairing, Similarity, fit_similarity
from mixseq.correspondence.triangle_mesh import ClosestPoints, TriangleMesh
from mixseq.errors import SettingsError
from mixseq.progress import Progress, silent
from mixseq.topology import Topology

_BEGINNING = 3  # minimisations with markers alone: similarities follow from the maps before


@dataclass(frozen=True)
class RegistrationSettings:
    """Settings of registration, tried on horse to camel and cat to lion; none is critical."""

    stiffest: float = 1.0  # first stiffness
    softest: float = 1e-5  # last stiffness
    steps: int = 10  # number of stiffnesses, evenly spaced in their logarithm
    rounds: int = 2  # rounds of closest points per stiffness
    bending: float = 0.1  # length over which maps are alike, in diagonals of the target
    shear: float = 0.1  # weight of similarities against affine maps
    markers: float = 1.0  # weight of all markers together; that of either surface is 1
    largest_angle: float = 60.0  # closest points whose normals differ by more, in degrees, do not count
    largest_distance: float = 0.1  # search radius at the first stiffness, in diagonals of the target
    last_distance: float = 0.02  # search radius at the last stiffness, in diagonals of the target

    def __post_init__(self) -> None:
        positive = ("softest", "steps", "rounds", "bending", "shear", "markers", "last_distance")
        for name in positive:
            if not getattr(self, name) > 0:
                raise SettingsError(f"{name} of a registration is {getattr(self, name)}; it must be positive")
        for small, large in (("softest", "stiffest"), ("last_distance", "largest_distance")):
            if getattr(self, small) > getattr(self, large):
                raise SettingsError(f"{small} of a registration is above its {large}; exchange them")
        if not 0 < self.largest_angle <= 180:
            raise SettingsError(f"the largest angle is {self.largest_angle}; give degrees from 0 to 180")


@dataclass(frozen=True, eq=False)
class Registration:
    """A source deformed onto a target."""

    points: Float  # (V, 3) the source's vertices, deformed, in the target's unit
    similarity: Similarity  # the initial similarity
    # (steps * rounds,) root mean square of the distances of source vertices to what drew them, in diagonals of the
    # target.
    residuals: Float


def register(
    source: TriangleMesh,
    target: TriangleMesh,
    pairings: tuple[Pairing, ...],
    markers: Markers,
    settings: RegistrationSettings | None = None,
    progress: Progress = silent,
) -> Registration:
    """Deform a source onto a target in a similar pose, component by component as paired.

    Unpaired components move with the affine map of the nearest paired vertex. Markers must be on triangles.
    """
    settings = RegistrationSettings() if settings is None else settings
    similarity = fit_similarity(source.points[markers.source], target.points[markers.target])
    # In diagonals of the target, about its centre: far from the origin digits would be lost.
    size, centre = target.diagonal, target.centroids.mean(axis=0)
    moved = TriangleMesh((similarity(source.points) - centre) / size, source.topology)
    goal = TriangleMesh((target.points - centre) / size, target.topology)
    fit = DataTerm.of(moved, goal, pairings, markers, settings.markers)
    energy = Energy(fit.mesh, settings.bending, settings.shear)
    maps = np.broadcast_to(np.eye(3), (len(fit.vertices), 3, 3))
    rounds = settings.steps * settings.rounds
    work = _BEGINNING + rounds
    for k in range(_BEGINNING):
        progress(k, work, "registering")
        points, maps = energy.minimise(settings.stiffest, maps, [fit.markers])
    residuals = []
    strengths = np.geomspace(settings.stiffest, settings.softest, settings.steps)
    reaches = np.linspace(settings.largest_distance, settings.last_distance, settings.steps)
    for k in range(rounds):
        progress(_BEGINNING + k, work, "registering")
        step = k // settings.rounds
        constraints, residual = fit.constraints(points, settings.largest_angle, float(reaches[step]))
        points, maps = energy.minimise(float(strengths[step]), maps, constraints)
        residuals.append(residual)
    progress(work, work, "registering")
    whole = _with_the_rest(moved, fit.vertices, points, maps)
    return Registration(whole * size + centre, similarity, np.array(residuals))


def _with_the_rest(source: TriangleMesh, vertices: Index, points: Float, maps: Float) -> Float:
    """Return all vertices ``(V, 3)``; unfitted components move with the map of the nearest fitted vertex."""
    x = source.points
    result = x.copy()
    result[vertices] = points
    others = np.setdiff1d(np.arange(len(x)), vertices)
    nearest = source.nearest_by_component(others, vertices)
    k = np.searchsorted(vertices, nearest)
    result[others] = points[k] + np.einsum("nij,nj->ni", maps[k], x[others] - x[nearest])
    return result


@dataclass(frozen=True, eq=False)
class DataTerm:
    """The fitted components of a source as a mesh of their own, and constraints that draw them to the target."""

    vertices: Index  # (n,) its vertices, ascending, as numbered in the source
    mesh: TriangleMesh  # that mesh before its deformation
    target: TriangleMesh  # the target
    # What belongs together, with the source's vertices and triangles numbered as in that mesh.
    pairings: tuple[Pairing, ...]
    markers: SoftConstraints  # the markers

    @classmethod
    def of(
        cls,
        source: TriangleMesh,
        target: TriangleMesh,
        pairings: tuple[Pairing, ...],
        markers: Markers,
        weight: float,
    ) -> DataTerm:
        """Select the paired components of a source; the weight is that of all markers together."""
        vertices = np.unique(np.concatenate([p.source_vertices for p in pairings]))
        row = np.full(len(source.points), -1)
        row[vertices] = np.arange(len(vertices))
        chosen = np.unique(np.concatenate([p.source_faces for p in pairings]))
        topology = Topology(row[source.faces[chosen]], len(vertices))
        own = tuple(
            Pairing(
                np.searchsorted(chosen, p.source_faces),
                p.target_faces,
                row[p.source_vertices],
                p.target_vertices,
            )
            for p in pairings
        )
        held = SoftConstraints(
            row[markers.source][:, None],
            np.ones((len(markers), 1)),
            target.points[markers.target],
            np.full(len(markers), weight / len(markers)),
        )
        return cls(vertices, TriangleMesh(source.points[vertices], topology), target, own, held)

    @cached_property
    def _goals(self) -> list[ClosestPoints]:
        """Closest-point queries of every pairing."""
        return [ClosestPoints(self.target, pairing.target_faces) for pairing in self.pairings]

    @cached_property
    def _areas(self) -> tuple[Float, Float]:
        """Areas about the vertices of the fitted mesh and of the target; each adds to one."""
        own, there = self.mesh.vertex_areas, self.target.vertex_areas
        return own / own.sum(), there / there.sum()

    def constraints(
        self, points: Float, largest_angle: float, reach: float
    ) -> tuple[list[SoftConstraints], float]:
        """Return constraints of the mesh at points ``(n, 3)``: markers, and closest points both ways."""
        moved, target = TriangleMesh(points, self.mesh.topology), self.target
        own_areas, areas = self._areas
        result, squares, total = [self.markers], 0.0, 0.0
        for pairing, goal in zip(self.pairings, self._goals, strict=True):
            own = pairing.source_vertices
            found = goal.query(points[own], moved.vertex_normals[own], largest_angle)
            near = np.flatnonzero(found.distances <= reach)
            goals, weights = target.points_on(found.faces[near], found.weights[near]), own_areas[own[near]]
            result.append(SoftConstraints(own[near][:, None], np.ones((len(near), 1)), goals, weights))
            squares += float(np.sum(weights * found.distances[near] ** 2))
            total += float(np.sum(weights))

            there, search = pairing.target_vertices, ClosestPoints(moved, pairing.source_faces)
            found = search.query(target.points[there], target.vertex_normals[there], largest_angle)
            near = np.flatnonzero(found.distances <= reach)
            corners, goals = moved.faces[found.faces[near]], target.points[there[near]]
            result.append(SoftConstraints(corners, found.weights[near], goals, areas[there[near]]))
        return result, float(np.sqrt(squares / total)) if total > 0 else 0.0
