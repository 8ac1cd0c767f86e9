"""Fields and tracks as streams of bytes, and back.

Fields go to several streams, each with twice as many as the one before, so that a damaged file still has the most
important ones; every stream has fields of all parts. Tracks go to one stream for every chunk of frames, and every chunk
is coded by itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Float
from mixseq.coding.basis import Basis
from mixseq.coding.coded import FactorName
from mixseq.coding.entropy import Reader, Writer
from mixseq.coding.factors import Factors
from mixseq.coding.fields import FieldCoder, NumberModels
from mixseq.coding.graph import SignalGraph, path_graph
from mixseq.coding.parts import Part, labels_of, parts_of, read_labels, whole, write_labels
from mixseq.errors import FormatError

GROUP = 12
"""Fields in the first stream."""

CHUNK = 512
"""A chunk has about so many frames."""

ZEROS = 3
"""Fields are coded until so many in a row are zero everywhere, after rounding."""


def groups(rank: int) -> list[slice]:
    """Return which fields are in which stream: 12, 24, 48, ..."""
    ends, size = [0], GROUP
    while ends[-1] < rank:
        ends.append(min(ends[-1] + size, rank))
        size *= 2
    return [slice(a, b) for a, b in pairwise(ends)]


def chunks(frame_count: int) -> list[range]:
    """Return the frames of every chunk."""
    number = max(1, round(frame_count / CHUNK))
    ends = [frame_count * place // number for place in range(number + 1)]
    return [range(a, b) for a, b in pairwise(ends)]


def write_fields(
    factors: Sequence[Factors], step: float, parts: Sequence[Part], graph: SignalGraph, dry: bool = False
) -> tuple[list[Float], tuple[bytes, ...]]:
    """Code fields until they are zero.

    Parameters
    ----------
    factors : sequence of Factors
        The fields of every part.
    step : float
        Quantisation step.
    parts : sequence of Part
        The parts of the mesh.
    graph : SignalGraph
        Of the whole mesh.
    dry : bool
        Leave out the coding proper, and return no streams: to see what rounding does.

    Returns
    -------
    fields : list of (K, c, n) float64
        Fields of every part as a decoder has them, without the constant one of trajectories.
    streams : tuple of bytes
        Streams of the groups.
    """
    fields = [_rounded(one, step, part) for one, part in zip(factors, parts, strict=True)]
    if dry:
        return fields, ()
    models, streams = NumberModels(), []
    coders = [
        FieldCoder(part.graph, one.fields.shape[1], models) for one, part in zip(factors, parts, strict=True)
    ]
    for number, of_parts in enumerate(_by_groups([len(some) for some in fields])):
        writer = Writer()
        if number == 0 and len(parts) > 1:
            write_labels(writer, labels_of(parts), graph)
        for place, group in of_parts:
            for row in range(group.start, group.stop):
                for values in factors[place].fields[row : row + 1][0] / step:
                    coders[place].write(writer, values)
        streams.append(writer.finish())
    return fields, tuple(streams)


def _rounded(factors: Factors, step: float, part: Part) -> Float:
    """Return the fields ``(K, c, n)`` of a part after rounding, until they are zero."""
    coder = FieldCoder(part.graph, factors.fields.shape[1])
    fields: list[Float] = []
    zeros = 0
    for place in range(len(factors.fields)):
        numbers = factors.fields[place : place + 1][0] / step
        fields.append(np.stack([coder.quantise(one) for one in numbers]))
        zeros = 0 if fields[-1].any() else zeros + 1
        if zeros == ZEROS:
            break
    return step * np.array(fields[: max(len(fields) - zeros, 1)])


def _by_groups(ranks: Sequence[int]) -> list[list[tuple[int, slice]]]:
    """Return which fields of which parts are in which stream: parts, and slices of their fields."""
    of_parts = [groups(rank) for rank in ranks]
    return [
        [(place, some[number]) for place, some in enumerate(of_parts) if number < len(some)]
        for number in range(max(map(len, of_parts)))
    ]


def read_fields(
    streams: Sequence[bytes],
    ranks: Sequence[int],
    coordinates: int,
    step: float,
    faces: NDArray[np.integer],
    graph: SignalGraph,
) -> tuple[list[Float], tuple[Part, ...]]:
    """Return the fields ``(K, c, n)`` of every part, and the parts; some groups may be missing at the end.

    Raises
    ------
    FormatError
        If the streams are damaged.
    """
    models, parts = NumberModels(), whole(graph)
    readers = [Reader(stream) for stream in streams]
    if len(ranks) > 1:
        if not readers:
            raise FormatError("the first fields are missing, with the parts of the mesh; the file is damaged")
        parts = parts_of(read_labels(readers[0], len(ranks), graph), faces)
    coders = [FieldCoder(part.graph, coordinates, models) for part in parts]
    fields: list[list[Float]] = [[] for _ in parts]
    for reader, of_parts in zip(readers, _by_groups(ranks), strict=False):
        for place, group in of_parts:
            for _ in range(group.start, group.stop):
                fields[place].append(np.stack([coders[place].read(reader) for _ in range(coordinates)]))
    decoded = [
        step * np.array(some).reshape(-1, coordinates, part.graph.size)
        for some, part in zip(fields, parts, strict=True)
    ]
    return decoded, parts


def basis_of(name: FactorName, fields: Sequence[Float], parts: Sequence[Part], frame_count: int) -> Basis:
    """Return the basis of coded fields ``(K, c, n)`` of all parts, without those that are zero: they have no tracks.

    Fields are in the order of their groups, so that those of the first groups come first.
    """
    vertices = sum(len(part.vertices) for part in parts)
    found: list[tuple[int, Float]] = []
    if name == "trajectories":
        found += [
            (place, np.full((1, 1, len(part.vertices)), 1 / np.sqrt(len(part.vertices))))
            for place, part in enumerate(parts)
        ]
    for of_parts in _by_groups([len(some) for some in fields]) if any(map(len, fields)) else ():
        for place, group in of_parts:
            some = fields[place][group]
            there: NDArray[np.bool_] = np.any(some, axis=(1, 2))
            there[:1] |= name == "shapes" and group.start == 0  # the mean, which may be zero
            found.append((place, some[there]))
    scattered = np.zeros((sum(len(some) for _, some in found), 1 if name == "trajectories" else 3, vertices))
    done = 0
    for place, some in found:
        scattered[done : done + len(some), :, parts[place].vertices] = some
        done += len(some)
    owners = np.repeat([place for place, _ in found], [len(some) for _, some in found]).astype(np.int64)
    return Basis(name, scattered, frame_count, owners)


def write_tracks(basis: Basis, tracks: Float, step: float, dry: bool = False) -> tuple[Float, list[bytes]]:
    """Code tracks ``(T, K, d)`` of the free fields; return them as decoders have them, and a stream for every chunk."""
    scales = basis.norms[basis.free, None] / step
    decoded = np.empty_like(tracks)
    streams = []
    for chunk in chunks(len(tracks)):
        writer, coders = Writer(), _track_coders(basis, len(chunk))
        frames = slice(chunk.start, chunk.stop)
        for place, coordinate in np.ndindex(tracks.shape[1:]):
            coder = coders[basis.parts[basis.free][place]]
            numbers = tracks[frames, place, coordinate] * scales[place]
            values = coder.quantise(numbers) if dry else coder.write(writer, numbers)
            decoded[frames, place, coordinate] = values / scales[place]
        streams.append(writer.finish())
    return decoded, streams


def read_tracks(basis: Basis, stream: bytes, count: int, step: float) -> Float:
    """Return the tracks ``(n, K, d)`` of the free fields in a chunk of `count` frames."""
    scales = basis.norms[basis.free] / step
    dim = 3 if basis.name == "trajectories" else 1
    coders, reader = _track_coders(basis, count), Reader(stream)
    tracks = np.empty((count, len(scales), dim))
    for place, coordinate in np.ndindex(tracks.shape[1:]):
        coder = coders[basis.parts[basis.free][place]]
        tracks[:, place, coordinate] = coder.read(reader) / scales[place]
    return tracks


def _track_coders(basis: Basis, count: int) -> list[FieldCoder]:
    """Coders of the tracks of all parts in a chunk of so many frames; they share their models."""
    models, dim = NumberModels(), 3 if basis.name == "trajectories" else 1
    number = int(basis.parts.max(initial=0)) + 1
    return [FieldCoder(path_graph(count), dim, models) for _ in range(number)]
