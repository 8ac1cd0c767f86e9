"""A coarse copy of a mesh for quick distances along the surface.

Its vertices are vertices of the mesh, those of the decimated largest component. It is centred and has unit area, so
that lengths on two meshes are comparable in any units.

Distances are along edges, and across hinges: from the vertex opposite in one face straight to that of the other, both
unfolded into a plane. Edges alone overestimate by up to an eighth more.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from mixseq.arrays import Float, FloatArray, Index
from mixseq.correspondence.decimation import decimate
from mixseq.correspondence.triangle_mesh import TriangleMesh
from mixseq.errors import SettingsError
from mixseq.topology import Topology

COUNT = 2500
"""Number of vertices of coarse surfaces; of a horse's ears some 20 remain."""


@dataclass(frozen=True, eq=False)
class CoarseSurface:
    """The decimated largest component of a mesh, with unit area."""

    vertices: Index  # (n,) its vertices, as numbered in the mesh
    mesh: TriangleMesh  # the surface
    centre: Float  # (3,) where its origin is, in the mesh's unit
    size: float  # the mesh's units to one of its own

    @classmethod
    def of(cls, points: FloatArray, topology: Topology, count: int = COUNT) -> CoarseSurface:
        """Decimate the component of points ``(V, 3)`` with the largest area."""
        x = np.asarray(points, np.float64)
        areas = TriangleMesh(x, topology).face_areas
        if not areas.sum() > 0:
            raise SettingsError("no triangle of the mesh has an area; tips and limbs are those of surfaces")
        component = topology.component_of_face
        largest = component == np.bincount(component, areas).argmax()
        own, faces = np.unique(topology.faces[largest].astype(np.int64), return_inverse=True)
        faces = faces.reshape(-1, 3)
        if len(own) > count:
            kept, faces = decimate(x[own], faces, count)
            own = own[kept]
        mesh = TriangleMesh(x[own], Topology(faces, len(own)))
        centre = mesh.face_areas @ mesh.centroids / mesh.face_areas.sum()
        size = float(np.sqrt(mesh.face_areas.sum()))
        return cls(own, TriangleMesh((x[own] - centre) / size, mesh.topology), centre, size)

    @property
    def points(self) -> Float:
        """Points ``(n, 3)`` of the surface, centred, with unit area."""
        return self.mesh.points

    def distances(self, vertices: Index) -> Float:
        """Return distances ``(k, n)`` along the surface from vertices ``(k,)`` to all."""
        return np.asarray(csgraph.dijkstra(self._graph, directed=False, indices=vertices))

    @cached_property
    def _graph(self) -> sparse.csr_array:
        x, topology = self.points, self.mesh.topology
        a, b, c, d = topology.hinges.T
        along = x[b] - x[a]
        length = np.linalg.norm(along, axis=1)
        along = along / np.maximum(length, np.finfo(float).tiny)[:, None]
        # Both opposite vertices in the plane of the unfolded hinge: along its edge, and away from it.
        at_c, at_d = (np.einsum("hi,hi->h", x[e] - x[a], along) for e in (c, d))
        off_c, off_d = (
            np.linalg.norm(x[e] - x[a] - at[:, None] * along, axis=1) for e, at in ((c, at_c), (d, at_d))
        )
        crossing = at_c + (at_d - at_c) * off_c / np.maximum(off_c + off_d, np.finfo(float).tiny)
        inside = (crossing >= 0) & (crossing <= length)
        across = np.hypot(at_d - at_c, off_c + off_d)[inside]
        ends = np.concatenate([topology.edges, np.stack([c, d], axis=1)[inside]])
        lengths = np.concatenate([np.sqrt(self.mesh.squared_lengths), across])
        # Stored zeros are no edges to csgraph, and of two ways between the same vertices the shorter counts.
        lengths = np.maximum(lengths, 1e-12)
        ends.sort(axis=1)
        order = np.lexsort((lengths, ends[:, 1], ends[:, 0]))
        ends, first = np.unique(ends[order], axis=0, return_index=True)
        return sparse.csr_array((lengths[order][first], (ends[:, 0], ends[:, 1])), shape=2 * (len(x),))
