r"""The projection P_m at the joints: move posed vertices so that joints have the target lengths and angles.

Joint faces, and one ring of faces around them, move; all else stays posed. Lengths and angles go a *share* of the way
from those of the posed mesh to the targets; a share of 0 leaves the posed mesh.

1. *Faces.* The frames of the posed faces are rotated to the differences across hinges that follow from lengths and
   angles, by rotation averaging (`mixseq.shells.face_frames`): two rounds with one constant matrix.
2. *Vertices*, from the changes of sides of faces, by one back-substitution with a constant matrix,

   .. math:: \min_d \sum_f \sum_{ab} w_{ab}\, |d_b - d_a - (s'_{ab} - s_{ab})|^2 + \eta\, w \sum_v |d_v|^2 .

Everything is a difference against the posed mesh, so frames of the sequence, with the lengths and angles of the posed
mesh, are exact. Posed triangles with hardly any area keep their shapes and angles, which are noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mixseq.arrays import Float, Index, Mask
from mixseq.geometry.lengths_angles import edge_lengths, wrap
from mixseq.pickling import PickledWithoutCaches
from mixseq.shells.face_frames import Hinges
from mixseq.shells.shell import Shell
from mixseq.shells.shell_kernels import lengths_and_angles
from mixseq.shells.solvers import Factor, factored_laplacian
from mixseq.spaces.mixed import joint_kernels as kernels
from mixseq.spaces.mixed.complex_step import Numbers, solve
from mixseq.topology import Topology

AVERAGING_ROUNDS = 2
"""Rounds of rotation averaging over faces."""

MOVING_RINGS = 1
"""Rings of faces around joint faces that move with them; without them joints are too stiff."""

BENDING_WEIGHT = 0.25
"""Weight of an angle in radians against a relative length."""


@dataclass(frozen=True, eq=False)
class JointProjection(PickledWithoutCaches):
    """The projection at the joints of one mesh."""

    topology: Topology  # the mesh
    reference: Float  # (V, 3) its reference frame, in diagonals, which the weights are of
    joint_faces: Mask  # (F,) faces whose lengths and angles have targets
    hold: float  # weight of posed vertices and frames against sides and hinges

    def constants(self) -> tuple[object, ...]:
        """Implement `PickledWithoutCaches.constants`."""
        return self.frame_factor, self.vertex_factor

    @cached_property
    def edge_ids(self) -> Index:
        """Edges ``(E',)`` with a target length: those of joint faces, ascending."""
        return np.unique(self.topology.face_edges[self.joint_faces]).astype(np.int64)

    @cached_property
    def hinge_ids(self) -> Index:
        """Hinges ``(H',)`` with a target angle: those of joint faces, ascending."""
        return np.flatnonzero(self.joint_faces[self.topology.hinge_faces].any(axis=1))

    @cached_property
    def shell(self) -> Shell:
        """The mesh as a shell, for the weights of sides and hinges."""
        lengths = edge_lengths(self.reference, self.topology.edges)
        held = np.full(self.topology.vertex_count, self.hold)
        return Shell(
            self.topology, self.reference, lengths, np.zeros((0, 2), dtype=np.int64), held, BENDING_WEIGHT
        )

    @cached_property
    def _moving_faces(self) -> Index:
        moving, faces = self.joint_faces, self.topology.faces
        for _ in range(MOVING_RINGS):
            near = np.zeros(self.topology.vertex_count, dtype=bool)
            near[faces[moving]] = True
            moving = np.asarray(near[faces].any(axis=1))
        return np.flatnonzero(moving)

    @cached_property
    def _hinges(self) -> Index:
        """Hinges of moving faces with area."""
        moving = np.zeros(len(self.topology.faces), dtype=bool)
        moving[self._moving_faces] = True
        return np.flatnonzero(moving[self.topology.hinge_faces].any(axis=1) & self.shell.sound)

    @cached_property
    def _face_ids(self) -> Index:
        """Moving faces, then their fixed neighbours."""
        both = np.unique(self.topology.hinge_faces[self._hinges])
        return np.concatenate([self._moving_faces, np.setdiff1d(both, self._moving_faces)]).astype(np.int64)

    @cached_property
    def _faces(self) -> Index:
        return self.topology.faces[self._face_ids].astype(np.int64)

    @cached_property
    def _edge_table(self) -> tuple[Index, Index, Index]:
        """Edges of the faces ``(e,)``, sides ``(m, 3)`` of faces among these, and those with a target length."""
        sides = self.topology.face_edges[self._face_ids]
        edges, local = np.unique(sides, return_inverse=True)
        known = np.searchsorted(edges, self.edge_ids)
        return edges, local.reshape(sides.shape).astype(np.int64), known.astype(np.int64)

    @cached_property
    def _edges(self) -> Index:
        return self.topology.edges[self._edge_table[0]].astype(np.int64)

    @cached_property
    def _pairs(self) -> Index:
        """The two faces ``(h, 2)`` of every hinge, by their places among the faces."""
        place = np.empty(len(self.topology.faces), dtype=np.int64)
        place[self._face_ids] = np.arange(len(self._face_ids))
        return place[self.topology.hinge_faces[self._hinges]]

    @cached_property
    def _hinge_tables(self) -> tuple[Index, Index, Float, Index]:
        """Sides of hinges in their faces, and their target angles; see `target_turns`."""
        seen = Hinges(self._faces, self.topology.hinges[self._hinges].astype(np.int64), self._pairs)
        number = np.full(len(self.topology.hinge_faces), -1, dtype=np.int64)
        number[self.hinge_ids] = np.arange(len(self.hinge_ids))
        return seen.sides, seen.backward.astype(np.int64), seen.reversed_normals, number[self._hinges]

    @cached_property
    def _bend(self) -> Float:
        return np.ascontiguousarray(self.shell.bend[self._hinges])

    @cached_property
    def frame_factor(self) -> Factor | None:
        """Factor of the matrix of rotation averaging over the moving faces; None if nothing moves."""
        count = len(self._moving_faces)
        if not count:
            return None
        inside = self._pairs < count
        both, held = inside.all(axis=1), np.full(count, self.hold)
        for first in (0, 1):
            border = inside[:, first] & ~inside[:, 1 - first]
            np.add.at(held, self._pairs[border, first], self._bend[border])
        return factored_laplacian(self._pairs[both], self._bend[both], held)

    @cached_property
    def vertices(self) -> Index:
        """Moving vertices ``(n,)``: those of moving faces only."""
        still = np.ones(len(self.topology.faces), dtype=bool)
        still[self._moving_faces] = False
        free = np.zeros(self.topology.vertex_count, dtype=bool)
        free[self.topology.faces[self._moving_faces]] = True
        free[self.topology.faces[still]] = False
        return np.flatnonzero(free)

    @cached_property
    def _numbers(self) -> Index:
        numbers = np.full(self.topology.vertex_count, -1, dtype=np.int64)
        numbers[self.vertices] = np.arange(len(self.vertices))
        return numbers

    @cached_property
    def _side_weights(self) -> Float:
        """Weights ``(n, 3)`` of the sides of moving faces; zero for those without area."""
        weights = self.shell.side_weights[self._moving_faces]
        weights[np.isin(self._moving_faces, self.shell.thin)] = 0.0
        return weights

    @cached_property
    def vertex_factor(self) -> Factor | None:
        """Factor of the matrix of displacements; None if nothing moves."""
        if not len(self.vertices):
            return None
        corners = self._faces[: len(self._moving_faces)]
        ends = self._numbers[np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2)]
        weights, inside = self._side_weights.reshape(-1), ends >= 0
        both = inside.all(axis=1)
        held = np.full(len(self.vertices), self.hold * self.shell.tie_weight)
        for first in (0, 1):
            border = inside[:, first] & ~inside[:, 1 - first]
            np.add.at(held, ends[border, first], weights[border])
        return factored_laplacian(ends[both], weights[both], held)

    def targets(self, x: Float, lengths: Float, angles: Float) -> tuple[Float, Float]:
        """Return lengths ``(E,)`` and angles ``(H,)`` of the whole mesh: targets at joints, else of posed vertices."""
        topology = self.topology
        all_lengths, all_angles = lengths_and_angles(x, topology.edges, topology.hinges)
        sound = kernels.soundness(kernels.flatten(all_lengths, topology.face_edges.astype(np.int64)))
        part = sound[topology.hinge_faces[self.hinge_ids]].prod(axis=1)
        all_angles[self.hinge_ids] += part * wrap(angles - all_angles[self.hinge_ids])
        all_lengths[self.edge_ids] = np.maximum(lengths, 0.0)
        return all_lengths, all_angles

    def project(self, x: Numbers, lengths: Numbers, angles: Numbers, share: float) -> Numbers:
        """Move posed vertices ``(V, 3)`` of joints to lengths ``(E',)`` and angles ``(H',)``."""
        if not share or self.frame_factor is None or self.vertex_factor is None:
            return x
        _, face_edges, known = self._edge_table
        posed = kernels.lengths_of(x, self._edges)
        wanted = posed.copy()
        wanted[known] += share * (np.where(lengths.real > 0.0, lengths, 0.0) - posed[known])
        flat = kernels.flatten(posed, face_edges)
        sound = kernels.soundness(flat)
        target_flat = flat + sound[:, None] * (kernels.flatten(wanted, face_edges) - flat)
        frames = kernels.frames_of(x, self._faces)
        turns = kernels.target_turns(
            frames, self._pairs, flat, target_flat, sound, *self._hinge_tables, angles, share
        )
        target_frames, moving = frames, len(self._moving_faces)
        for _ in range(AVERAGING_ROUNDS):
            right = kernels.misfits(target_frames, self._pairs, turns, self._bend, moving)
            target_frames = kernels.turn_on(target_frames, solve(self.frame_factor, right))
        right = kernels.side_changes(
            frames,
            flat,
            target_frames,
            target_flat,
            self._faces[:moving],
            self._side_weights,
            self._numbers,
            len(self.vertices),
        )
        moved = x.copy()
        moved[self.vertices] += solve(self.vertex_factor, right)
        return moved
