"""Fields and tracks as streams of bytes, and back.

Fields go to several streams, each with twice as many as the one before, so that a damaged file still has the most
important ones. Tracks go to one stream for every chunk of frames, and every chunk is coded by itself.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mixseq.coding.basis import Basis
from mixseq.coding.coded import FactorName
from mixseq.coding.entropy import Reader, Writer
from mixseq.coding.factors import Factors
from mixseq.coding.fields import FieldCoder
from mixseq.coding.graph import SignalGraph, path_graph

Float = NDArray[np.float64]

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
    factors: Factors, step: float, graph: SignalGraph, dry: bool = False
) -> tuple[Float, tuple[bytes, ...]]:
    """Code fields until they are zero.

    Parameters
    ----------
    factors : Factors
        The fields.
    step : float
        Quantisation step.
    graph : SignalGraph
        Of the mesh.
    dry : bool
        Leave out the coding proper, and return empty streams: to see what rounding does.

    Returns
    -------
    fields : (K, c, V) float64
        Fields as a decoder has them, without the constant one of trajectories.
    streams : tuple of bytes
        Streams of the groups.
    """
    coder = FieldCoder(graph, factors.fields.shape[1])
    fields: list[Float] = []
    streams: list[bytes] = []
    zeros = 0
    for group in groups(len(factors.fields)):
        writer = Writer()
        for place in range(group.start, group.stop):
            numbers = factors.fields[place : place + 1][0] / step
            fields.append(
                np.stack([coder.quantise(one) if dry else coder.write(writer, one) for one in numbers])
            )
            zeros = 0 if fields[-1].any() else zeros + 1
            if zeros == ZEROS:
                break
        streams.append(writer.finish())
        if zeros == ZEROS:
            break
    rank = max(len(fields) - zeros, 1)
    return step * np.array(fields[:rank]), tuple(streams[: len(groups(rank))])


def read_fields(
    streams: tuple[bytes, ...], rank: int, coordinates: int, step: float, graph: SignalGraph
) -> Float:
    """Return the fields ``(K, c, V)`` of streams; of the groups that are there, if some are missing at the end."""
    coder = FieldCoder(graph, coordinates)
    fields: list[Float] = []
    for group, stream in zip(groups(rank), streams, strict=False):
        reader = Reader(stream)
        for _ in range(group.start, group.stop):
            fields.append(np.stack([coder.read(reader) for _ in range(coordinates)]))
    return step * np.array(fields).reshape(-1, coordinates, graph.size)


def basis_of(name: FactorName, fields: Float, frame_count: int) -> Basis:
    """Return the basis of coded fields ``(K, c, V)``, without those that are zero: they have no tracks."""
    there: NDArray[np.bool_] = np.any(fields, axis=(1, 2))
    there[:1] |= name == "shapes"  # the mean, which may be zero
    fields = fields[there]
    if name == "trajectories":
        constant = np.full((1, 1, fields.shape[2]), 1 / np.sqrt(fields.shape[2]))
        fields = np.concatenate([constant, fields])
    return Basis(name, fields, frame_count)


def write_tracks(basis: Basis, tracks: Float, step: float, dry: bool = False) -> tuple[Float, list[bytes]]:
    """Code tracks ``(T, K, d)`` of the free fields; return them as decoders have them, and a stream for every chunk."""
    scales = basis.norms[basis.free, None] / step
    decoded = np.empty_like(tracks)
    streams = []
    for chunk in chunks(len(tracks)):
        coder, writer = FieldCoder(path_graph(len(chunk)), tracks.shape[2]), Writer()
        frames = slice(chunk.start, chunk.stop)
        for place, coordinate in np.ndindex(tracks.shape[1:]):
            numbers = tracks[frames, place, coordinate] * scales[place]
            values = coder.quantise(numbers) if dry else coder.write(writer, numbers)
            decoded[frames, place, coordinate] = values / scales[place]
        streams.append(writer.finish())
    return decoded, streams


def read_tracks(basis: Basis, stream: bytes, count: int, step: float) -> Float:
    """Return the tracks ``(n, K, d)`` of the free fields in a chunk of `count` frames."""
    scales = basis.norms[basis.free] / step
    dim = 3 if basis.name == "trajectories" else 1
    coder, reader = FieldCoder(path_graph(count), dim), Reader(stream)
    tracks = np.empty((count, len(scales), dim))
    for place, coordinate in np.ndindex(tracks.shape[1:]):
        tracks[:, place, coordinate] = coder.read(reader) / scales[place]
    return tracks
