r"""The space of deformation gradients S_f (Sumner and Popović 2004, with their linear reconstruction P_f).

The deformation gradient of a face maps its reference triangle to that of the frame. Both are completed by a fourth
vertex along the normal, so with the columns ``D = [e_1, e_2, n / sqrt |n|]`` of a triangle with sides ``e_1, e_2`` and
``n = e_1 x e_2``

.. math:: J_f = D_f \, \bar D_f^{-1} .

1. Linear blends of J are linear blends of vertices. Interpolation in S_f (the paper's Figure 1; Kircher and Garland
   2008) therefore blends the polar decomposition ``J = R S`` (Sumner et al. 2005, Section 3): the rotation as a vector,
   the shortest one in the first frame and continuous in time, and the six numbers of the symmetric stretch S.
2. P_f minimises :math:`\min_x \sum_f \bar A_f |\nabla x - J_f|^2`, weighted by the areas of the reference (Botsch et
   al. 2006; Sumner and Popović do not weigh). That is a constant Poisson system, factored once. Gradients do not
   determine positions: the centre of each piece is stored beside them.

A vector is ``[rotation vectors (F, 3) | stretches (F, 6) | centres]``. The normal makes ``det J >= 0``: reflections
are rotations of the surface. Affine maps of the reference are reproduced; their blends are blends of matrices for
uniform scales on any mesh, and for stretches along the axes of a box's faces.

*Vertices from their differences* (`PoissonSystem`). Given the sides ``ij`` of a mesh, the vertices are

.. math:: \min_x \sum_{ij} w_{ij} \, | x_j - x_i - s_{ij} |^2 ,

which is ``L x = B^T W s`` with the incidence matrix B of the sides and the Laplacian ``L = B^T W B``. The first vertex
of every connected component is the origin. Sides of triangles weighted by half the cotangent of the angle opposite to
each make this the Poisson equation of P_f.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy import sparse

from mixseq.errors import ReconstructionError, SettingsError
from mixseq.mesh.rigid import nearest_rotations
from mixseq.mesh.rotations import matrix_to_rotvec, rotvec_to_matrix, unwrap_rotvec
from mixseq.mesh.topology import Topology, connected_components
from mixseq.mesh.triangle_mesh import replace_degenerate, triangle_matrices
from mixseq.runtime.lazy import PickledWithoutCaches
from mixseq.runtime.parallel import one_blas_thread
from mixseq.runtime.progress import Progress, no_progress
from mixseq.shells.solvers import Factor, factorise
from mixseq.spaces.base import ShapeSpace
from mixseq.spaces.pieces import Pieces
from mixseq.types import Float, FloatArray, Index


@dataclass(frozen=True, eq=False)
class PoissonSystem(PickledWithoutCaches):
    """The Poisson system of given sides."""

    # (S, 2) pairs i, j of vertices; a pair may be there more than once, or name one vertex twice.
    edges: Index
    # (S,) weights w. Single ones may be negative, if L is positive semidefinite all the same (obtuse triangles).
    weights: Float
    vertex_count: int  # number n of vertices

    def cached_values(self) -> tuple[object, ...]:
        """Implement `PickledWithoutCaches.cached_values`."""
        return (self.factor,) if self.unknown_ids.size else ()

    @cached_property
    def incidence(self) -> sparse.csr_array:
        """The matrix B ``(S, n)``: -1 at a side's first vertex, +1 at its second."""
        number = len(self.edges)
        value = np.tile([-1.0, 1.0], number)
        places = (np.repeat(np.arange(number), 2), self.edges.reshape(-1))
        return sparse.coo_array((value, places), shape=(number, self.vertex_count)).tocsr()

    @cached_property
    def weighted_incidence(self) -> sparse.csr_array:
        """The matrix ``B^T W`` ``(n, S)``."""
        return sparse.csr_array(self.incidence.T @ sparse.diags_array(self.weights))

    @cached_property
    def unknown_ids(self) -> Index:
        """Unknown vertices: all but the first of every component."""
        component = connected_components(self.vertex_count, self.edges)
        return np.setdiff1d(np.arange(self.vertex_count), np.unique(component, return_index=True)[1])

    @cached_property
    def factor(self) -> Factor:
        """Factor of the Laplacian of the unknown vertices."""
        laplacian = sparse.csr_array(self.weighted_incidence @ self.incidence)
        return factorise(laplacian[self.unknown_ids][:, self.unknown_ids])

    def solve(self, differences: Float) -> Float:
        """Solve for the vertices ``(n, 3)`` with sides ``x_j - x_i`` closest to differences ``(S, 3)``."""
        if differences.shape != (len(self.edges), 3):
            raise SettingsError(
                f"differences have shape {differences.shape}; one for each side is expected, ({len(self.edges)}, 3)"
            )
        result = np.zeros((self.vertex_count, 3))
        if self.unknown_ids.size:
            result[self.unknown_ids] = self.factor.solve(
                (self.weighted_incidence @ differences)[self.unknown_ids]
            )
        return result


SYMMETRIC_ENTRIES = ([0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2])
"""Rows and columns of the six numbers of a symmetric matrix, its diagonal first."""

SYMMETRIC_ENTRY_IDS = np.array([[0, 3, 4], [3, 1, 5], [4, 5, 2]])
"""Index of each matrix entry among the six numbers."""


class GradientBlocks(NamedTuple):
    """The blocks of T vectors of S_f."""

    rotation_vectors: Float  # (T, F, 3) rotation vectors from the reference, face by face
    stretches: Float  # (T, F, 6) stretches: xx, yy, zz, xy, xz, yz
    centres: Float  # (T, p, 3) centres of the pieces, in diagonals


@dataclass(frozen=True, eq=False)
class GradientSpace(ShapeSpace):
    """Deformation gradients of all faces from a reference."""

    topology: Topology
    scale: float  # unit of length, in the units of the sequence: the diagonal of the first frame
    reference: Float  # (V, 3) the first frame in diagonals; faces without area are replaced by others
    name = "gradient"

    @cached_property
    def pieces(self) -> Pieces:
        """The hinge-connected pieces of the mesh."""
        return Pieces.from_mesh(self.topology, self.reference)

    @cached_property
    def face_rows(self) -> Index:
        """Rows ``(F, 3)`` of the faces' corners; pieces share none."""
        return self.pieces.face_rows(self.topology)

    @cached_property
    def side_rows(self) -> Index:
        """Rows ``(3F, 2)`` of the sides 01, 12, 20 of all faces."""
        return np.stack([self.face_rows, np.roll(self.face_rows, -1, axis=1)], axis=2).reshape(-1, 2)

    @cached_property
    def reference_triangles(self) -> Float:
        """The reference triangles ``(F, 3, 3)``: two sides and the fourth vertex, in columns."""
        return replace_degenerate(self.complete_triangles(self.reference))

    @cached_property
    def inverse_triangles(self) -> Float:
        """Inverses ``(F, 3, 3)`` of the reference triangles."""
        return np.asarray(np.linalg.inv(self.reference_triangles))

    @cached_property
    def reference_sides(self) -> Float:
        """Sides 01, 12, 20 of the reference triangles ``(F, 3, 3)``, in columns."""
        first, second = self.reference_triangles[:, :, 0], self.reference_triangles[:, :, 1]
        return np.stack([first, second - first, -second], axis=2)

    @cached_property
    def poisson_system(self) -> PoissonSystem:
        """The Poisson system of the reference triangles."""
        following, before = (
            np.roll(self.reference_sides, -1, axis=2),
            np.roll(self.reference_sides, 1, axis=2),
        )
        # The angle opposite to a side is that between the other two, of which one is turned around.
        cosines = -np.sum(following * before, axis=1)
        areas = np.linalg.norm(np.cross(self.reference_sides[:, :, 0], self.reference_sides[:, :, 1]), axis=1)
        cotangents = cosines / areas[:, None]
        return PoissonSystem(self.side_rows, 0.5 * cotangents.reshape(-1), len(self.pieces.vertex_of_row))

    def cached_values(self) -> tuple[object, ...]:
        """Implement `PickledWithoutCaches.cached_values`."""
        return (self.poisson_system,)

    @property
    def vertex_count(self) -> int:  # type: ignore[override]
        """Implement `ShapeSpace.vertex_count`."""
        return self.topology.vertex_count

    @property
    def dim(self) -> int:
        """Length D of a vector: nine numbers per face, three per piece."""
        return 9 * len(self.topology.faces) + self.placement_dim

    @property
    def centre_count(self) -> int:
        """One for every piece; gradients contain the rotations."""
        return len(self.pieces)

    @property
    def weights(self) -> Float:
        """Metric ``(D,)``: numbers of a face weigh the root mean square of its sides; off-diagonals count twice."""
        sizes = np.sqrt(np.square(self.reference_sides).sum(axis=1).mean(axis=1))
        stretches = np.outer(sizes, [1.0, 1.0, 1.0, np.sqrt(2), np.sqrt(2), np.sqrt(2)])
        return np.concatenate([np.repeat(sizes, 3), stretches.reshape(-1), np.ones(self.placement_dim)])

    def encode_independently(self, points: FloatArray) -> Float:
        """Implement `ShapeSpace.encode_independently`."""
        result = np.empty((len(points), self.dim))
        for vector, frame in zip(result, points, strict=True):
            x = frame.astype(np.float64) / self.scale
            gradients = self.complete_triangles(x) @ self.inverse_triangles
            rotations = nearest_rotations(gradients)
            stretches = np.swapaxes(rotations, 1, 2) @ gradients
            blocks = (
                matrix_to_rotvec(rotations),
                stretches[:, *SYMMETRIC_ENTRIES],
                self.pieces.measure_centres(x),
            )
            np.concatenate([block.reshape(-1) for block in blocks], out=vector)
        return result

    def unwrap(self, vectors: Float, previous: Float | None = None) -> Float:
        """Implement `ShapeSpace.unwrap`."""
        before = None if previous is None else self.split(previous[None]).rotation_vectors[0]
        blocks = self.split(vectors)
        return self.join(blocks._replace(rotation_vectors=unwrap_rotvec(blocks.rotation_vectors, before)))

    def decode(self, vectors: Float, progress: Progress = no_progress) -> Float:
        """Implement `ShapeSpace.decode`."""
        blocks = self.split(np.asarray(vectors, dtype=np.float64))
        wrong = np.flatnonzero(~np.isfinite(vectors).all(axis=1))
        if wrong.size:
            raise ReconstructionError(f"vector {wrong[0]} is not finite")
        points = np.empty((len(blocks.rotation_vectors), self.vertex_count, 3))
        with one_blas_thread():
            for number, (turns, stretches, centres) in enumerate(zip(*blocks, strict=True)):
                gradients = rotvec_to_matrix(turns) @ stretches[:, SYMMETRIC_ENTRY_IDS]
                sides = np.swapaxes(gradients @ self.reference_sides, 1, 2).reshape(-1, 3)
                rows = self.poisson_system.solve(sides)
                points[number] = self.pieces.translate(rows, centres) * self.scale
                progress(number + 1, len(points), "decoding frames")
        return points

    def complete_triangles(self, x: Float) -> Float:
        """Return the matrices D ``(F, 3, 3)`` of the faces of a frame ``(V, 3)`` in diagonals."""
        return triangle_matrices(x[self.pieces.vertex_of_row], self.face_rows, self.side_rows)

    def split(self, vectors: Float) -> GradientBlocks:
        """Return the blocks of vectors ``(T, D)``; raises what `checked` does."""
        count, faces = len(vectors), len(self.topology.faces)
        turns, stretches, centres = np.split(self.check_vectors(vectors), [3 * faces, 9 * faces], axis=1)
        return GradientBlocks(
            turns.reshape(count, faces, 3),
            stretches.reshape(count, faces, 6),
            centres.reshape(count, len(self.pieces), 3),
        )

    def join(self, blocks: GradientBlocks) -> Float:
        """Return the vectors ``(T, D)`` of blocks; the inverse of `split`."""
        return np.concatenate([block.reshape(len(block), -1) for block in blocks], axis=1)
