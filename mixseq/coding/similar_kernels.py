"""Compiled loops of `mixseq.coding.prediction` that find nodes that are alike: sums in a fixed order.

Decoders get the same nodes on every machine.
"""

from __future__ import annotations

import numpy as np

from mixseq.arrays import Float, Index
from mixseq.compiled import compiled, inlined


@compiled
def nearest(
    values: Float, neighbours: Index, counts: Index, thorough: int, most: int, found: Index, sizes: Index
) -> None:
    """Write the nodes before every node that are nearest to it in the values (N, D), but for its neighbours.

    The first nodes look at all nodes before them; later ones at neighbours of their neighbours, and at what was found
    for these.
    """
    apart = np.empty(most)
    for node in range(len(values)):
        sizes[node] = 0
        if node < thorough:
            for other in range(node):
                _consider(node, other, values, neighbours, counts, most, found, sizes, apart)
            continue
        for i in range(counts[node]):
            beside = neighbours[node, i]
            for j in range(counts[beside]):
                _consider(node, neighbours[beside, j], values, neighbours, counts, most, found, sizes, apart)
            for j in range(sizes[beside]):
                _consider(node, found[beside, j], values, neighbours, counts, most, found, sizes, apart)


@inlined
def _consider(
    node: int,
    other: int,
    values: Float,
    neighbours: Index,
    counts: Index,
    most: int,
    found: Index,
    sizes: Index,
    apart: Float,
) -> None:
    """Insert a node into the nearest ones, if it is one of them, and not among the neighbours."""
    distance = 0.0
    limit = apart[most - 1] if sizes[node] == most else np.inf
    for dimension in range(values.shape[1]):
        one = values[node, dimension] - values[other, dimension]
        distance += one * one
        if distance >= limit:
            break
    if distance < limit:
        known = False
        for i in range(counts[node]):
            known = known or neighbours[node, i] == other
        for i in range(sizes[node]):
            known = known or found[node, i] == other
        if not known:
            place = sizes[node] if sizes[node] < most else most - 1
            while place > 0 and apart[place - 1] > distance:
                apart[place] = apart[place - 1]
                found[node, place] = found[node, place - 1]
                place -= 1
            apart[place] = distance
            found[node, place] = other
            if sizes[node] < most:
                sizes[node] += 1
