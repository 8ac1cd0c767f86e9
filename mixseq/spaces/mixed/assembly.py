"""The projection P_m of the free placement: a mesh from lengths, angles and rigid parts alone.

1. *Frames.* Every rigid part, and every other face, is a rotation. Across hinges they differ by rotations from
   lengths and angles. They are chained from one part of every component, and averaged (`mixseq.shells.face_frames`).
2. *Vertices*, from the sides of all faces, by one back-substitution.
3. *Relaxation*: a fixed number of steps reduces the errors of lengths and angles (`mixseq.shells.shell`).

Components are then moved to the pose of that part. At frames of the sequence the first two are exact. All matrices
are constant. The paper solves every joint by itself, registers joints and parts, and stitches them (Section 3.4);
`scripts/paper` has that.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from mixseq.mesh.measures import clamp_lengths, edge_lengths
from mixseq.mesh.rigid import kabsch
from mixseq.mesh.rotations import matrix_to_quat, quat_conjugate, quat_multiply, quat_to_matrix
from mixseq.mesh.topology import Topology, connected_components
from mixseq.runtime.lazy import PickledWithoutCaches
from mixseq.shells.face_frames import (
    FrameGraph,
    HingeFrames,
    bridging_mask,
    flat_triangles,
    rotate_sides,
    triangle_frames,
)
from mixseq.shells.kernels import lengths_and_angles
from mixseq.shells.shell import ZERO_AREA_HEIGHT_RATIO, Relaxation, Relaxed, Shell
from mixseq.types import Float, Index, Mask

AVERAGING_ROUNDS = 3
"""Rounds of rotation averaging over parts and faces."""

NOISE_HEIGHT_RATIO = 1e-4
"""Height over side of triangles below which heights are rounding errors of lengths."""


class FreeFrame(NamedTuple):
    """One point of S_m."""

    lengths: Float  # (E',) edge lengths of joint faces, in diagonals
    angles: Float  # (H',) hinge angles of joint faces, in radians
    rest_vertices: Float  # (V, 3) rest-space vertices: those of a rigid part have its shape
    skinned_vertices: Float  # (V, 3) posed vertices, which place components


@dataclass(frozen=True, eq=False)
class Assembly(PickledWithoutCaches):
    """The projection of the free placement of one mesh."""

    topology: Topology  # the mesh
    part_of_vertex: Index  # (V,) part of vertices skinned to one part alone, -1 for others
    # (F,) faces whose lengths and angles are known; all of those whose corners do not follow one part alone.
    joint_faces: Mask
    edge_ids: Index  # (E',) edges of joint faces
    hinge_ids: Index  # (H',) hinges of joint faces
    reference: Float  # (V, 3) a frame of the sequence
    relaxation: Relaxation  # settings of relaxation

    @cached_property
    def _rigid_parts(self) -> list[Index]:
        """Vertices of the rigid parts: of faces outside joints, part by part."""
        rigid = self.topology.faces[~self.joint_faces]
        kept = np.unique(rigid)
        labels = self.part_of_vertex[kept]
        return [kept[labels == part] for part in np.unique(labels)]

    @cached_property
    def _node_of_face(self) -> Index:
        """Node ``(F,)`` of every face: its rigid part, or a node of its own after all parts."""
        node = np.empty(len(self.topology.faces), dtype=np.int64)
        number = np.full(self.topology.vertex_count, -1, dtype=np.int64)
        for part, vertices in enumerate(self._rigid_parts):
            number[vertices] = part
        node[~self.joint_faces] = number[self.topology.faces[~self.joint_faces, 0]]
        node[self.joint_faces] = len(self._rigid_parts) + np.arange(int(np.count_nonzero(self.joint_faces)))
        return node

    @cached_property
    def _node_count(self) -> int:
        """Number of nodes."""
        return len(self._rigid_parts) + int(np.count_nonzero(self.joint_faces))

    @cached_property
    def _bridging_hinge_ids(self) -> Index:
        """Hinges between different nodes."""
        pairs, sound = self._node_of_face[self.topology.hinge_faces], self.shell.sound_hinge_mask
        return np.flatnonzero(bridging_mask(self._node_count, pairs, sound) & (pairs[:, 0] != pairs[:, 1]))

    @cached_property
    def _seed_nodes(self) -> Index:
        """First node ``(r,)`` of every component connected across hinges: a part, if it has one."""
        component = connected_components(self._node_count, self._node_of_face[self.topology.hinge_faces])
        return np.unique(component, return_index=True)[1]

    @cached_property
    def _seed_vertices(self) -> list[Index]:
        """The vertices of every seed."""
        parts = len(self._rigid_parts)
        loose = self.topology.faces[self.joint_faces]
        return [self._rigid_parts[node] if node < parts else loose[node - parts] for node in self._seed_nodes]

    @cached_property
    def frame_graph(self) -> FrameGraph:
        """The graph of nodes: rigid parts, and faces of joints."""
        weights = np.maximum(
            self.shell.relative_angle_weights[self._bridging_hinge_ids], ZERO_AREA_HEIGHT_RATIO
        )
        pairs = self._node_of_face[self.topology.hinge_faces[self._bridging_hinge_ids]]
        known = np.zeros(self._node_count, dtype=bool)
        known[self._seed_nodes] = True
        return FrameGraph(pairs, weights, known)

    @cached_property
    def hinges(self) -> HingeFrames:
        """The hinges of the mesh."""
        return HingeFrames(self.topology.faces, self.topology.hinges, self.topology.hinge_faces)

    @cached_property
    def shell(self) -> Shell:
        """The mesh as a shell, for relaxation."""
        t, ties = self.topology, self._ties[:, 1:]
        position_weights = np.zeros(t.vertex_count)
        position_weights[np.unique(self._component_of_vertex, return_index=True)[1]] = 1.0
        typical = edge_lengths(self.reference, t.edges)
        return Shell(t, self.reference, typical, position_weights, self.relaxation.bending, ties)

    @cached_property
    def _ties(self) -> Index:
        """Ties ``(t, 3)``: a part, and two vertices of it that no edges connect."""
        component = self.topology.component_of_vertex
        ties = []
        for number, part in enumerate(self._rigid_parts):
            first = part[np.unique(component[part], return_index=True)[1]]
            ties += [(number, first[0], other) for other in first[1:]]
        return np.array(ties, dtype=np.int64).reshape(-1, 3)

    @cached_property
    def _component_of_vertex(self) -> Index:
        """Component ``(V,)`` of every vertex, connected by edges and ties."""
        return connected_components(
            self.topology.vertex_count, np.concatenate([self.topology.edges, self._ties[:, 1:]])
        )

    @cached_property
    def _components(self) -> list[tuple[Index, list[int]]]:
        """Independently moving components: their vertices, and the numbers of their seeds."""
        component = self._component_of_vertex
        of_seed = [component[vertices[0]] for vertices in self._seed_vertices]
        return [
            (np.flatnonzero(component == body), [k for k, own in enumerate(of_seed) if own == body])
            for body in np.unique(of_seed)
        ]

    def cached_values(self) -> tuple[object, ...]:
        """Implement `PickledWithoutCaches.cached_values`."""
        return self.frame_graph, self.shell, self._components

    def targets(self, frame: FreeFrame) -> tuple[Float, Float]:
        """Return the target lengths ``(E,)`` and angles ``(H,)`` of all edges and hinges."""
        lengths, angles = lengths_and_angles(frame.rest_vertices, self.topology.edges, self.topology.hinges)
        lengths[self.edge_ids] = clamp_lengths(frame.lengths, self.shell.length_weights[self.edge_ids])
        angles[self.hinge_ids] = frame.angles
        return lengths, angles

    def assemble(self, frame: FreeFrame) -> Relaxed:
        """Return the mesh of a point of S_m, and its remaining energy."""
        lengths, angles = self.targets(frame)
        start = self.integrate(frame, lengths, angles)
        relaxed = self.shell.relax(start, lengths, angles, self.relaxation.steps)
        return relaxed._replace(points=self.place_components(frame.skinned_vertices, relaxed.points))

    def integrate(self, frame: FreeFrame, lengths: Float, angles: Float) -> Float:
        """Return vertices ``(V, 3)`` from frames of faces, each component in any pose."""
        t, loose, crossing, parts = (
            self.topology,
            self.joint_faces,
            self._bridging_hinge_ids,
            len(self._rigid_parts),
        )
        flat = flat_triangles(lengths[t.face_edges])
        heights = flat[self.shell.degenerate_face_ids, 2, 1]
        noise = heights < NOISE_HEIGHT_RATIO * lengths[t.face_edges[self.shell.degenerate_face_ids]].max(
            axis=1
        )
        flat[self.shell.degenerate_face_ids, 2, 1] = np.where(noise, 0.0, heights)
        own = np.zeros((len(t.faces), 4))
        own[:, 0] = 1.0
        own[~loose] = triangle_frames(frame.rest_vertices, t.faces[~loose])
        first, second = own[t.hinge_faces[crossing]].transpose(1, 0, 2)
        across = self.hinges.rotations(flat, angles)[crossing]
        turns = quat_multiply(quat_multiply(first, across), quat_conjugate(second))
        frames = self.frame_graph.chain(turns, self._seed_frames(frame))
        frames = self.frame_graph.average(frames, turns, AVERAGING_ROUNDS)
        sides = np.empty((len(t.faces), 3, 3))
        sides[loose] = rotate_sides(frames[self._node_of_face[loose]], flat[loose])
        matrices = quat_to_matrix(frames[:parts])
        corners = frame.rest_vertices[t.faces[~loose]]
        inside = np.roll(corners, -1, axis=1) - corners
        sides[~loose] = inside @ np.swapaxes(matrices, 1, 2)[self._node_of_face[~loose]]
        part, one, other = self._ties.T
        tied = np.einsum("tij,tj->ti", matrices[part], frame.rest_vertices[other] - frame.rest_vertices[one])
        return self.shell.integrate(sides, np.zeros((t.vertex_count, 3)), tied)

    def _seed_frames(self, frame: FreeFrame) -> Float:
        """Rotations ``(r, 4)`` of the seeds in the posed mesh."""
        found = []
        for node, vertices in zip(self._seed_nodes, self._seed_vertices, strict=True):
            if node < len(self._rigid_parts):
                found.append(
                    matrix_to_quat(kabsch(frame.rest_vertices[vertices], frame.skinned_vertices[vertices])[0])
                )
            else:
                found.append(triangle_frames(frame.skinned_vertices[vertices], np.arange(3)[None])[0])
        return np.array(found).reshape(-1, 4)

    def place_components(self, posed: Float, points: Float) -> Float:
        """Move components of points ``(V, 3)`` to the poses of their seeds, and vertices without faces to their own."""
        result = posed.copy()
        for vertices, seeds in self._components:
            first = self._seed_vertices[seeds[0]]
            turn, _ = kabsch(points[first], posed[first])
            result[vertices] = points[vertices] @ turn.T
            held = [self._seed_vertices[seed] for seed in seeds]
            shifts = [(posed[each] - result[each]).mean(axis=0) for each in held]
            result[vertices] += np.mean(shifts, axis=0)
        return result
