"""Code the part of the mesh to which every vertex belongs.

In the order of the mesh's graph: whether a vertex has the most frequent label of its known neighbours, or the second
most frequent, and else the label itself, from its highest bit. The contexts of both questions are the number of
neighbours, and the numbers with either label.

Frozen: changing this breaks old files (golden: ``tests/coding/golden/parts.npz``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Index
from mixseq.coding.bitstream.arithmetic import Coded
from mixseq.coding.bitstream.bit_models import BitModels, bit_models, code
from mixseq.coding.bitstream.signal_coder import Reader, Writer
from mixseq.coding.bitstream.signal_graph import MOST, SignalGraph
from mixseq.compiled import compiled
from mixseq.errors import FormatError

_BITS = 7
"""Bits of a label. Frozen: breaks old files."""

_VOTES = MOST + 1
"""Number of neighbour counts, from none on. Frozen: breaks old files."""


def write_labels(writer: Writer, labels: Index, graph: SignalGraph) -> None:
    """Code the part ``(V,)`` of every vertex; `graph` is that of the whole mesh."""
    nodes = labels[graph.order]
    _code(writer.room(graph.size), _models(), nodes, graph.neighbours, graph.counts)
    writer.checked(nodes)


def read_labels(reader: Reader, number: int, graph: SignalGraph) -> Index:
    """Return the labels ``(V,)`` of `number` parts written by `write_labels`."""
    nodes = np.zeros(graph.size, dtype=np.int64)
    _code(reader.bits(), _models(), nodes, graph.neighbours, graph.counts)
    reader.checked(nodes)
    if not np.array_equal(np.unique(nodes), np.arange(number)):
        raise FormatError(f"the labels of vertices are not those of {number} parts; the file is damaged")
    labels = np.empty_like(nodes)
    labels[graph.order] = nodes
    return labels


def _models() -> BitModels:
    return bit_models(2, _VOTES * _VOTES, 2 + (1 << _BITS))


@compiled
def _code(
    coded: Coded, models: BitModels, labels: Index, neighbours: NDArray[np.int64], counts: Index
) -> None:
    """Write or read the labels ``(N,)`` of nodes."""
    votes = np.zeros(1 << _BITS, dtype=np.int64)
    for node in range(len(labels)):
        count = counts[node]
        for i in range(count):
            votes[labels[neighbours[node, i]]] += 1
        # Ties go to the label of the nearest neighbour, the last one.
        first, second = -1, -1
        for i in range(count - 1, -1, -1):
            label = labels[neighbours[node, i]]
            if first < 0 or votes[label] > votes[first]:
                first = label
        for i in range(count - 1, -1, -1):
            label = labels[neighbours[node, i]]
            if label != first and (second < 0 or votes[label] > votes[second]):
                second = label
        most, fewer = (votes[first] if first >= 0 else 0), (votes[second] if second >= 0 else 0)
        for i in range(count):
            votes[labels[neighbours[node, i]]] = 0
        models.contexts[0] = most * _VOTES + fewer
        models.contexts[1] = most * _VOTES + count
        label = labels[node]
        if first >= 0 and code(coded, models, 0, 1 if label == first else 0):
            labels[node] = first
            continue
        if second >= 0 and code(coded, models, 1, 1 if label == second else 0):
            labels[node] = second
            continue
        models.contexts[0] = models.contexts[1] = 0
        found = 1
        for place in range(_BITS - 1, -1, -1):
            found = 2 * found + code(coded, models, 1 + found, (label >> place) & 1)
        labels[node] = found - (1 << _BITS)
