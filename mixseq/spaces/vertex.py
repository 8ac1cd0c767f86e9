"""The linear space of vertex positions (S_v)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mixseq.runtime.progress import Progress, no_progress
from mixseq.spaces.base import ShapeSpace
from mixseq.types import Float, FloatArray


@dataclass(frozen=True)
class VertexSpace(ShapeSpace):
    """Vectors are vertex positions in diagonals, for meshes without articulation: blends shrink rotating parts."""

    vertex_count: int
    scale: float  # unit of errors, see `reference_diagonal`, in the units of the sequence
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
