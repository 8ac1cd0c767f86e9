"""Elements of segmentations: faces or cells of faces with their trajectories, boundaries of parts, and landscapes.

An element of clustering has a few vertices, which define its motion, and neighbours, over which costs are averaged.

Regions grow over a *landscape*, in which every hinge has a height. Rising water connects faces across hinges in the
order of height, which is Kruskal's algorithm for the minimum spanning tree of the dual graph: its nodes are faces, its
edges hinges. A hinge that joins two lakes is the *pass* between them, with

- an *area*: that of the smaller lake when they meet,
- a *depth*: its height above the bottom of the shallower lake (the persistence of that lake).

Cutting the tree at passes leaves regions, connected across hinges, in every component one more than passes. If all cut
passes have at least some area, so have all regions. If they have at least some depth, every region has one bottom, its
*seed*, as deep below the surrounding passes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import SettingsError
from mixseq.mesh.measures import scatter_add, triangle_areas
from mixseq.mesh.topology import Topology, connected_components
from mixseq.types import Float, FloatArray, Index, IntArray, Mask, Single


@dataclass(frozen=True, eq=False)
class Boundaries:
    """The boundaries between n pairs of neighbouring parts."""

    parts: Index  # (n, 2) the parts i < j
    edges: Index  # (k, 2) vertices of the edges between faces of two parts
    pair: Index  # (k,) the pair of parts of each edge

    @classmethod
    def from_labels(cls, topology: Topology, part_of_face: Index) -> Boundaries:
        """Find the boundaries between the parts ``(F,)`` of faces: hinges between faces of two parts."""
        sides = np.sort(part_of_face[topology.hinge_faces], axis=1)
        across = sides[:, 0] != sides[:, 1]
        parts, pair = np.unique(sides[across], axis=0, return_inverse=True)
        edges = topology.edges[topology.hinge_edges[across]]
        return cls(parts.astype(np.int64).reshape(-1, 2), edges, pair.reshape(-1))

    def middles(self, frame: FloatArray) -> Float:
        """Return the middles ``(n, 3)`` of the boundaries in a frame ``(V, 3)``: means of edge midpoints."""
        sums = scatter_add(frame[self.edges].mean(axis=1), self.pair, len(self.parts))
        return sums / np.bincount(self.pair, minlength=len(self.parts))[:, None]


@dataclass(frozen=True, eq=False)
class Rim:
    """Edges and faces near the boundaries of patches."""

    vertex_count: int  # number of vertices of the mesh
    ends: Index  # (n, 2) vertices of the boundary edges
    sides: Index  # (n, 2) faces beside the boundary edges
    edges: Index  # (m, 2) edges with an end on a boundary
    faces: Index  # (k,) faces with a corner on a boundary or one edge away
    corners: IntArray  # (k, 3) vertices of these faces

    @classmethod
    def from_labels(cls, topology: Topology, patches: Index) -> Rim:
        """Find the rim of patches ``(F,)`` of faces."""
        of_hinge = patches[topology.hinge_faces]
        across = of_hinge[:, 0] != of_hinge[:, 1]
        ends = topology.edges[topology.hinge_edges[across]]
        edges = topology.edges[_marked(ends, topology.vertex_count)[topology.edges].any(axis=1)]
        faces = np.flatnonzero(_marked(edges, topology.vertex_count)[topology.faces].any(axis=1))
        sides, corners = topology.hinge_faces[across], topology.faces[faces]
        return cls(topology.vertex_count, ends, sides, edges, faces, corners)

    def narrowness(self, patches: Index) -> Float:
        """Return the share of each patch's corners on its boundary or one edge away: patches ``(F,)``, also merged."""
        across = patches[self.sides]
        boundary = _marked(self.ends[across[:, 0] != across[:, 1]], self.vertex_count)
        near = _marked(self.edges[boundary[self.edges].any(axis=1)], self.vertex_count)
        sizes = np.bincount(patches)
        shares = np.bincount(patches[self.faces], near[self.corners].sum(axis=1) / 3.0, minlength=len(sizes))
        return np.asarray(shares / np.maximum(sizes, 1), dtype=np.float64)


def _marked(some: Index, count: int) -> Mask:
    """Return a mask ``(count,)`` of vertices."""
    marks = np.zeros(count, dtype=bool)
    marks[some] = True
    return marks


@dataclass(frozen=True, eq=False)
class Passes:
    """The minimum spanning tree of the dual graph, from its lowest hinge to its highest."""

    topology: Topology  # connectivity of the mesh
    face_areas: Float  # (F,) areas of the faces
    hinges: Index  # (n,) hinges of the tree; n is the number of faces less that of components
    areas: Float  # (n,) areas of the passes
    depths: Float  # (n,) depths of the passes

    def cut(self, where: Index) -> Index:
        """Cut the tree at n hinges; number the regions ``(F,)`` by decreasing area."""
        kept = self.topology.hinge_faces[np.delete(self.hinges, where)]
        return renumber_by_area(connected_components(len(self.face_areas), kept), self.face_areas)

    def deepest(self, parts: int, least_area: float) -> Index:
        """Choose the deepest passes that leave `parts` regions; the least area is halved until there are enough."""
        components = len(self.face_areas) - len(self.hinges)
        count = min(max(parts - components, 0), len(self.hinges))
        while np.count_nonzero(self.areas >= least_area) < count:
            least_area /= 2.0
        large = np.flatnonzero(self.areas >= least_area)
        return np.asarray(large[np.argsort(-self.depths[large], kind="stable")[:count]], dtype=np.int64)

    def deeper(self, than: float, least_area: float) -> Index:
        """Choose all passes above a depth and an area."""
        return np.flatnonzero((self.depths > than) & (self.areas >= least_area))


def flood(topology: Topology, heights: Float, bottoms: Float, areas: Float) -> Passes:
    """Find the passes of a landscape: heights ``(H,)``; bottoms ``(F,)``; areas ``(F,)``."""
    from mixseq.segmentation.segmentation_kernels import kruskal

    order = np.argsort(heights, kind="stable")
    tree, area, depth = kruskal(topology.hinge_faces[order], heights[order], bottoms.copy(), areas.copy())
    return Passes(topology, areas, order[tree], area, depth)


def renumber_by_area(labels: NDArray[np.integer], areas: Float) -> Index:
    """Renumber the labels ``(F,)`` of faces by decreasing area, equal ones in the order of first faces."""
    _, first, dense = np.unique(labels, return_index=True, return_inverse=True)
    order = np.lexsort((first, -np.bincount(dense, areas)))
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return np.asarray(rank[dense], dtype=np.int64)


def check_part_count(parts: int | None, topology: Topology) -> None:
    """Raise `SettingsError` for a number of parts that no segmentation has."""
    if parts is None:
        return
    whole = isinstance(parts, int | np.integer)
    if not (whole and 1 <= parts <= len(topology.faces)):
        given = parts if np.ndim(parts) == 0 else f"of type {type(parts).__name__}"
        raise SettingsError(
            f"parts is {given}; a whole number from 1 to {len(topology.faces)} (the faces) is expected"
        )


Table = NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class Trajectories:
    """Vertex positions in a set of frames."""

    moved: Single  # (3T, V) their coordinates, frame by frame
    # (V, 4T + 4) for every vertex its coordinates x_t, the squares |x_t|^2, and h = (rest position, 1).
    rows: Float

    @classmethod
    def from_frames(cls, x: Float) -> Trajectories:
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
    def from_faces(cls, topology: Topology, x: Float) -> Elements:
        """Make the triangles of a mesh elements, for frames ``(T, V, 3)``; neighbours are across hinges."""
        count = len(topology.faces)
        return cls(
            trajectories=Trajectories.from_frames(x),
            corners=_filled(topology.faces, topology.vertex_count),
            corner_factors=np.full(count, 1.0 / 3.0, dtype=np.float32),
            weights=face_areas(x[0], topology) / 3.0,
            pairs=topology.hinge_faces,
        )

    @classmethod
    def from_cells(cls, topology: Topology, faces: Elements) -> tuple[Elements, Index]:
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
    return np.maximum(triangle_areas(x, topology.faces), 1e-12)


def _filled(members: NDArray[np.integer], none: int, width: int = 0) -> Table:
    """Return a table of members ``(E, n)`` with at least four columns, padded with `none`."""
    table = np.full((len(members), max(4, width)), none, dtype=np.int32)
    table[:, : members.shape[1]] = members
    return table
