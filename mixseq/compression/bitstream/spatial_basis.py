r"""Read the spatial basis and the coefficients of a compressed sequence from streams of bytes.

A frame is a sum of basis vectors over the mesh, with coefficients over time,

.. math:: x_t(v) = \sum_k u_k(t)\, b_k(v)

trajectories
    A basis vector has one number at each vertex, and three coefficients at each frame. The first vector,
    :math:`b_0 = 1 / \sqrt V`, is known. If the mesh is cut into parts, every part has a basis that is zero elsewhere.
shapes
    A basis vector has three coordinates at each vertex, and one coefficient at each frame. The first vector is the mean
    shape, whose coefficient :math:`u_0 = 1 / \sqrt T` is known.

Basis vectors are split into groups with one stream each. A group is twice as large as the group before, so that a
damaged file keeps the most important vectors. Every group has vectors of all parts; the first one begins with the part
labels of vertices, each predicted from its known neighbours. Coefficients have one stream per chunk of frames, coded
independently.

In-betweens move in the spatial basis, or in an affine basis, which takes no bytes: in every labelled part, the
functions 1, x, y and z of the position in the first frame, made orthogonal in this order (Gram-Schmidt).

Frozen: changing this breaks old files (specified in ``docs/file-format.md``; golden:
``tests/compression/golden/*.npz``). `mixseq.compression.encoder.trial` writes these streams.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixseq.compression.bitstream.arithmetic import (
    DAMAGE_CURE,
    BitModels,
    BitStream,
    code_modelled_bit,
    load_state,
    new_bit_models,
    store_state,
)
from mixseq.compression.bitstream.signal_coder import Reader, SignalCoder, Writer, new_number_models
from mixseq.compression.bitstream.signal_graph import (
    NEIGHBOUR_COUNTS,
    SignalGraph,
    edge_neighbours,
    mesh_graph,
    path_graph,
    ring_graph,
)
from mixseq.errors import FormatError
from mixseq.mesh.topology_kernels import number_pairs, pair_sides
from mixseq.runtime.jit import compiled
from mixseq.runtime.parallel import two_thread_executor
from mixseq.types import Float, Index, Int32

MAX_PARTS = 128  # largest number of parts of a mesh; frozen: files with more parts are refused
FIRST_GROUP_SIZE = 12  # number of basis vectors in the first group; frozen
MIN_FIELD_NORM = 1e-6  # norm in diagonals up to which affine fields are left out; frozen
_LABEL_BITS = 7  # number of bits of a label; frozen


def write_labels(writer: Writer, labels: Index, graph: SignalGraph) -> None:
    """Write the part labels ``(N,)`` of the nodes of a graph."""
    node_labels = labels[graph.order]
    _code_labels(writer.reserve(graph.size), _new_label_models(), node_labels, graph.neighbours, graph.counts)
    writer.add_to_checksum(node_labels)


def read_labels(reader: Reader, part_count: int, graph: SignalGraph) -> Index:
    """Read the part labels ``(N,)`` written by `write_labels` for `part_count` parts."""
    node_labels = np.zeros(graph.size, dtype=np.int64)
    _code_labels(reader.stream(), _new_label_models(), node_labels, graph.neighbours, graph.counts)
    reader.add_to_checksum(node_labels)
    if not np.array_equal(np.unique(node_labels), np.arange(part_count)):
        raise FormatError(f"the labels of the mesh are damaged: {part_count} parts are expected; {DAMAGE_CURE}")
    labels = np.empty_like(node_labels)
    labels[graph.order] = node_labels
    return labels


@dataclass(frozen=True)
class FaceLabels:
    """The coded labels of triangles in `count` parts."""

    count: int
    data: bytes


def encode_face_labels(labels: Index, faces: NDArray[np.integer]) -> FaceLabels:
    """Code the labels ``(F,)``, below `MAX_PARTS`, of triangles ``(F, 3)``."""
    writer = Writer()
    write_labels(writer, labels, _face_graph(faces))
    return FaceLabels(int(labels.max()) + 1, writer.finish())


def decode_face_labels(coded: FaceLabels | None, faces: NDArray[np.integer]) -> Index | None:
    """Decode the labels ``(F,)`` of triangles ``(F, 3)``; None if there are none."""
    if coded is None:
        return None
    reader = Reader(coded.data)
    labels = read_labels(reader, coded.count, _face_graph(faces))
    reader.finish()
    return labels


def _face_graph(faces: NDArray[np.integer]) -> SignalGraph:
    """Return the graph of triangles ``(F, 3)`` that share an edge with exactly one other triangle."""
    starts = faces.astype(np.int32).reshape(-1)
    ends = np.roll(faces, -1, axis=1).astype(np.int32).reshape(-1)
    low, high = np.minimum(starts, ends), np.maximum(starts, ends)
    edges, edge_ids = number_pairs(low, high, int(high.max(initial=-1)) + 1)
    sides = pair_sides(edge_ids, len(edges))
    pairs = sides[np.bincount(edge_ids)[edge_ids[sides[:, 0]]] == 2] // 3
    del starts, ends, low, high, edges, edge_ids, sides  # as large as the graph
    return ring_graph(*edge_neighbours(pairs, len(faces)))


def _new_label_models() -> BitModels:
    return new_bit_models(2, NEIGHBOUR_COUNTS * NEIGHBOUR_COUNTS, 2 + (1 << _LABEL_BITS))


@compiled
def _code_labels(stream: BitStream, models: BitModels, labels: Index, neighbours: Int32, counts: Int32) -> None:
    """Write or read the labels ``(N,)`` of nodes."""
    state, votes = load_state(stream), np.zeros(1 << _LABEL_BITS, dtype=np.int64)
    for node in range(len(labels)):
        count = counts[node]
        for i in range(count):
            votes[labels[neighbours[node, i]]] += 1
        # Ties go to the label of the last neighbour, which is the nearest.
        first, second = -1, -1
        for i in range(count - 1, -1, -1):
            label = labels[neighbours[node, i]]
            if first < 0 or votes[label] > votes[first]:
                first = label
        for i in range(count - 1, -1, -1):
            label = labels[neighbours[node, i]]
            if label != first and (second < 0 or votes[label] > votes[second]):
                second = label
        first_votes, second_votes = (votes[first] if first >= 0 else 0), (votes[second] if second >= 0 else 0)
        for i in range(count):
            votes[labels[neighbours[node, i]]] = 0
        contexts = (first_votes * NEIGHBOUR_COUNTS + second_votes, first_votes * NEIGHBOUR_COUNTS + count)
        label, is_first, is_second = labels[node], 0, 0
        if first >= 0:
            is_first, state = code_modelled_bit(stream, state, models, contexts, 0, 1 if label == first else 0)
        if second >= 0 and not is_first:
            is_second, state = code_modelled_bit(stream, state, models, contexts, 1, 1 if label == second else 0)
        if is_first or is_second:
            labels[node] = first if is_first else second
            continue
        prefix = 1  # a 1, then the bits coded up to now
        for shift in range(_LABEL_BITS - 1, -1, -1):
            bit, state = code_modelled_bit(stream, state, models, (0, 0), 1 + prefix, (label >> shift) & 1)
            prefix = 2 * prefix + bit
        labels[node] = prefix - (1 << _LABEL_BITS)
    store_state(stream, state)


BasisKind = Literal["trajectories", "shapes"]


class Part(NamedTuple):
    """Vertices ``(n,)`` of a part, ascending, and the graph over these vertices."""

    vertices: Index
    graph: SignalGraph


def split_parts(labels: Index, faces: NDArray[np.integer]) -> list[Part]:
    """Return the parts of labels ``(V,)`` 0 ... P - 1, with graphs of the `faces` ``(F, 3)`` inside each part."""
    vertices = part_vertices(labels)
    graphs = two_thread_executor()(
        lambda _, part: build_part_graph(part, vertices[part], labels, faces), None, range(len(vertices))
    )
    return list(map(Part, vertices, graphs))


def part_vertices(labels: Index) -> list[Index]:
    """Return the ascending vertices of every part with labels ``(V,)``."""
    return [np.flatnonzero(labels == part) for part in range(int(labels.max(initial=-1)) + 1)]


def build_part_graph(part: int, vertices: Index, labels: Index, faces: NDArray[np.integer]) -> SignalGraph:
    """Return the graph over the vertices ``(n,)`` of a part, from the `faces` ``(F, 3)`` inside the part."""
    inner_faces = faces[(labels[faces] == part).all(axis=1)]
    return mesh_graph(np.searchsorted(vertices, inner_faces), len(vertices))


class PartBasis(NamedTuple):
    """The basis of a part: its vertices ``(n,)``, ascending, and the vectors ``(K, c, n)`` over these vertices."""

    vertices: Index
    vectors: Float


@dataclass(frozen=True, eq=False)
class SpatialBasis:
    """A decoded spatial basis."""

    kind: BasisKind  # vectors of trajectories or of shapes
    # Basis vectors of every part, in the units of the sequence, zero outside the part. Trajectories: c = 1, the first
    # vector of a part is constant. Shapes: c = 3, the first vector is the mean times the root of T.
    part_bases: tuple[PartBasis, ...]
    part_ids: Index  # (K,) part of every vector, in the order of coefficients
    frame_count: int  # number T of frames

    @property
    def vertex_count(self) -> int:
        """Number V of vertices."""
        return sum(len(basis.vertices) for basis in self.part_bases)

    @property
    def norms(self) -> Float:
        """Norms ``(K,)`` of the vectors."""
        norms = np.empty(len(self.part_ids))
        for part, basis in enumerate(self.part_bases):
            norms[self.part_ids == part] = np.sqrt(np.square(basis.vectors).sum(axis=(1, 2)))
        return norms

    @property
    def vectors(self) -> Float:
        """All vectors ``(K, c, V)`` over the whole mesh."""
        coordinates = np.arange(1 if self.kind == "trajectories" else 3)
        vectors = np.zeros((len(self.part_ids), len(coordinates), self.vertex_count))
        for part, basis in enumerate(self.part_bases):
            vectors[np.ix_(self.part_ids == part, coordinates, basis.vertices)] = basis.vectors
        return vectors

    @property
    def varying(self) -> slice:
        """Slice of the vectors with coded coefficients: all but the mean shape."""
        return slice(0 if self.kind == "trajectories" else 1, None)

    @property
    def coefficient_shape(self) -> tuple[int, int]:
        """Shape ``(K, d)`` of the coefficients of the varying vectors at a frame."""
        return len(self.part_ids[self.varying]), 3 if self.kind == "trajectories" else 1

    def frames(self, coefficients: Float) -> Float:
        """Return the frames ``(T, V, 3)`` with coefficients ``(T, K, 3 / c)`` of the varying vectors."""
        if self.kind == "shapes":
            vectors = self.part_bases[0].vectors
            mean = vectors[0].T / np.sqrt(self.frame_count)
            displacements = np.tensordot(coefficients[..., 0], vectors[1:], 1)
            return np.asarray(mean + displacements.transpose(0, 2, 1))
        frames = np.empty((len(coefficients), self.vertex_count, 3))
        for part, basis in enumerate(self.part_bases):
            of_part = coefficients[:, self.part_ids == part].transpose(0, 2, 1)
            frames[:, basis.vertices] = (of_part @ basis.vectors[:, 0]).transpose(0, 2, 1)
        return frames


MAX_NORM = 2.0**127  # limit on norms of basis vectors; frozen: players compute in single precision


def group_slices(rank: int) -> list[slice]:
    """Return the slice of a part's basis vectors in every group: 12, 24, 48, ... vectors."""
    ends, size = [0], FIRST_GROUP_SIZE
    while ends[-1] < rank:
        ends.append(min(ends[-1] + size, rank))
        size *= 2
    return [slice(a, b) for a, b in pairwise(ends)]


def part_groups(ranks: Sequence[int]) -> list[list[tuple[int, slice]]]:
    """Return the parts, and the slices of their vectors, in every group."""
    slices = [group_slices(rank) for rank in ranks]
    return [
        [(part, of_part[group]) for part, of_part in enumerate(slices) if group < len(of_part)]
        for group in range(max(map(len, slices), default=0))
    ]


def read_basis(
    streams: Sequence[bytes],
    ranks: Sequence[int],
    coordinates: int,
    step: float,
    faces: NDArray[np.integer],
    graph: SignalGraph,
) -> tuple[list[Float], list[Index]]:
    """Read the basis vectors ``(K, c, n)`` of every part; return vectors and vertices by part."""
    models, labels = new_number_models(), np.zeros(graph.size, dtype=np.int64)
    readers = [Reader(stream) for stream in streams]
    if len(ranks) > 1:
        labels = read_labels(readers[0], len(ranks), graph)
    vertices, signals = part_vertices(labels), [list[Float]() for _ in ranks]
    # Coders are created on demand and freed after use, as each takes over a kilobyte per vertex.
    coders: dict[int, SignalCoder] = {}
    for reader, group in zip(readers, part_groups(ranks), strict=True):
        for part, vectors in group:
            coder = coders.pop(part, None)
            if coder is None:
                if len(ranks) > 1:
                    graph = build_part_graph(part, vertices[part], labels, faces)
                coder = SignalCoder(graph, coordinates, models)
            for _ in range(coordinates * (vectors.stop - vectors.start)):
                signals[part].append(coder.read(reader))
            if vectors.stop < ranks[part]:
                coders[part] = coder
            del coder
        reader.finish()
    shapes = [(-1, coordinates, len(of_part)) for of_part in vertices]
    decoded = []
    for shape in shapes:
        decoded.append(np.array(signals.pop(0)).reshape(shape))
        decoded[-1] *= step
    return decoded, vertices


def assemble_basis(kind: BasisKind, vectors: list[Float], vertices: Sequence[Index], frame_count: int) -> SpatialBasis:
    """Make a basis from the decoded vectors ``(K, c, n)`` of all parts, without zero vectors, ordered by groups.

    The list is emptied, as vectors are large.
    """
    groups = part_groups(list(map(len, vectors)))
    nonzero_masks = [np.any(of_part, axis=(1, 2)) for of_part in vectors]
    if kind == "shapes":
        nonzero_masks[0][:1] = True  # keep the mean, even if it is zero
    part_bases, part_ids = [], [np.arange(len(vertices) if kind == "trajectories" else 0)]
    for ids, nonzero_mask in zip(vertices, nonzero_masks, strict=True):
        values = vectors.pop(0)[nonzero_mask]
        if kind == "trajectories":
            values = np.concatenate([np.full((1, 1, len(ids)), 1 / np.sqrt(len(ids))), values])
        part_bases.append(PartBasis(ids, values))
    for group in groups:
        part_ids += [np.full(np.count_nonzero(nonzero_masks[part][span]), part) for part, span in group]
    return SpatialBasis(kind, tuple(part_bases), np.concatenate(part_ids), frame_count)


def affine_basis(points: Float, labels: Index, diagonal: float) -> SpatialBasis:
    """Return the affine basis of parts with labels ``(V,)``, for points ``(V, 3)`` of the first frame."""
    vectors, vertices = [], part_vertices(labels)
    for vertex_ids in vertices:
        part_fields = (points[vertex_ids] - points[vertex_ids].mean(axis=0)).T.copy()
        for axis, field in enumerate(part_fields):
            for other in part_fields[:axis]:
                field -= other * (field @ other) / max(other @ other, np.finfo(float).tiny)
            if np.sqrt(field @ field) <= MIN_FIELD_NORM * diagonal:
                field[:] = 0.0
        vectors.append(part_fields[:, None])
    return assemble_basis("trajectories", vectors, vertices, 1)


def read_coefficients(basis: SpatialBasis, stream: bytes, counts: Sequence[int], step: float) -> list[Float]:
    """Read the coefficients ``(n, K, d)`` of the varying vectors at n times, for each of `counts`.

    The stream of a chunk has the coefficients at its frames; another one has those of its levels of in-betweens.
    """
    scales, part_ids, shape = basis.norms[basis.varying] / step, basis.part_ids[basis.varying], basis.coefficient_shape
    models, reader, levels = new_number_models(), Reader(stream), []
    for count in counts:
        graph, coefficients = path_graph(count), np.empty((count, *shape))
        coders = [SignalCoder(graph, shape[1], models) for _ in basis.part_bases]
        for vector, coordinate in np.ndindex(shape):
            coefficients[:, vector, coordinate] = coders[part_ids[vector]].read(reader) / scales[vector]
        levels.append(coefficients)
    reader.finish()
    return levels
