"""Boundaries between neighbouring parts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mixseq.arrays import Float, FloatArray, Index, IntArray, Mask
from mixseq.topology import Topology


@dataclass(frozen=True, eq=False)
class Boundaries:
    """The boundaries between n pairs of neighbouring parts."""

    parts: Index  # (n, 2) the parts i < j
    edges: Index  # (k, 2) vertices of the edges between faces of two parts
    pair: Index  # (k,) the pair of parts of each edge

    @classmethod
    def of(cls, topology: Topology, part_of_face: Index) -> Boundaries:
        """Find the boundaries between the parts ``(F,)`` of faces: hinges between faces of two parts."""
        sides = np.sort(part_of_face[topology.hinge_faces], axis=1)
        across = sides[:, 0] != sides[:, 1]
        parts, pair = np.unique(sides[across], axis=0, return_inverse=True)
        edges = topology.edges[topology.hinge_edges[across]]
        return cls(parts.astype(np.int64).reshape(-1, 2), edges, pair.reshape(-1))

    def middles(self, frame: FloatArray) -> Float:
        """Return the middles ``(n, 3)`` of the boundaries in a frame ``(V, 3)``: means of edge midpoints."""
        middles = frame[self.edges].mean(axis=1)
        sums = [np.bincount(self.pair, column, minlength=len(self.parts)) for column in middles.T]
        return np.stack(sums, axis=1) / np.bincount(self.pair, minlength=len(self.parts))[:, None]


@dataclass(frozen=True, eq=False)
class Rim:
    """Edges and faces near the boundaries of patches."""

    vertex_count: int  # number of vertices of the mesh
    ends: Index  # (n, 2) vertices of the boundary edges
    sides: Index  # (n, 2) faces beside the boundary edges
    edges: Index  # (m, 2) edges with an end on a boundary
    faces: Index  # (k,) faces with a corner on a boundary or one edge away
    corners: IntArray  # (k, 3) vertices of these faces

    @classmethod
    def of(cls, topology: Topology, patches: Index) -> Rim:
        """Find the rim of patches ``(F,)`` of faces."""
        of_hinge = patches[topology.hinge_faces]
        across = of_hinge[:, 0] != of_hinge[:, 1]
        ends = topology.edges[topology.hinge_edges[across]]
        edges = topology.edges[_marked(ends, topology.vertex_count)[topology.edges].any(axis=1)]
        faces = np.flatnonzero(_marked(edges, topology.vertex_count)[topology.faces].any(axis=1))
        sides, corners = topology.hinge_faces[across], topology.faces[faces]
        return cls(topology.vertex_count, ends, sides, edges, faces, corners)

    def narrowness(self, patches: Index) -> Float:
        """Return the share of each patch's corners on its boundary or one edge away: patches ``(F,)``, also merged."""
        across = patches[self.sides]
        boundary = _marked(self.ends[across[:, 0] != across[:, 1]], self.vertex_count)
        near = _marked(self.edges[boundary[self.edges].any(axis=1)], self.vertex_count)
        sizes = np.bincount(patches)
        shares = np.bincount(patches[self.faces], near[self.corners].sum(axis=1) / 3.0, minlength=len(sizes))
        return np.asarray(shares / np.maximum(sizes, 1), dtype=np.float64)


def _marked(some: Index, count: int) -> Mask:
    """Return a mask ``(count,)`` of vertices."""
    marks = np.zeros(count, dtype=bool)
    marks[some] = True
    return marks
