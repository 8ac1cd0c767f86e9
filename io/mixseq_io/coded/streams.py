"""Read compressed models, which have a text that describes the streams, and one dataset with all streams.

The streams are connectivity, surface, times, texture coordinates and labels if any; every group of the spatial basis;
coefficients, residual layer, and in-betweens if any, of every chunk. The dataset begins with an index of the lengths
(LEB128) and CRC-32 checksums of all streams. Every further body has a text and a dataset of its own. First differences
of numbers are stored by byte: first bytes of all numbers, second bytes, and so on, most of which are zero.

Frozen: changing this breaks old files (golden: ``tests/formats/golden/compressed-v1*``). Specification:
``docs/file-format.md``.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, replace
from itertools import accumulate
from math import inf
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from mixseq.choices import ORDERS, OrderName
from mixseq.compression.bitstream.arithmetic import MAX_BITS_PER_BYTE, PADDING_BYTES
from mixseq.compression.bitstream.compressed_sequence import (
    MAX_CHUNK_FRAMES,
    Chunk,
    CodingParameters,
    CompressedSequence,
    TemporalInterpolation,
)
from mixseq.compression.bitstream.connectivity import decode_polygons
from mixseq.compression.bitstream.corner_values import decode_uvs
from mixseq.compression.bitstream.corners import decode_hard_edges, encode_hard_edges
from mixseq.compression.bitstream.spatial_basis import MAX_PARTS, FaceLabels
from mixseq.compression.compressed_model import CompressedModel
from mixseq.errors import FormatError, InvalidSequenceError, SettingsError
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import DEFAULT_COLOUR, CornerValues, Surface
from mixseq.sequence.events import describe_cuts
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.provenance import Provenance
from mixseq.signals.bodies import SAME_BODY, Relation
from mixseq.types import Float, Index
from mixseq_io.files import check_memory, format_gigabytes, max_memory
from mixseq_io.reader import DamageError
from mixseq_io.surfaces import surface_from_arrays, surface_to_arrays

COMPRESSED_VERSION = 1
"""Format version of compressed models, independent of the version of models with datasets. Frozen: breaks old files."""

MAGIC = b"msq1"
"""First bytes of the index. Frozen: breaks old files."""

INDEX_HEAD = struct.Struct("<4sIII")
"""Magic, size of the lengths, size of the checksums, CRC-32 of lengths and checksums. Frozen: breaks old files."""

_HEADER_STREAMS = {
    "connectivity": "the connectivity's bytes",
    "surface": "the surface's bytes",
    "times": "the times",
    "uvs": "the texture coordinates",
    "labels": "the labels of parts",
}
"""Streams of the header, and their names in error messages."""

LABEL_COUNT = "label_count"
"""Parameter with the number of parts that label triangles. Frozen: breaks old files."""

INBETWEEN_LEVELS = "inbetween_levels"
"""Parameter of files whose chunks have streams of in-betweens. Frozen: breaks old files."""

_OPTIONAL_STREAMS = {"uvs": "uv_steps", "labels": LABEL_COUNT}
"""Streams of the header that not all files have, and the parameters that they come with."""


_MIN_NUMBER, _MAX_NUMBER, _MAX_INTEGER = 1e-100, 1e100, 2**53
"""Range of numbers in the text, whose squares are finite and not zero, and of integers. Frozen: part of the format."""

MAX_SHOWN_DIGITS = 24
"""Number of characters of a number in messages."""


@dataclass(frozen=True)
class Container:
    """Contents of a file: the raw attribute ``coding``, the raw dataset ``streams``, and the format version."""

    text: bytes
    streams: bytes
    version: int = COMPRESSED_VERSION
    bodies: tuple[Container, ...] = ()  # of further bodies

    @property
    def nbytes(self) -> int:
        """Number of bytes of the streams of all bodies."""
        return len(self.streams) + sum(each.nbytes for each in self.bodies)


@dataclass(frozen=True)
class Stream:
    """A stream in the dataset: its name, range in bytes, and CRC-32."""

    name: str
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
    inbetweens: Stream | None  # None in files without


@dataclass(frozen=True)
class StreamIndex:
    """The size of the index, and all streams of a file; `header` has those of `_HEADER_STREAMS`."""

    size: int
    header: Mapping[str, Stream]
    basis: tuple[Stream, ...]
    chunks: tuple[ChunkStreams, ...]


def read_index(path: Path, container: Container) -> StreamIndex:
    """Read the index; raise `FormatError` if the version differs, or the index or the attribute is damaged."""
    if container.version != COMPRESSED_VERSION:
        raise FormatError(
            f"{path} is a compressed model of version {container.version}, this mixseq reads {COMPRESSED_VERSION}: "
            "upgrade with pip install --upgrade mixseq, or compress the original again"
        )
    damaged = FormatError(f"{path}: its index is damaged, so nothing can be read; restore the file")
    if len(container.streams) < INDEX_HEAD.size:
        raise damaged
    magic, lengths_size, checksums_size, checksum = INDEX_HEAD.unpack_from(container.streams)
    size = INDEX_HEAD.size + lengths_size + checksums_size
    body = container.streams[INDEX_HEAD.size : size]
    if magic != MAGIC or crc32(body) != checksum or checksums_size % 4:
        raise damaged
    numbers = list(unpack_leb128(body[:lengths_size]))
    checksums = np.frombuffer(body[lengths_size:], dtype="<u4").tolist()
    if not checksums or crc32(container.text) != checksums[0]:
        raise damaged
    coding = read_facts(path, container)["coding"]
    absent = {name for name, parameter in _OPTIONAL_STREAMS.items() if coding.get(parameter) is None}
    header = [name for name in _HEADER_STREAMS if name not in absent]
    try:
        return _index_streams(size, numbers, checksums[1:], header, coding.get(INBETWEEN_LEVELS) is not None)
    except (IndexError, ValueError, StopIteration) as error:  # checksum right: written with this error
        raise damaged from error


def _index_streams(
    size: int, numbers: list[int], checksums: list[int], header: list[str], has_inbetweens: bool
) -> StreamIndex:
    group_count, chunk_count, *rest = numbers
    counts, lengths = rest[:chunk_count], rest[chunk_count:]
    if len(lengths) != len(header) + group_count + (2 + has_inbetweens) * chunk_count:
        raise DamageError("the number of streams is not that of the parts of the file")
    if not all(0 < count <= MAX_CHUNK_FRAMES for count in counts) or max(lengths) >= 1 << 63:
        raise DamageError("a chunk has no frames or too many, or a stream is too long")
    ranges = zip(accumulate(lengths, initial=size), lengths, strict=False)
    remaining = iter(checksums)

    def stream(name: str) -> Stream:
        start, length = next(ranges)
        return Stream(name, start, length, next(remaining) if length else 0)

    header_streams = {name: stream(_HEADER_STREAMS[name]) for name in header}
    basis = tuple([stream(f"the basis vectors of group {group}") for group in range(group_count)])
    chunks = []
    for first, count in zip([0, *accumulate(counts)], counts, strict=False):
        frames = f"of frames {first} to {first + count - 1}"
        coefficients, residuals = stream(f"the coefficients {frames}"), stream(f"the residuals {frames}")
        inbetweens = stream(f"the in-betweens {frames}") if has_inbetweens else None
        chunks.append(ChunkStreams(first, count, coefficients, residuals, inbetweens))
    if next(remaining, None) is not None:
        raise DamageError("there are more checksums than streams")
    return StreamIndex(size, header_streams, basis, tuple(chunks))


def read_facts(path: Path, container: Container) -> dict[str, Any]:
    """Return the attribute ``coding``; raise `FormatError` if it is not JSON, or has no parameters."""
    try:
        facts = json.loads(container.text, parse_int=_number, parse_float=_number, parse_constant=_number)
    except (ValueError, RecursionError) as error:
        raise FormatError(f"{path}: the attribute coding is not valid ({error}); it is damaged") from error
    if not isinstance(facts, dict) or not isinstance(facts.get("coding"), dict):
        raise FormatError(f"{path}: the attribute coding has no parameters; it is damaged")
    return facts


def _number(text: str) -> float:
    """Parse a number of the text as decoders in JavaScript do; whole numbers become integers."""
    number = float(text)
    if number and not _MIN_NUMBER <= abs(number) <= _MAX_NUMBER:
        shown = text if len(text) <= MAX_SHOWN_DIGITS else f"{text[:MAX_SHOWN_DIGITS]}..."
        raise DamageError(f"a number is {shown}; 0, or from {_MIN_NUMBER} to {_MAX_NUMBER} is expected")
    return int(number) if number.is_integer() and abs(number) <= _MAX_INTEGER else number


def pack_leb128(numbers: Iterable[int]) -> bytes:
    """Pack non-negative integers with 7 bits per byte, lowest bits first (LEB128): [5, 300] becomes 05 ac 02."""
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


Mesh = tuple[Polygons, int]
"""Polygons, and the number of vertices."""

_HARD_EDGES = "hard_edges"
"""Name of the array of coded hard edges, which replaces `creases`, the indices of normals. Frozen: breaks old files."""


def pack_times(times: Float, fps: float) -> bytes:
    """Pack deviations of times ``(T,)`` from ``times[0] + n / fps`` as integers of bits; no bytes if all are zero."""
    deviations = _as_integers(times) - _as_integers(_regular_times(float(times[0]), len(times), fps))
    return zlib.compress(_shuffle_bytes(np.diff(deviations, prepend=0)), 9) if deviations.any() else b""


def unpack_times(packed: bytes, first: float, count: int, fps: float) -> Float:
    """Return the times ``(T,)`` packed by `pack_times`; raise `FormatError` if there are not `count` times."""
    regular = _regular_times(first, count, fps)
    if not packed:
        return regular
    data = _decompress(packed, 8 * count + 1, "the times are")
    if len(data) != 8 * count:
        raise FormatError(f"there are {len(data)} bytes of times, {8 * count} are expected")
    deviations = np.cumsum(_unshuffle_bytes(data, np.dtype("<i8"), count))
    return np.asarray((_as_integers(regular) + deviations).view(np.float64))


def _regular_times(first: float, count: int, fps: float) -> Float:
    with np.errstate(all="ignore"):  # damaged files may have arbitrary numbers
        return np.asarray(first + np.arange(count) / fps, dtype=np.float64)


def _as_integers(times: Float) -> Index:
    return np.ascontiguousarray(times).view(np.int64)


def _decompress(packed: bytes, max_size: int, name: str) -> bytes:
    """Decompress the output of `zlib.compress`; return at most `max_size` bytes."""
    try:
        return zlib.decompressobj().decompress(packed, max_size)
    except zlib.error as error:
        raise FormatError(f"{name} damaged ({error})") from error


def pack_surface(surface: Surface, mesh: Mesh) -> bytes:
    """Pack a surface; return no bytes if it has no attributes.

    The result is a JSON list of the arrays' names, types and shapes (with all texts), a zero byte, and the arrays'
    bytes, compressed by zlib. If possible, `mixseq.compression.bitstream.corners` codes the hard edges. Colours
    per vertex are stored in the order of the vertices, without indices.
    """
    descriptions: list[list[Any]] = []
    data = []
    for name, array in _compact_arrays(surface, mesh).items():
        if array.dtype.kind == "U":
            descriptions.append([name, array.tolist()])
        else:
            little = array.astype(array.dtype.newbyteorder("<"))
            descriptions.append([name, little.dtype.str, little.shape])
            flat = little.reshape(-1)
            if flat.dtype.kind == "i":  # first differences, with wrap-around
                flat = np.diff(flat, prepend=flat.dtype.type(0))
            data.append(_shuffle_bytes(flat))
    if not descriptions:
        return b""
    text = json.dumps(descriptions, separators=(",", ":")).encode("ascii")
    return zlib.compress(b"\0".join([text, b"".join(data)]), 9)


def _compact_arrays(surface: Surface, mesh: Mesh) -> dict[str, NDArray[Any]]:
    """Return the arrays of a surface, shortened or omitted where they follow from the mesh."""
    polygons, vertex_count = mesh
    corners, colours = polygons.indices, surface.colours
    is_per_vertex = colours is not None and colours.one_per_vertex(corners)
    if colours is not None and is_per_vertex:
        values = colours.at_vertices(corners, vertex_count, DEFAULT_COLOUR)
        surface = replace(surface, colours=CornerValues(values, corners))
    arrays = surface_to_arrays(surface)
    if is_per_vertex:
        del arrays["colour_indices"]
    coded = None if surface.hard_edges is None else encode_hard_edges(*mesh, surface.hard_edges)
    if coded is None:
        return arrays
    del arrays["creases"]
    return arrays | {_HARD_EDGES: np.frombuffer(coded, dtype=np.uint8)}


def unpack_surface(packed: bytes, folder: Path, mesh: Mesh) -> Surface:
    """Return the surface packed by `pack_surface`; raise `FormatError` or `InvalidSequenceError` if it is damaged."""
    if not packed:
        return Surface()
    try:
        limit = max_memory()
        unpacked = _decompress(packed, limit, "the surface is")
        if len(unpacked) == limit:  # the length of the rest is unknown
            raise FormatError(
                f"the surface takes more than {format_gigabytes(limit)} of memory, the limit (--max-memory)"
            )
        text, _, data = unpacked.partition(b"\0")
        arrays = _split_arrays(json.loads(text), data)
        coded = arrays.pop(_HARD_EDGES, None)
        if coded is not None:
            arrays["creases"] = decode_hard_edges(coded.tobytes(), *mesh)
        if "colour_values" in arrays:
            arrays.setdefault("colour_indices", mesh[0].indices)
        return surface_from_arrays(arrays, folder)
    except (ValueError, TypeError, KeyError, IndexError) as error:
        raise FormatError(f"the surface is damaged ({error})") from error


def _split_arrays(descriptions: list[list[Any]], data: bytes) -> dict[str, NDArray[Any]]:
    arrays: dict[str, NDArray[Any]] = {}
    start = 0
    for name, *description in descriptions:
        if len(description) == 1:
            arrays[name] = np.array(description[0], dtype=np.str_)
            continue
        dtype, shape = np.dtype(description[0]), tuple(description[1])
        count = int(np.prod(shape, dtype=np.int64))
        flat = _unshuffle_bytes(data[start : start + count * dtype.itemsize], dtype, count)
        start += count * dtype.itemsize
        if dtype.kind == "i":
            flat = np.cumsum(flat, dtype=dtype)
        arrays[name] = flat.reshape(shape).astype(dtype.newbyteorder("="))
    return arrays


def _shuffle_bytes(array: NDArray[Any]) -> bytes:
    """Return the first bytes of all numbers, then their second bytes, and so on."""
    little = array.astype(array.dtype.newbyteorder("<"))
    return little.view(np.uint8).reshape(len(array), array.dtype.itemsize).T.tobytes()


def _unshuffle_bytes(data: bytes, dtype: np.dtype[Any], count: int) -> NDArray[Any]:
    planes = np.frombuffer(data, dtype=np.uint8).reshape(dtype.itemsize, count)
    return np.ascontiguousarray(planes.T).view(dtype).reshape(count)


_BYTES_PER_VERTEX, _BYTES_PER_CORNER, _BYTES_PER_SURFACE_CORNER = 800, 256, 256
"""Memory in bytes for decoding: graphs and stencils per vertex; half-edges per corner; extra with a surface."""

_BYTES_PER_FRAME, _BYTES_PER_NUMBER, _BYTES_PER_RESIDUAL_BYTE = 64, 16, 86
"""Memory in bytes per frame, number of signals, and byte of the largest residuals of a chunk."""


def read_sequence(path: Path, container: Container) -> CompressedSequence:
    """Read and check a compressed sequence; raise `FormatError` that names the damaged stream and its frames."""
    index = read_index(path, container)

    def read(stream: Stream) -> bytes:
        data = stream.read(container.streams)
        if data is None:
            raise FormatError(f"{path}: {stream.name} are damaged; restore the file")
        return data

    # All streams are checked before any is decoded.
    header_data = {name: read(stream) for name, stream in index.header.items()}
    basis = tuple(map(read, index.basis))
    chunks = tuple(
        Chunk(
            chunk.first,
            chunk.count,
            read(chunk.coefficients),
            read(chunk.residuals),
            b"" if chunk.inbetweens is None else read(chunk.inbetweens),
        )
        for chunk in index.chunks
    )
    facts = read_facts(path, container)
    parameters = _parameters(path, facts)
    header = _header(path, facts, parameters, index, header_data)
    order: OrderName = facts.get("order", "keep")
    if order not in ORDERS:
        raise FormatError(f"{path}: the order {order!r} is unknown to this mixseq; upgrade it")
    between = _between(path, facts)
    provenance = _provenance(path, facts, parameters, order)
    header = replace(
        header, provenance=replace(provenance, events=describe_cuts(between.cuts if between else (), header))
    )
    labels = _face_labels(path, facts["coding"].get(LABEL_COUNT), header_data.get("labels", b""))
    bodies = tuple(read_sequence(path, each) for each in container.bodies)
    relation = _relation(path, facts)
    try:
        return CompressedSequence(header, parameters, basis, chunks, order, between, labels, bodies, relation)
    except SettingsError as error:
        raise FormatError(f"{path}: {error}; it is damaged") from error


def _relation(path: Path, facts: Mapping[str, Any]) -> Relation:
    """Return the relation of a body to the first one; raise `FormatError` if it is invalid."""
    try:
        relation = Relation(**facts["relation"]) if "relation" in facts else SAME_BODY
        turn = np.asarray(relation.turn, dtype=np.float64)
        if turn.shape == (4,) and abs(np.linalg.norm(turn) - 1.0) < 1e-6 and isinstance(relation.same_parts, bool):
            return relation._replace(turn=tuple(turn.tolist()))
    except (TypeError, ValueError):
        pass
    raise FormatError(f"{path}: relation is {facts['relation']!r}; a quaternion is expected; it is damaged")


def _face_labels(path: Path, count: object, data: bytes) -> FaceLabels | None:
    """Return the coded parts of triangles; None if the file has none."""
    if count is None:
        return None
    if not (type(count) is int and 0 < count <= MAX_PARTS):
        raise FormatError(f"{path}: {LABEL_COUNT} is {count!r}; a whole number from 1 to {MAX_PARTS} is expected")
    return FaceLabels(count, data)


def _parameters(path: Path, facts: Mapping[str, Any]) -> CodingParameters:
    """Return the decoding parameters; raise `FormatError` if one is unknown, missing or out of range."""
    coding: dict[str, Any] = {name: value for name, value in facts["coding"].items() if name != LABEL_COUNT}
    unknown = sorted(set(coding) - {field.name for field in fields(CodingParameters)})
    if unknown:
        raise FormatError(f"{path}: the parameter {unknown[0]!r} is unknown to this mixseq; upgrade it")
    if not (
        isinstance(coding.get("ranks", []), list) and isinstance(origin := coding.get("origin", [0]), list) and origin
    ):
        raise FormatError(f"{path}: ranks or origin are no list of numbers; it is damaged")
    try:
        parameters = CodingParameters(**coding)
    except TypeError as error:
        raise FormatError(f"{path}: parameters are missing ({error}); it is damaged") from error
    except SettingsError as error:
        raise FormatError(f"{path}: {error}; it is damaged") from error
    if parameters.frame_count != facts.get("frame_count"):
        raise FormatError(f"{path}: its two numbers of frames differ; it is damaged")
    return parameters


def _provenance(path: Path, facts: Mapping[str, Any], parameters: CodingParameters, order: OrderName) -> Provenance:
    """Return the provenance of the decoded frames; raise `FormatError` if that of their source is invalid."""
    try:
        source = Provenance.from_plain(facts.get("source", {}))
    except (SettingsError, TypeError) as error:
        raise FormatError(f"{path}: source: {error}; it is damaged") from error
    bound = parameters.max_error, parameters.diagonal, parameters.promised
    return Provenance(path.name, source, *bound, order=order)


def _between(path: Path, facts: Mapping[str, Any]) -> TemporalInterpolation | None:
    """Return the interpolation of coefficients between frames, None if absent; raise `FormatError` if it is invalid."""
    between = facts.get("between")
    if between is None:
        return None
    if not (isinstance(between, dict) and set(between) in ({"length", "cubic"}, {"length", "cubic", "cuts"})):
        raise FormatError(f"{path}: between is {between!r}; length, cubic and cuts are expected; it is damaged")
    length, (cubic, cuts) = between["length"], (between["cubic"], between.get("cuts", []))
    cubic, cuts = (tuple(value) if isinstance(value, list) else value for value in (cubic, cuts))
    try:
        interpolation = TemporalInterpolation(inf if length is None else length, cubic, cuts)
    except SettingsError as error:
        raise FormatError(f"{path}: between: {error}; it is damaged") from error
    if cuts and cuts[-1] >= facts["frame_count"]:
        raise FormatError(f"{path}: between: a cut is before frame {cuts[-1]} of {facts['frame_count']}; it is damaged")
    return interpolation


_ELEMENTS = ("vertex", "polygon", "corner", "frame")
_FACT_TYPES: Mapping[str, tuple[type, ...]] = {
    **{f"{element}_count": (int,) for element in _ELEMENTS},
    **dict.fromkeys(("fps", "first_time", "metres_per_unit"), (int, float)),
    **dict.fromkeys(("name", "up_axis"), (str,)),
}
"""Types of the values of the text that have no class of their own."""


def _check_facts(path: Path, facts: Mapping[str, Any], parameters: CodingParameters, index: StreamIndex) -> None:
    """Raise `FormatError` if a value is of another type, streams are too short for its counts, or memory is."""
    for name, types in _FACT_TYPES.items():
        if type(value := facts.get(name)) not in types:
            expected = " or ".join(each.__name__ for each in types)
            raise FormatError(f"{path}: {name} is {ascii(value)[:40]}; {expected} is expected; it is damaged")
    vertices, _, corners, frames = (max(facts[f"{element}_count"], 0) for element in _ELEMENTS)
    is_shapes, rank = parameters.factors == "shapes", parameters.rank
    width, dim = (3, 1) if is_shapes else (1, 3)
    # Every number takes a modelled bit. Shapes may have no coefficients: the mean shape alone.
    coded = [("corners", corners, index.header["connectivity"].size)]
    coded.append(
        ("vertices", width * min(parameters.ranks or (rank,)) * vertices, sum(each.size for each in index.basis))
    )
    coded += [("frames", 0 if is_shapes else dim * chunk.count, chunk.coefficients.size) for chunk in index.chunks]
    for name, numbers, size in coded:
        if numbers > MAX_BITS_PER_BYTE * (size + PADDING_BYTES * (len(index.basis) + 1)):
            raise FormatError(f"{path}: {size} bytes cannot hold {numbers} numbers of its {name}; it is damaged")
    memory = _BYTES_PER_VERTEX * vertices + _BYTES_PER_CORNER * corners + _BYTES_PER_FRAME * frames
    if index.header["surface"].size or "uvs" in index.header:
        memory += _BYTES_PER_SURFACE_CORNER * corners
    memory += _BYTES_PER_RESIDUAL_BYTE * max((chunk.residuals.size for chunk in index.chunks), default=0)
    knots = frames << (parameters.inbetween_levels or 0)
    memory += _BYTES_PER_NUMBER * rank * (width * vertices + dim * knots)
    if parameters.inbetween_parts:
        memory += 4 * _BYTES_PER_NUMBER * (vertices + 3 * MAX_PARTS * knots)
    check_memory(path, memory, "decoding it")


def _header(
    path: Path, facts: Mapping[str, Any], parameters: CodingParameters, index: StreamIndex, data: Mapping[str, bytes]
) -> SequenceHeader:
    """Decode mesh and times from `StreamIndex.header`; raise `FormatError` if they are contradictory or too large."""
    _check_facts(path, facts, parameters, index)
    vertices, polygons, corners, frames = (facts[f"{element}_count"] for element in _ELEMENTS)
    try:
        if sum(chunk.count for chunk in index.chunks) != frames:
            raise FormatError(f"its chunks do not add up to {frames} frames")
        mesh = decode_polygons(data["connectivity"], polygons, corners, vertices)
        surface = unpack_surface(data["surface"], path.parent, (mesh, vertices))
        if "uvs" in data and parameters.uv_steps is not None:
            surface = replace(surface, uvs=decode_uvs(data["uvs"], mesh, vertices, parameters.uv_steps))
        return SequenceHeader(
            polygons=mesh,
            vertex_count=vertices,
            times=unpack_times(data["times"], float(facts["first_time"]), frames, float(facts["fps"])),
            fps=facts["fps"],
            up_axis=facts["up_axis"],
            metres_per_unit=facts["metres_per_unit"],
            name=facts["name"],
            surface=surface,
        )
    except (FormatError, InvalidSequenceError, LookupError, TypeError, ValueError, OverflowError) as error:
        raise FormatError(f"{path}: {error}; it is damaged") from error
    except MemoryError as error:
        raise FormatError(f"{path}: {error}; it is damaged, or there is too little memory") from error


def decode_model(path: Path, coded: CompressedSequence) -> CompressedModel:
    """Decode a sequence read from a file; raise `FormatError` if it is contradictory."""
    try:
        return CompressedModel.from_sequence(coded)
    except (FormatError, MemoryError) as error:
        raise FormatError(f"{path}: {error}") from error
