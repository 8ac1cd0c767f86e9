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
    def _holder_means(self) -> sparse.csr_array:
        """Matrix ``(n, F)`` that averages over the source triangles around the vertices with attached pieces."""
        return self.averaging_matrix(self.attachments.holder_vertices)

    @cached_property
    def _follower_means(self) -> tuple[Index, sparse.csr_array]:
        """Target triangles ``(n,)`` without source triangle, and averaging matrix ``(n, F)`` around their leaders."""
        face_ids = np.flatnonzero(self.correspondence.faces < 0)
        faces = self.target.topology.faces[face_ids]
        is_follower = ~self.correspondence.matched[faces]
        vertices = faces[np.arange(len(face_ids)), is_follower.argmax(axis=1)].astype(np.int64)
        return face_ids, self.averaging_matrix(vertices)

    def averaging_matrix(self, vertices: Index) -> sparse.csr_array:
        """Return the matrix ``(n, F)`` of area-weighted means over source triangles around target vertices ``(n,)``.

        A vertex without a source point uses the source point of its leader.
        """
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

    def transfer_frame(self, points: FloatArray) -> Float:
        """Return the target ``(V', 3)`` for a frame ``(V, 3)`` of the source."""
        target, faces = self.target, self.correspondence.faces
        points = points.astype(np.float64)
        source_gradients = self.source_gradients(points)
        holder_rotations = nearest_rotations(average_matrices(self._holder_means, source_gradients))
        target_gradients = self.alignment.rotate_matrices(source_gradients[np.maximum(faces, 0)])
        follower_faces, follower_means = self._follower_means
        leader_rotations = nearest_rotations(average_matrices(follower_means, source_gradients))
        target_gradients[follower_faces] = self.alignment.rotate_matrices(leader_rotations)
        edge_vectors = np.swapaxes(target_gradients @ target.reference_sides, 1, 2)
        piece_vertices = target.poisson_system.solve(edge_vectors.reshape(-1, 3))
        return self._place_pieces(piece_vertices, points, holder_rotations) * target.scale

    def _place_pieces(self, piece_vertices: Float, points: FloatArray, holder_rotations: Float) -> Float:
        """Translate and attach the pieces ``(N, 3)``, and return the target ``(V', 3)`` in the unit of its space."""
        pieces, attachments, rest = self.target.pieces, self.attachments, self.target.reference
        correspondence = self.correspondence
        linear_map = self.alignment.scale * self.source.scale / self.target.scale * self.alignment.rotation
        root_vertices = pieces.vertices[attachments.root]
        displacements = correspondence.interpolate(points / self.source.scale - self.source.reference)
        displacement = displacements[root_vertices].mean(axis=0)
        placed = piece_vertices.copy()
        root = pieces.row_slices[attachments.root]
        root_centre = rest[root_vertices].mean(axis=0) + linear_map @ displacement
        placed[root] += root_centre - piece_vertices[root].mean(axis=0)

        own_rows = pieces.find_rows(attachments.pieces, attachments.vertices)
        holder_rows = pieces.find_rows(attachments.holders, attachments.holder_vertices)
        gaps = correspondence.interpolate(np.stack([self.source.reference, points / self.source.scale]))
        gaps = gaps[:, attachments.vertices] - gaps[:, attachments.holder_vertices]
        gaps[:, ~correspondence.matched[attachments.vertices]] = 0.0
        for attachment, piece in enumerate(attachments.pieces):
            rotation = holder_rotations[attachment]
            gap_change = linear_map @ (gaps[1, attachment] - rotation @ gaps[0, attachment])
            rest_arm = rest[attachments.vertices[attachment]] - rest[attachments.holder_vertices[attachment]]
            arm = self.alignment.rotate_matrices(rotation) @ rest_arm
            goal = placed[holder_rows[attachment]] + arm + gap_change
            placed[pieces.row_slices[piece]] += goal - placed[own_rows[attachment]]
        return pieces.merge_rows(placed)


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
