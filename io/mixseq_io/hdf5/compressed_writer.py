"""Write compressed models to HDF5, and count their bytes. `mixseq_io.hdf5.compressed_reader` describes the layout.

Attributes are strings of fixed length (strings of any length would cost 4 KiB).
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from zlib import crc32

import h5py
import numpy as np

from mixseq.coding.bitstream.compressed_sequence import Chunk, CompressedSequence
from mixseq.coding.bitstream.connectivity import encode_polygons
from mixseq.coding.bitstream.entropy import pack_leb128
from mixseq.errors import SettingsError
from mixseq.sequence import SequenceHeader
from mixseq.version import __version__
from mixseq_io.hdf5.compressed_reader import (
    COMPRESSED_VERSION,
    HEAD,
    MAGIC,
    Container,
    read_container,
    read_index,
)
from mixseq_io.hdf5.h5_files import MODEL_FORMAT
from mixseq_io.hdf5.lossless import pack_surface, pack_times

_CONTAINER, _INDEX = 1200, 64
"""Bytes that HDF5 and the attributes take at most, and the index for 64 frames."""


def write_compressed(file: h5py.File, coded: CompressedSequence) -> None:
    """Store a compressed sequence in a new HDF5 file."""
    container = pack_streams(_json(coded), _ground(coded.header), coded.basis, coded.chunks)
    for name, text in (
        ("format", MODEL_FORMAT.encode()),
        ("created_by", f"mixseq {__version__}".encode()),
        ("coding", container.text),
    ):
        file.attrs.create(name, text, dtype=h5py.string_dtype("ascii", len(text)))
    file.attrs["version"] = COMPRESSED_VERSION
    file.create_dataset("streams", data=np.frombuffer(container.streams, dtype=np.uint8), track_times=False)


def pack_streams(
    text: bytes, ground: Sequence[bytes], basis: Sequence[bytes], chunks: Sequence[Chunk]
) -> Container:
    """Lay an index and streams one after the other.

    Parameters
    ----------
    text : bytes
        The attribute ``coding``.
    ground : sequence of three bytes
        Connectivity, surface, times.
    basis, chunks
        As in `CompressedSequence`.
    """
    of_chunks = [stream for chunk in chunks for stream in (chunk.coefficients, chunk.residuals)]
    streams = [*ground, *basis, *of_chunks]
    counts = [chunk.count for chunk in chunks]
    lengths = pack_leb128([len(basis), len(chunks), *counts, *map(len, streams)])
    checksums = np.array(
        [crc32(text), *(crc32(stream) for stream in streams if stream)], dtype="<u4"
    ).tobytes()
    head = HEAD.pack(MAGIC, len(lengths), len(checksums), crc32(lengths + checksums))
    return Container(text, b"".join([head, lengths, checksums, *streams]))


def compressed_sizes(path: Path) -> dict[str, int]:
    """Count the bytes of a compressed model.

    Returns
    -------
    dict
        ``total``: the file; ``connectivity``: the faces; ``container``: HDF5's own, and its attributes; ``signals``:
        everything else; and of these ``surface``: texture coordinates and the like, ``index``: lengths and checksums.

    Raises
    ------
    FormatError
        As `read_compressed`, but streams are not looked at.
    """
    container = read_container(path)
    index = read_index(path, container)
    total, connectivity = path.stat().st_size, index.ground["connectivity"].size
    return {
        "total": total,
        "connectivity": connectivity,
        "container": total - len(container.streams),
        "signals": len(container.streams) - connectivity,
        "surface": index.ground["surface"].size,
        "index": index.size,
    }


def room_for_signals(header: SequenceHeader, size: int) -> int:
    """Return how many bytes of a file of some size are left for basis, coefficients and residual layer.

    Raises
    ------
    SettingsError
        If there are none.
    """
    connectivity, surface, times = map(len, _ground(header))
    container = _CONTAINER + times + _INDEX * (1 + header.frame_count // 64)
    taken = connectivity + surface + container
    if size <= taken:
        parts = f"faces take {connectivity}, texture coordinates and the like {surface}, the container {container}"
        cure = "; write the sequence without texture coordinates first, or give more" if surface else ""
        raise SettingsError(
            f"size is {size} bytes; {taken} are taken before there is any motion: {parts}{cure}"
        )
    return size - taken


def _ground(header: SequenceHeader) -> list[bytes]:
    return [
        encode_polygons(header.polygons, header.vertex_count),
        pack_surface(header.surface),
        pack_times(header.times, header.fps),
    ]


def _json(coded: CompressedSequence) -> bytes:
    header = coded.header
    facts = {
        "coding": {name: value for name, value in asdict(coded.parameters).items() if value != ()},
        "name": header.name,
        "fps": header.fps,
        "up_axis": header.up_axis,
        "metres_per_unit": header.metres_per_unit,
        "vertex_count": header.vertex_count,
        "polygon_count": len(header.polygons.counts),
        "corner_count": len(header.polygons.indices),
        "first_time": float(header.times[0]),
        "frame_count": header.frame_count,
    }
    return json.dumps(facts, separators=(",", ":")).encode("ascii")
