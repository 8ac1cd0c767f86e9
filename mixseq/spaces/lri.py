r"""Linear rotation-invariant coordinates (Lipman, Sorkine, Levin and Cohen-Or 2005).

Every vertex i has an orthonormal frame ``F_i``: the tangential direction of one of its edges, the tangent across it,
and the normal. The relative rotation of the frames at the ends of an edge, and the edge in the axes of each frame, are
invariant under rigid motions,

.. math:: M_{ij} = F_i^T F_j, \qquad u_{ij} = F_i^T (x_j - x_i), \qquad u_{ji} = F_j^T (x_i - x_j) .

In the paper's terms, M holds the discrete second form and the connection; u holds the first form and the normal
offsets. As in the paper, all entries blend linearly; a blended M need not be a rotation.

A mesh is rebuilt by two sparse linear least-squares problems:

1. frames: :math:`\min_F \sum_{ij} \|F_j - F_i M_{ij}\|^2 + \|F_i - F_j M_{ij}^T\|^2`, with one fixed frame per piece.
   Every frame is then projected to a rotation, unlike in the paper, because inconsistent frames would shrink the mesh;
2. vertices: :math:`\min_x \sum_{ij} |x_j - x_i - F_i u_{ij}|^2 + |x_i - x_j - F_j u_{ji}|^2`, one vertex fixed.

The coordinates of a mesh reconstruct it exactly. A vector is ``[M (E, 3, 3) | u (E, 2, 3) | poses]``, with the poses of
the pieces as in `PosedSpace`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mixseq.mesh.triangle_mesh import DEGENERATE_HEIGHT_RATIO, normalise, perpendicular, vertex_normals
from mixseq.runtime.lazy import cached_property
from mixseq.shells.solvers import BlockPattern, PoissonSystem, index_of, solve_frames
from mixseq.spaces.pieces import PosedSpace
from mixseq.types import Float, Index

NUMBERS_PER_EDGE = 15  # numbers per edge: nine of the rotation, three of the edge in each frame


@dataclass(frozen=True, eq=False)
class LRISpace(PosedSpace):
    """Shapes are rotations between vertex frames along edges, and edges in frame axes; see `PosedSpace`."""

    name = "lri"

    @cached_property
    def edge_rows(self) -> Index:
        """Edges ``(E, 2)`` as pairs of rows i < j, except edges of triangles with repeated corners."""
        piece = np.empty(len(self.topology.edges), dtype=np.int64)
        piece[self.topology.face_edges] = self.topology.component_of_face[:, None]
        rows = self.pieces.find_rows(piece[:, None], self.topology.edges)
        return rows[rows[:, 0] < rows[:, 1]]

    @cached_property
    def reference_half_edges(self) -> Index:
        """Half-edge ``(N,)`` of each vertex that is longest in the tangent plane of the reference, -1 without an edge.

        Half-edge e is edge e, and half-edge E + e is its reverse.
        """
        rows = self.pieces.shapes
        starts, lengths, _ = self._tangents(rows, vertex_normals(rows, self.face_rows, self.edge_rows))
        order = np.lexsort((-lengths, starts))
        return self._first_of_vertices(order, starts[order])

    @cached_property
    def poisson_system(self) -> PoissonSystem:
        """Poisson system of the vertices."""
        fixed_mask = np.zeros(len(self.pieces.vertex_of_row), dtype=bool)
        return PoissonSystem(self.edge_rows, np.ones(len(self.edge_rows)), fixed_mask)

    @cached_property
    def unknown_index(self) -> Index:
        """Index ``(N,)`` of every frame among the unknown frames, -1 if fixed."""
        return index_of(self.poisson_system.unknown_ids, len(self.pieces.vertex_of_row))

    @cached_property
    def frame_pattern(self) -> BlockPattern:
        """Block pattern of unknown frames, coupled by edges."""
        count = len(self.poisson_system.unknown_ids)
        return BlockPattern.from_pairs(count, self.unknown_index[self.edge_rows])

    @property
    def shape_dim(self) -> int:
        """Implement `PosedSpace.shape_dim`: fifteen numbers per edge."""
        return NUMBERS_PER_EDGE * len(self.edge_rows)

    @property
    def shape_metric(self) -> Float:
        """Implement `PosedSpace.shape_metric`: a rotation of a frame moves the other end of an edge by its length.

        A rotation by one radian changes M by the square root of two, and every edge has two ends.
        """
        i, j = self.edge_rows.T
        lengths = np.linalg.norm(self.pieces.shapes[j] - self.pieces.shapes[i], axis=1)
        return np.concatenate([np.repeat(lengths, 9), np.ones(6 * len(lengths))]) * float(np.sqrt(0.5))

    def vertex_frames(self, rows: Float) -> Float:
        """Return the frames ``(N, 3, 3)`` of rows ``(N, 3)``, with axes in columns.

        A reference half-edge without tangential length is replaced by the first half-edge with at least half the
        largest length, or by an axis of the world.
        """
        normals = vertex_normals(rows, self.face_rows, self.edge_rows)
        starts, lengths, tangents = self._tangents(rows, normals)
        longest = np.zeros(len(rows))
        np.maximum.at(longest, starts, lengths)
        candidates = np.flatnonzero(lengths >= 0.5 * longest[starts])
        order = candidates[np.argsort(starts[candidates], kind="stable")]
        alternatives = self._first_of_vertices(order, starts[order])

        half_edges = alternatives
        if len(starts):
            is_long = lengths[self.reference_half_edges] > DEGENERATE_HEIGHT_RATIO * longest
            half_edges = np.where(is_long, self.reference_half_edges, alternatives)
        first = np.zeros((len(rows), 3))
        first[half_edges >= 0] = normalise(tangents[half_edges[half_edges >= 0]])
        is_missing = ~first.any(axis=1)
        first[is_missing] = perpendicular(normals[is_missing])
        is_missing = ~normals.any(axis=1)
        normals[is_missing] = perpendicular(first[is_missing])
        second = np.cross(normals, first)
        return np.stack([first, second, normals], axis=2)

    def measure_shape(self, x: Float) -> Float:
        """Implement `PosedSpace.measure_shape`."""
        rows = x[self.pieces.vertex_of_row]
        frames = self.vertex_frames(rows)
        i, j = self.edge_rows.T
        edges = rows[j] - rows[i]
        connections = np.swapaxes(frames[i], 1, 2) @ frames[j]
        ends = np.stack([_to_frame_axes(frames[i], edges), _to_frame_axes(frames[j], -edges)], axis=1)
        return np.concatenate([connections.reshape(-1), ends.reshape(-1)])

    def rebuild_rows(self, shape: Float) -> Float:
        """Implement `PosedSpace.rebuild_rows`."""
        count = len(self.edge_rows)
        connections, ends = shape[: 9 * count].reshape(-1, 3, 3), shape[9 * count :].reshape(-1, 2, 3)
        known = np.tile(np.eye(3), (len(self.unknown_index), 1, 1))
        frames = solve_frames(self.frame_pattern, self.unknown_index, self.edge_rows, connections, known)
        i, j = self.edge_rows.T
        forward, backward = (np.einsum("eab,eb->ea", frames[k], ends[:, n]) for n, k in enumerate((i, j)))
        # Both vectors constrain the same edge, so that the least-squares solution depends only on their mean.
        return self.poisson_system.solve((forward - backward) / 2)

    def _tangents(self, rows: Float, normals: Float) -> tuple[Index, Float, Float]:
        """Return start vertices, tangential lengths ``(2E,)`` and tangential directions of half-edges."""
        starts, ends = np.concatenate([self.edge_rows, self.edge_rows[:, ::-1]]).T
        edges = rows[ends] - rows[starts]
        normal = normals[starts]
        tangents = edges - normal * np.sum(edges * normal, axis=1, keepdims=True)
        return starts, np.linalg.norm(tangents, axis=1), tangents

    def _first_of_vertices(self, half_edges: Index, starts: Index) -> Index:
        """Return the first half-edge ``(N,)`` of every vertex, -1 without half-edges; starts ascend."""
        result = np.full(len(self.pieces.vertex_of_row), -1, dtype=np.int64)
        vertices, first = np.unique(starts, return_index=True)
        result[vertices] = half_edges[first]
        return result


def _to_frame_axes(frames: Float, vectors: Float) -> Float:
    """Return vectors ``(n, 3)`` in the axes of frames ``(n, 3, 3)``."""
    return np.asarray(np.einsum("nba,nb->na", frames, vectors))
