"""Read the part of every vertex as model versions 4 and 7 have it.

In the order of the mesh's graph: whether a vertex has the label that most known neighbours have, in the context of how
many do, and its label, if not.

Frozen: changing this breaks old files (golden: ``tests/coding/golden/parts.npz``).
"""

from __future__ import annotations

import numpy as np

from mixseq.arrays import Index
from mixseq.coding.bitstream.entropy import Reader, Tables
from mixseq.coding.bitstream.signal_graph import SignalGraph
from mixseq.errors import FormatError

LABEL_CONTEXTS = 8
"""Contexts of labels: shares of the known neighbours with the expected one, in eighths. Frozen: breaks old files."""


def read_labels(reader: Reader, number: int, graph: SignalGraph) -> Index:
    """Return the labels ``(V,)`` of so many parts.

    Raises
    ------
    FormatError
        If they are damaged.
    """
    tables = Tables([0.5] * (LABEL_CONTEXTS + 1), 1)
    nodes = np.zeros(graph.size, dtype=np.int64)
    for batch in graph.batches:
        likely, contexts = _expected(nodes, batch, graph, number)
        flags = reader.get(contexts, tables)
        if ((flags < 0) | (flags > 1)).any():
            raise FormatError("labels of parts are damaged")
        likely[flags == 1] = reader.get_flat(int(flags.sum()), number)
        nodes[batch] = likely
    labels = np.empty_like(nodes)
    labels[graph.order] = nodes
    if len(np.unique(labels)) < number:
        raise FormatError("a part has no vertices; the file is damaged")
    return labels


def _expected(nodes: Index, batch: slice, graph: SignalGraph, number: int) -> tuple[Index, Index]:
    """Return the label ``(n,)`` that most known neighbours have, and contexts ``(n,)``: how many have it."""
    neighbours = graph.neighbours[batch]
    known = (np.arange(neighbours.shape[1]) < graph.counts[batch, None]) & (neighbours < batch.start)
    votes = np.zeros((len(neighbours), number), dtype=np.int64)
    rows, _ = np.nonzero(known)
    np.add.at(votes, (rows, nodes[neighbours[known]]), 1)
    likely = votes.argmax(axis=1)
    most = votes[np.arange(len(votes)), likely]
    return likely, LABEL_CONTEXTS * most // np.maximum(known.sum(axis=1), 1)
