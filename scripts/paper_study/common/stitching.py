r"""Stitching: one mesh from pieces that almost agree where they overlap.

Every piece says where the edges it holds should point. The vertices are those whose edges fit best,

.. math:: \min_v \sum_{\text{pieces}} \sum_{ij} \Bigl| v_j - v_i -
          \frac{v'_j - v'_i}{|v'_j - v'_i|}\, l_{ij} \Bigr|^2

(paper, equation 1; edge blending of Winkler et al. 2010), that is ``M^T M v = M^T e`` with the incidence matrix M of
the pieces' edges; the paper drops the ``M^T`` on the right. M depends on connectivity only and is factored once.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from mixseq.mesh.measures import scatter_add
from mixseq.mesh.topology import Topology
from mixseq.shells.solvers import Factor, factorise
from mixseq.types import Float, Index


@dataclass(frozen=True, eq=False)
class Seams:
    """Edges of all pieces, as pairs of rows in the array of all pieces' points."""

    vertex: Index
    """Vertex ``(N,)`` of the mesh of every row."""

    rows: Index
    """Edges ``(S, 2)`` of the pieces, as two rows."""

    edge: Index
    """Their ids ``(S,)`` in the mesh."""

    vertex_count: int
    weights: Float | None = None
    """Weights ``(S,)`` of the edges; without them all are 1, as in the paper."""

    @classmethod
    def of(cls, topology: Topology, vertices: list[Index]) -> Seams:
        """Collect the edges with both ends in one of the pieces with global vertices ``(n_k,)``."""
        rows, edges, start = [], [], 0
        for piece in vertices:
            place = np.full(topology.vertex_count, -1, dtype=np.int64)
            place[piece] = start + np.arange(len(piece))
            inside = np.flatnonzero((place[topology.edges] >= 0).all(axis=1))
            rows.append(place[topology.edges[inside]])
            edges.append(inside)
            start += len(piece)
        return cls(np.concatenate(vertices), np.concatenate(rows), np.concatenate(edges), topology.vertex_count)

    @cached_property
    def incidence(self) -> sparse.csr_array:
        """The matrix M ``(S, V)``: -1 at an edge's first vertex, +1 at its second."""
        count = len(self.rows)
        place = np.repeat(np.arange(count), 2), self.vertex[self.rows].reshape(-1)
        return sparse.coo_array((np.tile([-1.0, 1.0], count), place), shape=(count, self.vertex_count)).tocsr()

    @cached_property
    def normal(self) -> sparse.csr_array:
        """``M^T M`` ``(V, V)``; with weights W ``M^T W M``."""
        weighted = self.incidence
        if self.weights is not None:
            weighted = sparse.csr_array(sparse.diags_array(self.weights) @ weighted)
        return sparse.csr_array(self.incidence.T @ weighted)

    @cached_property
    def component(self) -> Index:
        """Connected component ``(V,)`` of every vertex across the pieces' edges."""
        return csgraph.connected_components(self.normal, directed=False)[1].astype(np.int64)

    @cached_property
    def solved(self) -> Index:
        """Vertices that are solved for: all but the first of every component."""
        first = np.unique(self.component, return_index=True)[1]
        return np.setdiff1d(np.arange(self.vertex_count), first)

    @cached_property
    def factor(self) -> Factor:
        """Factor of the normal matrix without the first vertex of every component."""
        return factorise(self.normal[self.solved][:, self.solved])


def stitch(seams: Seams, points: Float, lengths: Float) -> Float:
    """Merge placed pieces ``(N, 3)`` into one mesh ``(V, 3)``; each component's centre is that of its pieces.

    Edges get the given lengths ``(E,)``, or where these are NaN the piece's own.
    """
    sides = points[seams.rows[:, 1]] - points[seams.rows[:, 0]]
    own = np.linalg.norm(sides, axis=1)
    wanted = np.where(np.isnan(lengths[seams.edge]), own, lengths[seams.edge])
    sides *= (wanted / np.where(own > 0, own, 1.0))[:, None]
    if seams.weights is not None:
        sides *= seams.weights[:, None]

    result = np.zeros((seams.vertex_count, 3))
    if seams.solved.size:
        result[seams.solved] = seams.factor.solve((seams.incidence.T @ sides)[seams.solved])
    mean = _average(points, seams.vertex, seams.vertex_count)
    return result + _average(mean - result, seams.component)[seams.component]


def _average(values: Float, group: Index, count: int = 0) -> Float:
    """Return the mean of the rows of each group."""
    return scatter_add(values, group, count) / np.maximum(np.bincount(group, minlength=count), 1)[:, None]
