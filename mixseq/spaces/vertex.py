"""Linear spaces: a shape is its vertex positions (S_v), or three coefficients of every vector of a spatial basis."""

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
"""Size of basis vectors relative to a shape below which they are rounding errors."""

MAX_BASIS_BLOCKS = 128
"""Largest number of independent blocks of a basis; a basis with more is treated as one block."""


@dataclass(frozen=True, eq=False)
class BasisSpace(ShapeSpace):
    r"""Vectors are coefficients :math:`c_k \in R^3` of a spatial basis: :math:`x(v) = \sum_k b_k(v)\, c_k`.

    Compressed sequences use principal components of trajectories. Linear blend skinning has basis vectors that are a
    weight, or a weight times a coordinate.
    """

    basis: Float  # (K, V) the basis vectors, none of them zero everywhere
    # Length of the unit of the space, in the units of the sequence: coefficients are in diagonals.
    scale: float
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
        """The norms of the basis vectors, for all three coordinates."""
        return np.repeat(np.sqrt(np.einsum("kv,kv->k", self.basis, self.basis)), 3)

    def cached_values(self) -> Iterable[object]:
        """Implement `ShapeSpace.cached_values`."""
        return (self._blocks,)

    @cached_property
    def _blocks(self) -> list[tuple[Index | slice, Index | slice, Float]]:
        """Vertices and basis vectors of independent blocks, with the basis ``(n, k)`` of each."""
        whole: list[tuple[Index | slice, Index | slice, Float]] = [(slice(None), slice(None), self.basis.T)]
        if self.basis.all(axis=1).any():
            return whole
        pieces = _number_blocks(self.basis != 0)
        if pieces.max(initial=0) >= MAX_BASIS_BLOCKS:
            return whole
        blocks: list[tuple[Index | slice, Index | slice, Float]] = []
        for piece in range(pieces.max(initial=-1) + 1):
            some = np.flatnonzero(pieces == piece)
            beside = np.flatnonzero(
                self.basis[some].any(axis=0)
            )  # vertices without vectors are at the origin
            blocks.append((beside, some, self.basis[np.ix_(some, beside)].T))
        return blocks

    @cached_property
    def _gram_inverse(self) -> Float:
        # Of normalised vectors, which may be of very different sizes.
        norms = self.weights[::3]
        products = (self.basis @ self.basis.T) / np.outer(norms, norms)
        return np.asarray(np.linalg.pinv(products, hermitian=True) / np.outer(norms, norms))

    def extend(self, points: Float) -> tuple[ShapeSpace, ShapeMap]:
        """Implement `ShapeSpace.extend`: add what the basis does not span, one vector each for x, y and z."""
        rest = points - self.decode(self.encode(points[None]))[0]
        norms = np.linalg.norm(rest, axis=0)
        new = (rest / np.where(norms > 0, norms, 1.0)).T[norms > RANK_TOLERANCE * np.linalg.norm(points)]
        wider = BasisSpace(np.concatenate([self.basis, new]), self.scale)
        return wider, lambda shapes: np.pad(shapes, [(0, 0), (0, 3 * len(new))])

    def merge(self, other: ShapeSpace) -> tuple[ShapeSpace, ShapeMap | None, ShapeMap | None]:
        """Implement `ShapeSpace.merge`: merge two bases into an orthonormal one; other spaces have all shapes."""
        if not isinstance(other, BasisSpace):
            return other, None, identity_map
        if self.scale == other.scale and np.array_equal(self.basis, other.basis):
            return self, identity_map, identity_map
        from scipy import linalg  # heavy, and not needed to decode

        normalised = [
            each.basis / np.linalg.norm(each.basis, axis=1, keepdims=True) for each in (self, other)
        ]
        with one_blas_thread():
            orthonormal, triangle, _ = linalg.qr(np.concatenate(normalised).T, mode="economic", pivoting=True)
            rank = int(np.count_nonzero(np.abs(np.diagonal(triangle)) > RANK_TOLERANCE))
            both = BasisSpace(orthonormal.T[:rank], self.scale)
            return both, self._map_to(both), other._map_to(both)

    def _map_to(self, new: BasisSpace) -> ShapeMap:
        """Return the map of shapes to a space whose orthonormal basis spans this one."""
        change = (new.basis @ self.basis.T) * (self.scale / new.scale)

        def carry(shapes: Float) -> Float:
            coefficients = shapes.reshape(len(shapes), -1, 3)
            return np.asarray(np.einsum("nk,jki->jni", change, coefficients).reshape(len(shapes), -1))

        return carry

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
            for frame, vector in zip(
                points, self.check_vectors(vectors), strict=True
            ):  # the same bits for any other frames in the block
                coefficients = self.scale * vector.reshape(-1, 3)
                for vertices, some, transposed in self._blocks:
                    frame[vertices] = transposed @ coefficients[some]
        return points

    def decode_with_velocities(self, vectors: Float, rates: Float) -> tuple[Float, Float]:
        """Implement `ShapeSpace.decode_with_velocities`."""
        return self.decode(vectors), self.decode(rates)


def _number_blocks(used: Mask) -> Index:
    """Number the connected blocks ``(K,)`` of basis vectors with support `used` ``(K, V)``."""
    lowest = np.arange(len(used), dtype=np.int32)
    while True:
        of_vertices = np.full(used.shape[1], len(used), dtype=np.int32)
        for row, number in zip(used, lowest, strict=True):  # row by row: there may be a gigabyte of vectors
            np.minimum(of_vertices, number, out=of_vertices, where=row)
        joined = np.array([of_vertices[row].min(initial=len(used)) for row in used], dtype=np.int32)
        if np.array_equal(joined, lowest):
            return np.unique(lowest, return_inverse=True)[1].astype(np.int64)
        lowest = joined[joined]


@dataclass(frozen=True)
class VertexSpace(ShapeSpace):
    """Vectors are vertex positions in diagonals, for meshes without articulation: blends shrink rotating parts."""

    vertex_count: int
    scale: float  # unit of length, in the units of the sequence: the diagonal of the first frame
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
        return np.asarray(
            self.check_vectors(vectors).reshape(len(vectors), self.vertex_count, 3) * self.scale
        )

    def shape_difference(self, vector: Float, before: Float, after: Float) -> Float:
        """Implement `ShapeSpace.shape_difference`."""
        return np.asarray((after - before).reshape(-1) / self.scale)

    def decode_with_velocities(self, vectors: Float, rates: Float) -> tuple[Float, Float]:
        """Implement `ShapeSpace.decode_with_velocities`."""
        return self.decode(vectors), self.decode(rates)
