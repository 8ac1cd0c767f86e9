r"""Settling: between poses that are far apart lengths and angles say what blends of vertices do not know.

Posed vertices and their sides are where a frame is expected. Between far poses they are sheared, and shorter than they
should be. There the frames of all faces, and then vertices, are moved a little to what lengths and angles of the joints
say, and those of the posed vertices elsewhere (`mixseq.shells`): one average of rotations, one back-substitution, and a
fixed number of steps. All matrices are constant, and where lengths and angles agree nothing moves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mixseq.arrays import Float, Index
from mixseq.geometry.lengths_angles import edge_lengths
from mixseq.pickling import PickledWithoutCaches
from mixseq.shells.frames import FrameGraph
from mixseq.shells.hinge_kernels import measured
from mixseq.shells.relaxation_kernels import turned_sides
from mixseq.shells.shell import Relaxation, Relaxed, Shell
from mixseq.shells.triangles import Hinges, flat_triangles, frames_of
from mixseq.topology import Topology

ROUNDS = 2
"""So often what does not fit between frames is divided among them."""

HOLD = 1e-3
"""How much frames and vertices stay where they are expected, against hinges and sides: enough to keep a mesh in its
place, too little to bend it. Ours."""


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
        holds = np.full(topology.vertex_count, HOLD)
        typical = edge_lengths(reference, topology.edges)
        shell = Shell(topology, reference, typical, nothing, holds, relaxation.bending)
        sound, everything = shell.sound, np.ones(len(topology.faces), dtype=bool)
        pairs = topology.hinge_faces[sound]
        graph = FrameGraph(len(everything), pairs, shell.bend[sound], everything, HOLD)
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
        all_lengths, all_angles = measured(x, topology.edges, topology.hinges)
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
