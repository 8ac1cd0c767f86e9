"""Prediction of integers over the connectivity, by vertices that come earlier in an order that the mesh alone gives.

The order goes through the faces breadth first. A vertex v is predicted by the mean of its earlier neighbours, by the
mean of the parallelograms a + b - c over the faces vab whose neighbour across ab, with apex c, is earlier, or by the
mean of these two (Touma and Gotsman 1998; several parallelograms: Cohen-Or et al. 2002). Weights are multiples of
2^-14, so that a decoder has the same predictions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

import mixseq
from mixseq.runtime.jit import compiled
from mixseq.types import Index

BITS = 14
HALF = 1 << (BITS - 1)


@dataclass(frozen=True, eq=False)
class Prediction:
    """Order ``(V,)`` of the vertices, and the integer weights ``(V, V)`` of each predictor; the first has none."""

    order: Index
    weights: tuple[sparse.csr_array, ...]

    def residuals(self, values: Index, predictor: int) -> Index:
        """Subtract from values ``(V, n)`` what the predictor says of them."""
        return values - ((self.weights[predictor] @ values + HALF) >> BITS)

    def values(self, residuals: Index, predictor: int) -> Index:
        """Undo `residuals`."""
        matrix = self.weights[predictor]
        values = residuals.copy()
        _fill(self.order, matrix.indptr.astype(np.int64), matrix.indices.astype(np.int64), matrix.data, values)
        return values


def prediction(mesh: mixseq.Topology) -> Prediction:
    """Return the order and the predictors of a mesh."""
    size = (mesh.vertex_count, mesh.vertex_count)
    order = traversal(mesh)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    i, j = np.concatenate([mesh.edges, mesh.edges[:, ::-1]]).T
    earlier = rank[j] < rank[i]
    near = sparse.csr_array((np.ones(earlier.sum()), (i[earlier], j[earlier])), shape=size)
    near = _scaled(near, 1 / np.maximum(near.sum(axis=1), 1))

    a, b, v, c = mesh.hinges[mesh.edge_face_counts[mesh.hinge_edges] == 2].T
    a, b, v, c = (np.concatenate(pair) for pair in ((a, a), (b, b), (v, c), (c, v)))
    known = rank[v] > np.maximum(np.maximum(rank[a], rank[b]), rank[c])
    a, b, v, c = a[known], b[known], v[known], c[known]
    count = np.bincount(v, minlength=len(order))
    signs = np.repeat([1.0, 1.0, -1.0], len(v))
    across = sparse.csr_array((signs, (np.tile(v, 3), np.concatenate([a, b, c]))), shape=size)
    across = _scaled(across, 1 / np.maximum(count, 1)) + _scaled(near, count == 0)
    none = sparse.csr_array(size)
    return Prediction(order, tuple(_fixed(each) for each in (none, near, across, (near + across) / 2)))


def traversal(mesh: mixseq.Topology) -> Index:
    """Return all vertices ``(V,)``: breadth first across edges, from the first face of every component."""
    starts = np.concatenate([[0], np.cumsum(mesh.edge_face_counts)])
    faces_at = np.argsort(mesh.face_edges.reshape(-1), kind="stable") // 3
    return _traverse(mesh.faces.astype(np.int64), mesh.face_edges.astype(np.int64), starts, faces_at, mesh.vertex_count)


def _scaled(matrix: sparse.csr_array, rows: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> sparse.csr_array:
    return sparse.csr_array(sparse.diags_array(np.asarray(rows, np.float64)) @ matrix)


def _fixed(matrix: sparse.csr_array) -> sparse.csr_array:
    matrix.sort_indices()
    whole = np.rint(matrix.data * (1 << BITS)).astype(np.int64)
    return sparse.csr_array((whole, matrix.indices, matrix.indptr), shape=matrix.shape)


@compiled
def _traverse(faces: Index, face_edges: Index, starts: Index, faces_at: Index, vertices: int) -> Index:
    order = np.empty(vertices, np.int64)
    met = np.zeros(vertices, np.bool_)
    done = np.zeros(len(faces), np.bool_)
    queue = np.empty(len(faces), np.int64)
    count = 0
    for seed in range(len(faces)):
        if done[seed]:
            continue
        done[seed] = True
        queue[0] = seed
        head, tail = 0, 1
        while head < tail:
            face = queue[head]
            head += 1
            for corner in range(3):
                v = faces[face, corner]
                if not met[v]:
                    met[v] = True
                    order[count] = v
                    count += 1
            for side in range(3):
                edge = face_edges[face, side]
                for k in range(starts[edge], starts[edge + 1]):
                    other = faces_at[k]
                    if not done[other]:
                        done[other] = True
                        queue[tail] = other
                        tail += 1
    for v in range(vertices):
        if not met[v]:
            order[count] = v
            count += 1
    return order


@compiled
def _fill(order: Index, indptr: Index, indices: Index, weights: Index, values: Index) -> None:
    """Turn residuals ``(V, n)`` into values, in place."""
    total = np.empty(values.shape[1], np.int64)
    for v in order:
        total[:] = HALF
        for k in range(indptr[v], indptr[v + 1]):
            for c in range(values.shape[1]):
                total[c] += weights[k] * values[indices[k], c]
        for c in range(values.shape[1]):
            values[v, c] += total[c] >> BITS
