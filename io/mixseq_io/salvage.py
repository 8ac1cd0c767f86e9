"""Read what is left of a damaged compressed model.

Every stream has a checksum of its own, so damage is known by stream:

=============================  =========================================================================
damaged                      what is left
=============================  =========================================================================
basis vectors of a group     the groups before it: all frames, coarser; the bound does not hold
coefficients of a chunk      all other frames
residual layer of a chunk    all frames; the bound does not hold in those of the chunk
surface, texture coordinates  everything else
connectivity, times, index   nothing
=============================  =========================================================================

Files that are not all there, or whose own structure (HDF5, glTF) is damaged, do not open. But index and streams follow
each other in one run of bytes, and so does the text, so both are found without that structure too.
"""

from __future__ import annotations

import json
import mmap
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from mixseq.coding.bitstream.compressed_sequence import Chunk, CompressedSequence
from mixseq.errors import AmbiguousError, FormatError, MixseqWarning
from mixseq.sequence_header import SequenceHeader
from mixseq_io.coded.reading import (
    read_between,
    read_header,
    read_order,
    read_parameters,
    sequence_of,
)
from mixseq_io.coded.stream_index import MAGIC, ChunkStreams, Container, StreamIndex, read_index
from mixseq_io.compressed_files import is_compressed, read_container

_TEXT = b'{"coding":{'
"""What the text begins with."""

_LONGEST = 1 << 16
"""Texts are not longer than this."""


def salvage_compressed(path: Path) -> CompressedSequence | None:
    """Read what is not damaged of a compressed model; None if the file is, or was, nothing of that kind.

    Whatever is left out is reported by a `MixseqWarning`; then `CodingParameters.promised` is false if the bound
    does not hold for the frames that are left.

    Raises
    ------
    FormatError
        If nothing can be read.
    """
    container = _found(path)
    if container is None:
        return None
    index = read_index(path, container)
    ground = {name: stream.read(container.streams) for name, stream in index.ground.items()}
    if ground["surface"] is None:
        textures = "" if "uvs" in ground else "texture coordinates, "
        _warn(path, f"the surface is damaged and left out: {textures}hard edges, face sets")
        ground["surface"] = b""
    if ground.get("uvs", b"") is None:
        _warn(path, "the texture coordinates are damaged and left out")
    for name in ("connectivity", "times"):
        if ground[name] is None:
            raise FormatError(f"{path}: its {name} are damaged, so nothing can be salvaged; restore the file")
    header = read_header(
        path, container, index, {name: data for name, data in ground.items() if data is not None}
    )
    parameters = read_parameters(path, container)
    if header.surface.uvs is None:
        parameters = replace(parameters, uv_steps=None, uv_error=None)
    groups = _basis(path, container, index)
    complete = len(groups) == len(index.basis)
    chunks, frames, bounded = _chunks(path, container, index, complete, header)
    whole = len(frames) == header.frame_count
    return CompressedSequence(
        header if whole else header.with_times(header.times[frames]),
        parameters if complete and bounded else replace(parameters, promised=False),
        groups,
        chunks,
        read_order(path, container),
        read_between(path, container) if whole else None,  # what was chosen is for all frames
    )


def _basis(path: Path, container: Container, index: StreamIndex) -> tuple[bytes, ...]:
    """Return the groups before the first one that is damaged."""
    groups = []
    for stream in index.basis:
        data = stream.read(container.streams)
        if data is None:
            break
        groups.append(data)
    there, all_groups = len(groups), len(index.basis)
    if all_groups and not there:
        raise FormatError(
            f"{path}: {index.basis[0].what} are damaged, so nothing can be salvaged; restore the file"
        )
    if there < all_groups:
        _warn(
            path,
            f"{index.basis[there].what} are damaged; decoded with {there} of {all_groups} groups, frames are coarser "
            "than the file promises",
        )
    return tuple(groups)


def _chunks(
    path: Path, container: Container, index: StreamIndex, complete: bool, header: SequenceHeader
) -> tuple[tuple[Chunk, ...], list[int], bool]:
    """Return the chunks that have coefficients, numbered anew, their frames, and whether the bound holds in all.

    Residuals are what the whole basis leaves: they are left out unless that is `complete`.
    """
    missing: list[ChunkStreams] = []
    coarse: list[ChunkStreams] = []
    chunks: list[Chunk] = []
    frames: list[int] = []
    for each in index.chunks:
        coefficients, residuals = (
            each.coefficients.read(container.streams),
            each.residuals.read(container.streams),
        )
        if coefficients is None:
            missing.append(each)
            continue
        if residuals is None:
            coarse.append(each)
        chunks.append(Chunk(len(frames), each.count, coefficients, (residuals or b"") if complete else b""))
        frames += range(each.first, each.first + each.count)
    if not chunks:
        raise FormatError(f"{path}: the coefficients of all frames are damaged; restore the file")
    if missing:
        _warn(path, f"frames {_ranges(missing, header)} are damaged and left out")
    if coarse:
        _warn(
            path, f"residuals of frames {_ranges(coarse, header)} are damaged; the bound does not hold there"
        )
    return tuple(chunks), frames, not coarse


def _ranges(chunks: list[ChunkStreams], header: SequenceHeader) -> str:
    """Name the frames of chunks; those that follow each other as one range."""
    starts = np.array([each.first for each in chunks])
    ends = np.array([each.first + each.count for each in chunks])
    gaps = np.flatnonzero(starts[1:] != ends[:-1]) + 1
    firsts, lasts = starts[[0, *gaps]], ends[[*(gaps - 1), -1]] - 1
    number = header.frame_number
    return ", ".join(f"{number(first)} to {number(last)}" for first, last in zip(firsts, lasts, strict=True))


def explain_damage(path: Path, error: FormatError) -> None:
    """Say more of a file whose own structure cannot be read, if it was a compressed model; do nothing if it was not.

    Raises
    ------
    FormatError
        Names the first stream that is damaged, or says that all are whole.
    """
    if isinstance(error, AmbiguousError) or not path.is_file():
        return
    container = _search_bytes(path)
    if container is not None:
        sequence_of(path, container)
        raise FormatError(
            f"{error}; all its signals are whole, read them with mixseq decode --salvage"
        ) from error


def _found(path: Path) -> Container | None:
    """Read text and streams as the file has them, else look for them in its bytes."""
    try:
        return read_container(path) if is_compressed(path) else None
    except FormatError:
        if not path.is_file():
            raise
    return _search_bytes(path)


def _search_bytes(path: Path) -> Container | None:
    """Find attribute and streams in the bytes of a file."""
    if not path.stat().st_size:
        return None
    # Not read as a whole: it may be any file, and larger than memory.
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        texts = list(_texts(data))
        for start in _places(data, MAGIC) if texts else ():
            for text in texts:
                try:
                    read_index(path, container := Container(text, data[start:]))
                except FormatError:
                    continue
                return container
    return None


def _texts(data: mmap.mmap) -> Iterator[bytes]:
    for start in _places(data, _TEXT):
        text = data[start : start + _LONGEST].decode("latin-1")
        try:
            _, end = json.JSONDecoder().raw_decode(text)
        except (ValueError, RecursionError):
            continue
        yield data[start : start + end]


def _places(data: mmap.mmap, what: bytes) -> Iterator[int]:
    start = data.find(what)
    while start >= 0:
        yield start
        start = data.find(what, start + 1)


def _warn(path: Path, what: str) -> None:
    warnings.warn(f"{path}: {what}", MixseqWarning, stacklevel=2)
