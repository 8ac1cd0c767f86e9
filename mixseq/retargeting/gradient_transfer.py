r"""Transfer by deformation gradients (S_f; Sumner and Popović 2004), the reference method.

The deformation gradient :math:`J_f` of every source triangle, from rest to a frame, is applied to the corresponding
target triangles. The target's vertices are a least-squares fit to these gradients (`mixseq.spaces.gradient`):

.. math:: \min_x \sum_{f'} A_{f'}\, | \nabla x - G J_{f(f')} G^T |^2 .

Gradients do not determine the positions of disconnected pieces. The largest piece has the mean displacement of its
source points. Every other piece is attached to a nearby vertex b (`mixseq.mesh.nearest`), and rotates with b:

.. math:: x_a = x_b + R_b (y_a - y_b) + s G (g_t - \bar R_b\, g_0)

Here a is the attached vertex and y the target at rest. The source rotates by :math:`\bar R_b` around b, the target by
:math:`R_b = G \bar R_b G^T`. The gap g between the source points of a and b may vary with time. Triangles without a
source triangle rotate with their leader.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from mixseq.mesh.nearest import Attachments, attach_pieces
from mixseq.mesh.rigid import nearest_rotations
from mixseq.mesh.topology import Topology
from mixseq.mesh.triangle_mesh import TriangleMesh
from mixseq.retargeting.markers import Correspondence
from mixseq.retargeting.sources import Alignment, fit_alignment
from mixseq.runtime.lazy import PickledWithoutCaches
from mixseq.sequence.sequence import bounding_diagonal
from mixseq.shells.kernels import deform_sides
from mixseq.spaces.gradient import GradientSpace
from mixseq.types import Float, FloatArray, Index


@dataclass(frozen=True, eq=False)
class GradientTransfer(PickledWithoutCaches):
    """Transfer by the deformation gradients of the source."""

    source: GradientSpace  # gradient space of the source at rest, in the unit of this space
    target: GradientSpace  # gradient space of the target at rest, in the unit of this space
    correspondence: Correspondence  # source points and triangles of the target
    alignment: Alignment  # from source to target, in the units of the meshes
    parts = None  # this method has no parts

    @cached_property
    def attachments(self) -> Attachments:
        """Attachments of the target's disconnected pieces to each other."""
        return attach_pieces(self.target.pieces.vertices, self.target.reference, self.correspondence.leaders)

    @cached_property
    def _leader_means(self) -> tuple[Index, sparse.csr_array]:
        """Source triangles ``(m,)``, and the matrix ``(n, m)`` that averages over those around vertices that lead.

        These are the vertices with attached pieces, then the leaders of the target's triangles without source triangle.
        """
        faces = self.target.topology.faces[self.correspondence.faces < 0]
        is_follower = ~self.correspondence.matched[faces]
        followers = faces[np.arange(len(faces)), is_follower.argmax(axis=1)].astype(np.int64)
        means = self.averaging_matrix(np.concatenate([self.attachments.holder_vertices, followers]))
        face_ids = np.unique(means.indices).astype(np.int64)
        return face_ids, means[:, face_ids]

    @cached_property
    def _side_maps(self) -> tuple[Index, Float]:
        """Matrix ids ``(F',)`` of target triangles, and maps ``(F', 3, 3)`` from these matrices to deformed sides.

        Matrices are those of the source's triangles in a frame, then the rotations of leaders. Sides are in the
        source's axes.
        """
        ids = self.correspondence.faces.copy()
        is_follower = ids < 0
        maps = self.alignment.rotation.T @ self.target.reference_sides
        maps[~is_follower] = self.source.inverse_triangles[ids[~is_follower]] @ maps[~is_follower]
        ids[is_follower] = len(self.source.topology.faces) + np.arange(np.count_nonzero(is_follower))
        return ids, maps

    @cached_property
    def _root_weights(self) -> Float:
        """Weights ``(V,)`` of the source's vertices in the mean source point of the largest piece."""
        leaders = self.correspondence.leaders[self.target.pieces.vertices[self.attachments.root]]
        corners, weights = self.correspondence.corners[leaders], self.correspondence.weights[leaders]
        total = np.bincount(corners.reshape(-1), weights.reshape(-1), self.source.vertex_count)
        return np.asarray(total / len(leaders))

    @cached_property
    def _root_centre(self) -> Float:
        """Mean ``(3,)`` of the largest piece at rest."""
        return np.asarray(self.target.reference[self.target.pieces.vertices[self.attachments.root]].mean(axis=0))

    def averaging_matrix(self, vertices: Index) -> sparse.csr_array:
        """Return the matrix ``(n, F)`` of area-weighted means over source triangles around target vertices ``(n,)``.

        A vertex without a source point uses the source point of its leader.
        """
        if not len(vertices):
            return sparse.csr_array((0, len(self.source.topology.faces)))
        correspondence = self.correspondence
        faces, edge_vectors = self.source.topology.faces, self.source.reference_triangles
        areas = np.linalg.norm(np.cross(edge_vectors[:, :, 0], edge_vectors[:, :, 1]), axis=1)
        entries = (faces.reshape(-1), np.repeat(np.arange(len(faces)), 3))
        shape = (self.source.topology.vertex_count, len(faces))
        at_vertices = sparse.coo_array((np.repeat(areas, 3), entries), shape=shape).tocsr()
        leaders, row_ids = correspondence.leaders[vertices], np.repeat(np.arange(len(vertices)), 3)
        columns = correspondence.corners[leaders].reshape(-1)
        barycentric = (correspondence.weights[leaders].reshape(-1), (row_ids, columns))
        points = sparse.coo_array(barycentric, shape=(len(vertices), shape[0])).tocsr()
        return normalise_rows(points @ normalise_rows(at_vertices))

    def source_gradients(self, points: FloatArray) -> Float:
        """Return deformation gradients ``(F, 3, 3)`` of the source's triangles in a frame ``(V, 3)``."""
        triangles = self.source.complete_triangles(points.astype(np.float64) / self.source.scale)
        return triangles @ self.source.inverse_triangles

    def transfer_frames(self, points: FloatArray) -> Float:
        """Return the target ``(B, V', 3)`` for frames ``(B, V, 3)`` of the source, with one back-substitution."""
        system, frames = self.target.poisson_system, points.astype(np.float64) / self.source.scale
        rotations, right_hand_sides = [], []
        for frame in frames:
            frame_rotations, sides = self._deform_sides(frame)
            rotations.append(frame_rotations)
            right_hand_sides.append(system.right_hand_side(sides))
        solution = system.factor.solve(np.concatenate(right_hand_sides, axis=1)).reshape(-1, len(frames), 3)
        result = np.empty((len(frames), self.target.vertex_count, 3))
        for number, frame in enumerate(frames):
            # Sides are linear in vertices, so that these are rotated instead.
            rows = np.zeros((len(system.fixed_mask), 3))
            rows[system.unknown_ids] = solution[:, number] @ self.alignment.rotation.T
            result[number] = self._place_pieces(rows, frame, rotations[number])
        return result * self.target.scale

    def _deform_sides(self, source_points: Float) -> tuple[Float, Float]:
        """Return the rotations of the source around holders, and deformed sides ``(3F', 3)`` in the source's axes."""
        triangles = self.source.complete_triangles(source_points)
        face_ids, means = self._leader_means
        gradients = triangles[face_ids] @ self.source.inverse_triangles[face_ids]
        rotations = nearest_rotations(average_matrices(means, gradients))
        holder_rotations, leader_rotations = np.split(rotations, [len(self.attachments.holders)])
        matrix_ids, maps = self._side_maps
        if len(leader_rotations):
            triangles = np.concatenate([triangles, leader_rotations])
        sides = np.empty((3 * len(matrix_ids), 3))
        deform_sides(triangles, matrix_ids, maps, sides)
        return holder_rotations, sides

    def _place_pieces(self, rows: Float, source_points: Float, holder_rotations: Float) -> Float:
        """Translate and attach pieces ``(N, 3)`` in place; return the target ``(V', 3)`` in the unit of its space."""
        pieces, attachments, rest = self.target.pieces, self.attachments, self.target.reference
        linear_map = self.alignment.scale * self.source.scale / self.target.scale * self.alignment.rotation
        displacement = self._root_weights @ (source_points - self.source.reference)
        root = rows[pieces.row_slices[attachments.root]]
        root += self._root_centre + linear_map @ displacement - np.einsum("ni->i", root) / len(root)
        if not len(attachments):
            return pieces.merge_rows(rows)

        correspondence = self.correspondence
        own_rows = pieces.find_rows(attachments.pieces, attachments.vertices)
        holder_rows = pieces.find_rows(attachments.holders, attachments.holder_vertices)
        poses = np.stack([self.source.reference, source_points])
        ends = attachments.vertices, attachments.holder_vertices
        gaps = np.subtract(*(correspondence.interpolate(poses, vertices) for vertices in ends))
        gaps[:, ~correspondence.matched[attachments.vertices]] = 0.0
        for attachment, piece in enumerate(attachments.pieces):
            rotation = holder_rotations[attachment]
            gap_change = linear_map @ (gaps[1, attachment] - rotation @ gaps[0, attachment])
            rest_arm = rest[attachments.vertices[attachment]] - rest[attachments.holder_vertices[attachment]]
            arm = self.alignment.rotate_matrices(rotation) @ rest_arm
            goal = rows[holder_rows[attachment]] + arm + gap_change
            rows[pieces.row_slices[piece]] += goal - rows[own_rows[attachment]]
        return pieces.merge_rows(rows)


def gradient_transfer(
    source: Topology, source_rest: Float, target: Topology, target_rest: Float, correspondence: Correspondence
) -> GradientTransfer:
    """Prepare a transfer between meshes at rest ``(V, 3)`` and ``(V', 3)``; raises the errors of `fit_alignment`."""
    source_space, target_space = _space(source, source_rest), _space(target, target_rest)
    matched = correspondence.matched
    alignment = fit_alignment(
        correspondence.interpolate(source_space.reference)[matched],
        target_space.reference[matched],
        TriangleMesh(target_space.reference, target).vertex_areas[matched],
    )
    scale = alignment.scale * target_space.scale / source_space.scale
    return GradientTransfer(source_space, target_space, correspondence, Alignment(alignment.rotation, scale))


def _space(topology: Topology, rest: Float) -> GradientSpace:
    scale = bounding_diagonal(rest) or 1.0
    return GradientSpace(topology, scale, rest / scale)


def average_matrices(weights: sparse.csr_array, matrices: Float) -> Float:
    """Return weighted sums ``(n, 3, 3)`` of matrices ``(F, 3, 3)``: weights ``(n, F)``."""
    return np.asarray(weights @ matrices.reshape(-1, 9)).reshape(-1, 3, 3)


def normalise_rows(weights: sparse.csr_array) -> sparse.csr_array:
    """Scale every row of a weight matrix to a sum of one; rows of zeros are unchanged."""
    sums = np.asarray(weights.sum(axis=1)).reshape(-1)
    return sparse.csr_array(sparse.diags_array(1.0 / np.where(sums > 0, sums, 1.0)) @ weights)
