"""Write a compressed sequence as a text and a dataset of streams, in the layout of `mixseq_io.coded.streams`."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from math import inf
from typing import TYPE_CHECKING
from zlib import crc32

import numpy as np

from mixseq.compression.bitstream.compressed_sequence import CompressedSequence
from mixseq.compression.bitstream.connectivity import encode_polygons
from mixseq.compression.bitstream.corner_values import to_grid
from mixseq.compression.encoder.uvs import encode_uvs
from mixseq.errors import InvalidSequenceError
from mixseq.sequence.header import SequenceHeader
from mixseq.signals.bodies import SAME_BODY
from mixseq.version import __version__
from mixseq_io.coded.streams import INDEX_HEAD, LABEL_COUNT, MAGIC, Container, pack_leb128, pack_surface, pack_times
from mixseq_io.hdf5.contents import MODEL_FORMAT

if TYPE_CHECKING:
    import h5py


def pack(coded: CompressedSequence) -> Container:
    """Return the text of a compressed sequence, and its index and streams concatenated, and those of its bodies."""
    text = facts_json(coded)
    has_inbetweens = coded.parameters.inbetween_levels is not None
    chunk_streams = [
        stream
        for chunk in coded.chunks
        for stream in (chunk.coefficients, chunk.residuals, *[chunk.inbetweens][:has_inbetweens])
    ]
    of_header = header_streams(coded.header, coded.parameters.uv_steps)
    if coded.labels is not None:
        of_header.append(coded.labels.data)
    streams = [*of_header, *coded.basis, *chunk_streams]
    counts = [chunk.count for chunk in coded.chunks]
    lengths = pack_leb128([len(coded.basis), len(counts), *counts, *map(len, streams)])
    crcs = [crc32(text), *(crc32(stream) for stream in streams if stream)]
    checksums = np.array(crcs, dtype="<u4").tobytes()
    head = INDEX_HEAD.pack(MAGIC, len(lengths), len(checksums), crc32(lengths + checksums))
    bodies = tuple(map(pack, coded.bodies))
    return Container(text, b"".join([head, lengths, checksums, *streams]), bodies=bodies)


def header_streams(header: SequenceHeader, uv_steps: int | None) -> list[bytes]:
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


def facts_json(coded: CompressedSequence) -> bytes:
    """Return the text of a compressed sequence."""
    header, parameters = coded.header, asdict(coded.parameters)
    if coded.labels is not None:
        parameters[LABEL_COUNT] = coded.labels.count
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
    if coded.relation != SAME_BODY:
        facts["relation"] = coded.relation._asdict()
    if coded.order != "keep":
        facts["order"] = coded.order
    if coded.between is not None:
        length, cubic = coded.between.length, coded.between.cubic
        cuts = {"cuts": coded.between.cuts} if coded.between.cuts else {}
        facts["between"] = {"length": None if length == inf else length, "cubic": cubic, **cuts}
    return json.dumps(facts, separators=(",", ":")).encode("ascii")


def write_container(file: h5py.File, container: Container) -> None:
    """Store the text of a compressed model as an attribute, and all streams as one dataset, as each takes bytes.

    Further bodies have groups. Strings have fixed length, since a string of variable length takes 4 KiB.
    """
    import h5py

    from mixseq_io.hdf5.datasets import body_groups

    def write_text(group: h5py.Group, name: str, text: bytes) -> None:
        group.attrs.create(name, text, dtype=h5py.string_dtype("ascii", len(text)))

    write_text(file, "format", MODEL_FORMAT.encode())
    write_text(file, "created_by", f"mixseq {__version__}".encode())
    file.attrs["version"] = container.version
    groups = body_groups(file, len(container.bodies))
    for each, group in zip((container, *container.bodies), (file, *groups), strict=True):
        write_text(group, "coding", each.text)
        group.create_dataset("streams", data=np.frombuffer(each.streams, dtype=np.uint8), track_times=False)
