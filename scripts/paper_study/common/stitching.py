r"""Stitching: one mesh from pieces that almost agree where they overlap.

Every piece says where the edges it holds should point. The vertices are those whose edges fit best,

.. math:: \min_v \sum_{\text{pieces}} \sum_{ij} w_{ij} \Bigl| v_j - v_i -
          \frac{v'_j - v'_i}{|v'_j - v'_i|}\, l_{ij} \Bigr|^2

(paper, equation 1, where all weights are 1; edge blending of Winkler et al. 2010). With the incidence matrix M of the
pieces' edges this is ``M^T M v = M^T e``, a Poisson system; the paper drops the ``M^T`` on the right.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mixseq.mesh.measures import scatter_add
from mixseq.mesh.topology import Topology, connected_components
from mixseq.shells.solvers import PoissonSystem, index_of
from mixseq.types import Float, Index


@dataclass(frozen=True, eq=False)
class Seams:
    """Edges of all pieces, as pairs of rows in the array of all pieces' points."""

    vertex: Index  # (N,) vertex of the mesh of every row
    rows: Index  # (S, 2) edges of the pieces, as two rows
    edge: Index  # (S,) their ids in the mesh
    weights: Float  # (S,) their weights, 1 in the paper
    vertex_count: int

    @classmethod
    def of(cls, topology: Topology, vertices: list[Index]) -> Seams:
        """Collect the edges with both ends in one of the pieces with global vertices ``(n_k,)``."""
        rows, edges, start = [], [], 0
        for piece in vertices:
            ends = index_of(piece, topology.vertex_count)[topology.edges]
            edges.append(np.flatnonzero((ends >= 0).all(axis=1)))
            rows.append(start + ends[edges[-1]])
            start += len(piece)
        edge = np.concatenate(edges)
        return cls(np.concatenate(vertices), np.concatenate(rows), edge, np.ones(len(edge)), topology.vertex_count)

    @cached_property
    def system(self) -> PoissonSystem:
        """The system of all vertices, the first one of every component at the origin."""
        return PoissonSystem(self.vertex[self.rows], self.weights, np.zeros(self.vertex_count, dtype=bool))

    @cached_property
    def component(self) -> Index:
        """Connected component ``(V,)`` of every vertex across the pieces' edges."""
        return connected_components(self.vertex_count, self.vertex[self.rows])


def stitch(seams: Seams, points: Float, lengths: Float) -> Float:
    """Merge placed pieces ``(N, 3)`` into one mesh ``(V, 3)``; each component's centre is that of its pieces.

    Edges get the given lengths ``(E,)``, or where these are NaN the piece's own.
    """
    sides = points[seams.rows[:, 1]] - points[seams.rows[:, 0]]
    own = np.linalg.norm(sides, axis=1)
    wanted = np.where(np.isnan(lengths[seams.edge]), own, lengths[seams.edge])
    sides *= (wanted / np.where(own > 0, own, 1.0))[:, None]
    result = seams.system.solve(sides)
    mean = _average(points, seams.vertex, seams.vertex_count)
    return result + _average(mean - result, seams.component)[seams.component]


def _average(values: Float, group: Index, count: int = 0) -> Float:
    """Return the mean of the rows of each group."""
    return scatter_add(values, group, count) / np.maximum(np.bincount(group, minlength=count), 1)[:, None]
