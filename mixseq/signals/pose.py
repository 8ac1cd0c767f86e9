r"""Pose space: principal components of a sequence, the map to weights of key shapes, and the main plane.

.. math:: \varphi(c) = \varphi_0 + c\,\Phi, \qquad \sum_j \varphi_j(c) = 1 \text{ for every } c

Every point c of pose space represents the shape :math:`\sum_j \varphi_j(c)\,P_j`. The coordinates of pose space are the
scores of a principal component analysis of the sequence, so that distances in pose space are distances between shapes.
Key shapes are the mean, and the mean plus one standard deviation along every mode.

*Principal components* are the modes of the shapes. The centred, weighted vectors are :math:`Y = U \Sigma V^T`,
``(T, D)``. Scores are :math:`U \Sigma`, coordinates of the frames.

The columns of the smaller matrix, U or V, are eigenvectors of a Gram matrix:

- :math:`Y Y^T`, if the number of frames is at most that of coordinates. With the centred, unweighted vectors X, the
  deviations are :math:`U^T X / \sqrt T`;
- :math:`Y^T Y`, if there are more frames. Scores are :math:`Y V`, deviations are scaled columns of V over the weights.

Both methods apply an orthogonal matrix and its inverse. The modes therefore reproduce the vectors up to rounding
errors, for singular values of any size. Only blocks of the vectors are in memory.

The *main plane* is used to draw the sequence (classical multidimensional scaling of its frames). Let :math:`c_t` be the
frames in pose space, :math:`C` their deviations from the mean ``(T, k)``, and :math:`u_1, u_2` the first two principal
components of their shapes, unit vectors of the shape space. With the singular values :math:`\sigma_i` and the left
singular vectors :math:`d_i` of the frames' deviations in the shape space,

.. math:: u_i = \sum_t d_{ti}\, (s_t - \bar s) / \sigma_i, \qquad p_i = C^T d_i / \sigma_i,

a shape is drawn at its scalar products with :math:`u_1` and :math:`u_2`. A step :math:`p_i` in pose space changes the
shape by :math:`u_i`, the smallest change by one diagonal along axis i.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from hashlib import blake2b
from typing import NamedTuple

import numpy as np

from mixseq.errors import SettingsError
from mixseq.mesh.polygons import read_only
from mixseq.runtime.low_memory import LargeArray, column_blocks
from mixseq.types import Float, Index


@dataclass(frozen=True, eq=False)
class PoseMap:
    """An affine map from pose space to weights of key shapes.

    Attributes
    ----------
    offset : (K,) float64
        Weights at the origin; they add up to one.
    matrix : (k, K) float64
        Change of the weights per unit of every coordinate; rows add up to zero.

    Raises
    ------
    SettingsError
        If the sums or the array shapes are wrong.
    """

    offset: Float
    matrix: Float

    def __post_init__(self) -> None:
        offset = np.asarray(self.offset, dtype=np.float64)
        # The rounding of products depends on the memory order of the matrix.
        matrix = np.asarray(self.matrix, dtype=np.float64, order="C")
        if offset.ndim != 1 or matrix.ndim != 2 or matrix.shape[1] != len(offset) or not len(offset):
            raise SettingsError(f"a pose map of {offset.shape} weights has a matrix of shape {matrix.shape}")
        slack = 1e-9 * np.maximum(1.0, np.abs(matrix).max(axis=1, initial=0.0))
        if abs(offset.sum() - 1) > 1e-9 or (np.abs(matrix.sum(axis=1)) > slack).any():
            raise SettingsError("the weights of key shapes do not add up to one everywhere in pose space")
        object.__setattr__(self, "offset", read_only(offset))
        object.__setattr__(self, "matrix", read_only(matrix))

    @cached_property
    def identity(self) -> str:
        """Digest of the pose map; models with equal digests can exchange key shapes."""
        digest = blake2b(digest_size=16)
        for array in (self.offset, self.matrix):
            digest.update(np.ascontiguousarray(array).data)
        return digest.hexdigest()

    @property
    def dim(self) -> int:
        """Dimension k of pose space."""
        return int(self.matrix.shape[0])

    def weights(self, coordinates: Float) -> Float:
        """Return the weights ``(N, K)`` of the key shapes at points ``(N, k)`` of pose space."""
        return self.offset + self.rates(coordinates)

    def rates(self, velocities: Float) -> Float:
        """Return the rates ``(N, K)`` of the weights at velocities ``(N, k)`` of points."""
        # Row by row, because a product of many rows is summed in another order than a product of one row.
        rates = np.empty((len(velocities), len(self.offset)))
        for row, velocity in zip(rates, velocities, strict=True):
            row[:] = velocity @ self.matrix
        return rates

    @classmethod
    def from_modes(cls, steps: Float) -> PoseMap:
        """Make the map of key shapes at the origin, and at ``1 / steps`` along each of k coordinates."""
        matrix = np.diag(steps)
        return cls(np.eye(len(steps) + 1)[0], np.hstack([-matrix.sum(axis=1, keepdims=True), matrix]))

    @classmethod
    def from_key_count(cls, count: int) -> PoseMap:
        """Make the map whose coordinates are the weights of all key shapes except the first."""
        return cls(np.eye(count)[0], np.eye(count)[1:] - np.eye(count)[0])


NEGLIGIBLE_MODE = 1e-15  # ratio to the largest singular value below which modes are rounding errors
MIN_WEIGHT_RATIO = 1e-9  # least ratio of a weight of coordinates to the largest weight, because weights are divisors

Deviations = Callable[[int], Iterator[tuple[slice, Float]]]
"""Function of r that yields blocks ``(r, C)``, with their columns, of one standard deviation along r modes."""


@dataclass(frozen=True, eq=False)
class Modes:
    """Principal components of T vectors."""

    scores: Float  # (T, r) coordinates of the vectors, in the metric's unit
    sizes: Float  # (r,) singular values, decreasing: norms of the columns of scores
    mean: Float  # (D,) mean vector
    deviations: Deviations  # yields one standard deviation along every mode
    groups: Index  # (r,) group whose coordinates the mode changes

    def first(self, rank: int) -> Modes:
        """Return the first `rank` modes."""
        return replace(self, scores=self.scores[:, :rank], sizes=self.sizes[:rank], groups=self.groups[:rank])

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


def principal_modes(vectors: LargeArray, metric: Float, groups: Index | None = None) -> Modes:
    """Compute all modes of vectors ``(T, D)`` in a metric ``(D,)``: at most the minimum of D and T - 1 of every group.

    With groups ``(D,)`` of coordinates, a mode changes the coordinates of one group.
    """
    count, dim = vectors.shape
    modes_of = _from_frames if count <= dim else _from_coordinates
    if groups is None or not groups.any():
        return modes_of(vectors, metric)
    numbers = np.unique(groups)
    parts = [modes_of(vectors, np.where(groups == number, metric, 0.0)) for number in numbers]
    sizes = np.concatenate([part.sizes for part in parts])
    order = np.argsort(-sizes, kind="stable")
    mode_groups = np.repeat(numbers, [len(part.sizes) for part in parts])[order]
    scores = np.concatenate([part.scores for part in parts], axis=1)[:, order]

    def deviations(rank: int) -> Iterator[tuple[slice, Float]]:
        masks = [mode_groups[:rank] == number for number in numbers]
        for blocks in zip(*(part.deviations(mask.sum()) for part, mask in zip(parts, masks, strict=True)), strict=True):
            columns = blocks[0][0]
            block = np.zeros((rank, len(groups[columns])))
            for number, mask, (_, of_group) in zip(numbers, masks, blocks, strict=True):
                block[mask] = of_group * (groups[columns] == number)
            yield columns, block

    return Modes(scores, sizes[order], parts[0].mean, deviations, mode_groups)


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
    return Modes(scores, sizes, mean, lambda rank: deviations(directions[:rank]), np.zeros(len(sizes), dtype=np.int64))


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

    return Modes(scores, sizes, mean, deviations, np.zeros(len(sizes), dtype=np.int64))


def _significant_modes(sizes: Float) -> Index:
    """Return the indices of modes above rounding errors, largest first."""
    is_significant = sizes > NEGLIGIBLE_MODE * sizes.max(initial=0.0)
    return np.flatnonzero(is_significant)[np.argsort(-sizes[is_significant], kind="stable")]


NEGLIGIBLE_SPREAD = 1e-12  # ratio to the largest spread along an axis below which a spread is a rounding error
MIN_STEP_SPREAD = 1e-4  # least spread along an axis with a step, in diagonals and relative to the largest


class Plane(NamedTuple):
    """A plane through a pose space."""

    origin: Float  # (K,) mean weights of the key shapes
    axes: Float  # (K, 2) ``(weights - origin) @ axes`` are coordinates in the plane; zero without a spread
    directions: Float  # (k, 2) smallest steps in pose space that move by one along an axis; zero without a spread


def fit_plane(points: Float, pose: PoseMap, shapes: Float, metric: Float) -> Plane:
    """Fit the main plane of blended shapes: points ``(T, k)``; key shapes ``(K, S)``; metric ``(S,)``."""
    weights = pose.weights(points)
    origin = weights.mean(axis=0)
    centred = shapes - shapes.mean(axis=0)  # without effect on products with weights that add up to zero
    gram = (centred * np.square(metric)) @ centred.T
    spread = weights - origin
    if len(points) <= shapes.shape[1]:
        sizes, frames = np.linalg.eigh(spread @ gram @ spread.T)
    else:
        sizes, frames = _principal_frames(spread, gram)
    axes, directions = np.zeros((len(origin), 2)), np.zeros((points.shape[1], 2))
    for column in range(min(2, len(sizes))):
        size, frame = sizes[-1 - column], frames[:, -1 - column]
        if size > NEGLIGIBLE_SPREAD**2 * max(sizes[-1], np.finfo(np.float64).tiny):
            frame = frame * np.sign(frame[np.abs(frame).argmax()])
            axes[:, column] = gram @ (spread.T @ frame) / np.sqrt(size)
            if size > MIN_STEP_SPREAD**2 * max(sizes[-1], len(points)):
                directions[:, column] = (points - points.mean(axis=0)).T @ frame / np.sqrt(size)
    return Plane(origin, axes, directions)


def _principal_frames(spread: Float, gram: Float) -> tuple[Float, Float]:
    """Return eigenvalues and eigenvectors of ``spread gram spread^T`` ``(T, T)``, without forming the matrix."""
    gram_values, axes = np.linalg.eigh(gram)
    coordinates = spread @ (axes * np.sqrt(np.maximum(gram_values, 0.0)))
    values, vectors = np.linalg.eigh(coordinates.T @ coordinates)
    singular_values = np.sqrt(np.maximum(values, np.finfo(np.float64).tiny))
    return values, coordinates @ (vectors / singular_values)
