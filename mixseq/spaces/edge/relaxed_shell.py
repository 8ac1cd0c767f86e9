"""The projection of the space S_e by steps with constant matrices.

Faces are rebuilt from their lengths and rotated by the angles: frames are chained from the middle of every piece, and
averaged (`mixseq.shells.face_frames`). Vertices follow from the sides of faces, and relaxation steps reduce the errors
of lengths and angles (`mixseq.shells.shell`). Then frames and steps alternate a few times: frames distribute errors
globally, steps locally. The first mesh is exact where a mesh has these lengths and angles. All matrices are constant.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from mixseq.arrays import Float, Index
from mixseq.geometry.lengths_angles import sound_lengths
from mixseq.pickling import PickledWithoutCaches
from mixseq.shells.face_frame_kernels import turned_sides
from mixseq.shells.face_frames import FrameGraph, Hinges, bridging, connected, flat_triangles, frames_of
from mixseq.shells.gauss_newton import ShellReport, ShellSettings
from mixseq.shells.shell import THIN, Relaxed, Shell
from mixseq.spaces.edge.projection import Wanted
from mixseq.spaces.pieces import Pieces
from mixseq.topology import Topology

ROUNDS = 10
"""Rounds of rotation averaging of chained frames."""

CYCLES = 4
"""Largest number of cycles of steps; in between, frames of the mesh are averaged once."""

STEPS = 20
"""Relaxation steps per cycle."""

NOTHING = np.zeros((0, 3))


class _Rows(NamedTuple):
    """The mesh with pieces that share no vertices; its faces are those of the mesh."""

    topology: Topology  # connectivity of the rows
    edge_ids: Index  # (E,) the mesh edge of every edge of the rows
    hinge_ids: Index  # (H,) the mesh hinge of every hinge of the rows


@dataclass(frozen=True, eq=False)
class RelaxedShell(PickledWithoutCaches):
    """An `EdgeProjection` by constant matrices."""

    topology: Topology  # connectivity of the mesh
    pieces: Pieces  # its hinge-connected pieces, with shapes of typical lengths
    typical: Float  # (E,) typical lengths of all edges
    bending: float  # weight of an angle in radians against a relative length

    @cached_property
    def _rows(self) -> _Rows:
        mesh, faces = self.topology, np.zeros((len(self.topology.faces), 3), dtype=np.int64)
        pieces = zip(self.pieces.slices, self.pieces.vertices, self.pieces.faces, strict=True)
        for rows, vertices, own in pieces:
            faces[own] = rows.start + np.searchsorted(vertices, mesh.faces[own])
        topology = Topology(faces, len(self.pieces.shapes))
        vertex = np.concatenate(self.pieces.vertices)
        # Both tables of edges have the same ones, as pieces share none; so have those of hinges.
        edge_ids = _places(vertex[topology.edges], mesh.edges)
        hinges = np.column_stack([edge_ids[topology.hinge_edges], topology.hinge_faces])
        hinge_ids = _places(hinges, np.column_stack([mesh.hinge_edges, mesh.hinge_faces]))
        return _Rows(topology, edge_ids, hinge_ids)

    @cached_property
    def shell(self) -> Shell:
        """The mesh as a shell, with one fixed vertex per piece."""
        topology, edge_ids, _ = self._rows
        position_weights = np.zeros(topology.vertex_count)
        position_weights[[rows.start for rows in self.pieces.slices]] = 1.0
        ties = np.zeros((0, 2), dtype=np.int64)
        return Shell(
            topology, self.pieces.shapes, self.typical[edge_ids], ties, position_weights, self.bending
        )

    @cached_property
    def _crossing(self) -> Index:
        """Hinges ``(h,)`` between frames: the sound ones, and others where they alone connect faces."""
        hinge_faces = self._rows.topology.hinge_faces
        return np.flatnonzero(bridging(len(self.topology.faces), hinge_faces, self.shell.sound))

    @cached_property
    def graph(self) -> FrameGraph:
        """Frames of all faces; chains start in the middle of every piece."""
        count, pairs = (
            len(self.topology.faces),
            self._rows.topology.hinge_faces[self._crossing].astype(np.int64),
        )
        known = np.zeros(count, dtype=bool)
        known[_middles(count, pairs)] = True
        return FrameGraph(count, pairs, np.maximum(self.shell.bend[self._crossing], THIN), known, 1.0)

    @cached_property
    def hinges(self) -> Hinges:
        """The hinges of the mesh."""
        topology = self._rows.topology
        return Hinges(topology.faces, topology.hinges, topology.hinge_faces)

    def constants(self) -> tuple[object, ...]:
        """Implement `PickledWithoutCaches.constants`."""
        return self.graph, self.shell

    def fit(self, wanted: Wanted, settings: ShellSettings) -> tuple[Float, list[ShellReport]]:
        """Implement `EdgeProjection.fit`; of the settings only the tolerance is used."""
        topology, edge_ids, hinge_ids = self._rows
        lengths = sound_lengths(wanted.lengths, wanted.weights)[edge_ids]
        angles = wanted.angles[hinge_ids]
        flat = flat_triangles(lengths[topology.face_edges])
        turns = self.hinges.turns(flat, angles)[self._crossing]
        known = np.tile([1.0, 0.0, 0.0, 0.0], (int(np.count_nonzero(self.graph.known)), 1))
        frames, x = self.graph.averaged(self.graph.chained(turns, known), turns, ROUNDS), self.pieces.shapes
        best = Relaxed(x, np.inf)
        steps = 0
        for _ in range(CYCLES):
            start = self.shell.integrated(turned_sides(frames, flat), NOTHING, best.points)
            points, steps = self.shell.relaxed(start, lengths, angles, STEPS).points, steps + STEPS
            found = Relaxed(points, self.shell.energy(points, lengths, angles))
            done = self.shell.agree(found.energy) or found.energy > (1.0 - settings.tolerance) * best.energy
            best = min(found, best, key=lambda each: each.energy)
            if done:
                break
            frames = self.graph.averaged(frames_of(best.points, topology.faces), turns, 1)
        return best.points, [ShellReport(2.0 * best.energy, steps, True)]


def _places(rows: Index, table: Index) -> Index:
    """Return the places of rows ``(n, k)`` in a table ``(n, k)`` with the same rows in another order."""
    places = np.empty(len(rows), dtype=np.int64)
    places[np.lexsort(rows.T)] = np.lexsort(table.T)
    return places


def _middles(count: int, pairs: Index) -> Index:
    """Return one node for every component connected by pairs ``(h, 2)``, in the middle of its longest path."""
    graph = sparse.coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count)).tocsr()
    component = connected(count, pairs)

    def best(distances: Float) -> Index:
        order = np.lexsort((np.arange(count), distances, component))
        return order[np.unique(component[order], return_index=True)[1]]

    def away(sources: Index) -> Float:
        return np.asarray(
            csgraph.dijkstra(graph, directed=False, indices=sources, unweighted=True, min_only=True)
        )

    one = away(best(-away(best(np.zeros(count)))))
    return best(np.maximum(one, away(best(-one))))
