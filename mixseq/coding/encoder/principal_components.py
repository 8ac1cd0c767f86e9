r"""Principal components of a sequence: the spatial basis before it is rounded.

trajectories
    :math:`x_t(v) = m(t) + \sum_k u_k(t)\, b_k(v)`: principal components of the vertices' trajectories about their mean
    m. A basis vector :math:`b_k` has one number at each vertex, its coefficients :math:`u_k(t)` three coordinates. A
    rigid part needs three of them, affine functions of the position. The best for most sequences.
shapes
    :math:`x_t(v) = m(v) + \sum_k u_k(t)\, b_k(v)`: principal components of the frames about their mean m. A basis
    vector has three coordinates at each vertex, its coefficients are numbers. For meshes with few vertices relative
    to their frames.

Both are optimal in the least-squares sense. If every number of :math:`b_k` and of :math:`u_k \|b_k\|` is rounded to a
multiple of the same step, all of them cost the same bits and make the same error: reverse water-filling.

Frames are read for the trajectories of the whole mesh only. Shapes and the components of parts are sums of these
components, which are far fewer than the frames.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import linalg

from mixseq.arrays import Float, Index
from mixseq.coding.bitstream.spatial_basis import BasisKind
from mixseq.disk_array import LargeArray, column_blocks, new_large_array
from mixseq.frame_store import FrameStore

MOST = 3000
"""Largest number of rows or columns for principal components; frames of longer sequences are skipped for it."""


@dataclass(frozen=True, eq=False)
class PrincipalComponents:
    """Principal components of a sequence: curves over time times vectors over the mesh, most important first."""

    kind: BasisKind  # components of trajectories or of shapes
    # (T, 3) mean of all vertices at every frame (trajectories), or of all frames at every vertex (shapes).
    mean: Float
    curves: Float  # (K, T, d) coefficients, orthonormal: d = 3 of trajectories, 1 of shapes
    # (K, c, V) basis vectors in the units of the sequence, orthogonal: c = 1 of trajectories, 3 of shapes.
    vectors: Float
    left_out: float  # sum of squares of the components that were left out as too small

    @cached_property
    def norms(self) -> Float:
        """Norms ``(K,)`` of the vectors, decreasing: the singular values."""
        return np.asarray(np.sqrt(np.square(self.vectors).sum(axis=(1, 2))))

    @property
    def frame_count(self) -> int:
        """Number T of frames."""
        return int(self.curves.shape[1])


def trajectories(sequence: FrameStore, least: float) -> PrincipalComponents:
    """Compute the principal components of all vertices' trajectories."""
    count = len(sequence.points)
    table, means = _centred(sequence, np.arange(count))
    stride = -(-min(table.shape) // MOST)
    if stride == 1 and table.shape[0] <= table.shape[1]:
        curves = _leading(_gram_of_rows(table), least)
        vectors = _product(curves, table)
    else:
        # Each used frame stands for those beside it.
        some = table if stride == 1 else _centred(sequence, np.arange(0, count, stride))[0]
        scores = _scores(table, _directions(some, least / np.sqrt(stride)))
        curves = np.asarray(linalg.qr(scores, mode="economic")[0].T, dtype=np.float64)
        vectors = _product(curves, table)
        turn = _leading(vectors @ vectors.T, 0.0)
        curves, vectors = turn @ curves, turn @ vectors
    energy = sum(float(np.square(block).sum()) for _, block in column_blocks(table))
    left_out = max(energy - float(np.square(vectors).sum()), 0.0)
    return PrincipalComponents(
        "trajectories", means, curves.reshape(-1, count, 3), vectors[:, None], left_out
    )


def shapes(components: PrincipalComponents, least: float) -> PrincipalComponents:
    """Compute the principal components of the frames from those of the trajectories."""
    some = components.norms > 0
    curves, vectors, norms = components.curves[some], components.vectors[some, 0], components.norms[some]
    mean = components.mean.mean(axis=0)[:, None] + curves.mean(axis=1).T @ vectors
    # Frames as numbers (T, 3 (K + 1)) times vectors that are orthonormal, the last of which is constant.
    own = np.append(norms, np.sqrt(vectors.shape[1]))
    moved = np.concatenate([curves, components.mean[None]])
    moved = (moved - moved.mean(axis=1, keepdims=True)) * own[:, None, None]
    table = moved.transpose(1, 2, 0).reshape(len(components.mean), -1)
    if table.shape[0] <= table.shape[1]:
        found = _leading(_gram_of_rows(table), least)
    else:
        directions = _leading(table.T @ table, least)
        found = np.asarray(linalg.qr(table @ directions.T, mode="economic")[0].T)
    turned = (found @ table).reshape(len(found), 3, -1) / own
    shapes = turned[..., :-1] @ vectors + turned[..., -1:]
    left_out = max(float(np.square(table).sum() - np.square(turned * own).sum()), 0.0)
    return PrincipalComponents("shapes", mean, found[..., None], shapes, components.left_out + left_out)


def _leading(gram: Float, least: float) -> Float:
    """Return the eigenvectors ``(K, n)`` of a matrix ``(n, n)`` with values above `least` squared, one at least."""
    vectors = linalg.eigh(gram, subset_by_value=(max(least, 0.0) ** 2, np.inf), check_finite=False)[1]
    if not vectors.shape[1]:
        vectors = np.eye(len(gram))[:, -1:]
    return np.ascontiguousarray(vectors[:, ::-1].T)


def _gram_of_rows(table: LargeArray) -> Float:
    gram = np.zeros((table.shape[0],) * 2)
    for _, block in column_blocks(table):
        gram += block @ block.T
    return gram


def _directions(table: LargeArray, least: float) -> Float:
    """Return orthogonal vectors ``(K, V)`` that nearly span rows ``(R, V)``."""
    height, width = table.shape
    if height <= width:
        return _product(_leading(_gram_of_rows(table), least), table)
    gram = np.zeros((width, width))
    for start in range(0, height, width):
        block = table[start : start + width]
        gram += block.T @ block
    return _leading(gram, least)


def _product(some: Float, table: LargeArray) -> Float:
    product = np.empty((len(some), table.shape[1]))
    for columns, block in column_blocks(table):
        product[:, columns] = some @ block
    return product


def _scores(table: LargeArray, directions: Float) -> Float:
    scores, size = np.empty((len(table), len(directions))), 1 << 10
    for start in range(0, len(table), size):
        scores[start : start + size] = table[start : start + size] @ directions.T
    return scores


def _centred(sequence: FrameStore, frames: Index) -> tuple[LargeArray, Float]:
    """Return trajectories ``(3T, V)`` without the mean of all vertices, and these means ``(T, 3)``."""
    table = new_large_array((3 * len(frames), sequence.points.shape[1]))
    means = np.empty((len(frames), 3))
    for row, frame in enumerate(frames):
        points = sequence.points[frame : frame + 1][0].astype(np.float64)
        means[row] = points.mean(axis=0)
        table[3 * row : 3 * row + 3] = (points - means[row]).T
    return table, means
