r"""Simultaneous registration of overlapping pieces (Williams and Bennamoun 2000).

Pieces know their vertices up to a rigid motion and share vertices with other pieces. Wanted are the motions that
minimise the squared distances between all copies of the same vertex. For a pair p of copies of one vertex, x in
piece k and y in piece l, stack ``x`` and ``-y`` into the columns of pieces k and l of a row of Q, and +1, -1 into the
columns k, l of a row of B. Optimal translations are linear in the rotations, and what remains is

.. math:: E = \mathrm{tr}(R^T M R), \qquad M = Q^T Q - (B^T Q)^T (B^T B)^+ (B^T Q)

with the rotations stacked in R. Sweeping over the pieces, each rotation is replaced by the best one given the
others, a 3 x 3 singular value decomposition that never raises E. The start is pairwise registration along a
spanning tree of the overlaps; where the overlaps form a tree that already is the minimum.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from mixseq.mesh.rigid import kabsch, nearest_rotations, transform_points
from mixseq.mesh.rotations import rotate_vectors
from mixseq.types import Float, Index


@dataclass(frozen=True, eq=False)
class Overlaps:
    """The vertices that pieces share. Points of all pieces are kept in one array, piece after piece."""

    sizes: Index  # (n,) number of vertices of every piece
    pieces: Index  # (P, 2) the pieces of every pair of copies, the first one with the lower number
    rows: Index  # (P, 2) rows of the two copies
    group: Index  # (n,) first piece of the pieces that overlaps hold together
    tree: Index  # (n,) parent of every piece in the spanning tree of its group, -1 for the first piece
    order: Index  # (n,) pieces, parents before children

    @classmethod
    def of(cls, vertices: list[Index], shapes: list[Float]) -> Overlaps:
        """Find the overlaps of pieces with global vertices ``(n_k,)`` and typical shapes ``(n_k, 3)``.

        Two pieces hold each other if the vertices they share are not on one line.
        """
        sizes = np.array([len(v) for v in vertices], dtype=np.int64)
        owner = np.repeat(np.arange(len(sizes)), sizes)
        pairs = _pairs_of_equals(np.concatenate(vertices))
        pieces, points = owner[pairs], np.concatenate(shapes)
        strength = np.zeros((len(sizes), len(sizes)))
        for k, l in np.unique(pieces, axis=0):  # noqa: E741
            shared = points[pairs[(pieces == (k, l)).all(axis=1), 0]]
            spread = np.linalg.svd(shared - shared.mean(axis=0), compute_uv=False)
            if len(spread) > 1 and spread[1] > 1e-6 * spread[0] > 0:
                strength[k, l] = len(shared)
        return cls(sizes, pieces, pairs, *_forest(strength))

    @cached_property
    def owner(self) -> Index:
        """Piece of every row."""
        return np.repeat(np.arange(len(self.sizes)), self.sizes)

    @cached_property
    def incidence(self) -> sparse.csr_array:
        """The matrix B ``(P, n)``."""
        count = len(self.pieces)
        row, size = np.repeat(np.arange(count), 2), (count, len(self.sizes))
        return sparse.coo_array((np.tile([1.0, -1.0], count), (row, self.pieces.reshape(-1))), shape=size).tocsr()

    @cached_property
    def translation_solver(self) -> Float:
        """The pseudo-inverse of ``B^T B`` ``(n, n)``."""
        return np.linalg.pinv((self.incidence.T @ self.incidence).toarray(), hermitian=True)

    def move(self, points: Float, rotations: Float, translations: Float) -> Float:
        """Move the points ``(N, 3)`` of every piece by its motion ``(n, 3, 3), (n, 3)``."""
        return rotate_vectors(rotations[self.owner], points) + translations[self.owner]


def register(overlaps: Overlaps, points: Float, sweeps: int = 500, tolerance: float = 1e-12) -> tuple[Float, Float]:
    """Return the motions ``x -> R x + t`` ``(n, 3, 3), (n, 3)`` that bring pieces together, the first ones at rest.

    Rounds end when one changes no entry of a rotation by more than the tolerance, or no longer lowers the energy.
    """
    rotation, translation = _along_tree(overlaps, points)
    if not len(overlaps.pieces):
        return rotation, translation
    matrix, projected = _energy_matrix(overlaps, points)
    stacked = np.swapaxes(rotation, 1, 2).reshape(-1, 3)  # R_k^T below each other: rows are points' coordinates
    # Smaller changes are rounding: a very thin overlap may turn for ever without lowering the energy.
    rounding = 1e-15 * float(np.trace(matrix))
    energy = np.inf
    for _ in range(sweeps):
        change, before = 0.0, energy
        for k in range(len(overlaps.sizes)):
            own = slice(3 * k, 3 * k + 3)
            pull = matrix[own, own] @ stacked[own] - matrix[own] @ stacked
            if not pull.any():
                continue
            best = nearest_rotations(pull)
            change = max(change, float(np.abs(best - stacked[own]).max()))
            stacked[own] = best
        energy = float(np.einsum("ij,ij->", stacked, matrix @ stacked))
        if change <= tolerance or before - energy <= rounding:
            break
    shift = -overlaps.translation_solver @ (projected @ stacked)
    return _rooted(overlaps, np.swapaxes(stacked.reshape(-1, 3, 3), 1, 2), shift)


def _pairs_of_equals(values: Index) -> Index:
    """Return all pairs ``(P, 2)`` of positions with equal values, in ascending order."""
    order, found = np.argsort(values, kind="stable"), [np.zeros((0, 2), dtype=np.int64)]
    ordered = values[order]
    for step in range(1, len(values)):
        same = ordered[step:] == ordered[:-step]
        if not same.any():
            break
        found.append(np.stack([order[:-step][same], order[step:][same]], axis=1))
    pairs = np.concatenate(found)
    return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]


def _forest(strength: Float) -> tuple[Index, Index, Index]:
    """Return groups, parents and order of the maximum spanning forest of an upper triangular matrix."""
    count = len(strength)
    costs = np.where(strength > 0, 1.0 / np.maximum(strength, 1.0), 0.0)
    forest = csgraph.minimum_spanning_tree(sparse.csr_array(costs))
    group, parent = np.full((2, count), -1, dtype=np.int64)
    orders = []
    for piece in range(count):
        if group[piece] < 0:
            order, predecessors = csgraph.breadth_first_order(forest, piece, directed=False)
            group[order] = piece
            parent[order[1:]] = predecessors[order[1:]]
            orders.append(order)
    return group, parent, np.concatenate(orders).astype(np.int64)


def _along_tree(overlaps: Overlaps, points: Float) -> tuple[Float, Float]:
    """Register every piece with its parent."""
    count = len(overlaps.sizes)
    rotation, translation = np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3))
    for piece in overlaps.order[overlaps.tree[overlaps.order] >= 0]:
        parent = overlaps.tree[piece]
        own = int(piece > parent)  # column of the piece in pairs
        rows = overlaps.rows[(overlaps.pieces == np.sort([piece, parent])).all(axis=1)]
        placed = transform_points(points[rows[:, 1 - own]], rotation[parent], translation[parent])
        rotation[piece], translation[piece] = kabsch(points[rows[:, own]], placed)
    return rotation, translation


def _energy_matrix(overlaps: Overlaps, points: Float) -> tuple[Float, Float]:
    """Return the matrix M ``(3n, 3n)`` and ``B^T Q`` ``(n, 3n)``."""
    count = len(overlaps.pieces)
    place = np.repeat(np.arange(count), 6), (3 * overlaps.pieces[:, :, None] + np.arange(3)).reshape(-1)
    value = (points[overlaps.rows] * np.array([1.0, -1.0])[:, None]).reshape(-1)
    q = sparse.coo_array((value, place), shape=(count, 3 * len(overlaps.sizes))).tocsr()
    projected = (overlaps.incidence.T @ q).toarray()
    return (q.T @ q).toarray() - projected.T @ overlaps.translation_solver @ projected, projected


def _rooted(overlaps: Overlaps, rotation: Float, translation: Float) -> tuple[Float, Float]:
    """Move every group rigidly so that its first piece is where it was."""
    back = np.swapaxes(rotation[overlaps.group], 1, 2)
    return back @ rotation, rotate_vectors(back, translation - translation[overlaps.group])
