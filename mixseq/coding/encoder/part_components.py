"""Principal components of a part of the mesh, and the coefficients nearest to its motion.

Both are computed in few coordinates: the motion of a part is that of the components of the whole mesh, times their
vectors at its vertices. So the cost of parts and errors does not grow with the number of frames.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import linalg

from mixseq.arrays import Float
from mixseq.coding.bitstream.spatial_basis import Block, Part
from mixseq.coding.encoder.principal_components import PrincipalComponents

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
