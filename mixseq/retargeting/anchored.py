"""Anchored placement: parts go where their poses say, joints are solved between them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mixseq.arrays import Float, Index
from mixseq.geometry.rigid import kabsch
from mixseq.retargeting.blend import Blend
from mixseq.retargeting.placement import JointRows, MixedFrame, concatenate
from mixseq.segmentation.joints import Decomposition, Joint
from mixseq.shells.fitting import NO_PULL, Pull, ShellReport, ShellSettings
from mixseq.shells.joint import rebuild
from mixseq.shells.patch import Patch
from mixseq.topology import Topology


@dataclass(frozen=True, eq=False)
class AnchoredPlacement:
    """Parts go where their poses say; joints are boundary value problems between them.

    Attributes
    ----------
    shapes : (N, 3) float64
        Mean shapes of the parts.
    reference : (V, 3) float64
        A frame of the sequence, from which guesses of the joints are blended.
    """

    topology: Topology
    decomposition: Decomposition
    shapes: Float
    reference: Float

    @cached_property
    def rows(self) -> JointRows:
        """The joints that are solved, and which of their edges and hinges are stored."""
        joints = tuple(joint for joint in self.decomposition.joints if joint.free.any())
        patches = tuple(Patch.of_joint(self.topology, joint, ~joint.free) for joint in joints)
        return JointRows(
            joints, patches, tuple(p.free_edges for p in patches), tuple(p.free_hinges for p in patches)
        )

    @property
    def edge_ids(self) -> Index:
        """Edges at free vertices."""
        return self.rows.edge_ids

    @property
    def hinge_ids(self) -> Index:
        """Hinges with a free vertex."""
        return self.rows.hinge_ids

    @cached_property
    def posed(self) -> Index:
        """All parts."""
        return np.arange(len(self.decomposition.parts))

    @cached_property
    def _copies(self) -> tuple[Index, Index, Float]:
        """Part and vertex of every row of part vertices, and how many copies each vertex of the mesh has."""
        part = np.repeat(self.posed, [len(vertices) for vertices in self.decomposition.parts])
        vertex = concatenate(list(self.decomposition.parts))
        copies = np.bincount(vertex, minlength=self.topology.vertex_count)
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
    def _blends(self) -> tuple[Blend, ...]:
        owner = np.full(self.topology.vertex_count, -1, dtype=np.int64)
        for number, vertices in reversed(list(enumerate(self.decomposition.parts))):
            owner[vertices] = number
        rows = self.rows
        return tuple(
            Blend.of(patch, owner[joint.vertices], self.reference[joint.vertices])
            for joint, patch in zip(rows.joints, rows.patches, strict=True)
        )

    @cached_property
    def _solved(self) -> list[tuple[Joint, Patch, slice, slice, slice, Blend]]:
        """The joints that are solved, with the places of their lengths, angles and free vertices."""
        rows = self.rows
        slices = rows.edge_slices, rows.hinge_slices, rows.free_slices
        return list(zip(rows.joints, rows.patches, *slices, self._blends, strict=True))

    def assemble(self, frame: MixedFrame, settings: ShellSettings) -> tuple[Float, list[ShellReport]]:
        """Return the mesh ``(V, 3)`` of a frame, with a report for each joint that was solved.

        A vertex that several parts share is where they put it on average.
        """
        points = self._on_average(self._turned(frame.rotations, frame.parts), frame.translations)
        moves, shifts = self._moves(frame.rotations, frame.translations)
        reports = []
        for joint, patch, edges, hinges, free, blend in self._solved:
            guess, pull = _expected(blend, moves, shifts, frame, free)
            solved, report = rebuild(
                patch,
                frame.lengths[edges],
                frame.angles[hinges],
                frame.weights[edges],
                points[joint.vertices],
                settings,
                guess,
                pull,
            )
            points[joint.vertices[patch.free]] = solved[patch.free]
            reports.append(report)
        return points, reports

    def offsets(self, rotations: Float, translations: Float, points: Float) -> Float:
        """Return the offsets ``(F, 3)`` of a frame's free vertices from where the parts carry them.

        They are blended with harmonic weights from the reference frame (`Blend`); the offset is seen from the part
        that a vertex follows most, so it turns with the body.
        """
        moves, shifts = self._moves(rotations, translations)
        offsets = np.zeros((len(self.rows.free), 3))
        for free, blend in zip(self.rows.free_slices, self._blends, strict=True):
            away = points[self.rows.free[free]] - blend.place(moves, shifts)
            offsets[free] = _turned(np.swapaxes(rotations[blend.nearest], 1, 2), away)
        return offsets

    def _turned(self, rotations: Float, parts: Float) -> Float:
        """Part vertices ``(N, 3)``, each multiplied by the matrix of its part."""
        return _turned(rotations[self._copies[0]], parts)

    def _on_average(self, turned: Float, translations: Float) -> Float:
        """Mean over the copies of each vertex ``(V, 3)``; zero for those that no part holds."""
        part, vertex, copies = self._copies
        placed = turned + translations[part]
        sums = [np.bincount(vertex, column, minlength=len(copies)) for column in placed.T]
        return np.stack(sums, axis=1) / copies[:, None]

    def _moves(self, rotations: Float, translations: Float) -> tuple[Float, Float]:
        """Motions ``x -> M x + s`` of the parts from the reference frame; linear in both."""
        turns, centres = self._reference_poses
        moves = rotations @ np.swapaxes(turns, 1, 2)
        return moves, translations - _turned(moves, centres)


def _expected(
    blend: Blend, moves: Float, shifts: Float, frame: MixedFrame, free: slice
) -> tuple[Float, Pull]:
    """Where the free vertices ``(f, 3)`` of a joint may be, and the pull towards it: where offsets tell it."""
    carried = blend.place(moves, shifts)
    if not frame.holds.size:
        return carried, NO_PULL
    places = carried + _turned(frame.rotations[blend.nearest], frame.offsets[free])
    return places, Pull(places, frame.holds[free])


def _turned(matrices: Float, vectors: Float) -> Float:
    return np.asarray(np.einsum("nij,nj->ni", matrices, vectors))
