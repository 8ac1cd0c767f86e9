r"""Joints of the target: skinning of their free vertices, their solves, and transfer of their lengths and angles.

Parts are posed. A joint between them is a boundary value problem: its free vertices fit lengths and angles best
(`mixseq.shells.fitting`), near their skinned positions. Skinning is linear blending from a reference frame: every free
vertex moves with all parts that hold fixed vertices of its joint, with harmonic weights (1 at the vertices of a part, 0
at those of the others). Close to the reference this is a start without folds, where blended lengths and angles are
inconsistent.

Lengths are transferred as ratios, angles as differences. Where both meshes have the same connectivity every edge and
hinge has its own,

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
from typing import NamedTuple, Protocol

import numpy as np
from scipy import sparse

from mixseq.mesh.measures import dihedral_angles, edge_lengths, wrap
from mixseq.mesh.rigid import kabsch, nearest_rotations
from mixseq.mesh.rotations import turned
from mixseq.mesh.topology import Topology
from mixseq.retargeting.gradient_transfer import GradientTransfer, combined, normalised
from mixseq.segmentation.joints import Decomposition, Joint
from mixseq.shells.fitting import Patch, SoftConstraint, rebuild_patch
from mixseq.shells.gauss_newton import ShellReport, ShellSettings
from mixseq.types import Float, Index


@dataclass(frozen=True, eq=False)
class SolvedJoints:
    """The joints of a mesh with free vertices; data of frames is stored joint by joint."""

    joints: tuple[Joint, ...]  # the joints
    patches: tuple[Patch, ...]  # each as a patch, in which the vertices of parts are fixed

    @classmethod
    def of(cls, topology: Topology, decomposition: Decomposition) -> SolvedJoints:
        """Select the joints of a decomposition with free vertices."""
        joints = tuple(joint for joint in decomposition.joints if joint.free.any())
        return cls(joints, tuple(Patch.from_joint(topology, joint, ~joint.free) for joint in joints))

    @cached_property
    def edge_ids(self) -> Index:
        """Global numbers ``(E',)`` of the edges at free vertices."""
        return _joined([j.edge_ids[p.free_edge_mask] for j, p in zip(self.joints, self.patches, strict=True)])

    @cached_property
    def hinge_ids(self) -> Index:
        """Global numbers ``(H',)`` of the hinges with a free vertex."""
        return _joined(
            [j.hinge_ids[p.free_hinge_mask] for j, p in zip(self.joints, self.patches, strict=True)]
        )

    @cached_property
    def vertices(self) -> Index:
        """Global numbers ``(F,)`` of the free vertices."""
        return _joined([j.vertices[p.free_ids] for j, p in zip(self.joints, self.patches, strict=True)])

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

    def spacing(self, lengths: Float) -> Float:
        """Return the mean length ``(F,)`` of the edges at every free vertex, from lengths ``(E',)``."""
        sums, counts = np.zeros((2, len(self.vertices)))
        for patch, edges, free in zip(self.patches, self.edge_slices, self.vertex_slices, strict=True):
            ends = patch.free_index[patch.edges[patch.free_edge_mask]]
            for end in ends.T:
                inside = end >= 0
                np.add.at(sums[free], end[inside], lengths[edges][inside])
                np.add.at(counts[free], end[inside], 1.0)
        return np.asarray(sums / counts)


@dataclass(frozen=True, eq=False)
class HarmonicSkin:
    """Harmonic skinning weights of the free vertices of a joint."""

    parts: Index  # (k,) parts that hold fixed vertices of the joint
    weights: Float  # (f, k) weights of the free vertices; rows add up to one
    rest: Float  # (f, 3) the free vertices in the reference frame

    @classmethod
    def of(cls, patch: Patch, owner: Index, rest: Float) -> HarmonicSkin:
        """Find the weights of a patch: owner ``(n,)``; rest ``(n, 3)``."""
        parts, number = np.unique(owner[patch.fixed_mask], return_inverse=True)
        boundary = np.eye(len(parts))[number.reshape(-1)]
        coupling = patch.laplacian[patch.free_ids][:, patch.fixed_mask]
        return cls(parts, -patch.laplacian_factor.solve(coupling @ boundary), rest[patch.free_ids])

    def place(self, rotations: Float, translations: Float) -> Float:
        """Move the free vertices ``(f, 3)`` with motions ``x -> R x + t`` of all parts from the reference frame."""
        moved = np.einsum("kij,fj->fki", rotations[self.parts], self.rest) + translations[self.parts]
        return np.asarray(np.einsum("fk,fki->fi", self.weights, moved))

    @cached_property
    def nearest(self) -> Index:
        """Main part ``(f,)`` of every free vertex."""
        return np.asarray(self.parts[self.weights.argmax(axis=1)])


def _joined(ids: list[Index]) -> Index:
    """Concatenate index arrays; return an empty one for none."""
    return np.concatenate(ids) if ids else np.zeros(0, dtype=np.int64)


def _slices(sizes: list[int]) -> list[slice]:
    ends = np.cumsum(sizes)
    return [slice(int(end) - size, int(end)) for end, size in zip(ends, sizes, strict=True)]


class JointFrame(NamedTuple):
    """A frame as poses and shapes of the parts, lengths and angles of the joints."""

    lengths: Float  # (E',) edge lengths of the joints
    angles: Float  # (H',) hinge angles of the joints, in radians
    weights: Float  # (E',) weights of the edge lengths
    parts: Float  # (N, 3) aligned vertices of all parts
    rotations: Float  # (p, 3, 3) rotations of the parts
    translations: Float  # (p, 3) translations of the parts
    offsets: Float  # (F, 3) offsets of the free vertices from where the parts carry them
    offset_weights: Float  # (F,) weights of offsets as soft position constraints


@dataclass(frozen=True, eq=False)
class JointSolver:
    """Poses parts, and solves the joints between them."""

    topology: Topology  # connectivity of the mesh
    decomposition: Decomposition  # its parts and joints
    shapes: Float  # (N, 3) mean shapes of the parts
    reference: Float  # (V, 3) a frame of the sequence, from which the parts carry free vertices

    @cached_property
    def solved(self) -> SolvedJoints:
        """The joints with free vertices."""
        return SolvedJoints.of(self.topology, self.decomposition)

    @cached_property
    def _copies(self) -> tuple[Index, Index, Float]:
        """Part and vertex of every row of part vertices, and the number of copies of each vertex of the mesh."""
        parts = self.decomposition.parts
        vertex = np.concatenate(parts)
        copies = np.bincount(vertex, minlength=self.topology.vertex_count)
        part = np.repeat(np.arange(len(parts)), [len(vertices) for vertices in parts])
        return part, vertex, np.maximum(copies, 1).astype(np.float64)

    @cached_property
    def _reference_poses(self) -> tuple[Float, Float]:
        """Rotations ``(p, 3, 3)`` and centres ``(p, 3)`` of the parts in the reference frame."""
        sizes = [len(vertices) for vertices in self.decomposition.parts]
        shapes = np.split(self.shapes, np.cumsum(sizes)[:-1])
        targets = [self.reference[vertices] for vertices in self.decomposition.parts]
        poses = [kabsch(shape, target) for shape, target in zip(shapes, targets, strict=True)]
        return np.stack([rotation for rotation, _ in poses]), np.stack([centre for _, centre in poses])

    @cached_property
    def _skins(self) -> tuple[HarmonicSkin, ...]:
        owner = np.full(self.topology.vertex_count, -1, dtype=np.int64)
        for number, vertices in reversed(list(enumerate(self.decomposition.parts))):
            owner[vertices] = number
        return tuple(
            HarmonicSkin.of(patch, owner[joint.vertices], self.reference[joint.vertices])
            for joint, patch in zip(self.solved.joints, self.solved.patches, strict=True)
        )

    def solve(self, frame: JointFrame, settings: ShellSettings) -> tuple[Float, list[ShellReport]]:
        """Return the mesh ``(V, 3)`` of a frame, with the mean of shared vertices, and a report per solved joint."""
        points = self._placed(frame)
        moves, shifts = self._moves(frame.rotations, frame.translations)
        reports, solved = [], self.solved
        slices = zip(solved.edge_slices, solved.hinge_slices, solved.vertex_slices, strict=True)
        systems = zip(solved.joints, solved.patches, slices, self._skins, strict=True)
        for joint, patch, (edges, hinges, free), skin in systems:
            guess = skin.place(moves, shifts) + turned(frame.rotations[skin.nearest], frame.offsets[free])
            rebuilt, report = rebuild_patch(
                patch,
                frame.lengths[edges],
                frame.angles[hinges],
                frame.weights[edges],
                points[joint.vertices],
                settings,
                guess,
                SoftConstraint(guess, frame.offset_weights[free]),
            )
            points[joint.vertices[patch.free_ids]] = rebuilt[patch.free_ids]
            reports.append(report)
        return points, reports

    def offsets(self, rotations: Float, translations: Float, points: Float) -> Float:
        """Return the offsets ``(F, 3)`` of a frame's free vertices from their skinned positions (`HarmonicSkin`).

        Offsets are in the axes of the main part of a vertex, and rotate with the body.
        """
        moves, shifts = self._moves(rotations, translations)
        offsets = np.zeros((len(self.solved.vertices), 3))
        for free, skin in zip(self.solved.vertex_slices, self._skins, strict=True):
            away = points[self.solved.vertices[free]] - skin.place(moves, shifts)
            offsets[free] = turned(np.swapaxes(rotations[skin.nearest], 1, 2), away)
        return offsets

    def _placed(self, frame: JointFrame) -> Float:
        """Return the vertices ``(V, 3)`` posed by parts: the mean of copies, zero without a part."""
        part, vertex, copies = self._copies
        placed = turned(frame.rotations[part], frame.parts) + frame.translations[part]
        sums = [np.bincount(vertex, column, minlength=len(copies)) for column in placed.T]
        return np.stack(sums, axis=1) / copies[:, None]

    def _moves(self, rotations: Float, translations: Float) -> tuple[Float, Float]:
        """Return motions ``x -> M x + s`` of the parts from the reference frame; linear in both."""
        turns, centres = self._reference_poses
        moves = rotations @ np.swapaxes(turns, 1, 2)
        return moves, translations - turned(moves, centres)


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
        return np.unique(_joined([joint.face_ids for joint in self.solved.joints]))

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
        gradients = source.complete_triangles(x) @ source.inverse_triangles
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
