r"""The projection P_m of the free placement: where parts and joints go, from lengths, angles and aligned parts alone.

1. *Frames.* Every part, and every face of a joint that no part holds, is a rotation. Across hinges they differ by what
   lengths and angles tell. They are chained from parts whose poses are known, and averaged
   (`mixseq.shells.face_frames`).
2. *Vertices*, from the sides of all faces, by one back-substitution.
3. *Relaxation*: a fixed number of steps makes lengths and angles agree, those of parts and those of joints
   (`mixseq.shells.shell`).

At frames of the sequence the first two are exact. All matrices are constant. The paper solves every joint by itself,
registers joints and parts, and stitches them (Section 3.4); `scripts/paper` has that.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from mixseq.arrays import Float, Index, IntArray, Mask
from mixseq.geometry.lengths_angles import edge_lengths, sound_lengths
from mixseq.geometry.rigid import kabsch
from mixseq.geometry.rotations import inverse, normalised, product, rotations_of
from mixseq.pickling import PickledWithoutCaches
from mixseq.segmentation.joints import Decomposition
from mixseq.shells.face_frame_kernels import turned_sides
from mixseq.shells.face_frames import FrameGraph, Hinges, bridging, connected, flat_triangles, frames_of
from mixseq.shells.shell import THIN, Relaxation, Relaxed, Shell
from mixseq.shells.shell_kernels import lengths_and_angles
from mixseq.topology import Topology

ROUNDS = 3
"""So often what does not fit between frames is divided among them."""


class FreeFrame(NamedTuple):
    """One point of S_m, for r posed parts.

    Attributes
    ----------
    lengths, angles : (E',), (H',) float64
        Edge lengths and hinge angles of joints.
    parts : (N, 3) float64
        Aligned vertices of all parts.
    rotations, centres : (r, 4), (r, 3) float64
        Poses; quaternions of any length.
    """

    lengths: Float
    angles: Float
    parts: Float
    rotations: Float
    centres: Float


class _Layout(NamedTuple):
    """What is known from parts: rows of part vertices, -1 where no part holds all of an edge, a hinge or a face."""

    edges: Index
    hinges: Index
    faces: Index


@dataclass(frozen=True, eq=False)
class Assembly(PickledWithoutCaches):
    """Puts parts and joints of one mesh together.

    Attributes
    ----------
    topology : Topology
        The mesh.
    decomposition : Decomposition
        Its parts and joints.
    shapes : (N, 3) float64
        Mean shapes of the parts.
    reference : (V, 3) float64
        A frame of the sequence.
    typical : (E',) float64
        Typical lengths of the stored edges.
    relaxation : Relaxation
        How lengths and angles are made to agree.
    """

    topology: Topology
    decomposition: Decomposition
    shapes: Float
    reference: Float
    typical: Float
    relaxation: Relaxation

    @cached_property
    def _layout(self) -> _Layout:
        t = self.topology
        return _Layout(*(self._rows_in_one_part(table) for table in (t.edges, t.hinges, t.faces)))

    @cached_property
    def _inside(self) -> tuple[Index, Index]:
        """Rows ``(E, 2)`` and ``(H, 4)`` of part vertices that edges and hinges connect, any where none has them."""
        return np.maximum(self._layout.edges, 0), np.maximum(self._layout.hinges, 0)

    def _rows_in_one_part(self, vertices: IntArray) -> Index:
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
    def edge_ids(self) -> Index:
        """Edges ``(E',)`` that no part has both ends of, joint by joint."""
        unknown = self._layout.edges[:, 0] < 0
        return _stored(unknown, [joint.edge_ids for joint in self.decomposition.joints])

    @cached_property
    def hinge_ids(self) -> Index:
        """Hinges ``(H',)`` that no part has all vertices of, joint by joint."""
        unknown = self._layout.hinges[:, 0] < 0
        return _stored(unknown, [joint.hinge_ids for joint in self.decomposition.joints])

    @cached_property
    def _starts(self) -> Index:
        """First row of every part."""
        sizes = [len(part) for part in self.decomposition.parts]
        return np.cumsum([0, *sizes[:-1]]).astype(np.int64)

    @cached_property
    def _node(self) -> Index:
        """What every face ``(F,)`` turns with: its part, or a number of its own after all parts."""
        rows, parts = self._layout.faces[:, 0], len(self.decomposition.parts)
        loose = rows < 0
        node = np.searchsorted(self._starts, rows, side="right") - 1
        node[loose] = parts + np.arange(int(np.count_nonzero(loose)))
        return node

    @cached_property
    def rigid_faces(self) -> Mask:
        """Mark the faces ``(F,)`` with all corners in one part."""
        return np.asarray(self._layout.faces[:, 0] >= 0)

    @cached_property
    def _crossing(self) -> Index:
        """Hinges between two that turn by themselves."""
        pairs, sound = self._node[self.topology.hinge_faces], self.shell.sound
        return np.flatnonzero(bridging(self._count, pairs, sound) & (pairs[:, 0] != pairs[:, 1]))

    @cached_property
    def _count(self) -> int:
        """Number of all that turn by themselves."""
        return len(self.decomposition.parts) + int(np.count_nonzero(~self.rigid_faces))

    @cached_property
    def posed(self) -> Index:
        """The first part ``(r,)`` of everything that is connected across hinges: those with poses."""
        component = connected(self._count, self._node[self.topology.hinge_faces])
        return np.unique(component[: len(self.decomposition.parts)], return_index=True)[1]

    @cached_property
    def graph(self) -> FrameGraph:
        """What turns by itself: parts, and faces of joints that no part holds."""
        weights = np.maximum(self.shell.bend[self._crossing], THIN)
        pairs = self._node[self.topology.hinge_faces[self._crossing]]
        known = np.zeros(self._count, dtype=bool)
        known[self.posed] = True
        return FrameGraph(self._count, pairs, weights, known, 1.0)

    @cached_property
    def hinges(self) -> Hinges:
        """The hinges of the mesh."""
        return Hinges(self.topology.faces, self.topology.hinges, self.topology.hinge_faces)

    @cached_property
    def shell(self) -> Shell:
        """The mesh, whose lengths and angles are to agree."""
        t = self.topology
        typical = edge_lengths(self.shapes, self._inside[0])
        typical[self.edge_ids] = self.typical
        ties = self._ties
        component = connected(t.vertex_count, np.concatenate([t.edges, ties]))
        position_weights = np.zeros(t.vertex_count)
        position_weights[np.unique(component, return_index=True)[1]] = 1.0
        return Shell(t, self.reference, typical, ties, position_weights, self.relaxation.bending)

    @cached_property
    def _ties(self) -> Index:
        """Pairs of vertices ``(t, 2)`` that hold those of a part together where no edges do."""
        component = self.topology.component_of_vertex
        ties = []
        for part in self.decomposition.parts:
            first = part[np.unique(component[part], return_index=True)[1]]
            ties += [(first[0], other) for other in first[1:]]
        return np.array(ties, dtype=np.int64).reshape(-1, 2)

    @cached_property
    def _tied_rows(self) -> tuple[Index, Index]:
        """Rows of part vertices ``(t, 2)`` of the ties, and the part ``(t,)`` of each."""
        rows = self._rows_in_one_part(self._ties)
        return rows, np.searchsorted(self._starts, rows[:, 0], side="right") - 1

    @cached_property
    def _bodies(self) -> list[tuple[Index, list[int]]]:
        """What moves by itself: vertices, and the numbers of the poses that tell where they are."""
        t = self.topology
        component = connected(t.vertex_count, np.concatenate([t.edges, self._ties]))
        of_pose = [component[self.decomposition.parts[part][0]] for part in self.posed]
        return [
            (np.flatnonzero(component == body), [k for k, own in enumerate(of_pose) if own == body])
            for body in np.unique(of_pose)
        ]

    def constants(self) -> tuple[object, ...]:
        """Implement `PickledWithoutCaches.constants`."""
        return self.graph, self.shell, self._inside, self._bodies, self._tied_rows

    def targets(self, frame: FreeFrame) -> tuple[Float, Float]:
        """Return the lengths ``(E,)`` and angles ``(H,)`` that all edges and hinges should have."""
        lengths, angles = lengths_and_angles(frame.parts, *self._inside)
        lengths[self.edge_ids] = sound_lengths(frame.lengths, self.shell.stretch[self.edge_ids])
        angles[self.hinge_ids] = frame.angles
        return lengths, angles

    def assemble(self, frame: FreeFrame) -> Relaxed:
        """Return the mesh of a point of S_m, and what is left of its energy.

        Raises
        ------
        ReconstructionError
            If it is not finite.
        """
        lengths, angles = self.targets(frame)
        start = self.start(frame, lengths, angles)
        relaxed = self.shell.relaxed(start, lengths, angles, self.relaxation.steps)
        return relaxed._replace(points=self.placed(frame, relaxed.points))

    def start(self, frame: FreeFrame, lengths: Float, angles: Float) -> Float:
        """Return the vertices ``(V, 3)``, anywhere, that frames tell."""
        t, loose, crossing = self.topology, ~self.rigid_faces, self._crossing
        flat = flat_triangles(lengths[t.face_edges])
        own = np.zeros((len(t.faces), 4))
        own[:, 0] = 1.0
        corners = frame.parts[self._layout.faces[~loose]]
        own[~loose] = frames_of(frame.parts, self._layout.faces[~loose])
        first, second = own[t.hinge_faces[crossing]].transpose(1, 0, 2)
        across = self.hinges.turns(flat, angles)[crossing]
        turns = product(product(first, across), inverse(second))
        frames = self.graph.chained(turns, normalised(frame.rotations))
        frames = self.graph.averaged(frames, turns, ROUNDS)
        sides = np.empty((len(t.faces), 3, 3))
        sides[loose] = turned_sides(frames[self._node[loose]], flat[loose])
        matrices = rotations_of(frames[: len(self.decomposition.parts)])
        inside = np.roll(corners, -1, axis=1) - corners
        sides[~loose] = inside @ np.swapaxes(matrices, 1, 2)[self._node[~loose]]
        rows, part = self._tied_rows
        tied = np.einsum("tij,tj->ti", matrices[part], frame.parts[rows[:, 1]] - frame.parts[rows[:, 0]])
        return self.shell.integrated(sides, tied, np.zeros((t.vertex_count, 3)))

    def _posed(self, frame: FreeFrame, pose: int) -> Float:
        """Vertices ``(n, 3)`` of a part whose pose is known."""
        part = self.posed[pose]
        start, count = self._starts[part], len(self.decomposition.parts[part])
        shape = frame.parts[start : start + count]
        return np.asarray(shape @ rotations_of(frame.rotations[pose]).T + frame.centres[pose])

    def placed(self, frame: FreeFrame, points: Float) -> Float:
        """Move what is connected, in points ``(V, 3)``, to where its poses say."""
        result, parts = points.copy(), self.decomposition.parts
        for vertices, poses in self._bodies:
            turn, _ = kabsch(points[parts[self.posed[poses[0]]]], self._posed(frame, poses[0]))
            result[vertices] = points[vertices] @ turn.T
            shifts = [
                (self._posed(frame, each) - result[parts[self.posed[each]]]).mean(axis=0) for each in poses
            ]
            result[vertices] += np.mean(shifts, axis=0)
        return result


def _stored(unknown: Mask, of_joints: list[Index]) -> Index:
    """Those that are unknown: joint by joint, then others."""
    ids = np.concatenate([*of_joints, np.flatnonzero(unknown)])
    ids = ids[unknown[ids]]
    return np.asarray(ids[np.sort(np.unique(ids, return_index=True)[1])])
