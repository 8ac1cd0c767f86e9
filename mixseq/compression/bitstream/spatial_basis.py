r"""The spatial basis and the coefficients of a compressed sequence, read from streams of bytes.

A frame is a sum of basis vectors over the mesh, with coefficients over time,

.. math:: x_t(v) = \sum_k u_k(t)\, b_k(v)

trajectories
    A basis vector has one number at each vertex, and three coefficients at each frame. The first one,
    :math:`b_0 = 1 / \sqrt V`, is known. A mesh may be cut into parts with a basis each, which is zero elsewhere.
shapes
    A basis vector has three coordinates at each vertex, and one coefficient at each frame. The first one is the mean
    shape, whose coefficient :math:`u_0 = 1 / \sqrt T` is known.

Basis vectors are split into streams (groups), each with twice as many as the one before, so that a damaged file keeps
the most important ones; every stream has vectors of all parts. Coefficients have one stream per chunk of frames, coded
independently.

The first group begins with the part of every vertex, in the order of the mesh's graph: whether a vertex has the most
frequent label of its known neighbours, or the second most frequent, and else the label itself, from its highest bit.
The contexts of both questions are the number of neighbours, and the numbers with either label.

Frozen: changing this breaks old files (golden: ``tests/compression/golden/*.npz``; ``parts.npz`` has several parts,
``shapes.npz`` several groups, ``long.npz`` several chunks). `mixseq.compression.encoder.trial` writes these streams.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixseq.compression.bitstream.arithmetic import BitModels, Coded, bit_models, code
from mixseq.compression.bitstream.signal_coder import NumberModels, Reader, SignalCoder, Writer
from mixseq.compression.bitstream.signal_graph import NEIGHBOUR_COUNTS, SignalGraph, mesh_graph, path_graph
from mixseq.errors import FormatError
from mixseq.runtime.jit import compiled
from mixseq.runtime.parallel import two_thread_executor
from mixseq.types import Float, Index

MOST_PARTS = 128
"""Largest number of parts of a mesh. Frozen: files with more are refused."""

GROUP = 12
"""Basis vectors in the first group. Frozen: another number breaks old files."""

_BITS = 7
"""Bits of a label. Frozen: breaks old files."""


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
    return bit_models(2, NEIGHBOUR_COUNTS * NEIGHBOUR_COUNTS, 2 + (1 << _BITS))


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
        models.contexts[0] = most * NEIGHBOUR_COUNTS + fewer
        models.contexts[1] = most * NEIGHBOUR_COUNTS + count
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


BasisKind = Literal["trajectories", "shapes"]


class Part(NamedTuple):
    """Vertices ``(n,)`` of a part, increasing, and the graph over them."""

    vertices: Index
    graph: SignalGraph


def whole(graph: SignalGraph) -> tuple[Part, ...]:
    """Return the mesh as its only part."""
    return (Part(np.arange(graph.size), graph),)


def parts_of(labels: Index, faces: NDArray[np.integer]) -> tuple[Part, ...]:
    """Return the parts of labels ``(V,)`` 0 ... P - 1, each with the triangles ``(F, 3)`` that lie inside it."""
    return tuple(two_thread_executor()(_part, (labels, faces), enumerate(vertices_of(labels))))


def _part(mesh: tuple[Index, NDArray[np.integer]], part: tuple[int, Index]) -> Part:
    """Return the part of a mesh (labels and triangles) with a number and vertices ``(n,)``."""
    number, vertices = part
    return Part(vertices, part_graph(number, vertices, *mesh))


def vertices_of(labels: Index) -> list[Index]:
    """Return the vertices of every part, increasing."""
    return [np.flatnonzero(labels == part) for part in range(int(labels.max(initial=-1)) + 1)]


def part_graph(part: int, vertices: Index, labels: Index, faces: NDArray[np.integer]) -> SignalGraph:
    """Return the graph over the vertices ``(n,)`` of a part."""
    inside = faces[(labels[faces] == part).all(axis=1)]
    return mesh_graph(np.searchsorted(vertices, inside), len(vertices))


class Block(NamedTuple):
    """The basis of a part: its vertices ``(n,)``, increasing, and the vectors ``(K, c, n)`` over them."""

    vertices: Index
    vectors: Float


@dataclass(frozen=True, eq=False)
class SpatialBasis:
    """A decoded spatial basis."""

    kind: BasisKind  # vectors of trajectories or of shapes
    # Basis vectors of every part, in the units of the sequence; they are zero everywhere else. c = 1 of trajectories,
    # the first of which are constant; c = 3 of shapes, the first of which is the mean times the root of T.
    blocks: tuple[Block, ...]
    parts: Index  # (K,) part that a vector belongs to, for all vectors in the order of their coefficients
    frame_count: int  # number T of frames

    @property
    def vertex_count(self) -> int:
        """Number V of vertices."""
        return sum(len(block.vertices) for block in self.blocks)

    @property
    def norms(self) -> Float:
        """Norms ``(K,)`` of the vectors."""
        norms = np.empty(len(self.parts))
        for place, block in enumerate(self.blocks):
            norms[self.parts == place] = np.sqrt(np.square(block.vectors).sum(axis=(1, 2)))
        return norms

    @property
    def vectors(self) -> Float:
        """All vectors ``(K, c, V)`` over the whole mesh."""
        vectors = np.zeros((len(self.parts), 1 if self.kind == "trajectories" else 3, self.vertex_count))
        for place, block in enumerate(self.blocks):
            vectors[np.ix_(self.parts == place, np.arange(vectors.shape[1]), block.vertices)] = block.vectors
        return vectors

    @property
    def varying(self) -> slice:
        """Slice of the vectors with coded coefficients: all but the mean shape."""
        return slice(0 if self.kind == "trajectories" else 1, None)

    def frames(self, coefficients: Float) -> Float:
        """Return the frames ``(T, V, 3)`` of coefficients ``(T, K, 3 / c)`` of the varying vectors."""
        if self.kind == "shapes":
            vectors = self.blocks[0].vectors
            mean = vectors[0].T / np.sqrt(self.frame_count)
            moved = np.tensordot(coefficients[..., 0], vectors[1:], 1)
            return np.asarray(mean + moved.transpose(0, 2, 1))
        frames = np.empty((len(coefficients), self.vertex_count, 3))
        for place, block in enumerate(self.blocks):
            own = coefficients[:, self.parts == place].transpose(0, 2, 1)
            frames[:, block.vertices] = (own @ block.vectors[:, 0]).transpose(0, 2, 1)
        return frames


def groups(rank: int) -> list[slice]:
    """Return the slice of basis vectors in every stream: 12, 24, 48, ... vectors."""
    ends, size = [0], GROUP
    while ends[-1] < rank:
        ends.append(min(ends[-1] + size, rank))
        size *= 2
    return [slice(a, b) for a, b in pairwise(ends)]


def groups_of_parts(ranks: Sequence[int]) -> list[list[tuple[int, slice]]]:
    """Return the parts, and slices of their vectors, in every stream."""
    of_parts = [groups(rank) for rank in ranks]
    return [
        [(place, some[number]) for place, some in enumerate(of_parts) if number < len(some)]
        for number in range(max(map(len, of_parts), default=0))
    ]


def read_basis(
    streams: Sequence[bytes],
    ranks: Sequence[int],
    coordinates: int,
    step: float,
    faces: NDArray[np.integer],
    graph: SignalGraph,
) -> tuple[list[Float], list[Index]]:
    """Return the basis vectors ``(K, c, n)`` of every part, and its vertices."""
    models, labels = NumberModels(), np.zeros(graph.size, dtype=np.int64)
    readers = [Reader(stream) for stream in streams]
    if len(ranks) > 1:
        labels = read_labels(readers[0], len(ranks), graph)
    parts, vectors = vertices_of(labels), [list[Float]() for _ in ranks]
    # Made on demand and freed after use, as a coder takes more than a kilobyte a vertex.
    coders: dict[int, SignalCoder] = {}
    for reader, of_parts in zip(readers, groups_of_parts(ranks), strict=True):
        for place, group in of_parts:
            coder = coders.pop(place, None)
            if coder is None:
                own = part_graph(place, parts[place], labels, faces) if len(ranks) > 1 else graph
                coder = SignalCoder(own, coordinates, models)
            for _ in range(group.start, group.stop):
                vectors[place] += [coder.read_ahead(reader) for _ in range(coordinates)]
            if group.stop < ranks[place]:
                coders[place] = coder
            del coder
        reader.finish()
    decoded = [
        step * np.array(some).reshape(-1, coordinates, len(vertices))
        for some, vertices in zip(vectors, parts, strict=True)
    ]
    return decoded, parts


def assemble_basis(
    kind: BasisKind, vectors: Sequence[Float], parts: Sequence[Index], frame_count: int
) -> SpatialBasis:
    """Return the basis of decoded vectors ``(K, c, n)`` of all parts, without zero ones, ordered by groups."""
    kept = [np.any(some, axis=(1, 2)) for some in vectors]
    if kind == "shapes":
        kept[0][:1] = True  # the mean, which may be zero
    blocks, owners = [], [np.arange(len(parts) if kind == "trajectories" else 0)]
    for vertices, some, there in zip(parts, vectors, kept, strict=True):
        constant = np.full((1, 1, len(vertices)), 1 / np.sqrt(len(vertices)))
        stacked = some[there] if kind == "shapes" else np.concatenate([constant, some[there]])
        blocks.append(Block(vertices, stacked))
    for of_parts in groups_of_parts([len(some) for some in vectors]):
        owners += [np.full(np.count_nonzero(kept[place][group]), place) for place, group in of_parts]
    return SpatialBasis(kind, tuple(blocks), np.concatenate(owners), frame_count)


def read_coefficients(basis: SpatialBasis, stream: bytes, count: int, step: float) -> Float:
    """Return the coefficients ``(n, K, d)`` of the varying vectors in a chunk of `count` frames."""
    scales = basis.norms[basis.varying] / step
    models, graph = NumberModels(), path_graph(count)
    coefficients = np.empty((count, len(scales), 3 if basis.kind == "trajectories" else 1))
    coders = [SignalCoder(graph, coefficients.shape[2], models) for _ in basis.blocks]
    reader = Reader(stream)
    for place, coordinate in np.ndindex(coefficients.shape[1:]):
        coder = coders[basis.parts[basis.varying][place]]
        coefficients[:, place, coordinate] = coder.read(reader) / scales[place]
    reader.finish()
    return coefficients
