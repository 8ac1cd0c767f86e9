"""The dataset ``streams`` of compressed models: an index, then all streams, one after the other.

The index says how long every stream is and what its CRC-32 is, so damage is known by stream. Even without HDF5 the
index is found, by its first bytes:

==========  =====================================================================================================
bytes       meaning, all numbers little-endian
==========  =====================================================================================================
4           ``msq4``
3 x 4       uint32: size of the lengths, size of the checksums, CRC-32 of both
any         lengths, as numbers of 7 bits a byte (LEB128): number of groups of fields, number of chunks, number of
            frames of every chunk, length of every stream
any         uint32 each: CRC-32 of the attribute ``coding``, and of every stream that is not empty
==========  =====================================================================================================

Streams are in this order: connectivity, surface, times; fields, group by group; tracks and corrections of
the first chunk, of the second, and so on.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from zlib import crc32

import numpy as np

from mixseq.coding.coded import Chunk
from mixseq.errors import FormatError
from mixseq_io.hdf5.files import refuse_newer
from mixseq_io.hdf5.packing import pack_whole, unpack_whole

CODED_VERSION = 4
"""Version of model files that hold a compressed sequence."""

MAGIC = b"msq4"
"""What the index begins with."""

_HEAD = struct.Struct("<4sIII")  # magic, bytes of the lengths, bytes of the checksums, checksum of both


@dataclass(frozen=True)
class Stored:
    """What is in a file: the attribute ``coding`` and the dataset ``streams``, as they are, and the version."""

    text: bytes
    streams: bytes
    version: int = CODED_VERSION


@dataclass(frozen=True)
class Stream:
    """Where a stream is among the bytes of the dataset, and its CRC-32."""

    what: str
    start: int
    size: int
    checksum: int

    def read(self, streams: bytes) -> bytes | None:
        """Return the stream's bytes, or None if they are damaged or not all there."""
        data = streams[self.start : self.start + self.size]
        return data if len(data) == self.size and crc32(data) == self.checksum else None


@dataclass(frozen=True)
class StoredChunk:
    """Frames `first` to ``first + count - 1``."""

    first: int
    count: int
    tracks: Stream
    corrections: Stream


@dataclass(frozen=True)
class Index:
    """All streams of a file; `size` is that of the index itself."""

    size: int
    connectivity: Stream
    surface: Stream
    times: Stream
    fields: tuple[Stream, ...]
    chunks: tuple[StoredChunk, ...]

    def ground(self) -> dict[str, Stream]:
        """The streams that are about the mesh and its times, by name."""
        return {"connectivity": self.connectivity, "surface": self.surface, "times": self.times}


def pack_streams(
    text: bytes, ground: Sequence[bytes], fields: Sequence[bytes], chunks: Sequence[Chunk]
) -> Stored:
    """Lay an index and streams one after the other.

    Parameters
    ----------
    text : bytes
        The attribute ``coding``.
    ground : sequence of three bytes
        Connectivity, surface, times.
    fields, chunks
        As in `Coded`.
    """
    of_chunks = [stream for chunk in chunks for stream in (chunk.tracks, chunk.corrections)]
    streams = [*ground, *fields, *of_chunks]
    lengths = pack_whole(
        [
            len(fields),
            len(chunks),
            *(chunk.count for chunk in chunks),
            *(len(stream) for stream in streams),
        ]
    )
    checksums = np.array(
        [crc32(text), *(crc32(stream) for stream in streams if stream)], dtype="<u4"
    ).tobytes()
    head = _HEAD.pack(MAGIC, len(lengths), len(checksums), crc32(lengths + checksums))
    return Stored(text, b"".join([head, lengths, checksums, *streams]))


def read_index(path: Path, stored: Stored) -> Index:
    """Read where the streams are.

    Raises
    ------
    FormatError
        If a newer mixseq wrote it; or if the index, or the attribute, is damaged: then nothing can be found.
    """
    refuse_newer(path, stored.version, CODED_VERSION)
    damaged = FormatError(f"{path}: its index is damaged, so nothing can be read; restore the file")
    if len(stored.streams) < _HEAD.size:
        raise damaged
    magic, lengths_size, checksums_size, checksum = _HEAD.unpack_from(stored.streams)
    size = _HEAD.size + lengths_size + checksums_size
    body = stored.streams[_HEAD.size : size]
    if magic != MAGIC or crc32(body) != checksum or checksums_size % 4:
        raise damaged
    numbers = list(unpack_whole(body[:lengths_size]))
    checksums = np.frombuffer(body[lengths_size:], dtype="<u4").tolist()
    if not checksums or crc32(stored.text) != checksums[0]:
        raise damaged
    try:
        return _index(size, numbers, checksums[1:])
    except (IndexError, ValueError, StopIteration) as error:  # not by chance: somebody made it so
        raise damaged from error


def _index(size: int, numbers: list[int], checksums: list[int]) -> Index:
    groups, chunks, *rest = numbers
    counts, lengths = rest[:chunks], rest[chunks:]
    if len(lengths) != 3 + groups + 2 * chunks or 0 in counts or max(lengths) >= 1 << 63:
        raise ValueError("there cannot be so many streams, or frames, or bytes")
    firsts = [0, *accumulate(counts)]
    names = ["the connectivity's bytes", "the surface's bytes", "the times"]
    names += [f"the fields of group {group}" for group in range(groups)]
    for first, count in zip(firsts, counts, strict=False):
        frames = f"of frames {first} to {first + count - 1}"
        names += [f"the tracks {frames}", f"the corrections {frames}"]
    starts = accumulate(lengths, initial=size)
    left = iter(checksums)
    streams = [
        Stream(name, start, length, next(left) if length else 0)
        for name, start, length in zip(names, starts, lengths, strict=False)
    ]
    if next(left, None) is not None:
        raise ValueError("there are more checksums than streams")
    of_chunks = streams[3 + groups :]
    return Index(
        size=size,
        connectivity=streams[0],
        surface=streams[1],
        times=streams[2],
        fields=tuple(streams[3 : 3 + groups]),
        chunks=tuple(
            StoredChunk(*each) for each in zip(firsts, counts, of_chunks[::2], of_chunks[1::2], strict=False)
        ),
    )
