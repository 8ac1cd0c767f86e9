"""The projection P_m of the free placement, which finds a mesh from lengths, angles and rigid parts alone.

1. *Frames.* Every rigid part, and every joint face, is a node with a rotation. The relative rotations across hinges
   follow from lengths and angles. Rotations are chained from a seed of every component, and averaged
   (`mixseq.shells.face_frames`).
2. *Vertices* follow from the sides of all faces by one back-substitution.
3. *Relaxation*: a fixed number of steps reduces the errors of lengths and angles (`mixseq.shells.shell`).

Components are then moved to the poses of their seeds. At frames of the sequence the first two steps are exact. All
matrices are constant.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mixseq.mesh.measures import clamp_lengths, dihedral_angles, edge_lengths
from mixseq.mesh.rigid import kabsch
from mixseq.mesh.rotations import matrix_to_quat, quat_conjugate, quat_multiply, quat_to_matrix
from mixseq.mesh.topology import Topology, connected_components
from mixseq.runtime.lazy import PickledWithoutCaches, cached_property
from mixseq.shells.face_frames import FrameGraph, bridging_mask, flat_triangles, rotate_sides, triangle_frames
from mixseq.shells.shell import ZERO_AREA_HEIGHT_RATIO, Relaxed, Shell
from mixseq.types import Float, Index, Mask

ASSEMBLY_AVERAGING_ROUNDS = 3  # rounds of rotation averaging over parts and faces
NOISE_HEIGHT_RATIO = 1e-4  # ratio of height to side of triangles below which heights are rounding errors of lengths


class FreeFrame(NamedTuple):
    """Blocks of one frame of S_m that determine its mesh."""

    lengths: Float  # (E',) edge lengths of joint faces, in diagonals
    angles: Float  # (H',) hinge angles of joint faces, in radians
    rest_vertices: Float  # (V, 3) vertices in rest space, which determine the shapes of rigid parts
    skinned_vertices: Float  # (V, 3) skinned vertices, which determine the poses of components


@dataclass(frozen=True, eq=False)
class Assembly(PickledWithoutCaches):
    """The projection of the free placement of one mesh."""

    topology: Topology  # the mesh
    part_of_vertex: Index  # (V,) part of vertices skinned to a single part, else -1
    joint_faces: Mask  # (F,) faces with lengths and angles, including all faces not skinned to a single part
    edge_ids: Index  # (E',) edges of joint faces
    hinge_ids: Index  # (H',) hinges of joint faces
    reference: Float  # (V, 3) a frame of the sequence
    steps: int  # number of relaxation steps

    @cached_property
    def _rigid_parts(self) -> list[Index]:
        """Vertices of the faces outside joints, part by part."""
        rigid_faces = self.topology.faces[~self.joint_faces]
        vertex_ids = np.unique(rigid_faces)
        labels = self.part_of_vertex[vertex_ids]
        return [vertex_ids[labels == part] for part in np.unique(labels)]

    @cached_property
    def _node_of_face(self) -> Index:
        """Node ``(F,)`` of every face: its rigid part, or a separate node for every joint face, after all parts."""
        part_of_vertex = np.full(self.topology.vertex_count, -1, dtype=np.int64)
        for part, vertex_ids in enumerate(self._rigid_parts):
            part_of_vertex[vertex_ids] = part
        node = part_of_vertex[self.topology.faces[:, 0]]
        node[self.joint_faces] = np.arange(len(self._rigid_parts), self._node_count)
        return node

    @cached_property
    def _node_count(self) -> int:
        """Number of nodes."""
        return len(self._rigid_parts) + int(np.count_nonzero(self.joint_faces))

    @cached_property
    def _bridging_hinge_ids(self) -> Index:
        """Hinges between different nodes: sound hinges, and unsound hinges where no sound hinges connect nodes."""
        pairs, sound = self._node_of_face[self.topology.hinge_faces], self.shell.sound_hinge_mask
        return np.flatnonzero(bridging_mask(self._node_count, pairs, sound) & (pairs[:, 0] != pairs[:, 1]))

    @cached_property
    def _seed_nodes(self) -> Index:
        """First node ``(r,)`` of every hinge-connected component: a rigid part, if it has one."""
        component = connected_components(self._node_count, self._node_of_face[self.topology.hinge_faces])
        return np.unique(component, return_index=True)[1]

    @cached_property
    def _seed_vertices(self) -> list[Index]:
        """Vertices of every seed."""
        joint_faces = self.topology.faces[self.joint_faces]
        parts, count = self._rigid_parts, len(self._rigid_parts)
        return [parts[node] if node < count else joint_faces[node - count] for node in self._seed_nodes]

    @cached_property
    def frame_graph(self) -> FrameGraph:
        """Graph of the rotations of nodes."""
        weights = self.shell.relative_angle_weights[self._bridging_hinge_ids]
        pairs = self._node_of_face[self.topology.hinge_faces[self._bridging_hinge_ids]]
        known = np.isin(np.arange(self._node_count), self._seed_nodes)
        return FrameGraph(pairs, np.maximum(weights, ZERO_AREA_HEIGHT_RATIO), known)

    @cached_property
    def shell(self) -> Shell:
        """The mesh as a shell, for relaxation."""
        t, ties = self.topology, self._ties[:, 1:]
        position_weights = np.zeros(t.vertex_count)
        position_weights[np.unique(self._component_of_vertex, return_index=True)[1]] = 1.0
        typical = edge_lengths(self.reference, t.edges)
        return Shell(t, self.reference, typical, position_weights, ties)

    @cached_property
    def _ties(self) -> Index:
        """Ties ``(t, 3)``, each of a part and two of its vertices in different components of the mesh."""
        component = self.topology.component_of_vertex
        ties = []
        for number, part in enumerate(self._rigid_parts):
            first = part[np.unique(component[part], return_index=True)[1]]
            ties += [(number, first[0], other) for other in first[1:]]
        return np.array(ties, dtype=np.int64).reshape(-1, 3)

    @cached_property
    def _component_of_vertex(self) -> Index:
        """Component ``(V,)`` of every vertex by edges and ties."""
        pairs = np.concatenate([self.topology.edges, self._ties[:, 1:]])
        return connected_components(self.topology.vertex_count, pairs)

    @cached_property
    def _components(self) -> list[tuple[Index, list[int]]]:
        """Vertices and indices of seeds of all independently moving components."""
        component = self._component_of_vertex
        component_of_seed = np.array([component[vertices[0]] for vertices in self._seed_vertices])
        return [
            (np.flatnonzero(component == k), np.flatnonzero(component_of_seed == k).tolist())
            for k in np.unique(component_of_seed)
        ]

    def targets(self, frame: FreeFrame) -> tuple[Float, Float]:
        """Return target lengths ``(E,)`` and angles ``(H,)`` of all edges and hinges."""
        lengths = edge_lengths(frame.rest_vertices, self.topology.edges)
        angles = dihedral_angles(frame.rest_vertices, self.topology.hinges)
        lengths[self.edge_ids] = clamp_lengths(frame.lengths, self.shell.length_weights[self.edge_ids])
        angles[self.hinge_ids] = frame.angles
        return lengths, angles

    def assemble(self, frame: FreeFrame) -> Relaxed:
        """Return the mesh of a frame, and its final energy."""
        lengths, angles = self.targets(frame)
        start = self.integrate(frame, lengths, angles)
        relaxed = self.shell.relax(start, lengths, angles, self.steps)
        return relaxed._replace(points=self.place_components(frame.skinned_vertices, relaxed.points))

    def integrate(self, frame: FreeFrame, lengths: Float, angles: Float) -> Float:
        """Return vertices ``(V, 3)`` from rotations of nodes, each component in any pose."""
        t, joint, hinge_ids = self.topology, self.joint_faces, self._bridging_hinge_ids
        degenerate, rigid_faces = self.shell.degenerate_face_ids, t.faces[~joint]
        flat = flat_triangles(lengths[t.face_edges])
        heights = flat[degenerate, 2, 1]
        is_noise = heights < NOISE_HEIGHT_RATIO * lengths[t.face_edges[degenerate]].max(axis=1)
        flat[degenerate, 2, 1] = np.where(is_noise, 0.0, heights)
        rest_frames = np.zeros((len(t.faces), 4))
        rest_frames[:, 0] = 1.0
        rest_frames[~joint] = triangle_frames(frame.rest_vertices, rigid_faces)
        first, second = rest_frames[t.hinge_faces[hinge_ids]].transpose(1, 0, 2)
        across = self.shell.hinge_frames.rotations(flat, angles)[hinge_ids]
        rotations = quat_multiply(quat_multiply(first, across), quat_conjugate(second))
        frames = self.frame_graph.chain(rotations, self._seed_frames(frame))
        frames = self.frame_graph.average(frames, rotations, ASSEMBLY_AVERAGING_ROUNDS)
        sides = np.empty((len(t.faces), 3, 3))
        matrices = quat_to_matrix(frames)
        sides[joint] = rotate_sides(matrices[self._node_of_face[joint]], flat[joint])
        corners = frame.rest_vertices[rigid_faces]
        rest_sides = np.roll(corners, -1, axis=1) - corners
        sides[~joint] = rest_sides @ np.swapaxes(matrices, 1, 2)[self._node_of_face[~joint]]
        part, i, j = self._ties.T
        ties = np.einsum("tij,tj->ti", matrices[part], frame.rest_vertices[j] - frame.rest_vertices[i])
        return self.shell.integrate(sides, np.zeros((t.vertex_count, 3)), ties)

    def _seed_frames(self, frame: FreeFrame) -> Float:
        """Rotations ``(r, 4)`` of the seeds in the skinned mesh."""
        rotations = []
        for node, vertex_ids in zip(self._seed_nodes, self._seed_vertices, strict=True):
            skinned = frame.skinned_vertices[vertex_ids]
            if node < len(self._rigid_parts):
                rotations.append(matrix_to_quat(kabsch(frame.rest_vertices[vertex_ids], skinned)[0]))
            else:
                rotations.append(triangle_frames(skinned, np.arange(3)[None])[0])
        return np.array(rotations).reshape(-1, 4)

    def place_components(self, skinned: Float, points: Float) -> Float:
        """Move components of points ``(V, 3)`` to the poses of their seeds; unused vertices stay skinned."""
        result = skinned.copy()
        for vertex_ids, seeds in self._components:
            seed_vertices = [self._seed_vertices[seed] for seed in seeds]
            rotation, _ = kabsch(points[seed_vertices[0]], skinned[seed_vertices[0]])
            result[vertex_ids] = points[vertex_ids] @ rotation.T
            shifts = [(skinned[ids] - result[ids]).mean(axis=0) for ids in seed_vertices]
            result[vertex_ids] += np.mean(shifts, axis=0)
        return result
