"""Elements of clustering: faces of a mesh, or cells of faces, and their trajectories.

Every element has a few vertices, which define its motion, and neighbours, over which costs are averaged.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Float, Index, Single
from mixseq.topology import Topology

Table = NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class Trajectories:
    """Vertex positions in a set of frames."""

    moved: Single  # (3T, V) their coordinates, frame by frame
    # (V, 4T + 4) for every vertex its coordinates x_t, the squares |x_t|^2, and h = (rest position, 1).
    rows: Float

    @classmethod
    def of(cls, x: Float) -> Trajectories:
        """Gather the trajectories of frames ``(T, V, 3)``; the first one is the rest frame."""
        count, vertices = x.shape[:2]
        rows = np.empty((vertices, 4 * count + 4))
        rows[:, : 3 * count].reshape(vertices, count, 3)[:] = x.transpose(1, 0, 2)
        rows[:, 3 * count : 4 * count] = np.einsum("tvi,tvi->vt", x, x)
        rows[:, -4:-1] = x[0]
        rows[:, -1] = 1.0
        return cls(x.transpose(0, 2, 1).reshape(3 * count, vertices).astype(np.float32), rows)

    def at(self, vertices: Index) -> Trajectories:
        """Return the trajectories of vertices."""
        return Trajectories(np.ascontiguousarray(self.moved[:, vertices]), self.rows[vertices])

    @property
    def frame_count(self) -> int:
        """Number of frames T."""
        return len(self.moved) // 3


@dataclass(frozen=True, eq=False)
class Elements:
    """Faces, or groups of faces."""

    trajectories: Trajectories  # of their vertices
    corners: Table  # (E, 4) vertices of every element; V stands for none
    corner_factors: Single  # (E,) inverse numbers of those
    weights: Float  # (E,) weight of each of its vertices: a share of its area
    pairs: Index  # (n, 2) pairs of neighbours

    @classmethod
    def faces(cls, topology: Topology, x: Float) -> Elements:
        """Make the triangles of a mesh elements, for frames ``(T, V, 3)``; neighbours are across hinges."""
        count = len(topology.faces)
        return cls(
            trajectories=Trajectories.of(x),
            corners=_filled(topology.faces, topology.vertex_count),
            corner_factors=np.full(count, 1.0 / 3.0, dtype=np.float32),
            weights=face_areas(x[0], topology) / 3.0,
            pairs=topology.hinge_faces,
        )

    @classmethod
    def cells(cls, topology: Topology, faces: Elements) -> tuple[Elements, Index]:
        """Make elements of cells, each a vertex and its surroundings; also return the cell of every face."""
        from mixseq.segmentation.segmentation_kernels import cells

        graph = topology.vertex_adjacency
        owner = np.full(topology.vertex_count, -1, dtype=np.int32)
        owner[topology.unused_vertices] = topology.vertex_count  # no cell's
        centres = cells(graph.indptr, graph.indices, owner)
        count = len(centres)
        thirds = np.repeat(faces.weights, 3)
        i, j = owner[topology.edges].T.astype(np.int64)
        pairs = np.sort((np.minimum(i, j) * count + np.maximum(i, j))[i != j])
        pairs = pairs[np.diff(pairs, prepend=-1) > 0]
        elements = cls(
            trajectories=faces.trajectories.at(centres),
            corners=_filled(np.arange(count)[:, None], count),
            corner_factors=np.ones(count, dtype=np.float32),
            weights=np.bincount(owner[topology.faces].reshape(-1), thirds, count).astype(np.float64),
            pairs=np.stack(np.divmod(pairs, count), axis=1),
        )
        return elements, owner[topology.faces[:, 0]].astype(np.int64)

    @cached_property
    def around(self) -> Table:
        """Every element and its neighbours ``(E, m)``, m >= 4, padded with E."""
        from mixseq.segmentation.segmentation_kernels import list_neighbours

        table = _filled(np.arange(len(self))[:, None], len(self), int(self._members.max(initial=1)))
        list_neighbours(self.pairs, table)
        return table

    @cached_property
    def factors(self) -> Single:
        """Inverse numbers ``(E,)`` of those."""
        return (1.0 / self._members).astype(np.float32)

    @cached_property
    def _members(self) -> Index:
        return 1 + np.bincount(self.pairs.reshape(-1), minlength=len(self))

    def __len__(self) -> int:
        return len(self.corners)

    def ball(self, element: int, size: int) -> Index:
        """Return the elements around one, ring by ring, until there are `size` of them or no more."""
        inside = np.array([element])
        while True:
            grown = np.unique(self.around[inside])
            grown = grown[grown < len(self)]
            if len(grown) >= size or len(grown) == len(inside):
                return grown.astype(np.int64)
            inside = grown


def face_areas(x: Float, topology: Topology) -> Float:
    """Return the areas ``(F,)`` of faces in a frame ``(V, 3)`` of unit size, tiny ones without area."""
    from mixseq.segmentation.segmentation_kernels import measure_areas

    areas = np.empty(len(topology.faces))
    measure_areas(x, topology.faces, areas)
    return np.maximum(areas, 1e-12, out=areas)


def _filled(members: NDArray[np.integer], none: int, width: int = 0) -> Table:
    """Return a table of members ``(E, n)`` with at least four columns, padded with `none`."""
    table = np.full((len(members), max(4, width)), none, dtype=np.int32)
    table[:, : members.shape[1]] = members
    return table
