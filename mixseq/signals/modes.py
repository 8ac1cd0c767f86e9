r"""Principal components of the vectors of a sequence: the modes of its shapes.

The centred, weighted vectors are :math:`Y = U \Sigma V^T`, ``(T, D)``. Scores are :math:`U \Sigma`, coordinates of the
frames. The key shapes are the mean, and the mean plus one standard deviation along every mode.

The columns of the smaller matrix, U or V, are eigenvectors of a Gram matrix:

- :math:`Y Y^T`, if the number of frames is at most that of coordinates. With the centred, unweighted vectors X, the
  deviations are :math:`U^T X / \sqrt T`;
- :math:`Y^T Y`, if there are more frames. Scores are :math:`Y V`, deviations are scaled columns of V over the weights.

Both methods apply an orthogonal matrix and its inverse. The modes therefore reproduce the vectors up to rounding
errors, for singular values of any size. Only blocks of the vectors are in memory.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from mixseq.runtime.low_memory import LargeArray, column_blocks
from mixseq.signals.pose import PoseMap
from mixseq.types import Float, Index

NEGLIGIBLE_MODE = 1e-15
"""Ratio to the largest singular value below which modes are rounding errors."""

MIN_WEIGHT_RATIO = 1e-9
"""Least ratio of a weight of coordinates to the largest weight, because weights are divisors."""

Deviations = Callable[[int], Iterator[tuple[slice, Float]]]
"""Function of r that yields blocks ``(r, C)``, with their columns, of one standard deviation along r modes."""


@dataclass(frozen=True, eq=False)
class Modes:
    """Principal components of T vectors."""

    scores: Float  # (T, r) coordinates of the vectors, in the metric's unit
    sizes: Float  # (r,) singular values, decreasing: norms of the columns of scores
    mean: Float  # (D,) mean vector
    deviations: Deviations  # yields one standard deviation along every mode

    def first(self, rank: int) -> Modes:
        """Return the first `rank` modes."""
        return replace(self, scores=self.scores[:, :rank], sizes=self.sizes[:rank])

    def pose_map(self) -> PoseMap:
        """Return the map from scores to weights of the key shapes."""
        return PoseMap.from_modes(np.sqrt(len(self.scores)) / self.sizes)

    def key_shapes(self) -> Float:
        """Return key shapes ``(1 + r, D)``: the mean, and the mean plus one standard deviation along each mode."""
        rank = len(self.sizes)
        shapes = np.empty((1 + rank, len(self.mean)))
        shapes[0] = self.mean
        for columns, block in self.deviations(rank) if rank else ():
            shapes[1:, columns] = self.mean[columns] + block
        return shapes


def principal_modes(vectors: LargeArray, metric: Float) -> Modes:
    """Compute all modes of vectors ``(T, D)`` in a metric ``(D,)``: at most the minimum of D and T - 1."""
    count, dim = vectors.shape
    return _from_frames(vectors, metric) if count <= dim else _from_coordinates(vectors, metric)


def _from_frames(vectors: LargeArray, metric: Float) -> Modes:
    """Compute modes from the Gram matrix ``(T, T)`` of frames."""
    count, dim = vectors.shape
    mean = np.empty(dim)
    gram = np.zeros((count, count))
    for columns, block in column_blocks(vectors):
        mean[columns] = block.mean(axis=0)
        weighted = block - mean[columns]
        weighted *= metric[columns]
        gram += weighted @ weighted.T
        del block, weighted  # blocks of many frames are as large as the Gram matrix
    # Separate the direction (1, ..., 1) of the mean, with eigenvalue zero, from modes with eigenvalues near zero.
    gram += 2.0 * (np.trace(gram) or 1.0) / count
    directions = np.linalg.eigh(gram)[1][:, -2::-1].T
    del gram
    largest = np.abs(directions).argmax(axis=1)
    directions = directions * np.sign(directions[np.arange(count - 1), largest])[:, None]

    def deviations(rows: Float) -> Iterator[tuple[slice, Float]]:
        for columns, block in column_blocks(vectors):
            deviation = rows @ (block - mean[columns])
            del block
            deviation /= np.sqrt(count)
            yield columns, deviation

    squares = np.zeros(count - 1)
    for columns, block in deviations(directions):
        squares += np.einsum("rd,rd,d->r", block, block, np.square(metric[columns]))
    sizes = np.sqrt(count) * np.sqrt(squares)
    order = _significant_modes(sizes)
    sizes, directions = sizes[order], directions[order]
    scores = (directions * sizes[:, None]).T
    return Modes(scores, sizes, mean, lambda rank: deviations(directions[:rank]))


def _from_coordinates(vectors: LargeArray, metric: Float) -> Modes:
    """Compute modes from the Gram matrix ``(D, D)`` of coordinates."""
    count, dim = vectors.shape
    blocks = [slice(start, start + dim) for start in range(0, count, dim)]
    mean = sum((vectors[rows].sum(axis=0) for rows in blocks), start=np.zeros(dim)) / count
    weights = np.maximum(metric, MIN_WEIGHT_RATIO * (metric.max(initial=0.0) or 1.0))
    gram = np.zeros((dim, dim))
    for rows in blocks:
        weighted = (vectors[rows] - mean) * weights
        gram += weighted.T @ weighted
    axes = np.linalg.eigh(gram)[1]
    scores = np.empty((count, dim))
    for rows in blocks:
        scores[rows] = ((vectors[rows] - mean) * weights) @ axes
    signs = np.where(scores.max(axis=0, initial=0.0) < -scores.min(axis=0, initial=0.0), -1.0, 1.0)
    sizes = np.sqrt(np.einsum("tr,tr->r", scores, scores))
    order = _significant_modes(sizes)
    scores, sizes = scores[:, order], sizes[order]
    scores *= signs[order]
    directions = (axes[:, order] * signs[order]).T

    def deviations(rank: int) -> Iterator[tuple[slice, Float]]:
        yield slice(None), directions[:rank] * (sizes[:rank, None] / np.sqrt(count)) / weights

    return Modes(scores, sizes, mean, deviations)


def _significant_modes(sizes: Float) -> Index:
    """Return the indices of modes above rounding errors, largest first."""
    is_significant = sizes > NEGLIGIBLE_MODE * sizes.max(initial=0.0)
    return np.flatnonzero(is_significant)[np.argsort(-sizes[is_significant], kind="stable")]
