"""The last step of P_m: put decoded parts and joints together, anchored or free."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mixseq.geometry.rigid import transform
from mixseq.reconstruction.joint import rebuild
from mixseq.reconstruction.patch import Patch
from mixseq.reconstruction.registration import Overlaps, register
from mixseq.reconstruction.shells import ShellReport, ShellSettings
from mixseq.reconstruction.stitching import Seams, stitch
from mixseq.segmentation.joints import Decomposition, Joint
from mixseq.topology import Topology

Float = NDArray[np.float64]
Index = NDArray[np.int64]


class Placement(Protocol):
    """What a placement stores of a frame, and how it puts a frame together."""

    @property
    def edge_ids(self) -> Index:
        """Global edges ``(E',)`` whose lengths are stored, joint by joint."""

    @property
    def hinge_ids(self) -> Index:
        """Global hinges ``(H',)`` whose angles are stored, joint by joint."""

    @property
    def posed(self) -> Index:
        """Parts ``(g,)`` whose poses are stored."""

    def assemble(
        self,
        lengths: Float,
        angles: Float,
        weights: Float,
        parts: Float,
        rotations: Float,
        translations: Float,
        settings: ShellSettings,
    ) -> tuple[Float, list[ShellReport]]:
        """Turn one frame of S_m into vertex positions.

        Parameters
        ----------
        lengths, angles, weights : (E',), (H',), (E',) float64
            Edge lengths, hinge angles, weights of the lengths.
        parts : (N, 3) float64
            Aligned vertices of all parts.
        rotations, translations : (g, 3, 3), (g, 3) float64
            Poses.
        settings : ShellSettings
            Settings of the joint solves.

        Returns
        -------
        points : (V, 3) float64
        reports : list of ShellReport
            One for each joint that was solved.
        """


@dataclass(frozen=True, eq=False)
class _Rows:
    """The joints that are solved, and where their rows are in the vector."""

    joints: tuple[Joint, ...]
    patches: tuple[Patch, ...]

    @cached_property
    def edge_ids(self) -> Index:
        return _concatenate(
            [j.edge_ids[p.free_edges] for j, p in zip(self.joints, self.patches, strict=True)]
        )

    @cached_property
    def hinge_ids(self) -> Index:
        return _concatenate(
            [j.hinge_ids[p.free_hinges] for j, p in zip(self.joints, self.patches, strict=True)]
        )

    @cached_property
    def edge_slices(self) -> list[slice]:
        return _slices([int(np.count_nonzero(patch.free_edges)) for patch in self.patches])

    @cached_property
    def hinge_slices(self) -> list[slice]:
        return _slices([int(np.count_nonzero(patch.free_hinges)) for patch in self.patches])


@dataclass(frozen=True, eq=False)
class AnchoredPlacement:
    """Parts go where their poses say; joints are boundary value problems between them."""

    topology: Topology
    decomposition: Decomposition

    @cached_property
    def _rows(self) -> _Rows:
        joints = tuple(joint for joint in self.decomposition.joints if joint.free.any())
        return _Rows(joints, tuple(Patch.of_joint(self.topology, j, ~j.free) for j in joints))

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
        vertex = _concatenate(list(self.decomposition.parts))
        copies = np.bincount(vertex, minlength=self.topology.vertex_count)
        return part, vertex, np.maximum(copies, 1).astype(np.float64)

    def assemble(
        self,
        lengths: Float,
        angles: Float,
        weights: Float,
        parts: Float,
        rotations: Float,
        translations: Float,
        settings: ShellSettings,
    ) -> tuple[Float, list[ShellReport]]:
        """See `Placement.assemble`; a vertex that several parts share is where they put it on average."""
        part, vertex, copies = self._copies
        placed = np.einsum("nij,nj->ni", rotations[part], parts) + translations[part]
        sums = [np.bincount(vertex, column, minlength=len(copies)) for column in placed.T]
        points = np.stack(sums, axis=1) / copies[:, None]
        reports = []
        rows = self._rows
        for joint, patch, edges, hinges in zip(
            rows.joints, rows.patches, rows.edge_slices, rows.hinge_slices, strict=True
        ):
            solved, report = rebuild(
                patch, lengths[edges], angles[hinges], weights[edges], points[joint.vertices], settings
            )
            points[joint.vertices[patch.free]] = solved[patch.free]
            reports.append(report)
        return points, reports


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
    def _rows(self) -> _Rows:
        joints = self.decomposition.joints
        nothing_fixed = [np.zeros(len(joint.vertices), dtype=bool) for joint in joints]
        patches = [Patch.of_joint(self.topology, j, f) for j, f in zip(joints, nothing_fixed, strict=True)]
        return _Rows(joints, tuple(patches))

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
        """All edges of the joints."""
        return self._rows.edge_ids

    @property
    def hinge_ids(self) -> Index:
        """All hinges of the joints."""
        return self._rows.hinge_ids

    @property
    def posed(self) -> Index:
        """The first part of every group of pieces that hold each other."""
        return self._overlaps.roots

    def assemble(
        self,
        lengths: Float,
        angles: Float,
        weights: Float,
        parts: Float,
        rotations: Float,
        translations: Float,
        settings: ShellSettings,
    ) -> tuple[Float, list[ShellReport]]:
        """See `Placement.assemble`."""
        pieces, reports = [parts], []
        rows = self._rows
        for patch, edges, hinges in zip(rows.patches, rows.edge_slices, rows.hinge_slices, strict=True):
            nowhere = np.zeros((len(patch.fixed), 3))
            solved, report = rebuild(patch, lengths[edges], angles[hinges], weights[edges], nowhere, settings)
            pieces.append(solved)
            reports.append(report)
        points = np.concatenate(pieces)

        overlaps = self._overlaps
        rotation, translation = register(overlaps, points)
        pose = np.searchsorted(self.posed, overlaps.group)
        to_world = rotations[pose] @ rotation
        centre = transform(translation[:, None], rotations[pose], translations[pose])[:, 0]
        owner = np.repeat(np.arange(len(overlaps.sizes)), overlaps.sizes)
        placed = np.einsum("nij,nj->ni", to_world[owner], points) + centre[owner]

        wanted = np.full(len(self.topology.edges), np.nan)
        wanted[rows.edge_ids] = lengths
        return stitch(self._seams, placed, wanted), reports


def _concatenate(arrays: list[Index]) -> Index:
    return np.concatenate(arrays) if arrays else np.zeros(0, dtype=np.int64)


def _slices(sizes: list[int]) -> list[slice]:
    ends = np.cumsum(sizes)
    return [slice(int(end) - size, int(end)) for end, size in zip(ends, sizes, strict=True)]
