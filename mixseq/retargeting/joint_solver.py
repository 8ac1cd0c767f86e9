"""Rebuild a mesh from poses of its parts, and lengths and angles of the joints between them.

Parts are posed. A joint between them is a boundary value problem: its free vertices fit lengths and angles best
(`mixseq.shells.reconstruction`), near their skinned positions (`mixseq.retargeting.solved_joints`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from mixseq.arrays import Float, Index
from mixseq.geometry.rigid import kabsch
from mixseq.geometry.rotations import turned
from mixseq.retargeting.solved_joints import HarmonicSkin, SolvedJoints
from mixseq.segmentation.joints import Decomposition, Joint
from mixseq.shells.fitting import ShellReport, ShellSettings, SoftConstraint
from mixseq.shells.patch import Patch
from mixseq.shells.reconstruction import rebuild
from mixseq.topology import Topology


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

    @cached_property
    def _systems(self) -> list[tuple[Joint, Patch, slice, slice, slice, HarmonicSkin]]:
        """Solved joints, with the places of their lengths, angles and free vertices."""
        solved = self.solved
        slices = solved.edge_slices, solved.hinge_slices, solved.vertex_slices
        return list(zip(solved.joints, solved.patches, *slices, self._skins, strict=True))

    def solve(self, frame: JointFrame, settings: ShellSettings) -> tuple[Float, list[ShellReport]]:
        """Return the mesh ``(V, 3)`` of a frame, with the mean of shared vertices, and a report per solved joint."""
        points = self._placed(frame)
        moves, shifts = self._moves(frame.rotations, frame.translations)
        reports = []
        for joint, patch, edges, hinges, free, skin in self._systems:
            guess, soft = _expected(skin, moves, shifts, frame, free)
            rebuilt, report = rebuild(
                patch,
                frame.lengths[edges],
                frame.angles[hinges],
                frame.weights[edges],
                points[joint.vertices],
                settings,
                guess,
                soft,
            )
            points[joint.vertices[patch.free]] = rebuilt[patch.free]
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


def _expected(
    skin: HarmonicSkin, moves: Float, shifts: Float, frame: JointFrame, free: slice
) -> tuple[Float, SoftConstraint]:
    """Return the start ``(f, 3)`` of a joint's free vertices, and the soft constraint of offsets."""
    places = skin.place(moves, shifts) + turned(frame.rotations[skin.nearest], frame.offsets[free])
    return places, SoftConstraint(places, frame.offset_weights[free])
