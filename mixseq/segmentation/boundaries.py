"""Where neighbouring parts meet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mixseq.arrays import Float, FloatArray, Index
from mixseq.topology import Topology


@dataclass(frozen=True, eq=False)
class Boundaries:
    """The boundaries between n pairs of neighbouring parts.

    Attributes
    ----------
    parts : (n, 2) int64
        The parts i < j.
    edges : (k, 2) int64
        Vertices of the edges between faces of two parts.
    pair : (k,) int64
        The pair of parts that each edge is between.
    """

    parts: Index
    edges: Index
    pair: Index

    @classmethod
    def of(cls, topology: Topology, part_of_face: Index) -> Boundaries:
        """Find the boundaries between the parts ``(F,)`` of all faces: where faces of two parts meet in a hinge."""
        sides = np.sort(part_of_face[topology.hinge_faces], axis=1)
        across = sides[:, 0] != sides[:, 1]
        parts, pair = np.unique(sides[across], axis=0, return_inverse=True)
        edges = topology.edges[topology.hinge_edges[across]]
        return cls(parts.astype(np.int64).reshape(-1, 2), edges, pair.reshape(-1))

    def middles(self, frame: FloatArray) -> Float:
        """Return the middles ``(n, 3)`` of the boundaries in a frame ``(V, 3)``: means of the middles of edges."""
        middles = frame[self.edges].mean(axis=1)
        sums = [np.bincount(self.pair, column, minlength=len(self.parts)) for column in middles.T]
        return np.stack(sums, axis=1) / np.bincount(self.pair, minlength=len(self.parts))[:, None]
