"""Anchored placement: parts go where their poses say, joints are solved between them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mixseq.geometry.rigid import kabsch
from mixseq.reconstruction.blend import Blend
from mixseq.reconstruction.joint import rebuild
from mixseq.reconstruction.patch import Patch
from mixseq.reconstruction.placement import JointRows, MixedFrame, concatenate
from mixseq.reconstruction.shells import ShellReport, ShellSettings
from mixseq.segmentation.joints import Decomposition
from mixseq.topology import Topology

Float = NDArray[np.float64]
Index = NDArray[np.int64]


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
    def _rows(self) -> JointRows:
        joints = tuple(joint for joint in self.decomposition.joints if joint.free.any())
        patches = tuple(Patch.of_joint(self.topology, joint, ~joint.free) for joint in joints)
        return JointRows(
            joints, patches, tuple(p.free_edges for p in patches), tuple(p.free_hinges for p in patches)
        )

    @property
    def edge_ids(self) -> Index:
        """Edges at free vertices."""
        return self._rows.edge_ids

    @property
    def hinge_ids(self) -> Index:
        """Hinges with a free vertex."""
        return self._rows.hinge_ids

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
        rows = self._rows
        return tuple(
            Blend.of(patch, owner[joint.vertices], self.reference[joint.vertices])
            for joint, patch in zip(rows.joints, rows.patches, strict=True)
        )

    def assemble(self, frame: MixedFrame, settings: ShellSettings) -> tuple[Float, list[ShellReport]]:
        """Implement `Placement.assemble`; a vertex that several parts share is where they put it on average."""
        part, vertex, copies = self._copies
        placed = np.einsum("nij,nj->ni", frame.rotations[part], frame.parts) + frame.translations[part]
        sums = [np.bincount(vertex, column, minlength=len(copies)) for column in placed.T]
        points = np.stack(sums, axis=1) / copies[:, None]
        turns, centres = self._reference_poses
        moves = frame.rotations @ np.swapaxes(turns, 1, 2)  # from the reference frame to this one
        shifts = frame.translations - np.einsum("pij,pj->pi", moves, centres)
        reports = []
        rows = self._rows
        for joint, patch, edges, hinges, blend in zip(
            rows.joints, rows.patches, rows.edge_slices, rows.hinge_slices, self._blends, strict=True
        ):
            solved, report = rebuild(
                patch,
                frame.lengths[edges],
                frame.angles[hinges],
                frame.weights[edges],
                points[joint.vertices],
                settings,
                guess=blend.place(moves, shifts),
            )
            points[joint.vertices[patch.free]] = solved[patch.free]
            reports.append(report)
        return points, reports
