"""Lossless packing of times and surfaces of compressed models.

First differences of numbers are stored bytewise: the first bytes of all numbers, then the second bytes, and so on.
Most are zeros, which zlib compresses well.

Frozen: changing this breaks old files (golden: ``tests/formats/golden/compressed-v1.h5``).
"""

from __future__ import annotations

import json
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixseq.coding.bitstream.hard_edges import decode_hard_edges, encode_hard_edges
from mixseq.errors import FormatError
from mixseq.polygons import Polygons
from mixseq.surface import WHITE, CornerValues, Surface
from mixseq_io.memory import gigabytes, max_memory
from mixseq_io.surface_arrays import surface_arrays, surface_of_arrays

Mesh = tuple[Polygons, int]
"""Polygons, and the number of vertices."""

_HARD_EDGES = "hard_edges"
"""Array of coded hard edges; `creases` are indices of normals. Frozen: breaks old files."""


def pack_times(times: NDArray[np.float64], fps: float) -> bytes:
    """Return the packed deviations of times ``(T,)`` from ``times[0] + n / fps``, empty if there are none.

    Differences of the numbers' bits, taken as integers, are stored, so that nothing is rounded.
    """
    apart = _bits(times) - _bits(_regular(float(times[0]), len(times), fps))
    return zlib.compress(_shuffled(np.diff(apart, prepend=0)), 9) if apart.any() else b""


def unpack_times(packed: bytes, first: float, count: int, fps: float) -> NDArray[np.float64]:
    """Return the times ``(T,)`` that `pack_times` was given; raise `FormatError` for another number of times."""
    regular = _regular(first, count, fps)
    if not packed:
        return regular
    data = _decompressed(packed, 8 * count + 1, "the times are")
    if len(data) != 8 * count:
        raise FormatError(f"there are {len(data)} bytes of times, {8 * count} are expected")
    apart = np.cumsum(_unshuffled(data, np.dtype("<i8"), count))
    times: NDArray[np.float64] = (_bits(regular) + apart).view(np.float64)
    return times


def _regular(first: float, count: int, fps: float) -> NDArray[np.float64]:
    with np.errstate(all="ignore"):  # damaged files have any numbers
        regular: NDArray[np.float64] = first + np.arange(count) / fps
    return regular


def _bits(times: NDArray[np.float64]) -> NDArray[np.int64]:
    return np.ascontiguousarray(times).view(np.int64)


def _decompressed(packed: bytes, most: int, what: str) -> bytes:
    """Undo `zlib.compress`, up to `most` bytes."""
    try:
        return zlib.decompressobj().decompress(packed, most)
    except zlib.error as error:
        raise FormatError(f"{what} damaged ({error})") from error


def pack_surface(surface: Surface, mesh: Mesh) -> bytes:
    """Return a packed surface, empty if it has nothing.

    A JSON list of the arrays' names, types and shapes (with all texts), a zero byte, the arrays' bytes;
    all of it compressed by zlib. Hard edges are coded by `mixseq.coding.bitstream.hard_edges`, if they can be. Colours
    per vertex are in the order of the vertices, without indices.
    """
    listed: list[list[Any]] = []
    data = []
    for name, array in _arrays_on(surface, mesh).items():
        if array.dtype.kind == "U":
            listed.append([name, array.tolist()])
        else:
            little = array.astype(array.dtype.newbyteorder("<"))
            listed.append([name, little.dtype.str, little.shape])
            data.append(_shuffled(_differences(little.reshape(-1))))
    if not listed:
        return b""
    text = json.dumps(listed, separators=(",", ":")).encode("ascii")
    return zlib.compress(b"\0".join([text, b"".join(data)]), 9)


def _arrays_on(surface: Surface, mesh: Mesh) -> dict[str, NDArray[Any]]:
    """Return the arrays of a surface, shortened or omitted where they follow from the mesh."""
    polygons, vertex_count = mesh
    corners, colours = polygons.indices, surface.colours
    of_vertices = colours is not None and colours.one_per_vertex(corners)
    if colours is not None and of_vertices:
        values = colours.at_vertices(corners, vertex_count, WHITE)
        surface = replace(surface, colours=CornerValues(values, corners))
    arrays = surface_arrays(surface)
    if of_vertices:
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
        whole = _decompressed(packed, limit, "the surface is")
        if len(whole) == limit:  # it continues to an unknown length
            raise FormatError(
                f"the surface takes more than {gigabytes(limit)} of memory, the limit (--max-memory)"
            )
        text, _, data = whole.partition(b"\0")
        arrays = _arrays(json.loads(text), data)
        coded = arrays.pop(_HARD_EDGES, None)
        if coded is not None:
            arrays["creases"] = decode_hard_edges(coded.tobytes(), *mesh)
        if "colour_values" in arrays:
            arrays.setdefault("colour_indices", mesh[0].indices)
        return surface_of_arrays(arrays, folder)
    except (ValueError, TypeError, KeyError, IndexError) as error:
        raise FormatError(f"the surface is damaged ({error})") from error


def _arrays(listed: list[list[Any]], data: bytes) -> dict[str, NDArray[Any]]:
    arrays: dict[str, NDArray[Any]] = {}
    start = 0
    for name, *what in listed:
        if len(what) == 1:
            arrays[name] = np.array(what[0], dtype=np.str_)
            continue
        dtype, shape = np.dtype(what[0]), tuple(what[1])
        count = int(np.prod(shape, dtype=np.int64))
        flat = _unshuffled(data[start : start + count * dtype.itemsize], dtype, count)
        start += count * dtype.itemsize
        if dtype.kind == "i":
            flat = np.cumsum(flat, dtype=dtype)
        arrays[name] = flat.reshape(shape).astype(dtype.newbyteorder("="))
    return arrays


def _differences(array: NDArray[Any]) -> NDArray[Any]:
    """Return first differences of integers, with wrap-around; floats unchanged."""
    return np.diff(array, prepend=array.dtype.type(0)) if array.dtype.kind == "i" else array


def _shuffled(array: NDArray[Any]) -> bytes:
    """Return the first bytes of all numbers, then their second bytes, and so on."""
    little = array.astype(array.dtype.newbyteorder("<"))
    return little.view(np.uint8).reshape(len(array), array.dtype.itemsize).T.tobytes()


def _unshuffled(data: bytes, dtype: np.dtype[Any], count: int) -> NDArray[Any]:
    planes = np.frombuffer(data, dtype=np.uint8).reshape(dtype.itemsize, count)
    return np.ascontiguousarray(planes.T).view(dtype).reshape(count)
