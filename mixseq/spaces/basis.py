"""The basis space: a shape is three coefficients of every field of a basis over the mesh."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mixseq.arrays import Float, FloatArray
from mixseq.polygons import frozen
from mixseq.progress import Progress, silent
from mixseq.spaces.base import ShapeSpace
from mixseq.threads import one_blas_thread


@dataclass(frozen=True, eq=False)
class BasisSpace(ShapeSpace):
    r"""Vectors are coefficients :math:`c_k \in R^3` of fields: :math:`x(v) = \sum_k b_k(v)\, c_k`.

    Compressed sequences are of this space: the fields are principal components of trajectories. Skinning is of it, too,
    with fields that are a weight, or a weight times a coordinate; so blends are those of linear blend skinning.

    Attributes
    ----------
    fields : (K, V) float64
        The fields, none of them zero everywhere.
    scale : float
        Length of the unit of the space, in the units of the sequence: coefficients are in diagonals.
    """

    fields: Float
    scale: float
    name = "basis"

    def __post_init__(self) -> None:
        object.__setattr__(self, "fields", frozen(np.asarray(self.fields, dtype=np.float64, order="C")))

    @property
    def dim(self) -> int:
        """Length of a vector, 3 K."""
        return 3 * len(self.fields)

    @property
    def weights(self) -> Float:
        """The norms of the fields, for all three coordinates."""
        return np.repeat(np.sqrt(np.square(self.fields).sum(axis=1)), 3)

    @cached_property
    def _inverse(self) -> Float:
        # Of normalised fields, which may be of very different sizes.
        norms = self.weights[::3]
        products = (self.fields @ self.fields.T) / np.outer(norms, norms)
        return np.asarray(np.linalg.pinv(products, hermitian=True) / np.outer(norms, norms))

    def encode_apart(self, points: FloatArray) -> Float:
        """Implement `ShapeSpace.encode_apart`: the coefficients nearest to the frames, in the least-squares sense."""
        vectors = np.empty((len(points), self.dim))
        with one_blas_thread():
            for row, frame in zip(vectors, points, strict=True):
                row[:] = (self._inverse @ (self.fields @ frame.astype(np.float64))).reshape(-1)
        return vectors / self.scale

    def decode(self, vectors: Float, progress: Progress = silent) -> Float:
        """Implement `ShapeSpace.decode`."""
        points = np.empty((len(vectors), self.fields.shape[1], 3))
        with one_blas_thread():
            for frame, vector in zip(points, vectors, strict=True):  # the same bits whatever is asked with it
                frame[:] = self.fields.T @ (self.scale * vector.reshape(-1, 3))
        return points

    def decode_moving(self, vectors: Float, rates: Float) -> tuple[Float, Float]:
        """Implement `ShapeSpace.decode_moving`."""
        return self.decode(vectors), self.decode(rates)
