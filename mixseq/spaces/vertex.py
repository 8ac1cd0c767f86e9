"""Linear spaces of vertex positions (S_v), or of three coefficients for every vector of a spatial basis."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mixseq.mesh.polygons import read_only
from mixseq.runtime.parallel import one_blas_thread
from mixseq.runtime.progress import Progress, no_progress
from mixseq.spaces.base import ShapeMap, ShapeSpace, identity_map
from mixseq.types import Float, FloatArray, Index, Mask

RANK_TOLERANCE = 1e-9
"""Ratio of the size of a basis vector to the size of shapes below which the vector is a rounding error."""

MAX_BASIS_BLOCKS = 128
"""Largest number of independent blocks of a basis; a basis with more blocks is treated as one block."""


@dataclass(frozen=True, eq=False)
class BasisSpace(ShapeSpace):
    r"""Vectors are coefficients :math:`c_k \in R^3` of a spatial basis: :math:`x(v) = \sum_k b_k(v)\, c_k`.

    Compressed sequences use principal components of trajectories. The basis vectors of linear blend skinning are
    weights, and weights times coordinates.
    """

    basis: Float  # (K, V) basis vectors, none of them zero everywhere
    scale: float  # unit of the coefficients, in the units of the sequence: a diagonal
    name = "basis"

    def __post_init__(self) -> None:
        object.__setattr__(self, "basis", read_only(np.asarray(self.basis, dtype=np.float64, order="C")))

    @property
    def vertex_count(self) -> int:  # type: ignore[override]
        """Implement `ShapeSpace.vertex_count`."""
        return int(self.basis.shape[1])

    @property
    def dim(self) -> int:
        """Length of a vector, 3 K."""
        return 3 * len(self.basis)

    @property
    def weights(self) -> Float:
        """Metric ``(D,)``: the norms of the basis vectors, for all three coordinates."""
        return np.repeat(np.sqrt(np.einsum("kv,kv->k", self.basis, self.basis)), 3)

    def cached_values(self) -> Iterable[object]:
        """Implement `ShapeSpace.cached_values`."""
        return (self._blocks,)

    @cached_property
    def _blocks(self) -> list[tuple[Index | slice, Index | slice, Float]]:
        """Vertices, basis vectors and the basis ``(n, k)`` of independent blocks."""
        whole: list[tuple[Index | slice, Index | slice, Float]] = [(slice(None), slice(None), self.basis.T)]
        if self.basis.all(axis=1).any():
            return whole
        block_of_vector = _number_blocks(self.basis != 0)
        if block_of_vector.max(initial=0) >= MAX_BASIS_BLOCKS:
            return whole
        blocks: list[tuple[Index | slice, Index | slice, Float]] = []
        for number in range(block_of_vector.max(initial=-1) + 1):
            vector_ids = np.flatnonzero(block_of_vector == number)
            vertex_ids = np.flatnonzero(self.basis[vector_ids].any(axis=0))  # other vertices are at the origin
            blocks.append((vertex_ids, vector_ids, self.basis[np.ix_(vector_ids, vertex_ids)].T))
        return blocks

    @cached_property
    def _gram_inverse(self) -> Float:
        # Normalised, because the vectors may have very different sizes.
        norms = self.weights[::3]
        gram = (self.basis @ self.basis.T) / np.outer(norms, norms)
        return np.asarray(np.linalg.pinv(gram, hermitian=True) / np.outer(norms, norms))

    def extend(self, points: Float) -> tuple[ShapeSpace, ShapeMap]:
        """Implement `ShapeSpace.extend`: add the residual of the shape, one vector each for x, y and z."""
        residual = points - self.decode(self.encode(points[None]))[0]
        norms = np.linalg.norm(residual, axis=0)
        new = (residual / np.where(norms > 0, norms, 1.0)).T[norms > RANK_TOLERANCE * np.linalg.norm(points)]
        extended = BasisSpace(np.concatenate([self.basis, new]), self.scale)
        return extended, lambda shapes: np.pad(shapes, [(0, 0), (0, 3 * len(new))])

    def merge(self, other: ShapeSpace) -> tuple[ShapeSpace, ShapeMap | None, ShapeMap | None]:
        """Implement `ShapeSpace.merge`: orthonormalise both bases; other spaces contain all shapes."""
        if not isinstance(other, BasisSpace):
            return other, None, identity_map
        if self.scale == other.scale and np.array_equal(self.basis, other.basis):
            return self, identity_map, identity_map
        from scipy import linalg  # slow import, unused for decoding

        bases = [space.basis / np.linalg.norm(space.basis, axis=1, keepdims=True) for space in (self, other)]
        with one_blas_thread():
            orthonormal, triangle, _ = linalg.qr(np.concatenate(bases).T, mode="economic", pivoting=True)
            rank = int(np.count_nonzero(np.abs(np.diagonal(triangle)) > RANK_TOLERANCE))
            merged = BasisSpace(orthonormal.T[:rank], self.scale)
            return merged, self._map_to(merged), other._map_to(merged)

    def _map_to(self, target: BasisSpace) -> ShapeMap:
        """Return the map of shapes to a space with an orthonormal basis that spans this space."""
        change = (target.basis @ self.basis.T) * (self.scale / target.scale)

        def map_shapes(shapes: Float) -> Float:
            coefficients = shapes.reshape(len(shapes), -1, 3)
            return np.asarray(np.einsum("nk,jki->jni", change, coefficients).reshape(len(shapes), -1))

        return map_shapes

    def encode_independently(self, points: FloatArray) -> Float:
        """Implement `ShapeSpace.encode_independently` by linear least squares."""
        vectors = np.empty((len(points), self.dim))
        with one_blas_thread():
            for row, frame in zip(vectors, points, strict=True):
                row[:] = (self._gram_inverse @ (self.basis @ frame.astype(np.float64))).reshape(-1)
        return vectors / self.scale

    def decode(self, vectors: Float, progress: Progress = no_progress) -> Float:
        """Implement `ShapeSpace.decode`."""
        points = np.zeros((len(vectors), self.vertex_count, 3))
        with one_blas_thread():
            # Frame by frame, so that results are independent of the block.
            for frame, vector in zip(points, self.check_vectors(vectors), strict=True):
                coefficients = self.scale * vector.reshape(-1, 3)
                for vertex_ids, vector_ids, transposed in self._blocks:
                    frame[vertex_ids] = transposed @ coefficients[vector_ids]
        return points

    def decode_with_velocities(self, vectors: Float, rates: Float) -> tuple[Float, Float]:
        """Implement `ShapeSpace.decode_with_velocities`."""
        return self.decode(vectors), self.decode(rates)


def _number_blocks(support: Mask) -> Index:
    """Return the connected block ``(K,)`` of every basis vector with support ``(K, V)``."""
    lowest = np.arange(len(support), dtype=np.int32)
    while True:
        lowest_of_vertex = np.full(support.shape[1], len(support), dtype=np.int32)
        for row, number in zip(support, lowest, strict=True):  # row by row, as the support may take a gigabyte
            np.minimum(lowest_of_vertex, number, out=lowest_of_vertex, where=row)
        count = len(support)
        merged = np.array([lowest_of_vertex[row].min(initial=count) for row in support], dtype=np.int32)
        if np.array_equal(merged, lowest):
            return np.unique(lowest, return_inverse=True)[1].astype(np.int64)
        lowest = merged[merged]


@dataclass(frozen=True)
class VertexSpace(ShapeSpace):
    """Vectors are vertex positions in diagonals, for meshes without articulation: blends shrink rotating parts."""

    vertex_count: int
    scale: float  # diagonal of the first frame, in the units of the sequence
    name = "vertex"

    @property
    def dim(self) -> int:
        """Length of a vector, 3 V."""
        return 3 * self.vertex_count

    @property
    def weights(self) -> Float:
        """Ones: coordinates are in diagonals."""
        return np.ones(self.dim)

    def encode_independently(self, points: FloatArray) -> Float:
        """Implement `ShapeSpace.encode_independently`."""
        return points.astype(np.float64).reshape(len(points), -1) / self.scale

    def decode(self, vectors: Float, progress: Progress = no_progress) -> Float:
        """Implement `ShapeSpace.decode`."""
        points = self.check_vectors(vectors).reshape(len(vectors), self.vertex_count, 3)
        return np.asarray(points * self.scale)

    def shape_difference(self, vector: Float, before: Float, after: Float) -> Float:
        """Implement `ShapeSpace.shape_difference`."""
        return np.asarray((after - before).reshape(-1) / self.scale)

    def decode_with_velocities(self, vectors: Float, rates: Float) -> tuple[Float, Float]:
        """Implement `ShapeSpace.decode_with_velocities`."""
        return self.decode(vectors), self.decode(rates)
