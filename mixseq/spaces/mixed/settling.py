r"""What posed vertices still lack: sides of faces agree, then, between far poses, lengths and angles.

*Sides.* Where the frames of a face's corners are one and the same, its sides follow from the vertices. Elsewhere the
two sides :math:`s_f` of the face are known too, as seen from the mean of these frames, and keep the skin from shearing.
Between frames of the sequence they are predicted like vertices, and disagree with them a little. The vertices that
agree best minimise

.. math:: \sum_f \sum_{ab} w_{ab}\, |x_b - x_a - R_f s_{ab}|^2 + \eta \sum_v |x_v - \hat x_v|^2

with the cotangent weights of the reference frame and the posed vertices :math:`\hat x`. Vertices of other faces stay
where these are. The matrix depends on the space only and is factored once. At frames all terms are zero.

*Settling.* Between far poses such vertices are sheared, and edges shorter than they should be. There the frames of all
faces, and then vertices, are moved a little to what lengths and angles of the joints say, and those of the posed
vertices elsewhere (`mixseq.shells`): one average of rotations, one back-substitution, and a fixed number of steps. All
matrices are constant, and where lengths and angles agree nothing moves.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mixseq.arrays import Float, Index
from mixseq.geometry.lengths_angles import edge_lengths
from mixseq.pickling import PickledWithoutCaches
from mixseq.shells.face_frame_kernels import turned_sides
from mixseq.shells.face_frames import FrameGraph, Hinges, flat_triangles, frames_of
from mixseq.shells.shell import Relaxation, Relaxed, Shell
from mixseq.shells.shell_kernels import lengths_and_angles
from mixseq.shells.solvers import Factor, factorise
from mixseq.spaces.mixed import vertex_frame_kernels as kernels
from mixseq.topology import Topology

POSED_WEIGHT = 1.0
r"""Weight :math:`\eta` of posed vertices against sides. Ours. Between .01 and 1 frames between frames are nearly
the same; models of few modes are the better the more it is."""

ROUNDS = 2
"""So often what does not fit between frames is divided among them."""

EXPECTED_WEIGHT = 1e-3
"""How much frames and vertices stay where they are expected, against hinges and sides: enough to keep a mesh in its
place, too little to bend it. Ours."""

COTANGENTS = (0.05, 20.0)
"""Bounds of cotangents: weights stay positive, and of the same size, whatever the triangles are."""


@dataclass(frozen=True, eq=False)
class Sides(PickledWithoutCaches):
    """The faces whose sides are known, and the vertices they decide.

    Attributes
    ----------
    faces : (f, 3) int64
        The faces.
    vertices : (n,) int64
        Vertices of no other faces, ascending.
    reference : (V, 3) float64
        The reference frame, which the weights are of.
    """

    faces: Index
    vertices: Index
    reference: Float

    @classmethod
    def of(cls, faces: Index, free: NDArray[np.bool_], reference: Float) -> Sides:
        """Take the sides of the faces ``(F, 3)`` at free vertices, which are marked ``(V,)``."""
        return cls(faces[free[faces].any(axis=1)].astype(np.int64), np.flatnonzero(free), reference)

    def constants(self) -> tuple[object, ...]:
        """Implement `PickledWithoutCaches.constants`."""
        return (self.factor,) if len(self.vertices) else ()

    @cached_property
    def weights(self) -> Float:
        """Weights ``(f, 3)`` of the sides 01, 12 and 20."""
        corners = self.reference[self.faces]
        columns = []
        for side in range(3):
            first = corners[:, side] - corners[:, side - 1]
            second = corners[:, (side + 1) % 3] - corners[:, side - 1]
            across = np.linalg.norm(np.cross(first, second), axis=1)
            along = np.einsum("fi,fi->f", first, second)
            cotangents = along / np.maximum(across, np.finfo(np.float64).tiny)
            columns.append(np.clip(cotangents, *COTANGENTS) / 2.0)
        return np.stack(columns, axis=1)

    @cached_property
    def _number(self) -> Index:
        number = np.full(len(self.reference), -1, dtype=np.int64)
        number[self.vertices] = np.arange(len(self.vertices))
        return number

    @cached_property
    def factor(self) -> Factor:
        """Factor of the system's matrix."""
        a, b = self.faces.reshape(-1), np.roll(self.faces, -1, axis=1).reshape(-1)
        weights = self.weights.reshape(-1)
        i, j = self._number[a], self._number[b]
        both = (i >= 0) & (j >= 0)
        diagonal = np.full(len(self.vertices), POSED_WEIGHT)
        for end in (i, j):
            np.add.at(diagonal, end[end >= 0], weights[end >= 0])
        count = len(self.vertices)
        places = np.concatenate([i[both], j[both]]), np.concatenate([j[both], i[both]])
        coupling = sparse.coo_array((np.tile(-weights[both], 2), places), shape=(count, count))
        return factorise(sparse.csr_array(coupling.tocsr() + sparse.diags_array(diagonal)))

    def local(self, motions: Float, x: Float) -> Float:
        """Return the sides 01 and 02 ``(f, 2, 3)`` of a frame ``(V, 3)``, from the mean of the corners' motions."""
        corners = x[self.faces]
        sides = corners[:, 1:] - corners[:, :1]
        return np.asarray(kernels.turn_sides(self.frames(motions), sides, True))

    def frames(self, motions: Float) -> Float:
        """Return the frames ``(f, 4)`` of faces: mean rotations of the motions ``(V, 7)`` of their corners."""
        return np.asarray(kernels.face_frames(motions, self.faces))

    def settle(self, motions: Float, sides: Float, x: Float) -> Float:
        """Move the free vertices of posed points ``(V, 3)`` to where sides ``(f, 2, 3)`` agree with them."""
        return self._solved(kernels.turn_sides(self.frames(motions), sides, False), x)

    def settle_moving(
        self, motions: Float, changes: Float, sides: Float, rates: Float, x: Float, speeds: Float
    ) -> tuple[Float, Float]:
        """Settle points, and return them and their velocities ``(V, 3)``.

        Parameters
        ----------
        motions, changes : (V, 7), (V, 6) float64
            Motions of the vertices and their rates.
        sides, rates : (f, 2, 3) float64
            Sides as seen from the faces' frames, and their derivatives.
        x, speeds : (V, 3) float64
            Posed points and their velocities.
        """
        frames = self.frames(motions)
        turned = kernels.turn_sides(frames, sides, False)
        spins = kernels.face_spins(motions, changes, self.faces)
        turning = kernels.turn_sides(frames, rates, False) + np.cross(spins[:, None], turned)
        return self._solved(turned, x), self._solved(turning, speeds)

    def _solved(self, turned: Float, x: Float) -> Float:
        if not len(self.vertices):
            return x
        right = kernels.right_hand_side(
            self.faces, self.weights, self._number, turned, x, POSED_WEIGHT, self.vertices
        )
        settled = x.copy()
        settled[self.vertices] = self.factor.solve(right)
        return settled


@dataclass(frozen=True, eq=False)
class Settling(PickledWithoutCaches):
    """Makes the lengths and angles of posed meshes agree with those that are known; make it with `Settling.of`.

    Attributes
    ----------
    edge_ids, hinge_ids : (E',), (H',) int64
        Edges and hinges whose lengths and angles are known; others should stay what they are.
    shell : Shell
        The mesh.
    graph : FrameGraph
        Frames of its faces.
    hinges : Hinges
        Its hinges.
    steps : int
        How many steps are taken.
    """

    edge_ids: Index
    hinge_ids: Index
    shell: Shell
    graph: FrameGraph
    hinges: Hinges
    steps: int

    @classmethod
    def of(
        cls, topology: Topology, reference: Float, edge_ids: Index, hinge_ids: Index, relaxation: Relaxation
    ) -> Settling:
        """Make it for a mesh whose reference frame ``(V, 3)`` has typical lengths."""
        nothing = np.zeros((0, 2), dtype=np.int64)
        position_weights = np.full(topology.vertex_count, EXPECTED_WEIGHT)
        typical = edge_lengths(reference, topology.edges)
        shell = Shell(topology, reference, typical, nothing, position_weights, relaxation.bending)
        sound, everything = shell.sound, np.ones(len(topology.faces), dtype=bool)
        pairs = topology.hinge_faces[sound]
        graph = FrameGraph(len(everything), pairs, shell.bend[sound], everything, EXPECTED_WEIGHT)
        hinges = Hinges(topology.faces, topology.hinges, topology.hinge_faces)
        return cls(edge_ids, hinge_ids, shell, graph, hinges, relaxation.steps)

    def constants(self) -> tuple[object, ...]:
        """Implement `PickledWithoutCaches.constants`."""
        return self.shell, self.graph.factor

    def settled(self, x: Float, lengths: Float, angles: Float) -> Float:
        """Return where vertices, posed at ``(V, 3)``, are with lengths ``(E',)`` and angles ``(H',)``."""
        return self.from_start(x, *self.targets(x, lengths, angles)).points

    def targets(self, x: Float, lengths: Float, angles: Float) -> tuple[Float, Float]:
        """Return the lengths ``(E,)`` and angles ``(H,)`` that all edges and hinges should have."""
        topology = self.shell.topology
        all_lengths, all_angles = lengths_and_angles(x, topology.edges, topology.hinges)
        all_lengths[self.edge_ids], all_angles[self.hinge_ids] = np.maximum(lengths, 0.0), angles
        return all_lengths, all_angles

    def from_start(self, x: Float, lengths: Float, angles: Float) -> Relaxed:
        """Return the mesh near ``(V, 3)`` with nearly these lengths ``(E,)`` and angles ``(H,)``, and what is left."""
        topology = self.shell.topology
        flat = flat_triangles(lengths[topology.face_edges])
        turns = self.hinges.turns(flat, angles)[self.shell.sound]
        sides = turned_sides(self.graph.averaged(frames_of(x, topology.faces), turns, ROUNDS), flat)
        corners = x[topology.faces[self.shell.thin]]
        sides[self.shell.thin] = np.roll(corners, -1, axis=1) - corners
        start = self.shell.integrated(sides, np.zeros((0, 3)), x)
        return self.shell.relaxed(start, lengths, angles, self.steps)
