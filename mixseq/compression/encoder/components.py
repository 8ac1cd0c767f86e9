r"""Principal components of a sequence and of parts of its mesh: the spatial basis before it is rounded.

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

Frames are read for the trajectories of the whole mesh only. Shapes, the components of parts and the coefficients
nearest to the motion of a part are computed from these components, which are far fewer than the frames.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy import linalg

from mixseq.compression.bitstream.spatial_basis import BasisKind, Block, Part
from mixseq.runtime.low_memory import LargeArray, column_blocks, new_large_array
from mixseq.sequence.sequence import FrameStore
from mixseq.types import Float, Index

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


VANISHING = 0.9
"""Largest number of a basis vector, in steps, below which the vector does not pay: rounding leaves next to nothing."""

ZEROS = 2
"""Number of consecutive basis vectors that do not pay, after which no more are coded."""

_AT_ONCE = 16
"""Number of vectors computed at once."""


class Fit(NamedTuple):
    """Coefficients of a part that are nearest to a sequence."""

    coefficients: Float  # (K, T, d) of the varying vectors, made unit vectors
    gram: Float  # (K, K) products of these vectors
    squares: float  # sum of the squared distances with these coefficients

    def squares_of(self, coefficients: Float) -> float:
        """Return the sum of squared distances of the part with other coefficients ``(K, T, d)``."""
        apart = coefficients - self.coefficients
        return self.squares + float(np.vdot(apart, np.tensordot(self.gram, apart, 1)))


class PartComponents:
    """Principal components of a part of the mesh, computed on demand."""

    def __init__(self, components: PrincipalComponents, part: Part, least: float) -> None:
        self.part, self.norms = part, components.norms
        self._components = components
        cubes = components.vectors
        if len(part.vertices) < cubes.shape[2]:
            cubes = cubes[..., part.vertices]
            self._directions, self._offsets, self.norms = _turned(cubes[:, 0], least)
            self._ready: list[Float] = []
        elif components.kind == "trajectories":
            self._ready = list(cubes)
        else:
            root = np.sqrt(components.frame_count)
            self._ready = [root * components.mean, *cubes]
            self.norms = np.append(root * np.linalg.norm(components.mean), self.norms)
        self._loadings = cubes.reshape(len(cubes), -1)

    @property
    def coordinates(self) -> int:
        """Number c of coordinates of a vector at a vertex."""
        return int(self._components.vectors.shape[1])

    @property
    def width(self) -> int:
        """Number of entries of a vector."""
        return int(self._loadings.shape[1])

    def vector(self, place: int) -> Float:
        """Return a basis vector ``(c, n)``, in the units of the sequence."""
        while place >= len(self._ready):
            some = slice(len(self._ready), len(self._ready) + _AT_ONCE)
            vectors = self._directions[some] @ self._loadings - self._offsets[some, None]
            self._ready.extend(vectors[:, None])
        return self._ready[place]

    def rank(self, step: float) -> int:
        """Return the number of vectors before `ZEROS` of them, or all that are left, that do not pay."""
        zeros = place = 0
        while place < len(self.norms) and zeros < ZEROS:
            zeros = zeros + 1 if np.abs(self.vector(place)).max() < VANISHING * step else 0
            place += 1
        return max(place - zeros, 1)

    def fitted(self, block: Block) -> Fit:
        """Return the coefficients of rounded vectors that are nearest to the motion of the part."""
        count, flat = self._components.frame_count, block.vectors.reshape(len(block.vectors), -1)
        loadings, curves = self._loadings, self._components.curves.reshape(len(self._loadings), -1)
        shapes = self._components.kind == "shapes"
        if shapes:  # the rounding error of the mean is one more component
            loadings = np.append(loadings, self._ready[0].reshape(1, -1) - flat[:1], axis=0)
            curves = np.append(curves, np.full((1, count), count**-0.5), axis=0)
            flat = flat[1:]
        unit = flat / np.linalg.norm(flat, axis=1, keepdims=True)
        gram, right = unit @ unit.T, unit @ loadings.T
        solved = _solved(gram, right)
        squares = np.square(loadings).sum() + np.vdot(solved, gram @ solved - 2 * right)
        coefficients = solved @ curves
        if not shapes:  # the first vector is constant, and has all of the mean
            coefficients[0] += np.sqrt(self.width) * self._components.mean.reshape(-1)
        return Fit(coefficients.reshape(len(unit), count, 3 // self.coordinates), gram, float(squares))


def _turned(loadings: Float, least: float) -> tuple[Float, Float, Float]:
    """Return a part's principal components ``(K, R)``, ``(K,)``, ``(K,)`` from the whole mesh's vectors ``(R, n)``."""
    means = loadings.mean(axis=1)
    gram = loadings @ loadings.T - loadings.shape[1] * np.outer(means, means)
    values, vectors = linalg.eigh(gram, check_finite=False)
    kept = max(1, min(int(np.count_nonzero(values > least**2)), loadings.shape[1]))
    directions = np.ascontiguousarray(vectors[:, ::-1][:, :kept].T)
    return directions, directions @ means, np.sqrt(np.maximum(values[::-1][:kept], 0.0))


def _solved(gram: Float, right: Float) -> Float:
    """Solve the normal equations of nearly orthogonal vectors."""
    if not len(gram):  # a mean shape, and nothing that moves
        return right
    # Slight damping allows vectors that are equal after rounding; a second solve corrects for it.
    factor = linalg.cho_factor(gram + 1e-9 * np.eye(len(gram)), check_finite=False)
    solved = linalg.cho_solve(factor, right, check_finite=False)
    return np.asarray(solved + linalg.cho_solve(factor, right - gram @ solved, check_finite=False))
