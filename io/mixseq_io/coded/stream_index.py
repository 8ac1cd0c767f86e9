"""Index of a compressed model's streams in its one dataset, with the length and CRC-32 of each.

==========  =====================================================================================================
bytes       meaning, all numbers little-endian
==========  =====================================================================================================
4           ``msq1``
3 x 4       uint32: size of the lengths, size of the checksums, CRC-32 of both
any         lengths, as numbers of 7 bits a byte (LEB128): number of groups of the basis, number of chunks, number of
            frames of every chunk, length of every stream
any         uint32 each: CRC-32 of the attribute ``coding``, and of every stream that is not empty
==========  =====================================================================================================

Frozen: changing this breaks old files.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np

from mixseq.errors import FormatError

COMPRESSED_VERSION = 1
"""Version of compressed models, separate from that of models with datasets. Frozen: breaks old files."""

MAGIC = b"msq1"
"""First bytes of the index. Frozen: breaks old files."""

HEAD = struct.Struct("<4sIII")
"""Magic, bytes of the lengths, bytes of the checksums, checksum of both. Frozen: breaks old files."""


@dataclass(frozen=True)
class Container:
    """Contents of a file: the attribute ``coding`` and the dataset ``streams``, unchanged, and the version."""

    text: bytes
    streams: bytes
    version: int = COMPRESSED_VERSION


@dataclass(frozen=True)
class Stream:
    """Range of a stream in the dataset, in bytes, and its CRC-32."""

    what: str
    start: int
    size: int
    checksum: int

    def read(self, streams: bytes) -> bytes | None:
        """Return the stream's bytes, or None if they are damaged or incomplete."""
        data = streams[self.start : self.start + self.size]
        return data if len(data) == self.size and crc32(data) == self.checksum else None


@dataclass(frozen=True)
class ChunkStreams:
    """Streams of the frames `first` to ``first + count - 1``."""

    first: int
    count: int
    coefficients: Stream
    residuals: Stream


@dataclass(frozen=True)
class StreamIndex:
    """All streams of a file; `ground` are connectivity, surface, times and uvs if any, `size` is the index's size."""

    size: int
    ground: Mapping[str, Stream]
    basis: tuple[Stream, ...]
    chunks: tuple[ChunkStreams, ...]


def read_index(path: Path, container: Container) -> StreamIndex:
    """Read the index; raise `FormatError` for another version, or a damaged index or attribute."""
    if container.version != COMPRESSED_VERSION:
        raise FormatError(
            f"{path} is a compressed model of version {container.version}, this mixseq reads {COMPRESSED_VERSION}: "
            "upgrade with pip install --upgrade mixseq, or compress the original again"
        )
    damaged = FormatError(f"{path}: its index is damaged, so nothing can be read; restore the file")
    if len(container.streams) < HEAD.size:
        raise damaged
    magic, lengths_size, checksums_size, checksum = HEAD.unpack_from(container.streams)
    size = HEAD.size + lengths_size + checksums_size
    body = container.streams[HEAD.size : size]
    if magic != MAGIC or crc32(body) != checksum or checksums_size % 4:
        raise damaged
    numbers = list(unpack_leb128(body[:lengths_size]))
    checksums = np.frombuffer(body[lengths_size:], dtype="<u4").tolist()
    if not checksums or crc32(container.text) != checksums[0]:
        raise damaged
    uvs = facts_of(path, container)["coding"].get("uv_steps") is not None
    try:
        return _index(size, numbers, checksums[1:], uvs)
    except (IndexError, ValueError, StopIteration) as error:  # not by chance: somebody made it so
        raise damaged from error


def _index(size: int, numbers: list[int], checksums: list[int], uvs: bool) -> StreamIndex:
    groups, chunks, *rest = numbers
    counts, lengths = rest[:chunks], rest[chunks:]
    if len(lengths) != 3 + uvs + groups + 2 * chunks or 0 in counts or max(lengths) >= 1 << 63:
        raise ValueError("there cannot be so many streams, or frames, or bytes")
    firsts = [0, *accumulate(counts)]
    names = ["the connectivity's bytes", "the surface's bytes", "the times", "the texture coordinates"]
    names = names[: 3 + uvs]
    names += [f"the basis vectors of group {group}" for group in range(groups)]
    for first, count in zip(firsts, counts, strict=False):
        frames = f"of frames {first} to {first + count - 1}"
        names += [f"the coefficients {frames}", f"the residuals {frames}"]
    starts = accumulate(lengths, initial=size)
    left = iter(checksums)
    streams = [
        Stream(name, start, length, next(left) if length else 0)
        for name, start, length in zip(names, starts, lengths, strict=False)
    ]
    if next(left, None) is not None:
        raise ValueError("there are more checksums than streams")
    of_chunks = zip(
        firsts, counts, streams[3 + uvs + groups :: 2], streams[4 + uvs + groups :: 2], strict=False
    )
    return StreamIndex(
        size=size,
        ground=dict(zip(("connectivity", "surface", "times", "uvs"), streams[: 3 + uvs], strict=False)),
        basis=tuple(streams[3 + uvs : 3 + uvs + groups]),
        chunks=tuple(ChunkStreams(*each) for each in of_chunks),
    )


def facts_of(path: Path, container: Container) -> dict[str, Any]:
    """Return the attribute ``coding``; raise `FormatError` if it is no JSON, or has no parameters."""
    try:
        facts = json.loads(container.text)
    except ValueError as error:
        raise FormatError(f"{path}: the attribute coding is no JSON ({error}); it is damaged") from error
    if not isinstance(facts, dict) or not isinstance(facts.get("coding"), dict):
        raise FormatError(f"{path}: the attribute coding has no parameters; it is damaged")
    return facts


def pack_leb128(numbers: Iterable[int]) -> bytes:
    """Write non-negative integers, 7 bits to the byte, the lowest first (LEB128): [5, 300] is 05 ac 02."""
    packed = bytearray()
    for number in numbers:
        while number > 127:
            packed.append(number & 127 | 128)
            number >>= 7
        packed.append(number)
    return bytes(packed)


def unpack_leb128(packed: bytes) -> Iterator[int]:
    """Read the integers written by `pack_leb128`."""
    number = shift = 0
    for byte in packed:
        number |= (byte & 127) << shift
        shift += 7
        if byte < 128:
            yield number
            number = shift = 0
