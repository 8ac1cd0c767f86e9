"""A hierarchy of overlapping patches: a hinge-connected set of faces, cut into connected parts again and again.

Every set is cut at once into at most `group` cells: the first seed is the face farthest from the first face, every
other one the face farthest from all seeds so far, and a face joins the cell of the seed that it reaches first, in
steps across hinges. Cells on shortest paths to their seed are hinge-connected. A set of at most `leaf` faces is a
leaf.

Leaves then grow by strips of triangles, the faces that touch a vertex, and every other patch is what its children
are together. So neighbouring patches overlap on all levels, by at least the two faces at any hinge between them.

How patches are cut is not in the paper; here it depends on connectivity only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph

from mixseq.mesh.topology import Topology
from mixseq.types import Index


@dataclass(frozen=True, eq=False)
class Region:
    """A hinge-connected patch of ascending faces ``(m,)``, and the patches it is the union of; none of a leaf."""

    faces: Index
    children: tuple[Region, ...]


def divide(topology: Topology, faces: Index, leaf: int, group: int, strips: int) -> Region:
    """Cut hinge-connected faces ``(m,)``, ascending, into a hierarchy of patches.

    Leaves have at most `leaf` faces before they grow by strips of triangles, patches at most `group` (2 or more)
    children.
    """
    neighbours = sparse.csr_array(topology.face_adjacency[faces][:, faces])
    count = len(faces)
    vertices, vertex = np.unique(topology.faces[faces], return_inverse=True)
    corner = (np.repeat(np.arange(count), 3), vertex.reshape(-1))
    corners = sparse.csr_array((np.ones(3 * count), corner), shape=(count, len(vertices)))
    touching = sparse.csr_array(corners @ corners.T)

    def divided(cell: Index) -> Region:
        if len(cell) <= leaf:
            return Region(faces[_grown(neighbours, touching, cell, strips)], ())
        inside = neighbours[cell][:, cell]
        owner = _nearest_seeds(inside, min(group, -(-len(cell) // leaf)))
        children = tuple(divided(cell[owner == seed]) for seed in np.unique(owner))
        return Region(np.unique(np.concatenate([child.faces for child in children])), children)

    return divided(np.arange(count))


def _nearest_seeds(graph: sparse.csr_array, count: int) -> Index:
    """Spread `count` seeds over a connected graph; return the seed ``(n,)`` that every node is nearest to."""
    distance = _distances(graph, [0])[0]
    seeds = [int(distance.argmax())]
    while True:
        distance, owner = _distances(graph, seeds)
        if len(seeds) == count:
            return owner
        seeds.append(int(distance.argmax()))


def _distances(graph: sparse.csr_array, seeds: list[int]) -> tuple[NDArray[np.float64], Index]:
    """Steps ``(n,)`` from the nearest seed, and that seed ``(n,)``."""
    distance, _, owner = csgraph.dijkstra(graph, False, np.array(seeds), True, unweighted=True, min_only=True)
    return distance, owner.astype(np.int64)


def _grown(neighbours: sparse.csr_array, touching: sparse.csr_array, cell: Index, strips: int) -> Index:
    """Add strips of triangles around a cell; faces that hang on by a point only are left out."""
    grown = cell
    for _ in range(strips):
        grown = np.unique(touching[grown].indices).astype(np.int64)
    patch = csgraph.connected_components(neighbours[grown][:, grown], directed=False)[1]
    return np.asarray(grown[patch == patch[np.searchsorted(grown, cell[0])]])
