r"""Free placement, the paper's: joints on their own, registration, stitching, one pose per component.

1. Every joint is rebuilt from its lengths and angles, anywhere, by the linear start (`mixseq.reconstruction.unfold`).
2. Parts and joints are registered through the vertices they share, and moved to where the pose says.
3. Stitching makes one mesh of them (paper, equation 1).
4. Settling (ours) lets parts, as rigid bodies, and joints give way to each other until lengths and angles fit best.
   The paper optimises every joint by itself before step 2; together they cost less, and no misfit is left in seams.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mixseq.geometry.lengths_angles import dihedral_angles, edge_lengths
from mixseq.geometry.rigid import kabsch, transform
from mixseq.reconstruction.joint import length_weights, sound_lengths
from mixseq.reconstruction.patch import Patch
from mixseq.reconstruction.placement import JointRows, MixedFrame
from mixseq.reconstruction.registration import Overlaps, register
from mixseq.reconstruction.settling import Settling, SettlingProblem, settle
from mixseq.reconstruction.shells import ShellReport, ShellSettings
from mixseq.reconstruction.stitching import Seams, stitch
from mixseq.reconstruction.unfold import unfold
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

    @cached_property
    def _settling(self) -> Settling:
        # What several parts share moves, too: its lengths and angles are known from any of them.
        parts, t = self.decomposition.parts, self.topology
        shared = np.bincount(np.concatenate(parts), minlength=t.vertex_count) > 1
        edges = np.flatnonzero(
            shared[t.edges].any(axis=1) & (self._rows_in_one_part(t.edges) >= 0).all(axis=1)
        )
        hinges = np.flatnonzero(
            shared[t.hinges].any(axis=1) & (self._rows_in_one_part(t.hinges) >= 0).all(axis=1)
        )
        return Settling(
            t, parts, self.posed, np.union1d(edges, self.edge_ids), np.union1d(hinges, self.hinge_ids)
        )

    @cached_property
    def _settled_rows(self) -> tuple[Index, Index, Index, Index]:
        """Rows of part vertices that edges and hinges of `_settling` connect, and which of them are stored ones."""
        edges, hinges = self._settling.edge_ids, self._settling.hinge_ids
        return (
            self._rows_in_one_part(self.topology.edges[edges]),
            self._rows_in_one_part(self.topology.hinges[hinges]),
            np.searchsorted(edges, self.edge_ids),
            np.searchsorted(hinges, self.hinge_ids),
        )

    def prepare(self) -> None:
        """Implement `Placement.prepare`."""
        for patch in self._rows.patches:
            patch.frame_pattern.analysis, patch.laplacian_factor  # noqa: B018 - cached properties
        self._settling.prepare()
        self._known_edges, self._known_hinges, self._overlaps, self._seams.factor, self._settled_rows  # noqa: B018

    def assemble(self, frame: MixedFrame, settings: ShellSettings) -> tuple[Float, list[ShellReport]]:
        """Implement `Placement.assemble`: joints, registration, stitching, settling."""
        joints, lengths = self.unfolded_joints(frame)
        pieces = np.concatenate([frame.parts, *joints])
        stitched = stitch(self._seams, self.placed(frame, pieces), lengths)
        points, report = self.settled(frame, stitched, settings)
        return points, [report]

    def unfolded_joints(self, frame: MixedFrame) -> tuple[list[Float], Float]:
        """Rebuild every joint ``(n, 3)`` on its own, anywhere; also return the lengths ``(E,)`` of its edges."""
        pieces = []
        wanted = np.full(len(self.topology.edges), np.nan)
        rows = self._rows
        for number, (joint, patch) in enumerate(zip(rows.joints, rows.patches, strict=True)):
            # What lies in one part is known from that part; only the rest is stored.
            lengths = edge_lengths(frame.parts, self._known_edges[number])
            angles = dihedral_angles(frame.parts, self._known_hinges[number])
            own = rows.edge_slices[number]
            lengths[rows.stored_edges[number]] = sound_lengths(frame.lengths[own], frame.weights[own])
            angles[rows.stored_hinges[number]] = frame.angles[rows.hinge_slices[number]]
            pieces.append(unfold(patch, lengths, angles, np.zeros((len(patch.fixed), 3))))
            wanted[joint.edge_ids] = lengths
        return pieces, wanted

    def placed(self, frame: MixedFrame, pieces: Float) -> Float:
        """Register all pieces ``(N, 3)``, parts and then joints, and move them to where the poses say."""
        overlaps = self._overlaps
        rotation, translation = register(overlaps, pieces)
        pose = np.searchsorted(self.posed, overlaps.group)
        to_world = frame.rotations[pose] @ rotation
        centre = transform(translation[:, None], frame.rotations[pose], frame.translations[pose])[:, 0]
        owner = np.repeat(np.arange(len(overlaps.sizes)), overlaps.sizes)
        return np.asarray(np.einsum("nij,nj->ni", to_world[owner], pieces) + centre[owner])

    def settled(
        self, frame: MixedFrame, stitched: Float, settings: ShellSettings
    ) -> tuple[Float, ShellReport]:
        """Make the parts of a mesh ``(V, 3)`` rigid again, and let parts and joints settle."""
        edges, hinges, stored_edges, stored_hinges = self._settled_rows
        lengths, angles = edge_lengths(frame.parts, edges), dihedral_angles(frame.parts, hinges)
        lengths[stored_edges] = sound_lengths(frame.lengths, frame.weights)
        angles[stored_hinges] = frame.angles
        weights = length_weights(lengths)
        weights[stored_edges] = frame.weights
        problem = SettlingProblem(self._settling, lengths, angles, weights, settings.bending)
        start = stitched.copy()
        ends = np.cumsum([len(part) for part in self.decomposition.parts])[:-1]
        for number, shape in enumerate(np.split(frame.parts, ends)):
            part = self.decomposition.parts[number]
            if number in self.posed:
                pose = int(np.searchsorted(self.posed, number))
                rotation, translation = frame.rotations[pose], frame.translations[pose]
            else:
                rotation, translation = kabsch(shape, stitched[part])
            held = self._settling.holder[part] == number
            start[part[held]] = transform(shape[held], rotation, translation)
        return settle(problem, start, settings)
