"""Connectivity of a triangle mesh: edges, hinges, adjacency, components, and what is wrong with it.

Everything here follows from the faces alone, never from vertex positions, and is computed once when first
asked for.

A *hinge* is an edge together with two faces that meet in it. Where exactly two faces meet there is one hinge;
a non-manifold edge with k faces has k - 1 of them, chained in the order of the faces, so that the lengths and
hinge angles of a mesh fix its shape also where it is not a manifold.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph

from mixseq.arrays import Index, IntArray, Mask
from mixseq.pickling import PickledWithoutCaches


@dataclass(frozen=True, eq=False)
class Topology(PickledWithoutCaches):
    """Connectivity of a triangle mesh.

    Parameters
    ----------
    faces : (F, 3) int
        Triangles.
    vertex_count : int
        Number of vertices V; vertices that no face uses are allowed.

    Examples
    --------
    >>> square = Topology(np.array([[0, 1, 2], [0, 2, 3]]), 4)
    >>> square.edges.tolist()
    [[0, 1], [0, 2], [0, 3], [1, 2], [2, 3]]
    >>> square.hinges.tolist(), square.hinge_faces.tolist()
    ([[2, 0, 1, 3]], [[0, 1]])
    """

    faces: IntArray
    vertex_count: int

    @cached_property
    def corners(self) -> NDArray[np.int64]:
        """Directed half-edges ``(3F, 4)``: start, end, opposite vertex, face."""
        f = self.faces.astype(np.int64)
        face = np.arange(len(f))
        sides = [(0, 1, 2), (1, 2, 0), (2, 0, 1)]
        return np.concatenate([np.stack([f[:, i], f[:, j], f[:, k], face], axis=1) for i, j, k in sides])

    @cached_property
    def _sorted_edges(self) -> tuple[Index, Index, Index]:
        start, end = self.corners[:, 0], self.corners[:, 1]
        keys = np.minimum(start, end) * self.vertex_count + np.maximum(start, end)
        unique, inverse, counts = np.unique(keys, return_inverse=True, return_counts=True)
        edges = np.stack([unique // self.vertex_count, unique % self.vertex_count], axis=1)
        return edges, inverse.reshape(-1), counts

    @property
    def edges(self) -> Index:
        """Edges ``(E, 2)``, each with its lower vertex first, in lexicographic order."""
        return self._sorted_edges[0]

    @property
    def edge_face_counts(self) -> Index:
        """Number of faces ``(E,)`` at every edge."""
        return self._sorted_edges[2]

    @cached_property
    def face_edges(self) -> Index:
        """Edge index ``(F, 3)`` of the sides 01, 12 and 20 of every face."""
        return self._sorted_edges[1].reshape(3, -1).T

    @cached_property
    def _hinge_table(self) -> tuple[Index, Index, Index]:
        edge_of_corner = self._sorted_edges[1]
        order = np.lexsort((self.corners[:, 3], edge_of_corner))
        same = edge_of_corner[order[1:]] == edge_of_corner[order[:-1]]
        first, second = order[:-1][same], order[1:][same]
        distinct = self.corners[first, 3] != self.corners[second, 3]
        first, second = first[distinct], second[distinct]
        # The first face gives the direction a -> b, so the angle's sign follows that face's orientation.
        a, b, c = self.corners[first, :3].T
        d = self.corners[second, 2]
        hinges = np.stack([a, b, c, d], axis=1)
        faces = np.stack([self.corners[first, 3], self.corners[second, 3]], axis=1)
        return hinges, faces, edge_of_corner[first]

    @property
    def hinges(self) -> Index:
        """Hinges ``(H, 4)`` as vertices a, b, c, d: edge ab, opposite vertices c (first face) and d."""
        return self._hinge_table[0]

    @property
    def hinge_faces(self) -> Index:
        """First and second face ``(H, 2)`` of every hinge."""
        return self._hinge_table[1]

    @property
    def hinge_edges(self) -> Index:
        """Edge index ``(H,)`` of every hinge."""
        return self._hinge_table[2]

    @cached_property
    def boundary_edges(self) -> Index:
        """Indices of edges with one face only."""
        return np.flatnonzero(self.edge_face_counts == 1)

    @cached_property
    def non_manifold_edges(self) -> Index:
        """Indices of edges with more than two faces."""
        return np.flatnonzero(self.edge_face_counts > 2)

    @cached_property
    def inconsistent_edges(self) -> Index:
        """Indices of edges whose two faces have opposite orientations."""
        start, end = self.corners[:, 0], self.corners[:, 1]
        direction = np.where(start < end, 1, -1)
        balance = np.bincount(self._sorted_edges[1], weights=direction, minlength=len(self.edges))
        return np.flatnonzero((self.edge_face_counts == 2) & (balance != 0))

    @cached_property
    def unused_vertices(self) -> Index:
        """Vertices that no face uses."""
        used = np.zeros(self.vertex_count, dtype=bool)
        used[self.faces] = True
        return np.flatnonzero(~used)

    @cached_property
    def vertex_adjacency(self) -> sparse.csr_array:
        """Symmetric ``(V, V)`` matrix with a one for every edge."""
        i, j = self.edges.T
        size = (self.vertex_count, self.vertex_count)
        half = sparse.coo_array((np.ones(len(i)), (i, j)), shape=size)
        return (half + half.T).tocsr()

    @cached_property
    def face_adjacency(self) -> sparse.csr_array:
        """Symmetric ``(F, F)`` matrix; its entries count the hinges between two faces."""
        i, j = self.hinge_faces.T
        size = (len(self.faces), len(self.faces))
        half = sparse.coo_array((np.ones(len(i)), (i, j)), shape=size)
        return (half + half.T).tocsr()

    @cached_property
    def component_of_vertex(self) -> NDArray[np.int32]:
        """Connected component ``(V,)`` of every vertex; an unused vertex is a component of its own."""
        return csgraph.connected_components(self.vertex_adjacency, directed=False)[1]

    @cached_property
    def component_of_face(self) -> NDArray[np.int32]:
        """Hinge-connected component ``(F,)`` of every face: faces that reach each other across edges."""
        return csgraph.connected_components(self.face_adjacency, directed=False)[1]

    @cached_property
    def component_count(self) -> int:
        """Number of connected components that have faces."""
        return int(np.unique(self.component_of_vertex[self.faces[:, 0]]).size)

    def report(self) -> dict[str, int | bool]:
        """Summarise the connectivity: counts, boundary, non-manifold and inconsistent edges, closedness."""
        return {
            "vertices": self.vertex_count,
            "faces": len(self.faces),
            "edges": len(self.edges),
            "hinges": len(self.hinges),
            "components": self.component_count,
            "boundary_edges": len(self.boundary_edges),
            "non_manifold_edges": len(self.non_manifold_edges),
            "inconsistent_edges": len(self.inconsistent_edges),
            "unused_vertices": len(self.unused_vertices),
            "closed": len(self.boundary_edges) == 0,
        }


def vertices_of(topology: Topology, faces: Mask) -> Mask:
    """Mark the vertices ``(V,)`` of the marked faces ``(F,)``."""
    marked = np.zeros(topology.vertex_count, dtype=bool)
    marked[topology.faces[faces]] = True
    return marked


def face_patches(topology: Topology, faces: Mask) -> NDArray[np.int64]:
    """Number the hinge-connected patches of the marked faces; other faces get -1.

    Patches are numbered in the order of their first face.
    """
    patch = np.full(len(topology.faces), -1, dtype=np.int64)
    chosen = np.flatnonzero(faces)
    if chosen.size:
        patch[chosen] = csgraph.connected_components(
            topology.face_adjacency[chosen][:, chosen], directed=False
        )[1]
    return patch


def split_labels(topology: Topology, labels: IntArray) -> NDArray[np.int64]:
    """Number the hinge-connected patches ``(F,)`` of equal labels 0, 1, ..., label by label."""
    together = labels[topology.hinge_faces[:, 0]] == labels[topology.hinge_faces[:, 1]]
    i, j = topology.hinge_faces[together].T
    graph = sparse.coo_array((np.ones(len(i), dtype=bool), (i, j)), shape=(len(labels), len(labels)))
    patch = csgraph.connected_components(graph, directed=False)[1]
    first = np.unique(patch, return_index=True)[1]
    number = np.empty(len(first), dtype=np.int64)
    number[np.lexsort((first, labels[first]))] = np.arange(len(first))
    return number[patch]


def spread(topology: Topology, depth: NDArray[np.int64]) -> NDArray[np.int64]:
    """Let values spread over the mesh, losing one per edge: ``max_b (depth_b - hops(v, b))``, at least 0.

    Examples
    --------
    >>> chain = Topology(np.array([[0, 1, 2], [1, 2, 3], [2, 3, 4], [3, 4, 5]]), 6)
    >>> spread(chain, np.array([2, 0, 0, 0, 0, 0])).tolist()
    [2, 1, 1, 0, 0, 0]
    """
    i, j = topology.edges.T
    result = np.maximum(depth, 0)
    for _ in range(int(result.max(initial=0)) - 1):
        grown = result.copy()
        np.maximum.at(grown, i, result[j] - 1)
        np.maximum.at(grown, j, result[i] - 1)
        result = grown
    return result
