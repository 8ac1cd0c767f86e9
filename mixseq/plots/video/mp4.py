"""Boxes of the ISO base media file format [1]_: one video track, out of an AVIF and into an MP4.

A box is its size, four letters, and what is in it: numbers, or boxes. Dates are zero, so that equal films are equal
files. Own code, as what writes MP4 brings codecs along: the wheels of PyAV and imageio-ffmpeg have 36 and 68 MB, and
Pillow, which encodes the frames already, writes AVIF only.

References
----------
.. [1] ISO/IEC 14496-12: ISO base media file format.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from typing import IO

_MATRIX = struct.pack(">9I", 0x10000, 0, 0, 0, 0x10000, 0, 0, 0, 0x40000000)  # pictures are upright

_TABLE = ("moov", "trak", "mdia", "minf", "stbl")

_ENTRY = 78  # bytes of a visual sample entry before its boxes


@dataclass(frozen=True)
class VideoTrack:
    """A video track.

    Attributes
    ----------
    width, height : int
        Size in pixels.
    codec : bytes
        Name of the sample entry, four letters.
    settings : bytes
        Boxes that the decoder needs to begin.
    samples : tuple of bytes
        The coded frames.
    keys : tuple of int
        Frames that need none before them, from 0.
    """

    width: int
    height: int
    codec: bytes
    settings: bytes
    samples: tuple[bytes, ...]
    keys: tuple[int, ...]


def joined(tracks: Sequence[VideoTrack]) -> VideoTrack:
    """Return tracks of the same codec and settings one after the other.

    Raises
    ------
    ValueError
        If they differ.
    """
    first = tracks[0]
    samples: list[bytes] = []
    keys: list[int] = []
    for track in tracks:
        if (track.width, track.height, track.codec, track.settings) != (
            first.width,
            first.height,
            first.codec,
            first.settings,
        ):
            raise ValueError("tracks with other settings cannot be joined")
        keys += [len(samples) + key for key in track.keys]
        samples += track.samples
    return VideoTrack(first.width, first.height, first.codec, first.settings, tuple(samples), tuple(keys))


def read_track(data: bytes) -> VideoTrack:
    """Return the first track of a file.

    Raises
    ------
    ValueError
        If there is none.
    """
    table = data
    for name in _TABLE:
        table = _child(table, name)
    entry_name, entry = next(_boxes(_child(table, "stsd")[8:]))
    width, height = struct.unpack_from(">HH", entry, 24)
    kept = [_box(name, inside) for name, inside in _boxes(entry[_ENTRY:]) if name in ("av1C", "colr")]

    size, count = struct.unpack_from(">II", _child(table, "stsz"), 4)
    sizes = [size] * count if size else list(struct.unpack_from(f">{count}I", _child(table, "stsz"), 12))
    samples: list[bytes] = []
    for start, length in zip(_chunk_starts(table), _chunk_lengths(table, count), strict=True):
        at = start
        for _ in range(length):
            end = at + sizes[len(samples)]
            samples.append(data[at:end])
            at = end
    try:
        keys = _child(table, "stss")
        numbers = struct.unpack_from(f">{struct.unpack_from('>I', keys, 4)[0]}I", keys, 8)
    except ValueError:  # without a list, all are
        numbers = tuple(range(1, count + 1))
    found = tuple(number - 1 for number in numbers)
    return VideoTrack(width, height, entry_name.encode("latin1"), b"".join(kept), tuple(samples), found)


def _boxes(data: bytes) -> Iterator[tuple[str, bytes]]:
    """Yield names and contents of the boxes that follow each other."""
    at = 0
    while at + 8 <= len(data):
        size, name = struct.unpack_from(">I4s", data, at)
        start = at + 8
        if size == 1:
            size, start = struct.unpack_from(">Q", data, start)[0], start + 8
        end = at + size if size else len(data)
        if end < start:
            raise ValueError("a box is shorter than its head")
        yield name.decode("latin1"), data[start:end]
        at = end


def _child(data: bytes, name: str) -> bytes:
    for found, inside in _boxes(data):
        if found == name:
            return inside
    raise ValueError(f"there is no box {name}")


def _chunk_starts(table: bytes) -> tuple[int, ...]:
    """Return where in the file the runs of samples begin."""
    for name, letter in (("stco", "I"), ("co64", "Q")):
        for found, inside in _boxes(table):
            if found == name:
                count = struct.unpack_from(">I", inside, 4)[0]
                return struct.unpack_from(f">{count}{letter}", inside, 8)
    raise ValueError("there are no chunks")


def _chunk_lengths(table: bytes, samples: int) -> list[int]:
    """Return how many samples each run has."""
    chunks = len(_chunk_starts(table))
    inside = _child(table, "stsc")
    rows = struct.unpack_from(">I", inside, 4)[0]
    entries = [struct.unpack_from(">III", inside, 8 + 12 * row)[:2] for row in range(rows)]
    lengths: list[int] = []
    for (first, length), (after, _) in pairwise([*entries, (chunks + 1, 0)]):
        lengths += [length] * (after - first)
    if sum(lengths) != samples:
        raise ValueError(f"{sum(lengths)} samples in chunks, but {samples} sizes")
    return lengths


def write_track(file: IO[bytes], track: VideoTrack, fps: float) -> None:
    """Write a track as an MP4 that can be played while it is still being loaded.

    Parameters
    ----------
    file : binary file
        Where it goes.
    track : VideoTrack
        The track.
    fps : float
        Frames per second; written as a fraction, of which 24000/1001 is one.
    """
    rate = frame_rate(fps)
    brands = _box("ftyp", b"isom", struct.pack(">I", 512), b"isom", b"iso6", track.codec, b"mp41")
    start = len(brands) + len(_movie(track, rate, 0)) + 8
    file.write(brands)
    file.write(_movie(track, rate, start))
    file.write(struct.pack(">I4s", 8 + sum(map(len, track.samples)), b"mdat"))
    for sample in track.samples:
        file.write(sample)


def frame_rate(fps: float) -> Fraction:
    """Return frames per second as a fraction, of which 24000/1001 is one.

    Examples
    --------
    >>> str(frame_rate(24000 / 1001)), str(frame_rate(1e-4))
    ('24000/1001', '1/10000')
    """
    return Fraction(fps).limit_denominator(1001) or Fraction(1, max(1, round(1 / fps)))


def _box(name: str, *inside: bytes) -> bytes:
    content = b"".join(inside)
    return struct.pack(">I4s", 8 + len(content), name.encode("latin1")) + content


def _full(name: str, flags: int, *inside: bytes) -> bytes:
    """Return a box of version 0 with flags."""
    return _box(name, struct.pack(">I", flags), *inside)


def _numbers(*values: int) -> bytes:
    return struct.pack(f">{len(values)}I", *values)


def _movie(track: VideoTrack, rate: Fraction, start: int) -> bytes:
    """Return the box that describes the samples, which begin at a byte of the file."""
    count, scale, step = len(track.samples), rate.numerator, rate.denominator
    duration = count * step
    entry = _box(
        track.codec.decode("latin1"),
        bytes(6) + struct.pack(">H", 1) + bytes(16),
        struct.pack(">HHIIIH", track.width, track.height, 0x480000, 0x480000, 0, 1),
        bytes(32) + struct.pack(">Hh", 24, -1),
        track.settings,
    )
    table = _box(
        "stbl",
        _full("stsd", 0, _numbers(1), entry),
        _full("stts", 0, _numbers(1, count, step)),
        _full("stss", 0, _numbers(len(track.keys), *(key + 1 for key in track.keys))),
        _full("stsc", 0, _numbers(1, 1, count, 1)),
        _full("stsz", 0, _numbers(0, count, *map(len, track.samples))),
        _full("stco", 0, _numbers(1, start)),
    )
    here = _box("dinf", _full("dref", 0, _numbers(1), _full("url ", 1)))
    media = _box(
        "mdia",
        _full("mdhd", 0, _numbers(0, 0, scale, duration), struct.pack(">HH", 0x55C4, 0)),
        _full("hdlr", 0, bytes(4), b"vide", bytes(12), b"video\0"),
        _box("minf", _full("vmhd", 1, bytes(8)), here, table),
    )
    head = _full(
        "tkhd",
        3,
        _numbers(0, 0, 1, 0, duration),
        bytes(16),
        _MATRIX,
        _numbers(track.width << 16, track.height << 16),
    )
    whole = _full(
        "mvhd",
        0,
        _numbers(0, 0, scale, duration),
        struct.pack(">IH", 0x10000, 0x100),
        bytes(10),
        _MATRIX,
        bytes(24),
        _numbers(2),
    )
    return _box("moov", whole, _box("trak", head, media))
