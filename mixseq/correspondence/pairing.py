"""Which components of a source belong to which of a target: those that markers join."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from mixseq.arrays import Index
from mixseq.correspondence.markers import Markers
from mixseq.topology import Topology


@dataclass(frozen=True, eq=False)
class Pairing:
    """Components of a source and of a target that markers join: shoes and shoes, a body and a body.

    Attributes
    ----------
    source_faces, target_faces : (n,) int64
        Triangles of these components.
    source_vertices, target_vertices : (n,) int64
        Their vertices.
    """

    source_faces: Index
    target_faces: Index
    source_vertices: Index
    target_vertices: Index


def pair_components(source: Topology, target: Topology, markers: Markers) -> tuple[Pairing, ...]:
    """Join components by markers.

    A component is in the pairing of all components that markers join it to, directly or through others; without a
    marker it is in none.
    """
    own = source.component_of_vertex.astype(np.int64)
    others = target.component_of_vertex.astype(np.int64) + len(np.unique(own))
    size = int(others.max(initial=-1)) + 1
    ends = own[markers.source], others[markers.target]
    graph = sparse.coo_array((np.ones(len(markers)), ends), shape=(size, size))
    joined = csgraph.connected_components(graph, directed=False)[1]
    pairings = []
    for number in np.unique(joined[ends[0]]):
        vertices = [np.flatnonzero(joined[component] == number) for component in (own, others)]
        faces = [
            np.flatnonzero(joined[component[topology.faces[:, 0]]] == number)
            for topology, component in ((source, own), (target, others))
        ]
        pairings.append(Pairing(faces[0], faces[1], vertices[0], vertices[1]))
    return tuple(pairings)
