r"""Deviation of vertex sets from rigid motion, from additive sums.

For vertices with weights w, rest positions h and positions x_t in frame t, the error of the best rigid motion is

.. math:: E = \sum_t \Bigl( S^{xx}_t + S^{hh} - 2 \max_R \mathrm{tr}(R^T C_t) \Bigr), \qquad
          C_t = \sum w\, x_t h^T - \frac{1}{W} \bigl(\sum w\, x_t\bigr)\bigl(\sum w\, h\bigr)^T

with centred second moments S. The maximum is the sum of the singular values of C_t, the last one with the sign
of det C_t (Kabsch 1976). All sums are additive over disjoint sets: the error of a union needs no vertices.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mixseq.arrays import Float
from mixseq.geometry.rigid import nearest_rotations


@dataclass(frozen=True, eq=False)
class Moments:
    """Weighted sums over a set of vertices, for T frames."""

    weight: float  # sum of w
    rest: Float  # (3,) sum of w h
    moved: Float  # (T, 3) sum of w x_t
    rest_square: float  # sum of w |h|^2
    moved_square: Float  # (T,) sum of w |x_t|^2
    cross: Float  # (T, 3, 3) sum of w x_t h^T

    def __add__(self, other: Moments) -> Moments:
        return Moments(
            weight=self.weight + other.weight,
            rest=self.rest + other.rest,
            moved=self.moved + other.moved,
            rest_square=self.rest_square + other.rest_square,
            moved_square=self.moved_square + other.moved_square,
            cross=self.cross + other.cross,
        )

    @property
    def covariance(self) -> Float:
        """Centred cross moments ``(T, 3, 3)``, the C_t above."""
        return self.cross - self.moved[:, :, None] * self.rest / max(self.weight, _TINY)

    def errors(self) -> Float:
        """Weighted squared error ``(T,)`` of the best rigid motion of every frame."""
        weight = max(self.weight, _TINY)
        moved = self.moved_square - np.einsum("ti,ti->t", self.moved, self.moved) / weight
        rest = self.rest_square - float(self.rest @ self.rest) / weight
        covariance = self.covariance
        traces = np.einsum("tij,tij->t", nearest_rotations(covariance), covariance)
        return np.asarray(np.maximum(moved + rest - 2.0 * traces, 0.0))

    def error(self) -> float:
        """Sum of `errors` over all frames."""
        return float(self.errors().sum())

    @property
    def softness(self) -> float:
        """Largest error of a frame, root mean square, relative to the radius of gyration at rest."""
        rest = self.rest_square - float(self.rest @ self.rest) / max(self.weight, _TINY)
        return float(np.sqrt(self.errors().max() / max(rest, _TINY)))

    def motion(self) -> tuple[Float, Float]:
        """Rotation ``(T, 3, 3)`` and translation ``(T, 3)`` of the best rigid motion."""
        weight = max(self.weight, _TINY)
        rotation = nearest_rotations(self.covariance)
        return rotation, (self.moved - rotation @ self.rest) / weight


_TINY = np.finfo(np.float64).tiny


def moments(rest: Float, moved: Float, weights: Float) -> Moments:
    """Gather the moments of vertices with rest positions ``(N, 3)``, positions ``(N, T, 3)``, weights ``(N,)``."""
    weighted = moved * weights[:, None, None]
    return Moments(
        weight=float(weights.sum()),
        rest=weights @ rest,
        moved=weighted.sum(axis=0),
        rest_square=float(weights @ np.einsum("ni,ni->n", rest, rest)),
        moved_square=np.einsum("nti,nti->t", weighted, moved),
        cross=(weighted.reshape(len(rest), -1).T @ rest).reshape(-1, 3, 3),
    )


def union_errors(one: Moments, others: Sequence[Moments]) -> Float:
    """Return the errors ``(n,)`` of the unions of a set with each of n others, ``(one + other).error()``, at once."""
    weight = np.maximum(one.weight + np.array([other.weight for other in others]), _TINY)[:, None]
    rest = one.rest + np.stack([other.rest for other in others])
    moved = one.moved + np.stack([other.moved for other in others])
    squares = one.rest_square + np.array([other.rest_square for other in others])[:, None]
    squares = squares + one.moved_square + np.stack([other.moved_square for other in others])
    cross = one.cross + np.stack([other.cross for other in others])
    covariance = cross - moved[..., None] * (rest / weight)[:, None, None]
    means = np.einsum("nti,nti->nt", moved, moved) + np.einsum("ni,ni->n", rest, rest)[:, None]
    traces = np.einsum("ntij,ntij->nt", nearest_rotations(covariance), covariance)
    return np.asarray(np.maximum(squares - means / weight - 2.0 * traces, 0.0).sum(axis=1))
