"""Sorting and connecting the elements of meshes in linear time, compiled."""

from __future__ import annotations

import numpy as np

from mixseq.runtime.jit import compiled, force_inlined
from mixseq.types import Int32, IntArray


@compiled
def sort_by_key(keys: Int32, order: Int32, key_count: int) -> Int32:
    """Return indices ``(n,)`` of keys below `key_count`, sorted stably by their keys."""
    ends = np.zeros(key_count, dtype=np.int32)
    for key in keys:
        ends[key] += 1
    total = 0
    for key in range(key_count):
        total += ends[key]
        ends[key] = total
    result = np.empty_like(order)
    for k in range(len(order) - 1, -1, -1):
        key = keys[order[k]]
        ends[key] -= 1
        result[ends[key]] = order[k]
    return result


@compiled
def number_pairs(low: Int32, high: Int32, node_count: int) -> tuple[Int32, Int32]:
    """Return distinct pairs ``(E, 2)`` of nodes in lexicographic order, and the pair ``(n,)`` at every index."""
    order = sort_by_key(high, np.arange(len(low)).astype(np.int32), node_count)
    order = sort_by_key(low, order, node_count)
    pair_of_index = np.empty(len(low), dtype=np.int32)
    count = 0
    for k in range(len(order)):
        i = order[k]
        if k == 0 or low[i] != low[order[k - 1]] or high[i] != high[order[k - 1]]:
            count += 1
        pair_of_index[i] = count - 1
    pairs = np.empty((count, 2), dtype=np.int32)
    for i in range(len(low)):
        pairs[pair_of_index[i], 0] = low[i]
        pairs[pair_of_index[i], 1] = high[i]
    return pairs, pair_of_index


@compiled
def pair_sides(edge_of_side: Int32, edge_count: int) -> Int32:
    """Return sides ``(H, 2)`` of consecutive, different faces at the same edge."""
    order = sort_by_key(edge_of_side, np.arange(len(edge_of_side)).astype(np.int32), edge_count)
    count = 0
    result = np.empty((max(len(order) - 1, 0), 2), dtype=np.int32)
    for k in range(len(order) - 1):
        first, second = order[k], order[k + 1]
        if edge_of_side[first] == edge_of_side[second] and first // 3 != second // 3:
            result[count, 0], result[count, 1] = first, second
            count += 1
    return result[:count].copy()


@compiled
def neighbour_lists(pairs: Int32, node_count: int) -> tuple[Int32, Int32]:
    """Return starts ``(node_count + 1,)`` and neighbours ``(2 n,)`` of nodes, by distinct pairs ``(n, 2)`` in order."""
    starts = np.zeros(node_count + 1, dtype=np.int32)
    for k in range(len(pairs)):
        starts[pairs[k, 0]] += 1
        starts[pairs[k, 1]] += 1
    total = 0
    for node in range(node_count + 1):
        total += starts[node]
        starts[node] = total
    neighbours = np.empty(2 * len(pairs), dtype=np.int32)
    # From the last to the first: lower neighbours of a node come before higher ones.
    for side in (0, 1):
        for k in range(len(pairs) - 1, -1, -1):
            node = pairs[k, side]
            starts[node] -= 1
            neighbours[starts[node]] = pairs[k, 1 - side]
    return starts, neighbours


@force_inlined
def find_root(parent: IntArray, node: int) -> int:
    """Return the root of a node in a union-find forest, and halve the path to it."""
    while parent[node] != node:
        parent[node] = parent[parent[node]]
        node = parent[node]
    return node


@compiled
def number_components(pairs: Int32, node_count: int) -> Int32:
    """Number the connected components ``(node_count,)`` of nodes in order of their first nodes, by pairs ``(n, 2)``."""
    parent = np.arange(node_count).astype(np.int32)  # no higher than the node
    for k in range(len(pairs)):
        a, b = find_root(parent, pairs[k, 0]), find_root(parent, pairs[k, 1])
        parent[max(a, b)] = min(a, b)
    count = 0
    for node in range(node_count):
        if parent[node] == node:
            parent[node] = count
            count += 1
        else:
            parent[node] = parent[parent[node]]
    return parent
