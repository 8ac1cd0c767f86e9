"""Elements of segmentations: faces or cells with their trajectories, boundaries of parts, and watersheds.

An element of clustering has a few vertices, which define its motion, and neighbours for averaging costs.

A watershed grows regions, given a height of every hinge. Rising water connects faces across hinges in the order of
height. This is Kruskal's algorithm for the minimum spanning tree of the dual graph, whose nodes are faces and whose
edges are hinges. A hinge that joins two lakes is the *pass* between them, with

- an *area*: the area of the smaller lake when the lakes meet,
- a *depth*: the height of the pass above the bottom of the shallower lake (the persistence of that lake).

Cutting the tree at n passes of a component leaves n + 1 regions, connected across hinges. Each region has at least the
least area of the passes. Its bottom, the *seed*, is below surrounding passes by at least the least depth of the passes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import SettingsError
from mixseq.mesh.measures import scatter_add, triangle_areas
from mixseq.mesh.topology import Topology, connected_components
from mixseq.mesh.topology_kernels import find_root, number_pairs
from mixseq.runtime.jit import compiled
from mixseq.types import Float, FloatArray, Index, Int32, IntArray, Single, evenly_spaced, index_mask


@dataclass(frozen=True, eq=False)
class Boundaries:
    """The boundaries between n pairs of neighbouring parts."""

    parts: Index  # (n, 2) parts i < j
    edges: Int32  # (k, 2) vertices of the edges between faces of two parts
    pair: Index  # (k,) index of the pair of parts at each edge

    @classmethod
    def from_labels(cls, topology: Topology, part_of_face: Index) -> Boundaries:
        """Find the boundaries of parts ``(F,)``, which consist of hinges between faces of two parts."""
        sides = part_of_face[topology.hinge_faces]
        across = sides[:, 0] != sides[:, 1]
        parts, pair = np.unique(np.sort(sides[across], axis=1), axis=0, return_inverse=True)
        edges = topology.edges[topology.hinge_edges[across]]
        return cls(parts.astype(np.int64).reshape(-1, 2), edges, pair.reshape(-1))

    def middles(self, frame: FloatArray) -> Float:
        """Return the centres ``(n, 3)`` of the boundaries in a frame ``(V, 3)``, as means of edge midpoints."""
        sums = scatter_add(frame[self.edges].mean(axis=1), self.pair, len(self.parts))
        return sums / np.bincount(self.pair, minlength=len(self.parts))[:, None]


@dataclass(frozen=True, eq=False)
class Rim:
    """Edges and faces near the boundaries of patches."""

    vertex_count: int  # number of vertices of the mesh
    ends: Int32  # (n, 2) vertices of the boundary edges
    sides: Int32  # (n, 2) faces at the boundary edges
    edges: Int32  # (m, 2) edges with at least one end on a boundary
    faces: Index  # (k,) faces with a corner on a boundary or one edge away
    corners: IntArray  # (k, 3) vertices of these faces

    @classmethod
    def from_labels(cls, topology: Topology, patches: Index) -> Rim:
        """Find the rim of the patches ``(F,)`` of faces."""
        hinge_patches = patches[topology.hinge_faces]
        across = hinge_patches[:, 0] != hinge_patches[:, 1]
        ends = topology.edges[topology.hinge_edges[across]]
        edges = topology.edges[index_mask(ends, topology.vertex_count)[topology.edges].any(axis=1)]
        faces = np.flatnonzero(index_mask(edges, topology.vertex_count)[topology.faces].any(axis=1))
        sides, corners = topology.hinge_faces[across], topology.faces[faces]
        return cls(topology.vertex_count, ends, sides, edges, faces, corners)

    def narrowness(self, patches: Index) -> Float:
        """Return, for (merged) patches ``(F,)``, the fraction of face corners at most one edge from a boundary."""
        across = patches[self.sides]
        boundary = index_mask(self.ends[across[:, 0] != across[:, 1]], self.vertex_count)
        near = index_mask(self.edges[boundary[self.edges].any(axis=1)], self.vertex_count)
        sizes = np.bincount(patches)
        sums = np.bincount(patches[self.faces], near[self.corners].sum(axis=1) / 3.0, minlength=len(sizes))
        return np.asarray(sums / np.maximum(sizes, 1), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Passes:
    """The minimum spanning tree of the dual graph, whose n edges are passes, by increasing height."""

    topology: Topology
    face_areas: Float  # (F,)
    hinges: Index  # (n,) hinge of every pass; n = number of faces - number of components
    areas: Float  # (n,)
    depths: Float  # (n,)

    def cut(self, passes: Index) -> Index:
        """Cut the tree at passes; number the regions ``(F,)`` by decreasing area."""
        pairs = self.topology.hinge_faces[np.delete(self.hinges, passes)]
        return renumber_by_area(connected_components(len(self.face_areas), pairs), self.face_areas)

    def segment(self, parts: int | None, min_depth: float, min_area_fraction: float) -> Index:
        """Cut the tree at large passes: at the deepest to get `parts` regions, or at all deeper than `min_depth`."""
        min_area = min_area_fraction * float(self.face_areas.sum())
        return self.cut(self.deeper(min_depth, min_area) if parts is None else self.deepest(parts, min_area))

    def deepest(self, parts: int, min_area: float) -> Index:
        """Return the deepest passes that leave `parts` regions; halve `min_area` until enough passes are large."""
        components = len(self.face_areas) - len(self.hinges)
        count = min(max(parts - components, 0), len(self.hinges))
        while np.count_nonzero(self.areas >= min_area) < count:
            min_area /= 2.0
        large = np.flatnonzero(self.areas >= min_area)
        return np.asarray(large[np.argsort(-self.depths[large], kind="stable")[:count]], dtype=np.int64)

    def deeper(self, depth: float, min_area: float) -> Index:
        """Return all passes deeper than `depth` with an area of at least `min_area`."""
        return np.flatnonzero((self.depths > depth) & (self.areas >= min_area))


@compiled
def kruskal(ends: Int32, heights: Float, bottoms: Float, areas: Float) -> tuple[Index, Float, Float]:
    """Join nodes by edges ``(m, 2)`` in order of height; return tree edges with their areas and depths ``(k,)``."""
    parent = np.arange(len(areas))
    tree = np.empty(len(areas), dtype=np.int64)
    area, depth = np.empty(len(areas)), np.empty(len(areas))
    count = 0
    for edge in range(len(ends)):
        a, b = find_root(parent, ends[edge, 0]), find_root(parent, ends[edge, 1])
        if a == b:
            continue
        tree[count] = edge
        area[count] = min(areas[a], areas[b])
        depth[count] = heights[edge] - max(bottoms[a], bottoms[b])
        count += 1
        if areas[a] < areas[b]:
            a, b = b, a
        parent[b] = a
        areas[a] += areas[b]
        bottoms[a] = min(bottoms[a], bottoms[b])
    return tree[:count], area[:count], depth[:count]


def find_passes(topology: Topology, heights: Float, bottoms: Float, areas: Float) -> Passes:
    """Find the passes among hinges with heights ``(H,)``, given bottoms and areas ``(F,)`` of faces."""
    order = np.argsort(heights, kind="stable")
    tree, area, depth = kruskal(topology.hinge_faces[order], heights[order], bottoms.copy(), areas.copy())
    return Passes(topology, areas, order[tree], area, depth)


def renumber_by_area(labels: NDArray[np.integer], areas: Float) -> Index:
    """Renumber the labels ``(F,)`` of faces by decreasing area; labels of equal area are ordered by first face."""
    first = np.empty(int(labels.max(initial=-1)) + 1, dtype=np.int64)
    first[labels[::-1]] = np.arange(len(labels))[::-1]
    sums, used = np.bincount(labels, areas), np.flatnonzero(np.bincount(labels))
    rank = np.empty_like(first)
    rank[used[np.lexsort((first[used], -sums[used]))]] = np.arange(len(used))
    return np.asarray(rank[labels])


def check_part_count(parts: int | None, topology: Topology) -> None:
    """Raise `SettingsError` unless the number of parts is None or from 1 to the number of faces."""
    if parts is None:
        return
    is_whole = isinstance(parts, int | np.integer)
    if not (is_whole and 1 <= parts <= len(topology.faces)):
        given = parts if np.ndim(parts) == 0 else f"of type {type(parts).__name__}"
        raise SettingsError(f"parts is {given}; a whole number from 1 to {len(topology.faces)} (the faces) is expected")


@compiled
def partition_cells(starts: Int32, neighbours: Int32, owner: Int32) -> Index:
    """Partition vertices into cells of a centre and unassigned neighbours; write owners ``(V,)``, return centres."""
    centres = np.empty(len(owner), dtype=np.int64)
    count = 0
    for v in range(len(owner)):
        if owner[v] < 0:
            owner[v] = count
            for i in range(starts[v], starts[v + 1]):
                if owner[neighbours[i]] < 0:
                    owner[neighbours[i]] = count
            centres[count] = v
            count += 1
    return centres[:count].copy()


@compiled
def add_neighbours(pairs: Int32, table: Int32) -> None:
    """Write the neighbours of elements by pairs ``(n, 2)`` after the first column of a table ``(E, m)``."""
    ends = np.ones(len(table), dtype=np.int32)
    for side in range(2):
        for k in range(len(pairs)):
            element = pairs[k, side]
            table[element, ends[element]] = pairs[k, 1 - side]
            ends[element] += 1


@dataclass(frozen=True, eq=False)
class Trajectories:
    """Vertex positions in T frames."""

    x: Float  # (T, V, 3); the first frame is the rest pose

    @cached_property
    def coordinates(self) -> Single:
        """Coordinates ``(3T, V)``, frame by frame."""
        return self.x.transpose(0, 2, 1).astype(np.float32).reshape(3 * len(self.x), -1)

    @cached_property
    def rows(self) -> Float:
        """Rows of all frames, see `frame_rows`."""
        return self.frame_rows(slice(None))

    def frame_rows(self, frames: slice) -> Float:
        """Return rows ``(V, 4T + 4)``: coordinates x_t, then squares |x_t|^2, then h = (rest position, 1)."""
        x = self.x[frames]
        count, vertices = x.shape[:2]
        rows = np.empty((vertices, 4 * count + 4))
        rows[:, : 3 * count].reshape(vertices, count, 3)[:] = x.transpose(1, 0, 2)
        rows[:, 3 * count : 4 * count] = np.einsum("tvi,tvi->vt", x, x)
        rows[:, -4:-1] = self.x[0]
        rows[:, -1] = 1.0
        return rows

    def at(self, vertices: Index) -> Trajectories:
        """Return the trajectories of the given vertices."""
        return Trajectories(np.take(self.x, vertices, axis=1))

    @property
    def frame_count(self) -> int:
        """Number of frames T."""
        return len(self.x)


@dataclass(frozen=True, eq=False)
class Elements:
    """Faces, or groups of faces."""

    trajectories: Trajectories  # trajectories of the vertices
    corners: Int32  # (E, 4) vertices of every element, padded with V
    corner_factors: Single  # (E,) inverse number of vertices of every element
    weights: Float  # (E,) weight of each vertex of an element: a fraction of the element's area
    pairs: Int32  # (n, 2) pairs of neighbours

    @classmethod
    def from_faces(cls, topology: Topology, trajectories: Trajectories, areas: Float) -> Elements:
        """Make elements of the triangles of a mesh, with areas ``(F,)``; neighbours share a hinge."""
        return cls(
            trajectories=trajectories,
            corners=_padded(topology.faces, topology.vertex_count),
            corner_factors=np.full(len(topology.faces), 1.0 / 3.0, dtype=np.float32),
            weights=areas / 3.0,
            pairs=topology.hinge_faces,
        )

    @classmethod
    def from_cells(cls, topology: Topology, trajectories: Trajectories, areas: Float) -> tuple[Elements, Index]:
        """Make elements of cells of faces around centre vertices; also return the cell ``(F,)`` of every face."""
        graph = topology.vertex_adjacency
        owner = np.full(topology.vertex_count, -1, dtype=np.int32)
        owner[topology.unused_vertices] = topology.vertex_count  # in no cell
        centres = partition_cells(graph.indptr, graph.indices, owner)
        count = len(centres)
        del graph  # large
        ends = owner[topology.edges]
        ends = ends[ends[:, 0] != ends[:, 1]]
        elements = cls(
            trajectories=trajectories.at(centres),
            corners=_padded(np.arange(count)[:, None], count),
            corner_factors=np.ones(count, dtype=np.float32),
            weights=np.bincount(owner[topology.faces].reshape(-1), np.repeat(areas / 3.0, 3), count).astype(np.float64),
            pairs=number_pairs(ends.min(axis=1), ends.max(axis=1), count)[0],
        )
        return elements, owner[topology.faces[:, 0]].astype(np.int64)

    @cached_property
    def neighbourhoods(self) -> Int32:
        """Table ``(E, m)``, m >= 4, of every element and its neighbours, padded with E."""
        table = _padded(np.arange(len(self))[:, None], len(self), int(self._neighbourhood_sizes.max(initial=1)))
        add_neighbours(self.pairs, table)
        return table

    @cached_property
    def factors(self) -> Single:
        """Inverse sizes ``(E,)`` of the neighbourhoods."""
        return (1.0 / self._neighbourhood_sizes).astype(np.float32)

    @cached_property
    def _neighbourhood_sizes(self) -> Index:
        return 1 + np.bincount(self.pairs.reshape(-1), minlength=len(self))

    def __len__(self) -> int:
        return len(self.corners)

    def ball(self, element: int, min_size: int) -> Index:
        """Return an element and rings of neighbours, until the ball has `min_size` elements or cannot grow."""
        ball = np.array([element])
        while True:
            grown = np.unique(self.neighbourhoods[ball])
            grown = grown[grown < len(self)]
            if len(grown) >= min_size or len(grown) == len(ball):
                return grown.astype(np.int64)
            ball = grown


def sample_frames(points: FloatArray, frames: int) -> Float:
    """Return centred sampled frames ``(T, V, 3)``, in diagonals of the first frame, or of the largest if that is 0."""
    x = points[evenly_spaced(len(points), frames)].astype(np.float64)
    x -= x.mean(axis=1, keepdims=True)
    x /= _diagonals(x[:1])[0] or _diagonals(x).max() or 1.0
    return x


def _diagonals(x: Float) -> Float:
    """Return the diagonals ``(T,)`` of the bounding boxes of frames ``(T, V, 3)``."""
    return np.asarray(np.linalg.norm(np.ptp(x, axis=1), axis=1))


def face_areas(x: Float, topology: Topology) -> Float:
    """Return the areas ``(F,)`` of faces in a frame ``(V, 3)`` of unit size, at least 1e-12."""
    return np.maximum(triangle_areas(x, topology.faces), 1e-12)


def _padded(members: NDArray[np.integer], padding: int, width: int = 0) -> Int32:
    """Pad a table of members ``(E, n)`` to at least four columns."""
    table = np.full((len(members), max(4, width)), padding, dtype=np.int32)
    table[:, : members.shape[1]] = members
    return table
