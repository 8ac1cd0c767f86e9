"""The vertex space S_v: a shape is its vertex positions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mixseq.arrays import Float, FloatArray
from mixseq.progress import Progress, silent
from mixseq.spaces.base import ShapeSpace


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

    def encode_apart(self, points: FloatArray) -> Float:
        """Implement `ShapeSpace.encode_apart`."""
        return points.astype(np.float64).reshape(len(points), -1) / self.scale

    def decode(self, vectors: Float, progress: Progress = silent) -> Float:
        """Implement `ShapeSpace.decode`."""
        return np.asarray(self.checked(vectors).reshape(len(vectors), self.vertex_count, 3) * self.scale)

    def shape_difference(self, vector: Float, before: Float, after: Float) -> Float:
        """Implement `ShapeSpace.shape_difference`."""
        return np.asarray((after - before).reshape(-1) / self.scale)

    def decode_moving(self, vectors: Float, rates: Float) -> tuple[Float, Float]:
        """Implement `ShapeSpace.decode_moving`."""
        return self.decode(vectors), self.decode(rates)
