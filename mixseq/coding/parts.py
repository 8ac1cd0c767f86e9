r"""Parts of a mesh that are coded with a basis of their own.

Vertices that move with the same few bones need few components; all vertices together need as many as there are bones.
So the mesh is cut into parts, as clustered principal components do (Sattler, Sarlette and Klein 2005, *Simple and
efficient compression of animation sequences*), and every part has its own fields and tracks, all with one step. Which
parts there are is found by `mixseq.coding.joining`.

Labels are coded in the order of the mesh's graph: whether a vertex has the label that most known neighbours have,
in the context of how many agree, and its label, if not.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Index
from mixseq.coding.entropy import Reader, Tables, Writer
from mixseq.coding.graph import SignalGraph, mesh_graph
from mixseq.errors import FormatError

AGREEMENT = 8
"""Contexts of labels: shares of the known neighbours that agree, in eighths."""


class Part(NamedTuple):
    """Vertices ``(n,)`` of a part, increasing, and the graph over them."""

    vertices: Index
    graph: SignalGraph


def whole(graph: SignalGraph) -> tuple[Part, ...]:
    """Return the mesh as its only part."""
    return (Part(np.arange(graph.size), graph),)


def labels_of(parts: Sequence[Part]) -> Index:
    """Return the part ``(V,)`` of every vertex."""
    labels = np.empty(sum(len(part.vertices) for part in parts), dtype=np.int64)
    for number, part in enumerate(parts):
        labels[part.vertices] = number
    return labels


def parts_of(labels: Index, faces: NDArray[np.integer]) -> tuple[Part, ...]:
    """Return the parts of labels ``(V,)`` 0 ... P - 1, each with the triangles ``(F, 3)`` that lie inside it."""
    found = []
    for part in range(int(labels.max(initial=-1)) + 1):
        vertices = np.flatnonzero(labels == part)
        inside = faces[(labels[faces] == part).all(axis=1)]
        found.append(Part(vertices, mesh_graph(np.searchsorted(vertices, inside), len(vertices))))
    return tuple(found)


def write_labels(writer: Writer, labels: Index, graph: SignalGraph) -> None:
    """Code the part ``(V,)`` of every vertex; `graph` is that of the whole mesh."""
    tables, number = _tables(), int(labels.max(initial=0)) + 1
    nodes = labels[graph.order]
    for batch in graph.batches:
        likely, contexts = _expected(nodes, batch, graph, number)
        other = nodes[batch] != likely
        writer.put(other.astype(np.int64), contexts, tables)
        writer.put_flat(nodes[batch][other], number)


def read_labels(reader: Reader, number: int, graph: SignalGraph) -> Index:
    """Return the labels ``(V,)`` of so many parts that `write_labels` wrote.

    Raises
    ------
    FormatError
        If they are damaged.
    """
    tables = _tables()
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


def _tables() -> Tables:
    return Tables([0.5] * (AGREEMENT + 1), 1)


def _expected(nodes: Index, batch: slice, graph: SignalGraph, number: int) -> tuple[Index, Index]:
    """Return the label ``(n,)`` that most known neighbours have, and contexts ``(n,)``: how many have it."""
    neighbours = graph.neighbours[batch]
    known = (np.arange(neighbours.shape[1]) < graph.counts[batch, None]) & (neighbours < batch.start)
    votes = np.zeros((len(neighbours), number), dtype=np.int64)
    rows, _ = np.nonzero(known)
    np.add.at(votes, (rows, nodes[neighbours[known]]), 1)
    likely = votes.argmax(axis=1)
    most = votes[np.arange(len(votes)), likely]
    return likely, AGREEMENT * most // np.maximum(known.sum(axis=1), 1)
