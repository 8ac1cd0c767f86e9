"""Count the bytes of files of compressed sequences, before and after compression.

Before compression, a file is counted that has all but the signals: numbers that follow from these are as long as they
can be, and the still is that of the exact first frame. After compression, the file itself is counted.
"""

from __future__ import annotations

from dataclasses import replace
from io import BytesIO
from typing import Any, NamedTuple

import h5py

from mixseq.choices import OrderName, StillName
from mixseq.compression.bitstream.compressed_sequence import (
    Chunk,
    CodingParameters,
    CompressedSequence,
    TemporalInterpolation,
)
from mixseq.compression.bitstream.spatial_basis import FaceLabels, part_groups
from mixseq.compression.encoder.compress import compress
from mixseq.compression.encoder.trial import DEFAULT_CHUNK_FRAMES, chunk_ranges
from mixseq.compression.encoder.uvs import UV_ERROR, with_quantised_uvs
from mixseq.compression.numbering import cheapest_numbering
from mixseq.errors import SizeError
from mixseq.mesh.measures import choose_origin
from mixseq.runtime.progress import Progress, log_progress
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.provenance import Provenance
from mixseq.sequence.sequence import Frames
from mixseq.types import Float
from mixseq_io.coded.packing import facts_json, header_streams, pack, write_container
from mixseq_io.coded.streams import Container
from mixseq_io.gltf.mesh_sequence import StillBody, glb_size
from mixseq_io.hdf5.datasets import H5_VERSIONS

_LONGEST_NUMBER, _LONGEST_FRACTION = 1.2345678901234567e-05, 0.12345678901234566
_RANK_OF_PARTS = (99,) * 12
_INDEX_ENTRY_BYTES = 6  # checksum of a stream, and its length beyond one byte


def compress_to_size(
    frames: Frames, size: int, still: StillName | None = None, progress: Progress = log_progress, **options: Any
) -> CompressedSequence:
    """Compress a sequence to the smallest error for which its file, see `file_size`, has at most `size` bytes.

    Other options are those of `mixseq.compress`. Raises `SizeError` if the size is too small; the message says what
    takes the bytes, and what can be left out.
    """
    static = static_size(frames, still, **{name: options[name] for name in _STATIC_OPTIONS if name in options})
    room = size - static.total
    while room > 0:
        try:
            coded = compress(frames, size=room, progress=progress, **options)
        except SizeError:
            break
        excess = file_size(coded, still) - size
        if excess <= 0:
            return coded
        room -= excess + excess // 4  # the still of a rough frame is larger than that of the exact one
    raise SizeError(
        f"size is {size:,} bytes, too few for any motion: {static.total:,} are taken without it, "
        f"{', '.join(f'{count:,} by {name}' for name, count in static.parts.items() if count)}; "
        f"{', or '.join(static.cures)}"
    )


def file_size(coded: CompressedSequence, still: StillName | None = None) -> int:
    """Return the size in bytes of the file of a sequence: a .glb with a still, or HDF5 if `still` is None."""
    return _h5_size(pack(coded)) if still is None else glb_size([StillBody.from_sequence(coded)], still)


class StaticSize(NamedTuple):
    """The size in bytes of a file without signals."""

    total: int  # upper bound, if the still of the decoded first frame is not larger than that of the exact one
    parts: dict[str, int]  # size of each part, by its name
    cures: list[str]  # ways to fewer bytes


_STATIC_OPTIONS = ("uv_error", "uvs", "order", "chunk")


def static_size(
    frames: Frames,
    still: StillName | None = None,
    *,
    uv_error: float = UV_ERROR,
    uvs: bool = True,
    order: OrderName = "keep",
    chunk: int = DEFAULT_CHUNK_FRAMES,
) -> StaticSize:
    """Return the size of the file of a sequence without signals; options are those of `mixseq.compress`."""
    frames = cheapest_numbering(frames.header, order).renumber_frames(frames)
    header, uv_steps = with_quantised_uvs(frames.header, uv_error, uvs)
    points = next(iter(frames.blocks(1)))[0]
    origin = choose_origin(points)
    container = _pack_without_signals(header, origin, uv_steps, uv_error, order, chunk)
    body = StillBody(container, header, points, origin)
    total = _h5_size(container) if still is None else glb_size([body], still)
    connectivity, surface, _, *uv_sizes = map(len, header_streams(header, uv_steps))
    parts = {"faces": connectivity, "texture coordinates and the like": surface + sum(uv_sizes)}
    cures = ["give more"]
    if uv_sizes:
        cures.insert(0, "leave out texture coordinates (--no-uvs)")
    if still is not None:
        parts["the first frame"] = total - glb_size([body], "none")
        if parts["the first frame"] > 0:
            cures.insert(0, "leave out the first frame (--still none)")
    parts["the container"] = total - sum(parts.values())
    return StaticSize(total, parts, cures)


def _h5_size(container: Container) -> int:
    """Return the size of the HDF5 file of a container."""
    buffer = BytesIO()
    with h5py.File(buffer, "w", libver=H5_VERSIONS) as file:
        write_container(file, container)
    return buffer.getbuffer().nbytes


def _pack_without_signals(
    header: SequenceHeader, origin: Float, uv_steps: int | None, uv_error: float, order: OrderName, chunk: int
) -> Container:
    """Return a container without signals, and with the longest numbers and index."""
    source = replace(header.provenance or Provenance(header.name), checksum=0xFFFFFFFF)
    parameters = CodingParameters(
        factors="trajectories",
        rank=sum(_RANK_OF_PARTS),
        frame_count=header.frame_count,
        step=_LONGEST_NUMBER,
        diagonal=_LONGEST_NUMBER,
        max_error=_LONGEST_NUMBER,
        kg_percent=_LONGEST_NUMBER,
        promised=False,
        ranks=_RANK_OF_PARTS,
        origin=(_LONGEST_NUMBER,) * 3 if origin.any() else (),
        uv_steps=uv_steps,
        uv_error=None if uv_steps is None else float(uv_error),
        inbetween_levels=1,
        inbetween_step=_LONGEST_NUMBER,
        inbetween_error=_LONGEST_NUMBER,
    )
    coded = CompressedSequence(
        replace(header, provenance=Provenance(header.name, source)),
        parameters,
        basis=(b"",) * len(part_groups(_RANK_OF_PARTS)),
        chunks=tuple(Chunk(each.start, len(each), b"") for each in chunk_ranges(header.frame_count, chunk)),
        order=order,
        between=TemporalInterpolation(10 + _LONGEST_FRACTION, (_LONGEST_FRACTION,) * 2),
    )
    streams = pack(coded).streams + bytes(_INDEX_ENTRY_BYTES * (1 + len(coded.basis) + 3 * len(coded.chunks)))
    with_parts = replace(coded, labels=FaceLabels(len(_RANK_OF_PARTS), b""))
    return Container(facts_json(with_parts), streams)
