r"""Shape spaces of rigid-motion invariants: vectors end with the poses of pieces.

A vector is ``[shape | quaternions | centres]``: invariants of rigid motions, and a pose of every hinge-connected piece,
its rotation from the reference and its centre (the paper's :math:`\mathbb{R}^6`, Section 2.2). The paper orients a mesh
by its first face; all vertices of a piece together are more robust.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mixseq.arrays import Float, FloatArray
from mixseq.geometry.rotations import continued, quaternions, rotations_of
from mixseq.progress import Progress, silent
from mixseq.spaces.base import ShapeSpace
from mixseq.spaces.pieces import Pieces
from mixseq.threads import one_blas_thread
from mixseq.topology import Topology


@dataclass(frozen=True, eq=False)
class PosedSpace(ShapeSpace):
    """A space whose shapes are invariant under a rigid motion of every piece."""

    topology: Topology  # connectivity of the mesh
    # Length of the unit of the space, in the units of the sequence: the diagonal of the first frame.
    scale: float
    # (V, 3) the first frame, in the space's unit: rotations are from it, angles of the first encoded frame stay near
    # it.
    reference: Float

    @cached_property
    def pieces(self) -> Pieces:
        """The pieces of the mesh."""
        return Pieces.of(self.topology, self.reference)

    @property
    def vertex_count(self) -> int:  # type: ignore[override]
        """Implement `ShapeSpace.vertex_count`."""
        return self.topology.vertex_count

    @property
    @abstractmethod
    def shape_dim(self) -> int:
        """Length S of the shape in a vector."""

    @property
    @abstractmethod
    def shape_metric(self) -> Float:
        """Weights ``(S,)`` of the shape, as in `weights`."""

    @abstractmethod
    def shape_of(self, x: Float) -> Float:
        """Return the shape ``(S,)`` of a frame ``(V, 3)`` in diagonals, invariant under rigid motions."""

    @abstractmethod
    def rebuilt(self, shape: Float) -> Float:
        """Return rows ``(N, 3)`` of all pieces with a shape ``(S,)``, each in any pose; see `Pieces`."""

    def unwrap_shapes(self, shapes: Float, previous: Float | None) -> Float:
        """Make shapes ``(T, S)`` continuous in time, after the previous one, or else the reference."""
        return shapes

    @property
    def dim(self) -> int:
        """Length D of a vector."""
        return self.shape_dim + self.placement_dim

    @property
    def rotation_count(self) -> int:
        """One for every piece."""
        return len(self.pieces)

    @property
    def centre_count(self) -> int:
        """One for every piece."""
        return len(self.pieces)

    @property
    def weights(self) -> Float:
        """Metric ``(D,)``: a quaternion moves vertices by twice the radius of gyration of its piece."""
        turns = np.repeat(2.0 * self.pieces.radii, 4)
        return np.concatenate([self.shape_metric, turns, np.ones(3 * len(self.pieces))])

    def encode_apart(self, points: FloatArray) -> Float:
        """Implement `ShapeSpace.encode_apart`."""
        result = np.empty((len(points), self.dim))
        for vector, frame in zip(result, points, strict=True):
            x = frame.astype(np.float64) / self.scale
            rotations, centres = self.pieces.poses(x)
            blocks = self.shape_of(x), quaternions(rotations).reshape(-1), centres.reshape(-1)
            np.concatenate(blocks, out=vector)
        return result

    def unwrap(self, vectors: Float, previous: Float | None = None) -> Float:
        """Implement `ShapeSpace.unwrap`."""
        shapes, turns, centres = self.split(vectors)
        before = None if previous is None else self.split(previous[None])
        shapes = self.unwrap_shapes(shapes, None if before is None else before[0][0])
        turns = continued(turns, None if before is None else before[1][0])
        count = len(vectors)
        return np.concatenate([shapes, turns.reshape(count, -1), centres.reshape(count, -1)], axis=1)

    def decode(self, vectors: Float, progress: Progress = silent) -> Float:
        """Implement `ShapeSpace.decode`."""
        shapes, turns, centres = self.split(np.asarray(vectors, dtype=np.float64))
        points = np.empty((len(shapes), self.topology.vertex_count, 3))
        with one_blas_thread():
            for number, shape in enumerate(shapes):
                points[number] = self.placed(self.rebuilt(shape), turns[number], centres[number])
                progress(number + 1, len(shapes), "decoding frames")
        return points

    def placed(self, rows: Float, turns: Float, centres: Float) -> Float:
        """Pose pieces ``(N, 3)`` in diagonals; returns vertices ``(V, 3)`` in units of the sequence."""
        return self.pieces.place(rows, rotations_of(turns), centres) * self.scale

    def split(self, vectors: Float) -> tuple[Float, Float, Float]:
        """Return shapes ``(T, S)``, quaternions ``(T, p, 4)``, centres ``(T, p, 3)``; raises what `checked` does."""
        shapes = self.checked(vectors)[:, : self.shape_dim]
        return shapes, *self.poses(vectors[:, self.shape_dim :])
