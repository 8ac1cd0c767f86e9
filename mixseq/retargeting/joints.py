r"""Joints of the target: transfer their edge lengths and angles, and solve for their free vertices.

A joint between posed parts is a boundary value problem: its free vertices fit edge lengths and dihedral angles
(`mixseq.shells.fitting`) near their skinned positions. Skinning from a reference frame blends the motions of all parts
with fixed vertices in the joint. The weights are harmonic: 1 at the vertices of a part, 0 at the vertices of other
parts. Close to the reference the skinned positions are a start without folds (there, lengths and angles conflict).

Lengths are transferred as ratios, angles as differences. For meshes of the same connectivity they are transferred from
each edge and hinge,

.. math:: l' = l'_0\, l / l_0, \qquad \theta' = \theta'_0 + (\theta - \theta_0) .

For other meshes only triangles correspond. Deformation gradients J = R S of the source's triangles are averaged around
the source points of the corners of a target triangle. Rotations and stretches are averaged separately, so that bends do
not shrink. The mean gradients of the two triangles f and g at an edge determine its length and angle:

.. math:: l' = \tfrac12 (|J_f e| + |J_g e|), \qquad
   \theta' = \angle_{\bar e}\bigl(J_f e \times J_f a,\; J_g b \times J_g e\bigr),
   \qquad \bar e = J_f e + J_g e .

A bend is thus distributed over the hinges of the target, even if the source has more or fewer hinges.

Near folds, a little noise of the source turns angles by up to a full turn, and targets that contradict the skinned
positions have several solutions. So angles differ from the angles :math:`\hat\theta` of the skinned positions by

.. math:: \sin\delta\, e^{\kappa (\cos\delta - 1)}, \qquad \delta = \theta' - \hat\theta ,

which retains small differences, ignores folds and varies smoothly with the source.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy import sparse

from mixseq.mesh.measures import clamp_lengths, dihedral_angles, edge_lengths, scatter_add, wrap_angles
from mixseq.mesh.rigid import kabsch, nearest_rotations
from mixseq.mesh.rotations import rotate_vectors
from mixseq.mesh.topology import Topology
from mixseq.retargeting.gradient_transfer import GradientTransfer, average_matrices, normalise_rows
from mixseq.segmentation.joints import Decomposition, Joint
from mixseq.shells.fitting import Patch, ShellSettings, fit_patch_near
from mixseq.types import Float, Index, Int32

BEND_CONCENTRATION = 4.0
"""Concentration of the differences of angles from skinned positions; larger values retain more bend and more noise."""


@dataclass(frozen=True, eq=False)
class SolvedJoints:
    """Joints with free vertices; arrays of edges, hinges and vertices are stored joint by joint."""

    joints: tuple[Joint, ...]  # the joints
    patches: tuple[Patch, ...]  # patch of each joint, in which the vertices of parts are fixed

    @classmethod
    def from_decomposition(cls, topology: Topology, decomposition: Decomposition) -> SolvedJoints:
        """Select the joints with free vertices."""
        joints = tuple(joint for joint in decomposition.joints if joint.free.any())
        return cls(joints, tuple(Patch.from_joint(topology, joint, ~joint.free) for joint in joints))

    @property
    def _systems(self) -> list[tuple[Joint, Patch]]:
        return list(zip(self.joints, self.patches, strict=True))

    @cached_property
    def edge_ids(self) -> Index:
        """Mesh ids ``(E',)`` of the edges at free vertices."""
        return _concatenate([joint.edge_ids[patch.free_edge_mask] for joint, patch in self._systems])

    @cached_property
    def hinge_ids(self) -> Index:
        """Mesh ids ``(H',)`` of the hinges with a free vertex."""
        return _concatenate([joint.hinge_ids[patch.free_hinge_mask] for joint, patch in self._systems])

    @cached_property
    def vertices(self) -> Index:
        """Mesh ids ``(F,)`` of the free vertices."""
        return _concatenate([joint.vertices[patch.free_ids] for joint, patch in self._systems])

    @cached_property
    def edge_slices(self) -> list[slice]:
        """Slices of the edges of every joint."""
        return _slices([int(np.count_nonzero(patch.free_edge_mask)) for patch in self.patches])

    @cached_property
    def hinge_slices(self) -> list[slice]:
        """Slices of the hinges of every joint."""
        return _slices([int(np.count_nonzero(patch.free_hinge_mask)) for patch in self.patches])

    @cached_property
    def vertex_slices(self) -> list[slice]:
        """Slices of the free vertices of every joint."""
        return _slices([len(patch.free_ids) for patch in self.patches])

    def vertex_spacing(self, lengths: Float) -> Float:
        """Return the mean length ``(F,)`` of the edges at every free vertex, from lengths ``(E',)``."""
        sums, counts = np.zeros((2, len(self.vertices)))
        for patch, edges, free in zip(self.patches, self.edge_slices, self.vertex_slices, strict=True):
            edge_vertices = patch.free_index[patch.edges[patch.free_edge_mask]]
            for vertices in edge_vertices.T:
                is_free = vertices >= 0
                np.add.at(sums[free], vertices[is_free], lengths[edges][is_free])
                np.add.at(counts[free], vertices[is_free], 1.0)
        return np.asarray(sums / counts)


@dataclass(frozen=True, eq=False)
class HarmonicSkin:
    """Harmonic skinning weights of free vertices."""

    weights: Float  # (F, p) skinning weights of the free vertices by all parts; rows add to one
    rest: Float  # (F, 3) free vertices in the reference frame

    def deform(self, rotations: Float, translations: Float) -> Float:
        """Skin the free vertices ``(F, 3)`` by motions ``x -> R x + t`` of all parts from the reference frame."""
        motions = np.concatenate([rotations, translations[:, :, None]], axis=2).reshape(-1, 12)
        blended = (self.weights @ motions).reshape(-1, 3, 4)
        return np.asarray(rotate_vectors(blended[:, :, :3], self.rest) + blended[:, :, 3])

    @cached_property
    def main_part(self) -> Index:
        """Part ``(F,)`` with the largest skinning weight at every free vertex."""
        return np.asarray(self.weights.argmax(axis=1))


def harmonic_weights(patch: Patch, part_of_vertex: Index, part_count: int) -> Float:
    """Return the skinning weights ``(f, p)`` of the free vertices of a patch whose fixed ones ``(n,)`` have parts."""
    parts, part_index = np.unique(part_of_vertex[patch.fixed_mask], return_inverse=True)
    weights, result = np.zeros((len(part_of_vertex), len(parts))), np.zeros((len(patch.free_ids), part_count))
    weights[patch.fixed_mask] = np.eye(len(parts))[part_index.reshape(-1)]
    equal = np.zeros((3 * len(patch.faces), len(parts)))  # no differences along sides
    result[:, parts] = patch.poisson_system.solve(equal, weights)[patch.free_ids]
    return result


def _concatenate(ids: list[Index]) -> Index:
    """Concatenate a list of index arrays, which may be empty."""
    return np.concatenate(ids) if ids else np.zeros(0, dtype=np.int64)


def _slices(sizes: list[int]) -> list[slice]:
    ends = np.cumsum(sizes)
    return [slice(int(end) - size, int(end)) for end, size in zip(ends, sizes, strict=True)]


class JointFrame(NamedTuple):
    """Input of a joint solve: poses and shapes of the parts, lengths and angles of the joints."""

    lengths: Float  # (E',) edge lengths of the joints
    angles: Float  # (H',) hinge angles of the joints, in radians
    length_weights: Float  # (E',) weights of the edge lengths
    part_vertices: Float  # (N, 3) vertices of all parts, aligned to their rest shapes
    rotations: Float  # (p, 3, 3) rotations of the parts
    translations: Float  # (p, 3) translations of the parts
    offsets: Float  # (F, 3) offsets of the free vertices from their skinned positions
    offset_weights: Float  # (F,) weights of the offsets as soft position constraints


@dataclass(frozen=True, eq=False)
class JointSolver:
    """Solver of the joints between posed parts."""

    topology: Topology  # connectivity of the mesh
    decomposition: Decomposition  # parts and joints
    shapes: Float  # (N, 3) mean shapes of the parts
    reference: Float  # (V, 3) reference frame of skinning

    @cached_property
    def joints(self) -> SolvedJoints:
        """Joints with free vertices."""
        return SolvedJoints.from_decomposition(self.topology, self.decomposition)

    @cached_property
    def _part_rows(self) -> tuple[list[slice], Index, Float]:
        """Rows of the parts in `part_vertices`, vertices ``(N,)`` of the rows, and row counts ``(V,)`` of vertices."""
        parts = self.decomposition.parts
        vertex = np.concatenate(parts)
        copy_counts = np.bincount(vertex, minlength=self.topology.vertex_count)
        return _slices([len(part) for part in parts]), vertex, np.maximum(copy_counts, 1).astype(np.float64)

    @cached_property
    def _reference_poses(self) -> tuple[Float, Float]:
        """Rotations ``(p, 3, 3)`` and centres ``(p, 3)`` of the parts in the reference frame."""
        sizes = [len(vertices) for vertices in self.decomposition.parts]
        shapes = np.split(self.shapes, np.cumsum(sizes)[:-1])
        targets = [self.reference[vertices] for vertices in self.decomposition.parts]
        poses = [kabsch(shape, target) for shape, target in zip(shapes, targets, strict=True)]
        return np.stack([rotation for rotation, _ in poses]), np.stack([centre for _, centre in poses])

    @cached_property
    def _skin(self) -> HarmonicSkin:
        joints, parts = self.joints, self.decomposition.parts
        part_of_vertex = np.full(self.topology.vertex_count, -1, dtype=np.int64)
        for part, vertices in reversed(list(enumerate(parts))):
            part_of_vertex[vertices] = part
        weights = np.zeros((len(joints.vertices), len(parts)))
        for joint, patch, rows in zip(joints.joints, joints.patches, joints.vertex_slices, strict=True):
            weights[rows] = harmonic_weights(patch, part_of_vertex[joint.vertices], len(parts))
        return HarmonicSkin(weights, self.reference[joints.vertices])

    @cached_property
    def _hinges(self) -> Int32:
        return self.topology.hinges[self.joints.hinge_ids]

    def solve(self, frame: JointFrame, settings: ShellSettings) -> Float:
        """Return the mesh ``(V, 3)`` of a frame; vertices shared by parts are averaged."""
        points, joints, skin = self._pose_parts(frame), self.joints, self._skin
        motions = self._relative_motions(frame.rotations, frame.translations)
        offsets = rotate_vectors(frame.rotations[skin.main_part], frame.offsets)
        points[joints.vertices] = skin.deform(*motions) + offsets
        lengths = clamp_lengths(frame.lengths, frame.length_weights)
        angles = limit_bends(frame.angles, dihedral_angles(points, self._hinges))
        slices = zip(joints.edge_slices, joints.hinge_slices, joints.vertex_slices, strict=True)
        for joint, patch, (edges, hinges, free) in zip(joints.joints, joints.patches, slices, strict=True):
            points[joint.vertices] = fit_patch_near(
                patch,
                lengths[edges],
                angles[hinges],
                frame.length_weights[edges],
                points[joint.vertices],
                frame.offset_weights[free],
                settings,
            )
        return points

    def skinning_offsets(self, rotations: Float, translations: Float, points: Float) -> Float:
        """Return the offsets ``(F, 3)`` of a frame's free vertices from their skinned positions (`HarmonicSkin`).

        The offset of a vertex is in the rotated axes of its main part, so that it rotates with the body.
        """
        differences = points[self.joints.vertices] - self._skin.deform(*self._relative_motions(rotations, translations))
        return rotate_vectors(np.swapaxes(rotations[self._skin.main_part], 1, 2), differences)

    def _pose_parts(self, frame: JointFrame) -> Float:
        """Return the vertices ``(V, 3)`` of the posed parts: averaged if parts share them, zero if in no part."""
        slices, vertex, copy_counts = self._part_rows
        poses = zip(slices, frame.rotations, frame.translations, strict=True)
        positions = [frame.part_vertices[rows] @ rotation.T + centre for rows, rotation, centre in poses]
        return scatter_add(np.concatenate(positions), vertex, len(copy_counts)) / copy_counts[:, None]

    def _relative_motions(self, rotations: Float, translations: Float) -> tuple[Float, Float]:
        """Return the motions ``x -> R x + t`` of the parts from the reference frame to given poses."""
        reference_rotations, reference_centres = self._reference_poses
        relative_rotations = rotations @ np.swapaxes(reference_rotations, 1, 2)
        return relative_rotations, translations - rotate_vectors(relative_rotations, reference_centres)


def limit_bends(angles: Float, skinned_angles: Float) -> Float:
    """Limit the differences of angles ``(H',)`` from those of skinned positions, in radians; see the formula above."""
    differences = angles - skinned_angles
    return np.asarray(skinned_angles + np.sin(differences) * np.exp(BEND_CONCENTRATION * (np.cos(differences) - 1.0)))


@dataclass(frozen=True, eq=False)
class EdgewiseMetrics:
    """Length ratios and angle differences of each edge and hinge, for meshes of the same connectivity."""

    topology: Topology  # connectivity of both meshes
    joints: SolvedJoints  # joints of both meshes
    source: Float  # (V, 3) source at rest, in the unit of its space
    target: Float  # (V, 3) target at rest, in the unit of its space

    @cached_property
    def _edges(self) -> Int32:
        return self.topology.edges[self.joints.edge_ids]

    @cached_property
    def _hinges(self) -> Int32:
        return self.topology.hinges[self.joints.hinge_ids]

    @cached_property
    def _rest(self) -> tuple[Float, Float, Float, Float]:
        return *self._measure(self.source), *self._measure(self.target)

    def _measure(self, points: Float) -> tuple[Float, Float]:
        return edge_lengths(points, self._edges), dihedral_angles(points, self._hinges)

    def lengths_and_angles(self, points: Float) -> tuple[Float, Float]:
        """Return lengths ``(E',)``, in the unit of the target's space, and angles ``(H',)`` for a frame ``(V, 3)``.

        Edges of zero length on the source keep their rest length.
        """
        lengths, angles, target_lengths, target_angles = self._rest
        current_lengths, current_angles = self._measure(points)
        ratios = np.divide(current_lengths, lengths, out=np.ones_like(current_lengths), where=lengths > 0)
        angle_changes = wrap_angles(current_angles - angles)
        return target_lengths * ratios, target_angles + angle_changes


@dataclass(frozen=True, eq=False)
class GradientMetrics:
    """Edge lengths and angles from mean deformation gradients, for meshes of different connectivity."""

    gradients: GradientTransfer  # the two meshes at rest, and their correspondence
    joints: SolvedJoints  # joints of the target

    @cached_property
    def _faces(self) -> Index:
        """Faces ``(f,)`` of the target's joints."""
        return np.unique(_concatenate([joint.face_ids for joint in self.joints.joints]))

    @cached_property
    def _face_weights(self) -> sparse.csr_array:
        """Weights ``(f, F)`` of the source's triangles in the mean gradient of every joint face."""
        corners = self._topology.faces[self._faces]
        vertices, vertex_rows = np.unique(corners, return_inverse=True)
        face_rows = np.repeat(np.arange(len(corners)), 3)
        entries = np.ones(len(face_rows)), (face_rows, vertex_rows.reshape(-1))
        corner_means = sparse.coo_array(entries, shape=(len(corners), len(vertices))).tocsr()
        return normalise_rows(corner_means @ self.gradients.averaging_matrix(vertices.astype(np.int64)))

    @property
    def _topology(self) -> Topology:
        return self.gradients.target.topology

    @cached_property
    def _edge_faces(self) -> tuple[Index, Index]:
        """Incident pairs of joint faces and joint edges, as row ids of `_faces` and of the edges."""
        edges = self._topology.face_edges[self._faces]
        order = np.argsort(self.joints.edge_ids, kind="stable")
        ids = self.joints.edge_ids[order]
        positions = np.searchsorted(ids, edges)
        is_stored = (positions < len(ids)) & (ids[np.minimum(positions, len(ids) - 1)] == edges)
        return np.nonzero(is_stored)[0], order[positions[is_stored]]

    @cached_property
    def _hinge_faces(self) -> Index:
        """Both faces ``(H', 2)`` of every joint hinge, as row ids of `_faces`."""
        return np.searchsorted(self._faces, self._topology.hinge_faces[self.joints.hinge_ids])

    @cached_property
    def _rest_angles(self) -> Float:
        return dihedral_angles(self.gradients.target.reference, self._topology.hinges[self.joints.hinge_ids])

    def lengths_and_angles(self, points: Float) -> tuple[Float, Float]:
        """Return lengths ``(E',)``, in the unit of the target's space, and angles ``(H',)`` for a frame ``(V, 3)``."""
        gradients = self._target_gradients(points)
        rest, edges = self.gradients.target.reference, self._topology.edges[self.joints.edge_ids]
        face_rows, edge_rows = self._edge_faces
        edge_vectors = rest[edges[:, 1]] - rest[edges[:, 0]]
        face_lengths = np.linalg.norm(rotate_vectors(gradients[face_rows], edge_vectors[edge_rows]), axis=1)
        face_counts = np.bincount(edge_rows, minlength=len(edges))
        lengths = np.bincount(edge_rows, face_lengths, minlength=len(edges)) / np.maximum(face_counts, 1)
        return lengths, self._bend_angles(gradients)

    def _target_gradients(self, points: Float) -> Float:
        source = self.gradients.source
        gradients = source.complete_triangles(points) @ source.inverse_triangles
        rotations = nearest_rotations(gradients)
        stretches = np.swapaxes(rotations, 1, 2) @ gradients
        mean_rotations = nearest_rotations(average_matrices(self._face_weights, rotations))
        mean_stretches = average_matrices(self._face_weights, stretches)
        return self.gradients.alignment.rotate_matrices(mean_rotations @ mean_stretches)

    def _bend_angles(self, gradients: Float) -> Float:
        rest = self.gradients.target.reference
        a, b, c, d = (rest[corner] for corner in self._topology.hinges[self.joints.hinge_ids].T)
        first, second = (gradients[side] for side in self._hinge_faces.T)
        first_edge, second_edge = rotate_vectors(first, b - a), rotate_vectors(second, b - a)
        n1, n2 = (
            np.cross(first_edge, rotate_vectors(first, c - a)),
            np.cross(rotate_vectors(second, d - a), second_edge),
        )
        axis = first_edge + second_edge
        sine = np.einsum("hi,hi->h", np.cross(n1, n2), axis)
        cosine = np.einsum("hi,hi->h", n1, n2) * np.linalg.norm(axis, axis=1)
        return np.asarray(self._rest_angles + wrap_angles(np.arctan2(sine, cosine) - self._rest_angles))
