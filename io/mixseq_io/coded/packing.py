"""Write a compressed sequence as a text and a dataset of streams, in the layout of `mixseq_io.coded.streams`."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from math import inf
from zlib import crc32

import numpy as np

from mixseq.choices import OrderName
from mixseq.compression.bitstream.compressed_sequence import CompressedSequence
from mixseq.compression.bitstream.connectivity import encode_polygons
from mixseq.compression.bitstream.corner_values import to_grid
from mixseq.compression.bitstream.spatial_basis import encode_face_labels
from mixseq.compression.encoder.uvs import UV_ERROR, encode_uvs, with_quantised_uvs
from mixseq.compression.numbering import cheapest_numbering
from mixseq.errors import InvalidSequenceError, SettingsError
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.provenance import Provenance
from mixseq_io.coded.streams import INDEX_HEAD, LABEL_COUNT, MAGIC, Container, pack_leb128, pack_surface, pack_times

_HDF5_SIZE, _INDEX_SIZE_PER_64_FRAMES, _SOURCE_SIZE = 1300, 96, 32
"""Largest sizes in bytes: HDF5 structures with attributes, part of the index for 64 frames, checksum of the source."""


def pack(coded: CompressedSequence) -> Container:
    """Return the text of a compressed sequence, and its index and streams concatenated."""
    text = _facts_json(coded)
    has_inbetweens = coded.parameters.inbetween_levels is not None
    chunk_streams = [
        stream
        for chunk in coded.chunks
        for stream in (chunk.coefficients, chunk.residuals, *[chunk.inbetweens][:has_inbetweens])
    ]
    header_streams = _header_streams(coded.header, coded.parameters.uv_steps)
    if coded.parts is not None:
        header_streams.append(encode_face_labels(coded.parts, coded.header.faces))
    streams = [*header_streams, *coded.basis, *chunk_streams]
    counts = [chunk.count for chunk in coded.chunks]
    lengths = pack_leb128([len(coded.basis), len(counts), *counts, *map(len, streams)])
    crcs = [crc32(text), *(crc32(stream) for stream in streams if stream)]
    checksums = np.array(crcs, dtype="<u4").tobytes()
    head = INDEX_HEAD.pack(MAGIC, len(lengths), len(checksums), crc32(lengths + checksums))
    return Container(text, b"".join([head, lengths, checksums, *streams]))


def room_for_signals(
    header: SequenceHeader,
    size: int,
    *,
    uv_error: float = UV_ERROR,
    uvs: bool = True,
    order: OrderName = "keep",
    container: int = _HDF5_SIZE,
) -> int:
    """Return the number of bytes available for basis, coefficients and residual layer in a file of `size` bytes.

    `uv_error`, `uvs` and `order` are options of `mixseq.compress`. `container` is the size of text and file format, by
    default HDF5. Raises `SettingsError` if no bytes remain, `uv_error` is out of range, or `order` is unknown.
    """
    header = cheapest_numbering(header, order).renumber_header(header)
    streams = _header_streams(*with_quantised_uvs(header, uv_error, uvs))
    connectivity, surface, times, *uv_sizes = map(len, streams)
    surface += sum(uv_sizes)
    source = header.provenance or Provenance(header.name)
    container += len(json.dumps(source.to_plain())) + _SOURCE_SIZE
    container += times + _INDEX_SIZE_PER_64_FRAMES * (1 + header.frame_count // 64)
    static = connectivity + surface + container
    if size <= static:
        parts = f"faces take {connectivity}, texture coordinates and the like {surface}, the container {container}"
        cure = "; leave out texture coordinates (--no-uvs), or give more" if surface else ""
        raise SettingsError(f"size is {size} bytes; {static} are taken before there is any motion: {parts}{cure}")
    return size - static


def _header_streams(header: SequenceHeader, uv_steps: int | None) -> list[bytes]:
    """Return the streams of connectivity, surface and times, and of texture coordinates if `uv_steps` is given."""
    polygons, vertex_count, surface = header.polygons, header.vertex_count, header.surface
    uv_streams = []
    if uv_steps is not None:
        numbers = None if surface.uvs is None else to_grid(surface.uvs.at_corners, uv_steps)
        if numbers is None:
            raise InvalidSequenceError(
                f"texture coordinates are not multiples of 1 / {uv_steps}; compress the sequence again"
            )
        uv_streams = [encode_uvs(polygons, vertex_count, numbers)]
        surface = replace(surface, uvs=None)
    connectivity, times = encode_polygons(polygons, vertex_count), pack_times(header.times, header.fps)
    return [connectivity, pack_surface(surface, (polygons, vertex_count)), times, *uv_streams]


def _facts_json(coded: CompressedSequence) -> bytes:
    header, parameters = coded.header, asdict(coded.parameters)
    if coded.parts is not None:
        parameters[LABEL_COUNT] = int(coded.parts.max()) + 1
    facts = {
        "coding": {name: value for name, value in parameters.items() if value not in ((), None)},
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
    if header.provenance is not None and header.provenance.source is not None:
        facts["source"] = header.provenance.source.to_plain()
    if coded.order != "keep":
        facts["order"] = coded.order
    if coded.between is not None:
        length, cubic = coded.between.length, coded.between.cubic
        facts["between"] = {"length": None if length == inf else length, "cubic": cubic}
    return json.dumps(facts, separators=(",", ":")).encode("ascii")
