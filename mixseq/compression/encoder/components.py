r"""Compute principal components of a sequence and of parts of its mesh: the spatial basis before rounding.

trajectories
    :math:`x_t(v) = m(t) + \sum_k u_k(t)\, b_k(v)`: principal components of the vertices' trajectories about their mean
    m. A basis vector :math:`b_k` has one number per vertex, a coefficient :math:`u_k(t)` three coordinates. A rigid
    part needs three vectors, which are affine functions of the position. This kind is best for most sequences.
shapes
    :math:`x_t(v) = m(v) + \sum_k u_k(t)\, b_k(v)`: principal components of the frames about their mean m. A basis
    vector has three coordinates per vertex, a coefficient is one number. This kind is best for meshes with few
    vertices and many frames.

Both kinds are optimal in the least-squares sense. Every number of :math:`b_k` and of :math:`u_k \|b_k\|` is rounded to
a multiple of the same step, so that all numbers have the same expected error (reverse water-filling).

Only the trajectory components of the whole mesh are computed from frames. Shapes, components of parts and best-fitting
coefficients are computed from these trajectory components, which are far fewer than the frames.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import fsum
from typing import NamedTuple

import numpy as np
from scipy import linalg

from mixseq.compression.bitstream.spatial_basis import BasisKind, Part, PartBasis
from mixseq.runtime.low_memory import LargeArray, column_blocks, new_large_array
from mixseq.sequence.sequence import FrameStore
from mixseq.types import Float, Index

MAX_TABLE_SIDE = 3000
"""Largest smaller side of a table for principal components; from larger tables, evenly spaced frames are used."""


@dataclass(frozen=True, eq=False)
class PrincipalComponents:
    """Principal components of a sequence, largest first: each is a curve over time times a vector over the mesh."""

    kind: BasisKind  # whether components are trajectories or shapes
    # Trajectories: (T, 3) mean of all vertices at every frame. Shapes: (3, V) mean of all frames at every vertex.
    mean: Float
    curves: Float  # (K, T, d) orthonormal coefficients; d = 3 for trajectories, 1 for shapes
    # (K, c, V) orthogonal basis vectors in the units of the sequence; c = 1 for trajectories, 3 for shapes.
    vectors: Float
    left_out: float  # sum of squares of the omitted small components

    @cached_property
    def norms(self) -> Float:
        """Norms ``(K,)`` of the vectors, decreasing: the singular values."""
        return np.asarray(np.sqrt(np.square(self.vectors).sum(axis=(1, 2))))


def trajectory_components(sequence: FrameStore, min_norm: float) -> PrincipalComponents:
    """Compute the principal components of all vertices' trajectories."""
    count = len(sequence.points)
    table, means = _centred_trajectories(sequence, np.arange(count))
    stride = -(-min(table.shape) // MAX_TABLE_SIDE)
    if stride == 1 and table.shape[0] <= table.shape[1]:
        curves = _leading_eigenvectors(_row_gram(table), min_norm)
        vectors = _multiply(curves, table)
    else:
        # Every used frame represents `stride` frames, so norms are smaller by the root of `stride`.
        used = table if stride == 1 else _centred_trajectories(sequence, np.arange(0, count, stride))[0]
        scores = _project(table, _principal_directions(used, min_norm / np.sqrt(stride)))
        curves = np.asarray(linalg.qr(scores, mode="economic")[0].T, dtype=np.float64)
        vectors = _multiply(curves, table)
        rotation = _leading_eigenvectors(vectors @ vectors.T, 0.0)
        curves, vectors = rotation @ curves, rotation @ vectors
    energy = fsum(float(np.square(row).sum()) for _, block in column_blocks(table) for row in block)
    left_out = max(energy - float(np.square(vectors).sum()), 0.0)
    curves = curves.reshape(-1, count, 3)
    return PrincipalComponents("trajectories", means, curves, vectors[:, None], left_out)


def shape_components(components: PrincipalComponents, min_norm: float) -> PrincipalComponents:
    """Compute the principal components of the frames from the components of the trajectories."""
    used_mask = components.norms > 0
    curves, norms = components.curves[used_mask], components.norms[used_mask]
    vectors = components.vectors[used_mask, 0]
    mean = components.mean.mean(axis=0)[:, None] + curves.mean(axis=1).T @ vectors
    # Frames are scores (T, 3 (K + 1)) times orthonormal vectors, the last of which is constant.
    scales = np.append(norms, np.sqrt(vectors.shape[1]))
    scores = np.concatenate([curves, components.mean[None]])
    scores = (scores - scores.mean(axis=1, keepdims=True)) * scales[:, None, None]
    table = scores.transpose(1, 2, 0).reshape(len(components.mean), -1)
    if table.shape[0] <= table.shape[1]:
        shape_curves = _leading_eigenvectors(_row_gram(table), min_norm)
    else:
        directions = _leading_eigenvectors(table.T @ table, min_norm)
        shape_curves = np.asarray(linalg.qr(table @ directions.T, mode="economic")[0].T)
    loadings = (shape_curves @ table).reshape(len(shape_curves), 3, -1) / scales
    shapes = loadings[..., :-1] @ vectors + loadings[..., -1:]
    left_out = max(float(np.square(table).sum() - np.square(loadings * scales).sum()), 0.0)
    left_out += components.left_out
    return PrincipalComponents("shapes", mean, shape_curves[..., None], shapes, left_out)


def _leading_eigenvectors(gram: Float, min_norm: float) -> Float:
    """Return the eigenvectors ``(K, n)`` of a matrix ``(n, n)`` with eigenvalues above `min_norm`^2, at least one."""
    vectors = linalg.eigh(gram, subset_by_value=(max(min_norm, 0.0) ** 2, np.inf), check_finite=False)[1]
    if not vectors.shape[1]:
        vectors = np.eye(len(gram))[:, -1:]
    return np.ascontiguousarray(vectors[:, ::-1].T)


def _row_gram(table: LargeArray) -> Float:
    gram = np.zeros((table.shape[0],) * 2)
    for _, block in column_blocks(table):
        gram += block @ block.T
    return gram


def _principal_directions(table: LargeArray, min_norm: float) -> Float:
    """Return orthogonal vectors ``(K, V)`` that nearly span the rows of a table ``(R, V)``."""
    height, width = table.shape
    if height <= width:
        return _multiply(_leading_eigenvectors(_row_gram(table), min_norm), table)
    gram = np.zeros((width, width))
    for start in range(0, height, width):
        block = table[start : start + width]
        gram += block.T @ block
    return _leading_eigenvectors(gram, min_norm)


def _multiply(matrix: Float, table: LargeArray) -> Float:
    product = np.empty((len(matrix), table.shape[1]))
    for columns, block in column_blocks(table):
        product[:, columns] = matrix @ block
    return product


def _project(table: LargeArray, directions: Float) -> Float:
    scores, size = np.empty((len(table), len(directions))), 1 << 10
    for start in range(0, len(table), size):
        scores[start : start + size] = table[start : start + size] @ directions.T
    return scores


def _centred_trajectories(sequence: FrameStore, frames: Index) -> tuple[LargeArray, Float]:
    """Return trajectories ``(3T, V)`` relative to the mean of all vertices, and these means ``(T, 3)``."""
    table = new_large_array((3 * len(frames), sequence.points.shape[1]))
    means = np.empty((len(frames), 3))
    for row, frame in enumerate(frames):
        points = sequence.points[frame : frame + 1][0].astype(np.float64)
        means[row] = points.mean(axis=0)
        table[3 * row : 3 * row + 3] = (points - means[row]).T
    return table, means


MIN_VECTOR_STEPS = 0.9
"""Largest magnitude in a basis vector, in steps, below which it vanishes: rounding sets nearly all numbers to zero."""

MAX_VANISHING_VECTORS = 2
"""Number of consecutive vanishing basis vectors after which no more vectors are coded."""

_VECTORS_PER_BATCH = 16
"""Number of basis vectors computed at once."""


class Fit(NamedTuple):
    """Least-squares coefficients of a part."""

    coefficients: Float  # (K, T, d) coefficients of the varying vectors, scaled to unit length
    gram: Float  # (K, K) inner products of these vectors
    squares: float  # sum of squared distances of the part from the fit

    def squares_of(self, coefficients: Float) -> float:
        """Return the sum of squared distances of the part from a fit with other coefficients ``(K, T, d)``."""
        difference = coefficients - self.coefficients
        return self.squares + float(np.vdot(difference, np.tensordot(self.gram, difference, 1)))


class PartComponents:
    """Principal components of a part of the mesh, computed on demand."""

    def __init__(self, components: PrincipalComponents, part: Part, min_norm: float) -> None:
        self.part, self.norms = part, components.norms
        self._components = components
        self._first = 0  # number of the first vector of the newest batch
        self._batch: list[Float] = list(components.vectors)
        if len(part.vertices) < components.vectors.shape[2]:
            self._directions, self._offsets, self.norms = _rotate_to_part(self._loadings, min_norm)
            self._batch = []
        elif components.kind == "shapes":
            root = np.sqrt(components.curves.shape[1])
            self._batch = [root * components.mean, *components.vectors]
            self.norms = np.append(root * np.linalg.norm(components.mean), self.norms)

    @property
    def _loadings(self) -> Float:
        """Vectors ``(R, c n)`` of the whole mesh at the vertices of the part."""
        vectors = self._components.vectors
        if len(self.part.vertices) < vectors.shape[2]:
            vectors = vectors[..., self.part.vertices]
        return vectors.reshape(len(vectors), -1)

    @property
    def coordinates(self) -> int:
        """Number c of coordinates of a vector at a vertex."""
        return int(self._components.vectors.shape[1])

    @property
    def width(self) -> int:
        """Number of entries of a vector."""
        return self.coordinates * len(self.part.vertices)

    def vector(self, number: int) -> Float:
        """Return a basis vector ``(c, n)``, in the units of the sequence."""
        if not self._first <= number < self._first + len(self._batch):
            self._first = number - number % _VECTORS_PER_BATCH
            batch = slice(self._first, self._first + _VECTORS_PER_BATCH)
            vectors = self._directions[batch] @ self._loadings - self._offsets[batch, None]
            self._batch = list(vectors[:, None])
        return np.asarray(self._batch[number - self._first])

    def free_vectors(self) -> None:
        """Free the vectors of a part of the mesh, which are computed again when needed."""
        if len(self.part.vertices) < self._components.vectors.shape[2]:
            self._first, self._batch = 0, []

    def rank(self, step: float) -> int:
        """Return the number of vectors, at least one, before the vanishing vectors at which coding stops."""
        vanishing = number = 0
        while number < len(self.norms) and vanishing < MAX_VANISHING_VECTORS:
            vanishes = np.abs(self.vector(number)).max() < MIN_VECTOR_STEPS * step
            vanishing = vanishing + 1 if vanishes else 0
            number += 1
        return max(number - vanishing, 1)

    def fit(self, basis: PartBasis) -> Fit:
        """Fit coefficients of rounded vectors to the motion of the part, by least squares."""
        loadings, curves = self._loadings, self._components.curves.reshape(len(self._loadings), -1)
        count, vectors = self._components.curves.shape[1], basis.vectors.reshape(len(basis.vectors), -1)
        has_mean_shape = self._components.kind == "shapes"
        if has_mean_shape:  # the rounding error of the mean is one more component
            loadings = np.append(loadings, self.vector(0).reshape(1, -1) - vectors[:1], axis=0)
            curves = np.append(curves, np.full((1, count), count**-0.5), axis=0)
            vectors = vectors[1:]
        unit = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
        gram, right = unit @ unit.T, unit @ loadings.T
        solution = solve_damped(gram, right)
        squares = np.square(loadings).sum() + np.vdot(solution, gram @ solution - 2 * right)
        coefficients = solution @ curves
        if not has_mean_shape:  # the first vector is constant, and represents the whole mean
            coefficients[0] += np.sqrt(self.width) * self._components.mean.reshape(-1)
        return Fit(coefficients.reshape(len(unit), count, 3 // self.coordinates), gram, float(squares))


def _rotate_to_part(loadings: Float, min_norm: float) -> tuple[Float, Float, Float]:
    """Compute a part's principal components from the whole mesh's vectors ``(R, n)`` at its vertices.

    Return directions ``(K, R)``, their products ``(K,)`` with the means of the vectors, and norms ``(K,)``.
    """
    means = loadings.mean(axis=1)
    gram = loadings @ loadings.T - loadings.shape[1] * np.outer(means, means)
    values, vectors = linalg.eigh(gram, check_finite=False)
    kept = max(1, min(int(np.count_nonzero(values > min_norm**2)), loadings.shape[1]))
    directions = np.ascontiguousarray(vectors[:, ::-1][:, :kept].T)
    return directions, directions @ means, np.sqrt(np.maximum(values[::-1][:kept], 0.0))


def solve_damped(gram: Float, right: Float) -> Float:
    """Solve the normal equations of nearly orthogonal vectors."""
    if not len(gram):  # a mean shape, and no motion
        return right
    # Damping keeps the matrix regular if vectors are equal after rounding; a second solve corrects for the damping.
    factor = linalg.cho_factor(gram + 1e-9 * np.eye(len(gram)), check_finite=False)
    solution = linalg.cho_solve(factor, right, check_finite=False)
    return np.asarray(solution + linalg.cho_solve(factor, right - gram @ solution, check_finite=False))
