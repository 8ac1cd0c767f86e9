"""Small pieces of labels join their neighbours: weights of skins leave ragged borders, and single faces astray."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from mixseq.arrays import Index
from mixseq.polygons import Polygons
from mixseq.topology import Topology


def without_crumbs(of_polygon: Index, polygons: Polygons, vertex_count: int, fewest: float) -> Index:
    """Give every connected piece of fewer polygons than `fewest` the label that it has most edges in common with.

    The smallest piece comes first; it counts as a part of its new neighbour from then on. Pieces that are all of a
    connected component stay.

    Parameters
    ----------
    of_polygon : (P,) int
        Label of every polygon.
    polygons : Polygons
        The faces.
    vertex_count : int
        Number of vertices.
    fewest : float
        Number of polygons that a piece needs.
    """
    pairs = _beside(polygons, vertex_count)
    count = len(of_polygon)
    same = of_polygon[pairs[:, 0]] == of_polygon[pairs[:, 1]]
    graph = coo_array((np.ones(int(same.sum())), tuple(pairs[same].T)), shape=(count, count))
    piece = connected_components(graph, directed=False)[1]
    label = of_polygon[np.unique(piece, return_index=True)[1]]
    sizes = dict(enumerate(np.bincount(piece).tolist()))
    beside: dict[int, dict[int, int]] = {each: {} for each in sizes}  # shared edges of neighbouring pieces
    for a, b in piece[pairs[~same]].tolist():
        beside[a][b] = beside[a].get(b, 0) + 1
        beside[b][a] = beside[b].get(a, 0) + 1
    into = np.arange(len(sizes))
    while crumbs := [(size, each) for each, size in sizes.items() if size < fewest and beside[each]]:
        crumb = min(crumbs)[1]
        keep = max(beside[crumb], key=lambda each: (beside[crumb][each], -each))
        into[into == crumb] = keep
        sizes[keep] += sizes.pop(crumb)
        for each, edges in beside.pop(crumb).items():
            del beside[each][crumb]
            if each != keep:
                beside[each][keep] = beside[keep][each] = beside[keep].get(each, 0) + edges
    return np.asarray(label[into[piece]], dtype=np.int64)


def _beside(polygons: Polygons, vertex_count: int) -> Index:
    """Return pairs of polygons ``(n, 2)``, one for every edge that two share."""
    owner = np.repeat(np.arange(len(polygons.counts)), polygons.counts - 2)
    pairs = owner[Topology(polygons.triangles, vertex_count).hinge_faces]
    return np.asarray(pairs[pairs[:, 0] != pairs[:, 1]], dtype=np.int64)
