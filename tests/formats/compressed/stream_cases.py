"""What tests of compressed files have in common: where streams are in a file, and how they are damaged."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mixseq.compression.bitstream.compressed_sequence import CodingParameters, CompressedSequence, TemporalInterpolation
from mixseq_io.coded.streams import MAGIC, Stream, StreamIndex, read_index
from mixseq_io.model_files import read_container

GOLDEN = Path(__file__).parents[1] / "golden"

PARAMETERS = CodingParameters(
    factors="trajectories",
    rank=3,
    frame_count=14,
    step=0.1 + 0.2,
    diagonal=4.1234567890123456,
    max_error=1e-3,
    kg_percent=1 / 3,
    promised=True,
    inbetween_levels=2,
    inbetween_step=0.7,
    inbetween_error=0.1 + 0.2,
)

BETWEEN = TemporalInterpolation(2.8, (1 / 3, 0.1 + 0.2))


def any_bytes(size: int) -> bytes:
    return np.random.default_rng(size).integers(0, 256, size, dtype=np.uint8).tobytes()


def assert_same(got: CompressedSequence, expected: CompressedSequence) -> None:
    assert (got.parameters, got.basis, got.chunks) == (expected.parameters, expected.basis, expected.chunks)
    assert (got.order, got.between) == (expected.order, expected.between)
    a, b = got.header, expected.header
    assert a.polygons.same_as(b.polygons)
    assert a.times.tolist() == b.times.tolist()
    for name in ("vertex_count", "fps", "up_axis", "metres_per_unit", "name"):
        assert getattr(a, name) == getattr(b, name)


def index_of(path: Path) -> StreamIndex:
    return read_index(path, read_container(path))


def place_of(path: Path) -> int:
    """Where the streams begin in the file."""
    return path.read_bytes().index(MAGIC)


def flip(path: Path, at: int) -> None:
    data = bytearray(path.read_bytes())
    data[at] ^= 0x10
    path.write_bytes(data)


def damage(path: Path, *streams: Stream) -> None:
    """Flip a bit in the middle of every stream."""
    first = place_of(path)
    for stream in streams:
        assert stream.size
        flip(path, first + stream.start + stream.size // 2)
