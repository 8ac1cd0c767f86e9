"""Free placement, the paper's: joints on their own, registration, stitching, one pose per component."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mixseq.geometry.lengths_angles import dihedral_angles, edge_lengths
from mixseq.geometry.rigid import transform
from mixseq.reconstruction.joint import rebuild
from mixseq.reconstruction.patch import Patch
from mixseq.reconstruction.placement import JointRows, MixedFrame
from mixseq.reconstruction.registration import Overlaps, register
from mixseq.reconstruction.shells import ShellReport, ShellSettings
from mixseq.reconstruction.stitching import Seams, stitch
from mixseq.segmentation.joints import Decomposition
from mixseq.topology import Topology

Float = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class FreePlacement:
    """The paper's: joints on their own, registration of all pieces, stitching, one pose per component.

    Attributes
    ----------
    shapes : (N, 3) float64
        Mean shapes of the parts; they tell which overlaps hold two pieces together.
    """

    topology: Topology
    decomposition: Decomposition
    shapes: Float

    @cached_property
    def _rows(self) -> JointRows:
        joints = self.decomposition.joints
        nothing_fixed = (np.zeros(len(joint.vertices), dtype=bool) for joint in joints)
        patches = tuple(
            Patch.of_joint(self.topology, j, f) for j, f in zip(joints, nothing_fixed, strict=True)
        )
        edges = tuple(np.any(rows < 0, axis=1) for rows in self._known_edges)
        hinges = tuple(np.any(rows < 0, axis=1) for rows in self._known_hinges)
        return JointRows(joints, patches, edges, hinges)

    @cached_property
    def _known_edges(self) -> list[Index]:
        """Joint by joint, the rows ``(e, 2)`` of part vertices that an edge connects, -1 if no part has both."""
        return [self._rows_in_one_part(self.topology.edges[j.edge_ids]) for j in self.decomposition.joints]

    @cached_property
    def _known_hinges(self) -> list[Index]:
        """The same for hinges ``(h, 4)``."""
        return [self._rows_in_one_part(self.topology.hinges[j.hinge_ids]) for j in self.decomposition.joints]

    def _rows_in_one_part(self, vertices: Index) -> Index:
        """Rows of vertices ``(n, k)`` in the first part that has all k of them, -1 where none has."""
        result = np.full(vertices.shape, -1, dtype=np.int64)
        start = 0
        for part in self.decomposition.parts:
            place = np.full(self.topology.vertex_count, -1, dtype=np.int64)
            place[part] = start + np.arange(len(part))
            rows = place[vertices]
            found = (rows >= 0).all(axis=1) & (result < 0).any(axis=1)
            result[found] = rows[found]
            start += len(part)
        return result

    @cached_property
    def _pieces(self) -> list[Index]:
        return [*self.decomposition.parts, *(joint.vertices for joint in self.decomposition.joints)]

    @cached_property
    def _overlaps(self) -> Overlaps:
        sizes = [len(part) for part in self.decomposition.parts]
        # Pairs are judged by their first piece, and pairs of joints (which share no face) do not count.
        shapes = np.split(self.shapes, np.cumsum(sizes)[:-1])
        return Overlaps.of(
            self._pieces, [*shapes, *(np.zeros((len(j.vertices), 3)) for j in self._rows.joints)]
        )

    @cached_property
    def _seams(self) -> Seams:
        return Seams.of(self.topology, self._pieces)

    @property
    def edge_ids(self) -> Index:
        """Edges of the joints that no part has both ends of."""
        return self._rows.edge_ids

    @property
    def hinge_ids(self) -> Index:
        """Hinges of the joints that no part has all vertices of."""
        return self._rows.hinge_ids

    @property
    def posed(self) -> Index:
        """The first part of every group of pieces that hold each other."""
        return self._overlaps.roots

    def prepare(self) -> None:
        """Implement `Placement.prepare`."""
        self._rows.prepare()
        self._known_edges, self._known_hinges, self._overlaps, self._seams.factor  # noqa: B018 - cached properties

    def assemble(self, frame: MixedFrame, settings: ShellSettings) -> tuple[Float, list[ShellReport]]:
        """Implement `Placement.assemble`."""
        pieces, reports = [frame.parts], []
        wanted = np.full(len(self.topology.edges), np.nan)
        rows = self._rows
        for number, (joint, patch) in enumerate(zip(rows.joints, rows.patches, strict=True)):
            # What lies in one part is known from that part; only the rest is stored.
            joint_lengths = edge_lengths(frame.parts, self._known_edges[number])
            joint_lengths[rows.stored_edges[number]] = frame.lengths[rows.edge_slices[number]]
            joint_angles = dihedral_angles(frame.parts, self._known_hinges[number])
            joint_angles[rows.stored_hinges[number]] = frame.angles[rows.hinge_slices[number]]
            joint_weights = 1.0 / np.maximum(joint_lengths, np.finfo(np.float64).tiny)
            joint_weights[rows.stored_edges[number]] = frame.weights[rows.edge_slices[number]]
            nowhere = np.zeros((len(patch.fixed), 3))
            solved, report = rebuild(patch, joint_lengths, joint_angles, joint_weights, nowhere, settings)
            pieces.append(solved)
            reports.append(report)
            wanted[joint.edge_ids] = joint_lengths
        points = np.concatenate(pieces)

        overlaps = self._overlaps
        rotation, translation = register(overlaps, points)
        pose = np.searchsorted(self.posed, overlaps.group)
        to_world = frame.rotations[pose] @ rotation
        centre = transform(translation[:, None], frame.rotations[pose], frame.translations[pose])[:, 0]
        owner = np.repeat(np.arange(len(overlaps.sizes)), overlaps.sizes)
        placed = np.einsum("nij,nj->ni", to_world[owner], points) + centre[owner]

        return stitch(self._seams, placed, wanted), reports
