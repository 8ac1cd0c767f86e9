"""Principal components of a part of the mesh, and the coefficients that are nearest to its motion.

Both are found in few coordinates: a part moves as the components of the whole mesh do, times what their vectors are at
its vertices. So parts cost little, however many frames there are; and so do errors, for which no frame has to be made.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import linalg

from mixseq.arrays import Float
from mixseq.coding.bitstream.spatial_basis import Block, Part
from mixseq.coding.encoder.principal_components import PrincipalComponents

ZEROS = 3
"""Basis vectors are coded until so many in a row are zero everywhere, after rounding."""

VANISHING = 0.55
"""Numbers below this share of a step are rounded to zero."""

_AT_ONCE = 16
"""So many vectors are computed at once."""


class Fit(NamedTuple):
    """Coefficients of a part that are nearest to a sequence.

    Attributes
    ----------
    coefficients : (K, T, d) float64
        Of the varying vectors, made unit vectors.
    gram : (K, K) float64
        Products of these vectors.
    squares : float
        Sum of the squared distances that these coefficients leave.
    """

    coefficients: Float
    gram: Float
    squares: float

    def squares_of(self, coefficients: Float) -> float:
        """Return the sum of the squared distances that other coefficients ``(K, T, d)`` leave."""
        apart = coefficients - self.coefficients
        return self.squares + float(np.vdot(apart, np.tensordot(self.gram, apart, 1)))


class PartComponents:
    """Principal components of a part of the mesh, computed as far as they are asked for.

    Parameters
    ----------
    components : PrincipalComponents
        Those of the whole mesh.
    part : Part
        The part; shapes are of the whole mesh only.
    least : float
        Components with a norm below this are left out, in the units of the sequence.
    """

    def __init__(self, components: PrincipalComponents, part: Part, least: float) -> None:
        self.part = part
        self._components = components
        self._shape = components.vectors.shape[1], len(part.vertices)
        self._whole = self._shape[1] == components.vectors.shape[2]
        vectors = components.vectors if self._whole else components.vectors[..., part.vertices]
        self._loadings = vectors.reshape(len(vectors), -1)
        self.norms = components.norms
        self._ready: list[Float] = []
        if components.kind == "shapes":
            root = np.sqrt(components.frame_count)
            self._ready.append(root * components.mean)
            self.norms = np.append(root * np.linalg.norm(components.mean), self.norms)
        elif not self._whole:
            means = self._loadings.mean(axis=1)
            gram = self._loadings @ self._loadings.T - self._shape[1] * np.outer(means, means)
            values, directions = linalg.eigh(gram, check_finite=False)
            kept = max(1, min(int(np.count_nonzero(values > least**2)), self._shape[1]))
            self._directions = np.ascontiguousarray(directions[:, ::-1][:, :kept].T)
            self._offsets = self._directions @ means
            self.norms = np.sqrt(np.maximum(values[::-1][:kept], 0.0))

    @property
    def coordinates(self) -> int:
        """Numbers c that a vector has at a vertex."""
        return int(self._shape[0])

    @property
    def width(self) -> int:
        """Numbers that a vector has."""
        return int(self._shape[0] * self._shape[1])

    def vector(self, place: int) -> Float:
        """Return a basis vector ``(c, n)``, in the units of the sequence."""
        if self._whole:
            before = len(self._ready)
            return self._ready[place] if place < before else self._components.vectors[place - before]
        while place >= len(self._ready):
            some = slice(len(self._ready), len(self._ready) + _AT_ONCE)
            vectors = self._directions[some] @ self._loadings - self._offsets[some, None]
            self._ready.extend(vectors.reshape(-1, *self._shape))
        return self._ready[place]

    def rank(self, step: float) -> int:
        """Return how many vectors there are before `ZEROS` of them, or all that are left, round to zero."""
        zeros = place = 0
        while place < len(self.norms) and zeros < ZEROS:
            zeros = zeros + 1 if np.abs(self.vector(place)).max() < VANISHING * step else 0
            place += 1
        return max(place - zeros, 1)

    def fitted(self, block: Block) -> Fit:
        """Return the coefficients of rounded vectors that are nearest to the motion of the part."""
        components, count = self._components, self._components.frame_count
        flat = block.vectors.reshape(len(block.vectors), -1)
        loadings, curves = self._loadings, components.curves.reshape(len(components.curves), -1)
        if components.kind == "shapes":  # what rounding the mean has changed is one more component
            rest = np.sqrt(count) * components.mean.reshape(-1) - flat[0]
            loadings, curves = (
                np.append(loadings, rest[None], axis=0),
                np.append(curves, np.full((1, count), count**-0.5), axis=0),
            )
            flat = flat[1:]
        unit = flat / np.linalg.norm(flat, axis=1, keepdims=True)
        gram, right = unit @ unit.T, unit @ loadings.T
        solved = _solved(gram, right)
        squares = np.square(loadings).sum() + np.einsum("ij,ij->", solved, gram @ solved - 2 * right)
        coefficients = solved @ curves
        if components.kind == "trajectories":  # the first vector is constant, and has all of the mean
            coefficients[0] += np.sqrt(self._shape[1]) * components.mean.reshape(-1)
        return Fit(coefficients.reshape(len(unit), count, 3 // self.coordinates), gram, float(squares))


def _solved(gram: Float, right: Float) -> Float:
    """Solve the normal equations of vectors that are nearly orthogonal."""
    if not len(gram):  # a mean shape, and nothing that moves
        return right
    # A trace of damping is for vectors that are the same, after rounding; then it takes back what the damping took.
    factor = linalg.cho_factor(gram + 1e-9 * np.eye(len(gram)), check_finite=False)
    solved = linalg.cho_solve(factor, right, check_finite=False)
    return np.asarray(solved + linalg.cho_solve(factor, right - gram @ solved, check_finite=False))
