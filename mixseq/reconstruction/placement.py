"""The last step of P_m: put decoded parts and joints together, anchored or free."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mixseq.geometry.lengths_angles import dihedral_angles, edge_lengths
from mixseq.geometry.rigid import kabsch, transform
from mixseq.reconstruction.blend import Blend
from mixseq.reconstruction.joint import rebuild
from mixseq.reconstruction.patch import Patch
from mixseq.reconstruction.registration import Overlaps, register
from mixseq.reconstruction.shells import ShellReport, ShellSettings
from mixseq.reconstruction.stitching import Seams, stitch
from mixseq.segmentation.joints import Decomposition, Joint
from mixseq.topology import Topology

Float = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]


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
    """The joints that are solved, which of their edges and hinges are stored, and where in the vector."""

    joints: tuple[Joint, ...]
    patches: tuple[Patch, ...]
    stored_edges: tuple[Mask, ...]
    stored_hinges: tuple[Mask, ...]

    @cached_property
    def edge_ids(self) -> Index:
        ids = [joint.edge_ids[stored] for joint, stored in zip(self.joints, self.stored_edges, strict=True)]
        return _concatenate(ids)

    @cached_property
    def hinge_ids(self) -> Index:
        ids = [joint.hinge_ids[stored] for joint, stored in zip(self.joints, self.stored_hinges, strict=True)]
        return _concatenate(ids)

    @cached_property
    def edge_slices(self) -> list[slice]:
        return _slices([int(np.count_nonzero(stored)) for stored in self.stored_edges])

    @cached_property
    def hinge_slices(self) -> list[slice]:
        return _slices([int(np.count_nonzero(stored)) for stored in self.stored_hinges])


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
    def _rows(self) -> _Rows:
        joints = tuple(joint for joint in self.decomposition.joints if joint.free.any())
        patches = tuple(Patch.of_joint(self.topology, joint, ~joint.free) for joint in joints)
        return _Rows(
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
        vertex = _concatenate(list(self.decomposition.parts))
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
        turns, centres = self._reference_poses
        moves = rotations @ np.swapaxes(turns, 1, 2)  # from the reference frame to this one
        shifts = translations - np.einsum("pij,pj->pi", moves, centres)
        reports = []
        rows = self._rows
        for joint, patch, edges, hinges, blend in zip(
            rows.joints, rows.patches, rows.edge_slices, rows.hinge_slices, self._blends, strict=True
        ):
            solved, report = rebuild(
                patch,
                lengths[edges],
                angles[hinges],
                weights[edges],
                points[joint.vertices],
                settings,
                guess=blend.place(moves, shifts),
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
        nothing_fixed = (np.zeros(len(joint.vertices), dtype=bool) for joint in joints)
        patches = tuple(
            Patch.of_joint(self.topology, j, f) for j, f in zip(joints, nothing_fixed, strict=True)
        )
        edges = tuple(np.any(rows < 0, axis=1) for rows in self._known_edges)
        hinges = tuple(np.any(rows < 0, axis=1) for rows in self._known_hinges)
        return _Rows(joints, patches, edges, hinges)

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
        wanted = np.full(len(self.topology.edges), np.nan)
        rows = self._rows
        for number, (joint, patch) in enumerate(zip(rows.joints, rows.patches, strict=True)):
            # What lies in one part is known from that part; only the rest is stored.
            joint_lengths = edge_lengths(parts, self._known_edges[number])
            joint_lengths[rows.stored_edges[number]] = lengths[rows.edge_slices[number]]
            joint_angles = dihedral_angles(parts, self._known_hinges[number])
            joint_angles[rows.stored_hinges[number]] = angles[rows.hinge_slices[number]]
            joint_weights = 1.0 / np.maximum(joint_lengths, np.finfo(np.float64).tiny)
            joint_weights[rows.stored_edges[number]] = weights[rows.edge_slices[number]]
            nowhere = np.zeros((len(patch.fixed), 3))
            solved, report = rebuild(patch, joint_lengths, joint_angles, joint_weights, nowhere, settings)
            pieces.append(solved)
            reports.append(report)
            wanted[joint.edge_ids] = joint_lengths
        points = np.concatenate(pieces)

        overlaps = self._overlaps
        rotation, translation = register(overlaps, points)
        pose = np.searchsorted(self.posed, overlaps.group)
        to_world = rotations[pose] @ rotation
        centre = transform(translation[:, None], rotations[pose], translations[pose])[:, 0]
        owner = np.repeat(np.arange(len(overlaps.sizes)), overlaps.sizes)
        placed = np.einsum("nij,nj->ni", to_world[owner], points) + centre[owner]

        return stitch(self._seams, placed, wanted), reports


def _concatenate(arrays: list[Index]) -> Index:
    return np.concatenate(arrays) if arrays else np.zeros(0, dtype=np.int64)


def _slices(sizes: list[int]) -> list[slice]:
    ends = np.cumsum(sizes)
    return [slice(int(end) - size, int(end)) for end, size in zip(ends, sizes, strict=True)]
