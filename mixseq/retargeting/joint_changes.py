r"""Transfer changes of joints: lengths as ratios, angles as differences.

Where both meshes have the same connectivity every edge and hinge has its own,

.. math:: l' = l'_0\, l / l_0, \qquad \theta' = \theta'_0 + (\theta - \theta_0) .

Otherwise triangles correspond, but not edges and hinges. Deformation gradients J = R S of the source's triangles are
averaged around the points that correspond to the corners of a target triangle (rotations and stretches apart, so that
a bend does not shrink); those of the two triangles at an edge give its length and angle:

.. math:: l' = \tfrac12 (|J_f e| + |J_g e|), \qquad
   \theta' = \angle_{\bar e}\bigl(J_f e \times J_f a,\; J_g b \times J_g e\bigr),
   \qquad \bar e = J_f e + J_g e .

A bend is thus distributed over the hinges of the target, more or fewer than the source's.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from scipy import sparse

from mixseq.arrays import Float, Index
from mixseq.geometry.lengths_angles import dihedral_angles, edge_lengths, wrap
from mixseq.geometry.rigid import nearest_rotations
from mixseq.geometry.rotations import turned
from mixseq.retargeting.gradient_transfer import GradientTransfer, combined, normalised
from mixseq.retargeting.solved_joints import SolvedJoints
from mixseq.topology import Topology


class JointChanges(Protocol):
    """Lengths and angles of the target's joints from a frame of the source."""

    def of(self, x: Float) -> tuple[Float, Float]:
        """Return lengths ``(E',)``, in the unit of the target's space, and angles ``(H',)`` for a frame ``(V, 3)``."""


@dataclass(frozen=True, eq=False)
class SameEdges:
    """Ratios and differences of each edge and hinge, for meshes of the same connectivity."""

    topology: Topology  # the connectivity
    solved: SolvedJoints  # the joints
    source: Float  # (V, 3) source at rest, in the unit of its space
    target: Float  # (V, 3) target at rest, in the unit of its space

    @cached_property
    def _edges(self) -> Index:
        return self.topology.edges[self.solved.edge_ids]

    @cached_property
    def _hinges(self) -> Index:
        return self.topology.hinges[self.solved.hinge_ids]

    @cached_property
    def _rest(self) -> tuple[Float, Float, Float, Float]:
        both = [
            (edge_lengths(x, self._edges), dihedral_angles(x, self._hinges))
            for x in (self.source, self.target)
        ]
        (lengths, angles), (own_lengths, own_angles) = both
        return lengths, angles, own_lengths, own_angles

    def of(self, x: Float) -> tuple[Float, Float]:
        """Implement `JointChanges.of`; an edge without a length at rest keeps that of the target."""
        lengths, angles, own_lengths, own_angles = self._rest
        now = edge_lengths(x, self._edges)
        ratios = np.divide(now, lengths, out=np.ones_like(now), where=lengths > 0)
        return own_lengths * ratios, own_angles + wrap(dihedral_angles(x, self._hinges) - angles)


@dataclass(frozen=True, eq=False)
class OtherEdges:
    """Changes by gradients, for meshes of different connectivity."""

    gradients: GradientTransfer  # the meshes and their correspondence
    solved: SolvedJoints  # the joints of the target

    @cached_property
    def _faces(self) -> Index:
        """Faces of the target's joints."""
        ids = [joint.face_ids for joint in self.solved.joints]
        return np.unique(np.concatenate(ids)) if ids else np.zeros(0, dtype=np.int64)

    @cached_property
    def _weights(self) -> sparse.csr_array:
        """Matrix ``(f, F)``: weights of source triangles in the gradient of every face of a joint."""
        corners = self._topology.faces[self._faces]
        vertices, place = np.unique(corners, return_inverse=True)
        rows = np.repeat(np.arange(len(corners)), 3)
        mean = sparse.coo_array(
            (np.ones(len(rows)), (rows, place.reshape(-1))), shape=(len(corners), len(vertices))
        )
        return normalised(mean.tocsr() @ self.gradients.around(vertices.astype(np.int64)))

    @property
    def _topology(self) -> Topology:
        return self.gradients.target.topology

    @cached_property
    def _edge_sides(self) -> tuple[Index, Index]:
        """Rows of `_faces` and stored edges: every face at each."""
        edges = self._topology.face_edges[self._faces]
        order = np.argsort(self.solved.edge_ids, kind="stable")
        ids = self.solved.edge_ids[order]
        place = np.searchsorted(ids, edges)
        found = (place < len(ids)) & (ids[np.minimum(place, len(ids) - 1)] == edges)
        return np.nonzero(found)[0], order[place[found]]

    @cached_property
    def _hinge_sides(self) -> Index:
        """Rows of `_faces` of both faces ``(H', 2)`` of every stored hinge."""
        return np.searchsorted(self._faces, self._topology.hinge_faces[self.solved.hinge_ids])

    @cached_property
    def _angles(self) -> Float:
        return dihedral_angles(self.gradients.target.reference, self._topology.hinges[self.solved.hinge_ids])

    def of(self, x: Float) -> tuple[Float, Float]:
        """Implement `JointChanges.of`."""
        moved = self._gradients(x)
        rest, edges = self.gradients.target.reference, self._topology.edges[self.solved.edge_ids]
        faces, rows = self._edge_sides
        sides = rest[edges[:, 1]] - rest[edges[:, 0]]
        stretched = np.linalg.norm(turned(moved[faces], sides[rows]), axis=1)
        count = np.bincount(rows, minlength=len(edges))
        lengths = np.bincount(rows, stretched, minlength=len(edges)) / np.maximum(count, 1)
        return lengths, self._bent(moved)

    def _gradients(self, x: Float) -> Float:
        source = self.gradients.source
        gradients = source.completed(x) @ source.inverses
        rotations = nearest_rotations(gradients)
        stretches = np.swapaxes(rotations, 1, 2) @ gradients
        turns = nearest_rotations(combined(self._weights, rotations))
        return self.gradients.alignment.turned(turns @ combined(self._weights, stretches))

    def _bent(self, moved: Float) -> Float:
        rest = self.gradients.target.reference
        a, b, c, d = (rest[corner] for corner in self._topology.hinges[self.solved.hinge_ids].T)
        first, second = (moved[side] for side in self._hinge_sides.T)
        near, far = turned(first, b - a), turned(second, b - a)
        n1, n2 = np.cross(near, turned(first, c - a)), np.cross(turned(second, d - a), far)
        middle = near + far
        sine = np.einsum("hi,hi->h", np.cross(n1, n2), middle)
        cosine = np.einsum("hi,hi->h", n1, n2) * np.linalg.norm(middle, axis=1)
        return np.asarray(self._angles + wrap(np.arctan2(sine, cosine) - self._angles))
