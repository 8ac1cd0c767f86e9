"""Connectivity of a triangle mesh: edges, hinges, adjacency, components and defects.

All results depend only on the faces. Tables of edges and hinges are computed once, at first use; what follows from
them quickly is not kept, as tables of large meshes take most of the memory.

A *hinge* is an edge with two of its faces. A non-manifold edge with k faces has k - 1 hinges, between consecutive
faces, so that lengths and hinge angles also determine the shape of non-manifold meshes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mixseq.runtime.lazy import PickledWithoutCaches, cached_property
from mixseq.types import Index, Int32, IntArray, Mask, index_mask


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
    def _numbered_edges(self) -> tuple[Int32, Int32]:
        """Edges ``(E, 2)``, and the edge ``(3F,)`` of every side, face by face."""
        from mixseq.mesh.topology_kernels import number_pairs

        start, end = (each.astype(np.int32) for each in self._sides)
        low = np.minimum(start, end)
        high = np.maximum(start, end, out=end)
        return number_pairs(low, high, self.vertex_count)

    @property
    def _sides(self) -> tuple[IntArray, IntArray]:
        """Starts and ends ``(3F,)`` of the sides 01, 12 and 20 of every face."""
        return self.faces.reshape(-1), self.faces[:, [1, 2, 0]].reshape(-1)

    @property
    def edges(self) -> Int32:
        """Edges ``(E, 2)``, each with its lower vertex first, in lexicographic order."""
        return self._numbered_edges[0]

    @cached_property
    def edge_face_counts(self) -> Index:
        """Number of faces ``(E,)`` at every edge."""
        return np.bincount(self._numbered_edges[1], minlength=len(self.edges))

    @property
    def face_edges(self) -> Int32:
        """Edge index ``(F, 3)`` of the sides 01, 12 and 20 of every face."""
        return self._numbered_edges[1].reshape(-1, 3)

    @cached_property
    def _hinge_sides(self) -> Int32:
        """Sides ``(H, 2)`` of the two faces at every hinge; sides are numbered face by face."""
        from mixseq.mesh.topology_kernels import pair_sides

        return pair_sides(self._numbered_edges[1], len(self.edges))

    @cached_property
    def hinges(self) -> Int32:
        """Hinges ``(H, 4)`` as vertices a, b, c, d: edge ab, opposite vertices c (first face) and d."""
        return self.hinges_at(slice(None))

    def hinges_at(self, hinge_ids: Index | slice) -> Int32:
        """Return the `hinges` ``(h, 4)`` with the given indices, to save memory on large meshes."""
        # Edge a -> b has the direction of the first face, whose orientation determines the sign of the angle.
        first, second = self._hinge_sides[hinge_ids].T
        corners = first, _next_side(first), _next_side(_next_side(first)), _next_side(_next_side(second))
        return np.stack([self.faces.reshape(-1)[corner] for corner in corners], axis=1, dtype=np.int32)

    @property
    def hinge_faces(self) -> Int32:
        """First and second face ``(H, 2)`` of every hinge."""
        return self._hinge_sides // np.int32(3)

    @property
    def hinge_edges(self) -> Int32:
        """Edge index ``(H,)`` of every hinge."""
        return self._numbered_edges[1][self._hinge_sides[:, 0]]

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
        start, end = self._sides
        direction = np.where(start < end, 1, -1)
        balance = np.bincount(self._numbered_edges[1], weights=direction, minlength=len(self.edges))
        return np.flatnonzero((self.edge_face_counts == 2) & (balance != 0))

    @cached_property
    def unused_vertices(self) -> Index:
        """Vertices that no face uses."""
        return np.flatnonzero(~index_mask(self.faces, self.vertex_count))

    @property
    def vertex_adjacency(self) -> sparse.csr_array:
        """Symmetric ``(V, V)`` matrix of bytes with a one for every edge."""
        return _symmetric(self.edges, self.vertex_count)

    @property
    def face_adjacency(self) -> sparse.csr_array:
        """Symmetric ``(F, F)`` matrix of bytes; its entries count the hinges between two faces."""
        return _symmetric(self.hinge_faces, len(self.faces))

    @cached_property
    def component_of_vertex(self) -> Int32:
        """Connected component ``(V,)`` of every vertex; an unused vertex forms a component."""
        return _number_components(self.vertex_count, self.edges)

    @cached_property
    def component_of_face(self) -> Int32:
        """Hinge-connected component ``(F,)`` of every face: faces that are connected across edges."""
        return _number_components(len(self.faces), self.hinge_faces)

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


def _next_side(sides: Int32) -> Int32:
    """Return the next side of the same face, which starts where the given side ends."""
    return np.where(sides % 3 == 2, sides - 2, sides + 1)


def _symmetric(pairs: Int32, count: int) -> sparse.csr_array:
    """Return the symmetric matrix ``(count, count)`` that counts pairs ``(n, 2)`` and reversed pairs."""
    from mixseq.mesh.topology_kernels import neighbour_lists

    starts, neighbours = neighbour_lists(pairs, count)
    matrix = sparse.csr_array((np.ones(len(neighbours), dtype=np.int8), neighbours, starts), shape=(count, count))
    matrix.sum_duplicates()
    return matrix


def connected_components(count: int, pairs: IntArray) -> Index:
    """Number the connected components ``(count,)`` of nodes in order of their first nodes, by pairs ``(n, 2)``."""
    return _number_components(count, pairs).astype(np.int64)


def _number_components(count: int, pairs: IntArray) -> Int32:
    from mixseq.mesh.topology_kernels import number_components

    return number_components(np.ascontiguousarray(pairs, dtype=np.int32), count)


def mark_face_vertices(topology: Topology, faces: Mask) -> Mask:
    """Mark the vertices ``(V,)`` of the marked faces ``(F,)``."""
    return index_mask(topology.faces[faces], topology.vertex_count)


def dilate_vertices(topology: Topology, vertices: Mask, rings: int) -> Mask:
    """Mark the vertices ``(V,)`` at most `rings` edges away from a marked vertex."""
    marked = vertices.copy()
    ring, graph = np.flatnonzero(marked), topology.vertex_adjacency
    for _ in range(rings):
        neighbours = graph[ring].indices
        ring = np.unique(neighbours[~marked[neighbours]])
        marked[ring] = True
    return marked


def interior_hinges(topology: Topology, faces: Mask) -> Index:
    """Return the indices of hinges between two marked faces ``(F,)``, ascending."""
    return np.flatnonzero(faces[topology.hinge_faces].all(axis=1))


def face_patches(topology: Topology, faces: Mask) -> NDArray[np.int64]:
    """Number the hinge-connected patches ``(F,)`` of the marked faces, in order of their first face; -1 elsewhere."""
    patch = np.full(len(topology.faces), -1, dtype=np.int64)
    face_ids = np.flatnonzero(faces)
    pairs = topology.hinge_faces[interior_hinges(topology, faces)]
    patch[face_ids] = connected_components(len(face_ids), np.searchsorted(face_ids, pairs))
    return patch


def split_labels(topology: Topology, labels: IntArray) -> NDArray[np.int64]:
    """Number the hinge-connected patches ``(F,)`` of equal labels from 0, ordered by label, then by first face."""
    is_inside = labels[topology.hinge_faces[:, 0]] == labels[topology.hinge_faces[:, 1]]
    patch = connected_components(len(labels), topology.hinge_faces[is_inside])
    first = np.unique(patch, return_index=True)[1]
    number = np.empty(len(first), dtype=np.int64)
    number[np.lexsort((first, labels[first]))] = np.arange(len(first))
    return number[patch]


def propagate_depth(topology: Topology, depth: NDArray[np.int64]) -> NDArray[np.int64]:
    """Propagate values ``(V,)`` along edges, one less per edge: ``max_b (depth_b - hops(v, b))``, at least 0."""
    result = np.maximum(depth, 0)
    for _ in range(int(result.max(initial=0)) - 1):
        i, j = topology.edges[(result > 1)[topology.edges].any(axis=1)].T
        updated = result.copy()
        np.maximum.at(updated, i, result[j] - 1)
        np.maximum.at(updated, j, result[i] - 1)
        result = updated
    return result
