r"""The pose signal: from a point of pose space to the affine weights of key shapes.

.. math:: \varphi(c) = \varphi_0 + c\,\Phi, \qquad \sum_j \varphi_j(c) = 1 \text{ for every } c

so every point of pose space is a shape, :math:`\sum_j \varphi_j(c)\,P_j`. Pose space has the coordinates of a
principal component analysis of the sequence: distances in it are distances between shapes, its first two
coordinates draw the sequence in the plane. Two forms of the same thing:

modes
    the first key shape is the mean, every other one is the mean plus one standard deviation along a mode;
keys
    key shapes are frames of the sequence, so an artist can look at them and exchange them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from mixseq.arrays import Float, Index
from mixseq.disk_array import LargeArray, column_blocks
from mixseq.errors import SettingsError
from mixseq.polygons import frozen

NEGLIGIBLE = 1e-15
"""Modes below this fraction of the largest are rounding errors."""


@dataclass(frozen=True, eq=False)
class PoseMap:
    """An affine map from pose space to weights of key shapes.

    Attributes
    ----------
    offset : (K,) float64
        Weights at the origin; they add up to one.
    matrix : (k, K) float64
        Change of the weights along every coordinate; rows add up to zero.

    Raises
    ------
    SettingsError
        If sums or shapes are wrong.
    """

    offset: Float
    matrix: Float

    def __post_init__(self) -> None:
        offset = np.asarray(self.offset, dtype=np.float64)
        matrix = np.asarray(self.matrix, dtype=np.float64, order="C")  # products round by the order
        if offset.ndim != 1 or matrix.ndim != 2 or matrix.shape[1] != len(offset) or not len(offset):
            raise SettingsError(f"a pose map of {offset.shape} weights has a matrix of shape {matrix.shape}")
        slack = 1e-9 * np.maximum(1.0, np.abs(matrix).max(axis=1, initial=0.0))
        if abs(offset.sum() - 1) > 1e-9 or (np.abs(matrix.sum(axis=1)) > slack).any():
            raise SettingsError("the weights of key shapes do not add up to one everywhere in pose space")
        object.__setattr__(self, "offset", frozen(offset))
        object.__setattr__(self, "matrix", frozen(matrix))

    @property
    def dim(self) -> int:
        """Dimension k of pose space."""
        return int(self.matrix.shape[0])

    def weights(self, coordinates: Float) -> Float:
        """Return the weights ``(N, K)`` of the key shapes at points ``(N, k)``."""
        return self.offset + self.rates(coordinates)

    def rates(self, velocities: Float) -> Float:
        """Return how the weights ``(N, K)`` change where points move with velocities ``(N, k)``."""
        # Row by row: products of many rows are summed in another order than those of one.
        rates = np.empty((len(velocities), len(self.offset)))
        for row, velocity in zip(rates, velocities, strict=True):
            row[:] = velocity @ self.matrix
        return rates

    @classmethod
    def of_weights(cls, count: int) -> PoseMap:
        """Make the map whose coordinates are the weights of all key shapes but the first."""
        return cls(np.eye(count)[0], np.eye(count)[1:] - np.eye(count)[0])


@dataclass(frozen=True, eq=False)
class Modes:
    """Principal components of T vectors.

    Attributes
    ----------
    scores : (T, r) float64
        Coordinates of the vectors, in the metric's unit.
    sizes : (r,) float64
        Singular values, decreasing: norms of the columns of the scores.
    mean : (D,) float64
        Mean vector.
    directions : (r, T) float64
        Unit vectors: how much of every vector is in a mode.
    vectors : (T, D) array, perhaps on disk, of float64
        The vectors.
    """

    scores: Float
    sizes: Float
    mean: Float
    directions: Float
    vectors: LargeArray

    def first(self, rank: int) -> Modes:
        """Return the first modes only."""
        return Modes(
            self.scores[:, :rank], self.sizes[:rank], self.mean, self.directions[:rank], self.vectors
        )

    def pose_map(self) -> PoseMap:
        """Return the map from scores to the weights of the mean and of the mean plus one deviation each."""
        rank, root = len(self.sizes), np.sqrt(len(self.scores))
        steps = np.diag(root / self.sizes) if rank else np.zeros((0, 0))
        return PoseMap(np.eye(rank + 1)[0], np.hstack([-steps.sum(axis=1, keepdims=True), steps]))

    def key_shapes(self) -> Float:
        """Return the key shapes ``(1 + r, D)`` of `pose_map`: the mean, and it plus one deviation along every mode."""
        shapes = np.empty((1 + len(self.sizes), len(self.mean)))
        shapes[0] = self.mean
        for columns, block in column_blocks(self.vectors) if len(self.sizes) else ():
            mean = self.mean[columns]
            shapes[1:, columns] = mean + _deviations(self.directions, block - mean)
        return shapes


def principal_modes(vectors: LargeArray, metric: Float) -> Modes:
    r"""Find all modes of vectors.

    From the Gram matrix :math:`G = Y Y^T = U \Sigma^2 U^T` of the centred, weighted vectors (T x T, which is
    small). The deviations are :math:`U^T X / \sqrt{T}`, so that the modes reproduce the vectors to rounding
    however small the singular values are. Only blocks of columns are in memory.

    Parameters
    ----------
    vectors : (T, D) array, perhaps on disk, of float64
        Vectors of a shape space.
    metric : (D,) float64
        Weight of every coordinate in distances between vectors.
    """
    count, dim = vectors.shape
    mean = np.empty(dim)
    gram = np.zeros((count, count))
    for columns, block in column_blocks(vectors):
        mean[columns] = block.mean(axis=0)
        weighted = (block - mean[columns]) * metric[columns]
        gram += weighted @ weighted.T
    # The direction (1, ..., 1) of the mean has the eigenvalue zero, and would mix with directions that are nearly so.
    gram += 2.0 * (np.trace(gram) or 1.0) / count
    directions = np.linalg.eigh(gram)[1][:, -2::-1].T
    largest = np.abs(directions).argmax(axis=1)
    directions = directions * np.sign(directions[np.arange(count - 1), largest])[:, None]
    squares = np.zeros(count - 1)
    for columns, block in column_blocks(vectors):
        deviations = _deviations(directions, block - mean[columns])
        squares += np.einsum("rd,rd,d->r", deviations, deviations, np.square(metric[columns]))
    sizes = np.sqrt(count) * np.sqrt(squares)
    there = sizes > NEGLIGIBLE * sizes.max(initial=0.0)
    order = np.flatnonzero(there)[np.argsort(-sizes[there], kind="stable")]
    directions = directions[order]
    return Modes((directions * sizes[order, None]).T, sizes[order], mean, directions, vectors)


def _deviations(directions: Float, centred: Float) -> Float:
    """One standard deviation along every mode ``(r, C)``, of centred vectors ``(T, C)``."""
    return np.asarray(directions @ centred / np.sqrt(directions.shape[1]))


def straight_modes(scores: Float, mean: Float, directions: Float) -> tuple[PoseMap, Float]:
    """Make the pose signal and the key shapes of vectors ``mean + scores @ directions``.

    Parameters
    ----------
    scores : (T, r) float64
        Points of pose space.
    mean : (D,) float64
        Vector at its origin.
    directions : (r, D) float64
        Change of the vector along every coordinate.

    Returns
    -------
    pose : PoseMap
        From scores to the weights of the key shapes.
    shapes : (1 + r, D) float64
        The mean, and it plus one standard deviation along every direction.
    """
    sizes = np.sqrt(np.square(scores).mean(axis=0))
    sizes = np.where(sizes > 0, sizes, 1.0)
    steps = np.diag(1 / sizes)
    pose = PoseMap(np.eye(len(sizes) + 1)[0], np.hstack([-steps.sum(axis=1, keepdims=True), steps]))
    return pose, np.concatenate([mean[None], mean + sizes[:, None] * directions])


def choose_keys(scores: Float) -> Index:
    """Choose frames as key shapes for points of pose space.

    Parameters
    ----------
    scores : (T, r) float64
        The sequence in pose space.

    Returns
    -------
    (r + 1,) int64
        Frames, ascending, spread as widely as a pivoted QR decomposition finds: the others are blends of them
        with small weights.
    """
    size = np.abs(scores).max(initial=0.0) or 1.0
    corners = np.concatenate([np.full((1, len(scores)), size), scores.T])
    pivots = linalg.qr(corners, mode="r", pivoting=True)[1]
    return np.sort(pivots[: scores.shape[1] + 1]).astype(np.int64)


def key_map(keys: Float) -> PoseMap:
    """Make the pose map of key shapes that lie at points of pose space.

    Parameters
    ----------
    keys : (K, r) float64
        Where the key shapes are. Of all weights that reproduce a point (barycentric coordinates where K = r + 1)
        the map gives those with the smallest sum of squares.
    """
    corners = np.concatenate(
        [np.ones((1, len(keys))), keys.T]
    )  # weights w of a point c: corners @ w = (1, c)
    inverse = np.linalg.pinv(corners)
    offset, matrix = inverse[:, 0], inverse[:, 1:].T
    # Rounding, and points that the keys do not span, must not make the sums drift.
    return PoseMap(offset + (1 - offset.sum()) / len(keys), matrix - matrix.mean(axis=1, keepdims=True))
