r"""Segmentation of a mesh that does not move, by its shape.

The mean distance along the surface to all vertices is least in the middle of a body and largest at the tips of its
limbs. Its level sets cut limbs across (Hilaga and others 2001). Of as few levels as have the wanted number of parts,
with small pieces left out, the pieces A and B with the least increase of variance are merged (Ward 1963) until the
number is right,

.. math:: \frac{a_A a_B}{a_A + a_B} |c_A - c_B|^2 ,

with areas a and centres c.
"""

from __future__ import annotations

import heapq

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from mixseq.mesh.measures import edge_lengths, element_blocks, scatter_add
from mixseq.mesh.topology import Topology, split_labels
from mixseq.segmentation.elements import Boundaries
from mixseq.types import Float, Index

DISTANCE_SAMPLES = 24  # number of vertices to which distances are measured, far from each other
MIN_PIECE_AREA_RATIO = 0.004  # least area of pieces that are counted as parts, as a fraction of the mesh
MAX_LEVELS = 256  # largest number of level sets


def segment_still(x: Float, topology: Topology, areas: Float, parts: int) -> Index:
    """Find parts ``(F,)`` of a frame ``(V, 3)`` with areas ``(F,)`` of faces; fewer if there are not enough pieces."""
    heights = mean_surface_distances(x, topology)[topology.faces].mean(axis=1)
    heights /= heights.max(initial=0.0) or 1.0
    levels, pieces = 0, topology.component_of_face.astype(np.int64)
    while np.count_nonzero(np.bincount(pieces, areas) > MIN_PIECE_AREA_RATIO * areas.sum()) < parts:
        levels += 1
        if levels > MAX_LEVELS:
            break
        pieces = split_labels(topology, np.floor(levels * heights).astype(np.int64))
    centres = np.empty((len(topology.faces), 3))
    for rows in element_blocks(len(centres)):
        centres[rows] = x[topology.faces[rows]].mean(axis=1)
    return merge_pieces(centres, topology, areas, pieces, parts)


def mean_surface_distances(x: Float, topology: Topology) -> Float:
    """Return mean distances ``(V,)`` along edges to far vertices of the same component, less the least of these."""
    count = topology.vertex_count
    graph = sparse.csr_array((edge_lengths(x, topology.edges), tuple(topology.edges.T)), shape=(count, count))
    nearest, sums, samples = np.full(count, np.inf), np.zeros(count), np.zeros(count)
    sample = int(topology.faces[0, 0])
    for _ in range(min(DISTANCE_SAMPLES, count)):
        distances = csgraph.dijkstra(graph, directed=False, indices=[sample])[0]
        reached = np.isfinite(distances)
        sums[reached] += distances[reached]
        samples += reached
        nearest = np.minimum(nearest, distances)
        sample = int(nearest.argmax())
    means = sums / np.maximum(samples, 1.0)
    component = topology.component_of_vertex
    least = np.full(component.max() + 1, np.inf)
    np.minimum.at(least, component, means)
    return np.asarray(means - least[component])


def merge_pieces(centres: Float, topology: Topology, areas: Float, pieces: Index, parts: int) -> Index:
    """Merge pieces ``(F,)`` of faces with centres ``(F, 3)`` and areas ``(F,)`` until few are left."""
    count = int(pieces.max()) + 1
    weights = np.bincount(pieces, areas, count)
    sums = scatter_add(areas[:, None] * centres, pieces, count)
    neighbours: list[set[int]] = [set() for _ in range(count)]

    def cost(i: int, j: int) -> float:
        distance = sums[i] / weights[i] - sums[j] / weights[j]
        return float(weights[i] * weights[j] / (weights[i] + weights[j]) * np.square(distance).sum())

    merged = np.arange(count)  # piece that a piece has become part of
    queue = []
    for i, j in Boundaries.from_labels(topology, pieces).parts.tolist():
        neighbours[i].add(j)
        neighbours[j].add(i)
        queue.append((cost(i, j), i, j, 0))
    heapq.heapify(queue)
    versions, left = np.zeros(count, dtype=np.int64), count
    while left > parts and queue:
        _, i, j, version = heapq.heappop(queue)
        if merged[i] != i or merged[j] != j or version != versions[i] + versions[j]:
            continue
        merged[merged == j] = i
        weights[i] += weights[j]
        sums[i] += sums[j]
        neighbours[i] = (neighbours[i] | neighbours[j]) - {i, j}
        versions[i] += versions[j] + 1
        left -= 1
        for k in neighbours[i]:
            neighbours[k] = (neighbours[k] - {j}) | {i}
            low, high = min(i, k), max(i, k)
            heapq.heappush(queue, (cost(low, high), low, high, int(versions[i] + versions[k])))
    return merged[pieces]
