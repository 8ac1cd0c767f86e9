r"""The space of deformation gradients S_f (Sumner and Popović 2004, with their linear reconstruction P_f).

The deformation gradient of a face maps its reference triangle to its triangle in the frame. A fourth vertex along the
normal completes both triangles. With the columns ``D = [e_1, e_2, n / sqrt |n|]`` of a triangle with sides ``e_1, e_2``
and ``n = e_1 x e_2``

.. math:: J_f = D_f \, \bar D_f^{-1} .

1. Linear blends of J would be linear blends of vertices. Interpolation in S_f (the paper's Figure 1; Kircher and
   Garland 2008) therefore blends the polar decomposition ``J = R S`` (Sumner et al. 2005, Section 3): a rotation
   vector, the shortest one in the first frame and continuous in time, and the six numbers of the symmetric stretch S.
2. P_f minimises :math:`\min_x \sum_f \bar A_f |\nabla x - J_f|^2`, weighted by the areas of the reference (Botsch et
   al. 2006; without weights in Sumner and Popović), a constant Poisson system. Gradients do not determine positions, so
   that the centres of pieces are stored as well.

A vector is ``[rotation vectors (F, 3) | stretches (F, 6) | centres]``. The normal makes ``det J >= 0``: reflections
are rotations of the surface. Affine maps of the reference are reproduced.

*Vertices* follow from the sides of triangles (`mixseq.shells.solvers.PoissonSystem`), with half the cotangent of the
opposite angle as the weight of a side.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mixseq.errors import ReconstructionError
from mixseq.mesh.rigid import nearest_rotations
from mixseq.mesh.rotations import matrix_to_rotvec, rotvec_to_matrix, unwrap_rotvec
from mixseq.mesh.triangle_mesh import replace_degenerate, triangle_matrices
from mixseq.runtime.lazy import cached_property
from mixseq.runtime.parallel import one_blas_thread
from mixseq.runtime.progress import Progress, log_progress
from mixseq.shells.solvers import PoissonSystem
from mixseq.spaces.base import flatten_blocks
from mixseq.spaces.pieces import PiecewiseSpace
from mixseq.types import Float, FloatArray, Index

SYMMETRIC_ENTRIES = ([0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2])
"""Rows and columns of the six numbers of a symmetric matrix, with the diagonal first."""

SYMMETRIC_ENTRY_IDS = np.array([[0, 3, 4], [3, 1, 5], [4, 5, 2]])  # index of each matrix entry among the six numbers


class GradientBlocks(NamedTuple):
    """The blocks of T vectors of S_f."""

    rotation_vectors: Float  # (T, F, 3) rotations of faces from the reference
    stretches: Float  # (T, F, 6) stretches: xx, yy, zz, xy, xz, yz
    centres: Float  # (T, p, 3) centres of the pieces, in diagonals


@dataclass(frozen=True, eq=False)
class GradientSpace(PiecewiseSpace):
    """Deformation gradients of all faces from a reference, in which faces without area are replaced."""

    name = "gradient"

    @cached_property
    def side_rows(self) -> Index:
        """Rows ``(3F, 2)`` of the sides 01, 12, 20 of all faces."""
        return np.stack([self.face_rows, np.roll(self.face_rows, -1, axis=1)], axis=2).reshape(-1, 2)

    @cached_property
    def reference_triangles(self) -> Float:
        """Matrices D ``(F, 3, 3)`` of the reference triangles: two sides and the fourth vertex, in columns."""
        return replace_degenerate(self.complete_triangles(self.reference))

    @cached_property
    def inverse_triangles(self) -> Float:
        """Inverses ``(F, 3, 3)`` of the matrices D of the reference triangles."""
        return np.asarray(np.linalg.inv(self.reference_triangles))

    @cached_property
    def reference_sides(self) -> Float:
        """Sides 01, 12, 20 of the reference triangles ``(F, 3, 3)``, in columns."""
        first, second = self.reference_triangles[:, :, 0], self.reference_triangles[:, :, 1]
        return np.stack([first, second - first, -second], axis=2)

    @cached_property
    def poisson_system(self) -> PoissonSystem:
        """The Poisson system of the reference triangles."""
        following = np.roll(self.reference_sides, -1, axis=2)
        preceding = np.roll(self.reference_sides, 1, axis=2)
        # The angle opposite to a side lies between the other two sides, of which one is reversed.
        cosines = -np.sum(following * preceding, axis=1)
        areas = np.linalg.norm(np.cross(self.reference_sides[:, :, 0], self.reference_sides[:, :, 1]), axis=1)
        cotangents = cosines / areas[:, None]
        fixed_mask = np.zeros(len(self.pieces.vertex_of_row), dtype=bool)
        return PoissonSystem(self.side_rows, 0.5 * cotangents.reshape(-1), fixed_mask)

    @property
    def dim(self) -> int:
        """Length D of a vector: nine numbers per face, three per piece."""
        return 9 * len(self.topology.faces) + self.placement_dim

    @property
    def centre_count(self) -> int:
        """Implement `ShapeSpace.centre_count`: one per piece; gradients contain the rotations."""
        return len(self.pieces)

    @property
    def weights(self) -> Float:
        """Metric ``(D,)``: the root mean square of a face's sides, times sqrt(2) for off-diagonal stretches."""
        sizes = np.sqrt(np.square(self.reference_sides).sum(axis=1).mean(axis=1))
        stretches = np.outer(sizes, [1.0, 1.0, 1.0, np.sqrt(2), np.sqrt(2), np.sqrt(2)])
        return np.concatenate([np.repeat(sizes, 3), stretches.reshape(-1), np.ones(self.placement_dim)])

    def encode_independently(self, points: FloatArray) -> Float:
        """Implement `ShapeSpace.encode_independently`."""
        encoded = np.empty((len(points), self.dim))
        for row, frame in zip(encoded, points, strict=True):
            x = frame.astype(np.float64) / self.scale
            gradients = self.complete_triangles(x) @ self.inverse_triangles
            rotations = nearest_rotations(gradients)
            stretches = np.swapaxes(rotations, 1, 2) @ gradients
            centres = self.pieces.measure_centres(x)
            blocks = matrix_to_rotvec(rotations), stretches[:, *SYMMETRIC_ENTRIES], centres
            np.concatenate([block.reshape(-1) for block in blocks], out=row)
        return encoded

    def unwrap(self, vectors: Float, previous: Float | None = None) -> Float:
        """Implement `ShapeSpace.unwrap`."""
        before = None if previous is None else self.split(previous[None]).rotation_vectors[0]
        blocks = self.split(vectors)
        return self.join(blocks._replace(rotation_vectors=unwrap_rotvec(blocks.rotation_vectors, before)))

    def decode(self, vectors: Float, progress: Progress = log_progress) -> Float:
        """Implement `ShapeSpace.decode`."""
        blocks = self.split(np.asarray(vectors, dtype=np.float64))
        invalid = np.flatnonzero(~np.isfinite(vectors).all(axis=1))
        if invalid.size:
            raise ReconstructionError(f"vector {invalid[0]} is not finite")
        points = np.empty((len(vectors), self.vertex_count, 3))
        with one_blas_thread():
            for number, (rotation_vectors, stretches, centres) in enumerate(zip(*blocks, strict=True)):
                gradients = rotvec_to_matrix(rotation_vectors) @ stretches[:, SYMMETRIC_ENTRY_IDS]
                sides = np.swapaxes(gradients @ self.reference_sides, 1, 2).reshape(-1, 3)
                points[number] = self.pieces.translate(self.poisson_system.solve(sides), centres) * self.scale
                progress(number + 1, len(points), "decoding frames")
        return points

    def complete_triangles(self, x: Float) -> Float:
        """Return the matrices D ``(F, 3, 3)`` of a frame ``(V, 3)`` in diagonals."""
        return triangle_matrices(x[self.pieces.vertex_of_row], self.face_rows, self.side_rows)

    def split(self, vectors: Float) -> GradientBlocks:
        """Return the blocks of vectors ``(T, D)``; raises as `check_vectors`."""
        count, faces = len(vectors), len(self.topology.faces)
        blocks = np.split(self.check_vectors(vectors), [3 * faces, 9 * faces], axis=1)
        shapes = (faces, 3), (faces, 6), (len(self.pieces), 3)
        return GradientBlocks(*(b.reshape(count, *shape) for b, shape in zip(blocks, shapes, strict=True)))

    def join(self, blocks: GradientBlocks) -> Float:
        """Return the vectors ``(T, D)`` of blocks; the inverse of `split`."""
        return flatten_blocks(blocks)
