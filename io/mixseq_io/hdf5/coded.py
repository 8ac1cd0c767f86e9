"""HDF5 container of compressed models: one dataset of streams, one attribute that says what they mean.

::

    /            format = "mixseq-model", version = 4, created_by,
                 coding                  JSON: parameters, name, fps, up_axis, metres_per_unit, counts, first time
    /streams     (n,) uint8: see `mixseq_io.hdf5.streams`

HDF5 has little to say about this, on purpose: it takes more bytes for a second dataset than a checksum of every stream.
Attributes are strings of fixed length (strings of any length would cost 4 KiB). Layout in ``docs/file-format.md``.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from mixseq.coding.coded import Chunk, Coded, CodingParameters
from mixseq.errors import FormatError, InvalidSequenceError, SettingsError
from mixseq.sequence import SequenceHeader
from mixseq.version import __version__
from mixseq_io.hdf5.files import MODEL_FORMAT, kind_of, reading_h5, whole
from mixseq_io.hdf5.packing import pack_surface, pack_times, unpack_surface, unpack_times
from mixseq_io.hdf5.streams import CODED_VERSION, Index, Stored, Stream, pack_streams, read_index

CURE = "restore the file, or read the rest of it with mixseq decode --salvage"
"""What to do with a damaged file."""


_CONTAINER, _INDEX = 1200, 64
"""Bytes that HDF5 and the attributes take at most, and the index for 64 frames."""


def write_coded(file: h5py.File, coded: Coded) -> None:
    """Store a compressed sequence in a new HDF5 file."""
    stored = _stored(coded)
    for name, text in (
        ("format", MODEL_FORMAT.encode()),
        ("created_by", f"mixseq {__version__}".encode()),
        ("coding", stored.text),
    ):
        file.attrs.create(name, text, dtype=h5py.string_dtype("ascii", len(text)))
    file.attrs["version"] = CODED_VERSION
    file.create_dataset("streams", data=np.frombuffer(stored.streams, dtype=np.uint8), track_times=False)


def read_coded(path: Path) -> Coded:
    """Read a compressed sequence, and check every byte of it.

    Raises
    ------
    FormatError
        If the file is no compressed model, or damaged; the message names the stream and its frames.
    """
    return coded_of(path, read_stored(path))


def coded_of(path: Path, stored: Stored) -> Coded:
    """Make a compressed sequence of what is in a file, as `read_coded`."""
    index = read_index(path, stored)

    def sound(stream: Stream) -> bytes:
        data = stream.read(stored.streams)
        if data is None:
            raise FormatError(f"{path}: {stream.what} are damaged; {CURE}")
        return data

    # Everything is checked before anything is made of it.
    ground = {name: sound(stream) for name, stream in index.ground().items()}
    groups = tuple(sound(stream) for stream in index.fields)
    chunks = tuple(
        Chunk(each.first, each.count, sound(each.tracks), sound(each.corrections)) for each in index.chunks
    )
    return Coded(read_header(path, stored, index, ground), read_parameters(path, stored), groups, chunks)


def coded_sizes(path: Path) -> dict[str, int]:
    """Count the bytes of a compressed model.

    Returns
    -------
    dict
        ``total``: the file; ``connectivity``: the faces; ``container``: HDF5's own, and its attributes; ``signals``:
        everything else; and of these ``surface``: texture coordinates and the like, ``index``: lengths and checksums.

    Raises
    ------
    FormatError
        As `read_coded`, but streams are not looked at.
    """
    stored = read_stored(path)
    index = read_index(path, stored)
    total = path.stat().st_size
    return {
        "total": total,
        "connectivity": index.connectivity.size,
        "container": total - len(stored.streams),
        "signals": len(stored.streams) - index.connectivity.size,
        "surface": index.surface.size,
        "index": index.size,
    }


def room_for_signals(header: SequenceHeader, size: int) -> int:
    """Return how many bytes of a file of some size are left for fields, tracks and corrections.

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


def is_coded(path: Path) -> bool:
    """Whether a file is an HDF5 file with a compressed model.

    Raises
    ------
    FormatError
        If it is missing or cannot be read as HDF5.
    """
    with reading_h5(path), h5py.File(path, "r") as file:
        return kind_of(file) == MODEL_FORMAT and "coding" in file.attrs


def read_stored(path: Path) -> Stored:
    """Read what HDF5 has of a compressed model.

    Raises
    ------
    FormatError
        If it is another file, or HDF5 cannot read it.
    """
    with reading_h5(path), h5py.File(path, "r") as file:
        if kind_of(file) != MODEL_FORMAT or "coding" not in file.attrs:
            raise FormatError(f"{path} is no compressed model; make one with mixseq encode --max-error")
        return Stored(
            text=bytes(file.attrs["coding"]),
            streams=whole(path, file, "streams").astype(np.uint8).tobytes(),
            version=int(file.attrs["version"]),
        )


def _stored(coded: Coded) -> Stored:
    return pack_streams(_json(coded), _ground(coded.header), coded.fields, coded.chunks)


def _ground(header: SequenceHeader) -> list[bytes]:
    from mixseq.coding.connectivity import encode_polygons

    return [
        encode_polygons(header.polygons, header.vertex_count),
        pack_surface(header.surface),
        pack_times(header.times, header.fps),
    ]


def _json(coded: Coded) -> bytes:
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


def read_parameters(path: Path, stored: Stored) -> CodingParameters:
    """Read how the streams are to be decoded.

    Raises
    ------
    FormatError
        If there is a parameter that this mixseq does not know, or one is missing or out of range.
    """
    facts = _facts(path, stored)
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


def read_header(path: Path, stored: Stored, index: Index, ground: Mapping[str, bytes]) -> SequenceHeader:
    """Read mesh and times from the streams of `Index.ground`.

    Raises
    ------
    FormatError
        If they contradict each other.
    """
    from mixseq.coding.connectivity import decode_polygons

    facts = _facts(path, stored)
    try:
        vertices, polygons, corners, frames = (
            int(facts[f"{what}_count"]) for what in ("vertex", "polygon", "corner", "frame")
        )
        fps = float(facts["fps"])
        if sum(chunk.count for chunk in index.chunks) != frames:
            raise FormatError(f"its chunks do not add up to {frames} frames")
        return SequenceHeader(
            polygons=decode_polygons(ground["connectivity"], polygons, corners, vertices),
            vertex_count=vertices,
            times=unpack_times(ground["times"], float(facts["first_time"]), frames, fps),
            fps=fps,
            up_axis=str(facts["up_axis"]),
            metres_per_unit=float(facts["metres_per_unit"]),
            name=str(facts["name"]),
            surface=unpack_surface(ground["surface"], path.parent),
        )
    except (FormatError, InvalidSequenceError, LookupError, TypeError, ValueError, OverflowError) as error:
        raise FormatError(f"{path}: {error}; it is damaged") from error
    except MemoryError as error:
        raise FormatError(f"{path}: {error}; it is damaged, or there is too little memory") from error


def _facts(path: Path, stored: Stored) -> dict[str, Any]:
    try:
        facts = json.loads(stored.text)
    except ValueError as error:
        raise FormatError(f"{path}: the attribute coding is no JSON ({error}); it is damaged") from error
    if not isinstance(facts, dict) or not isinstance(facts.get("coding"), dict):
        raise FormatError(f"{path}: the attribute coding has no parameters; it is damaged")
    return facts
