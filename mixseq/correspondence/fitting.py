"""What pulls a source to a target: markers, and closest points both ways, among components that belong together."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mixseq.arrays import Float, Index
from mixseq.correspondence.energy import Pull
from mixseq.correspondence.markers import Markers
from mixseq.correspondence.pairing import Pairing
from mixseq.correspondence.surfaces import Part, Surface
from mixseq.topology import Topology


@dataclass(frozen=True, eq=False)
class Fitting:
    """The components of a source that are fitted, as a mesh of their own, and where they go.

    Attributes
    ----------
    vertices : (n,) int64
        Its vertices, ascending, as numbered in the source.
    surface : Surface
        That mesh before it is deformed.
    target : Surface
        The target.
    pairings : tuple of Pairing
        What belongs together, with the source's vertices and triangles numbered as in that mesh.
    held : Pull
        The markers.
    """

    vertices: Index
    surface: Surface
    target: Surface
    pairings: tuple[Pairing, ...]
    held: Pull

    @classmethod
    def of(
        cls,
        source: Surface,
        target: Surface,
        pairings: tuple[Pairing, ...],
        markers: Markers,
        strength: float,
    ) -> Fitting:
        """Cut out of a source what belongs to the target; all markers together pull with a strength."""
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
        held = Pull(
            row[markers.source][:, None],
            np.ones((len(markers), 1)),
            target.points[markers.target],
            np.full(len(markers), strength / len(markers)),
        )
        return cls(vertices, Surface(source.points[vertices], topology), target, own, held)

    @cached_property
    def _goals(self) -> list[Part]:
        """Where the closest points of every pairing are."""
        return [Part(self.target, pairing.target_faces) for pairing in self.pairings]

    @cached_property
    def _areas(self) -> tuple[Float, Float]:
        """Areas about the vertices of the fitted mesh and of the target; each adds to one."""
        own, there = self.surface.vertex_areas, self.target.vertex_areas
        return own / own.sum(), there / there.sum()

    def pulls(self, points: Float, largest_angle: float, reach: float) -> tuple[list[Pull], float]:
        """Find what pulls when the mesh is at some points.

        Parameters
        ----------
        points : (n, 3) float64
            Where its vertices are now.
        largest_angle : float
            Largest angle between normals, in degrees.
        reach : float
            Largest distance.

        Returns
        -------
        pulls : list of Pull
        residual : float
            Root mean square distance of the mesh's vertices, by area, from what pulls them; 0 if nothing does.
        """
        moved, target = Surface(points, self.surface.topology), self.target
        own_areas, areas = self._areas
        result, squares, total = [self.held], 0.0, 0.0
        for pairing, goal in zip(self.pairings, self._goals, strict=True):
            own = pairing.source_vertices
            found = goal.closest(points[own], moved.vertex_normals[own], largest_angle)
            near = np.flatnonzero(found.distances <= reach)
            goals, strengths = target.between(found.faces[near], found.weights[near]), own_areas[own[near]]
            result.append(Pull(own[near][:, None], np.ones((len(near), 1)), goals, strengths))
            squares += float(np.sum(strengths * found.distances[near] ** 2))
            total += float(np.sum(strengths))

            there, part = pairing.target_vertices, Part(moved, pairing.source_faces)
            found = part.closest(target.points[there], target.vertex_normals[there], largest_angle)
            near = np.flatnonzero(found.distances <= reach)
            corners, goals = moved.faces[found.faces[near]], target.points[there[near]]
            result.append(Pull(corners, found.weights[near], goals, areas[there[near]]))
        return result, float(np.sqrt(squares / total)) if total > 0 else 0.0
