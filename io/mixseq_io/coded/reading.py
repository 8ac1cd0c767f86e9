"""Read a compressed sequence from a text that describes the streams, and the streams.

The text is JSON: parameters, name, fps, up_axis, metres_per_unit, counts, first time. The index (`stream_index`) has
the length and CRC-32 of every stream. Their order is: connectivity, surface, times, texture coordinates if any; spatial
basis by group; coefficients and residual layer chunk by chunk. Specification: ``docs/file-format.md``.

Frozen: changing this breaks old files (golden: ``tests/formats/golden/compressed-v1*``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from math import inf
from pathlib import Path
from typing import Any

from mixseq.choices import ORDERS, OrderName
from mixseq.coding.bitstream.compressed_sequence import (
    BetweenFrames,
    Chunk,
    CodingParameters,
    CompressedSequence,
    to_model,
)
from mixseq.coding.bitstream.connectivity import decode_polygons
from mixseq.coding.bitstream.texture_coordinates import decode_uvs
from mixseq.errors import FormatError, InvalidSequenceError, SettingsError
from mixseq.sequence import SequenceHeader
from mixseq.signals.model import Model
from mixseq_io.coded.lossless import unpack_surface, unpack_times
from mixseq_io.coded.stream_index import Container, Stream, StreamIndex, facts_of, read_index
from mixseq_io.memory import check_memory

_OF_ELEMENT, _OF_CORNER = 64, 256
"""Memory in bytes that decoding takes per vertex, corner and frame, and extra per corner with a surface."""

_DECODED = 16
"""Memory in bytes that decoding takes per number of a basis and its coefficients."""


def sequence_of(path: Path, container: Container) -> CompressedSequence:
    """Return the compressed sequence of a file, checked; raise `FormatError` with the damaged stream and its frames."""
    index = read_index(path, container)

    def sound(stream: Stream) -> bytes:
        data = stream.read(container.streams)
        if data is None:
            raise FormatError(f"{path}: {stream.what} are damaged; restore the file")
        return data

    # Everything is checked before anything is made of it.
    ground = {name: sound(stream) for name, stream in index.ground.items()}
    basis = tuple(sound(stream) for stream in index.basis)
    chunks = tuple(
        Chunk(each.first, each.count, sound(each.coefficients), sound(each.residuals))
        for each in index.chunks
    )
    header = read_header(path, container, index, ground)
    return CompressedSequence(
        header,
        read_parameters(path, container),
        basis,
        chunks,
        read_order(path, container),
        read_between(path, container),
    )


def read_parameters(path: Path, container: Container) -> CodingParameters:
    """Read the decoding parameters; raise `FormatError` if one is unknown, missing or out of range."""
    facts = facts_of(path, container)
    given: dict[str, Any] = facts["coding"]
    known = {field.name for field in fields(CodingParameters)}
    unknown = sorted(set(given) - known)
    if unknown:
        raise FormatError(f"{path}: this mixseq does not know the parameter {unknown[0]!r}; upgrade it")
    try:
        parameters = CodingParameters(**given)
    except TypeError as error:
        raise FormatError(f"{path}: parameters are missing ({error}); it is damaged") from error
    except SettingsError as error:
        raise FormatError(f"{path}: {error}; it is damaged") from error
    if parameters.frame_count != facts.get("frame_count"):
        raise FormatError(f"{path}: its two numbers of frames contradict each other; it is damaged")
    return parameters


def read_order(path: Path, container: Container) -> OrderName:
    """Read which numbering of the original is kept; raise `FormatError` if the order is unknown."""
    order: OrderName = facts_of(path, container).get("order", "keep")
    if order not in ORDERS:
        raise FormatError(f"{path}: this mixseq does not know the order {order!r}; upgrade it")
    return order


def read_between(path: Path, container: Container) -> BetweenFrames | None:
    """Read the prediction of coefficients between frames, None if absent; raise `FormatError` if it is invalid."""
    given = facts_of(path, container).get("between")
    if given is None:
        return None
    if not (isinstance(given, dict) and set(given) == {"length", "cubic"}):
        raise FormatError(f"{path}: between is {given!r}; length and cubic are expected; it is damaged")
    length, cubic = given["length"], given["cubic"]
    try:
        return BetweenFrames(
            inf if length is None else length, tuple(cubic) if isinstance(cubic, list) else cubic
        )
    except SettingsError as error:
        raise FormatError(f"{path}: between: {error}; it is damaged") from error


def read_header(
    path: Path, container: Container, index: StreamIndex, ground: Mapping[str, bytes]
) -> SequenceHeader:
    """Read mesh and times from `StreamIndex.ground`; raise `FormatError` for contradictions or too much memory."""
    facts = facts_of(path, container)
    told = [facts.get(f"{what}_count") for what in ("vertex", "corner", "frame")]
    elements = sum(each for each in told if isinstance(each, int))
    on_corners = "uvs" in ground or ground["surface"]
    corner = _OF_CORNER * told[1] if on_corners and isinstance(told[1], int) else 0
    check_memory(path, _OF_ELEMENT * elements + corner, "mesh and times")
    parameters = read_parameters(path, container)
    try:
        vertices, polygons, corners, frames = (
            int(facts[f"{what}_count"]) for what in ("vertex", "polygon", "corner", "frame")
        )
        fps = float(facts["fps"])
        if sum(chunk.count for chunk in index.chunks) != frames:
            raise FormatError(f"its chunks do not add up to {frames} frames")
        mesh = decode_polygons(ground["connectivity"], polygons, corners, vertices)
        surface = unpack_surface(ground["surface"], path.parent, (mesh, vertices))
        if "uvs" in ground and parameters.uv_steps is not None:
            uvs = decode_uvs(ground["uvs"], mesh, vertices, parameters.uv_steps)
            surface = replace(surface, uvs=uvs)
        return SequenceHeader(
            polygons=mesh,
            vertex_count=vertices,
            times=unpack_times(ground["times"], float(facts["first_time"]), frames, fps),
            fps=fps,
            up_axis=str(facts["up_axis"]),
            metres_per_unit=float(facts["metres_per_unit"]),
            name=str(facts["name"]),
            surface=surface,
        )
    except (FormatError, InvalidSequenceError, LookupError, TypeError, ValueError, OverflowError) as error:
        raise FormatError(f"{path}: {error}; it is damaged") from error
    except MemoryError as error:
        raise FormatError(f"{path}: {error}; it is damaged, or there is too little memory") from error


def decoded(path: Path, coded: CompressedSequence) -> Model:
    """Return the model of a sequence read from a file; raise `FormatError` for contradictions or too much memory."""
    width, frames = 3 if coded.parameters.factors == "shapes" else 1, coded.header.frame_count
    numbers = coded.parameters.rank * (width * coded.header.vertex_count + 3 * frames)
    check_memory(path, _DECODED * numbers, "its basis and coefficients")
    try:
        return to_model(coded)
    except (FormatError, MemoryError) as error:
        raise FormatError(f"{path}: {error}") from error
