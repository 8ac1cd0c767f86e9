"""What glTF meshes consist of, quantised and packed: points, normals, texture coordinates, numbers, triangles.

Points and texture coordinates are fixed-point numbers: multiples of a power of two, which readers see as float32 (the
filter EXPONENTIAL). So what is rounded is rounded once, differences are exact, and no node has to scale anything.
Normals are bytes (``KHR_mesh_quantization``) on the octahedron. Triangles may begin with another of their corners.
All is packed as ``EXT_meshopt_compression``.

Specification: https://github.com/KhronosGroup/glTF/blob/main/extensions/2.0/Vendor/EXT_meshopt_compression/README.md
"""

from __future__ import annotations

from math import floor, log2, sqrt
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mixseq_io.gltf.buffers import INDICES, VERTICES, Layout, require
from mixseq_io.gltf.meshopt import fixed_point, octahedral, packed_attributes, packed_triangles

_SIGNED_BYTE, _UNSIGNED_SHORT, _UNSIGNED_INT = 5120, 5123, 5125
_NORMAL_BITS = 8
_LARGEST_BYTE = 127
_LARGEST_SHORT = 2**16 - 1
UV_EXPONENT = -15
"""Texture coordinates are wrong by at most 1/65536: a sixteenth of a texel of 4096."""


def exponent_within(error: float) -> int:
    """Return the largest exponent of steps with which no point is wrong by more than `error`.

    Examples
    --------
    >>> exponent_within(0.01)  # steps of 1/128, so that points are wrong by at most sqrt(3)/256
    -7
    """
    return floor(log2(2 * error / sqrt(3)))


def rounded(values: ArrayLike, exponent: int) -> NDArray[np.float32]:
    """Return what readers see of fixed-point numbers, of any shape."""
    steps = np.rint(np.ldexp(np.asarray(values, dtype=np.float64), -exponent))
    return np.ldexp(steps, exponent).astype(np.float32)


def add_fixed_point(layout: Layout, values: ArrayLike, exponent: int, bounds: bool = False) -> int:
    """Add an attribute ``(n,)`` or ``(n, k)`` in steps of ``2**exponent``; return its accessor.

    Parameters
    ----------
    layout : Layout
        The document.
    values : (n,) or (n, k) array-like
        Points, texture coordinates, numbers of vertices, or what a morph target adds to points.
    exponent : int
        See `exponent_within`.
    bounds : bool
        Whether to tell the smallest and largest, as glTF demands of points.

    Raises
    ------
    SettingsError
        If a number is more than 2**23 steps.
    """
    rows = np.asarray(values, dtype=np.float64)
    rows = rows.reshape(len(rows), -1)
    view = _add_attribute(layout, fixed_point(rows, exponent), "EXPONENTIAL")
    kind = "SCALAR" if rows.shape[1] == 1 else f"VEC{rows.shape[1]}"
    accessor = layout.accessor(view, len(rows), kind)
    if bounds:
        seen = rounded(rows, exponent)
        layout.bounded(accessor, (seen.min(axis=0).tolist(), seen.max(axis=0).tolist()))
    return accessor


def add_normals(layout: Layout, normals: ArrayLike) -> int:
    """Add unit vectors ``(n, 3)`` as signed bytes; return their accessor. They are wrong by about a degree at most."""
    rows = octahedral(normals, _NORMAL_BITS)
    require(layout.document, "KHR_mesh_quantization")
    accessor = layout.accessor(
        _add_attribute(layout, rows, "OCTAHEDRAL"), len(rows), "VEC3", component=_SIGNED_BYTE
    )
    layout.document["accessors"][accessor]["normalized"] = True
    return accessor


def add_normal_changes(layout: Layout, changes: ArrayLike) -> int:
    """Add what a morph target adds to normals ``(n, 3)``, from -1 to 1, as signed bytes; return their accessor."""
    steps = np.rint(np.asarray(changes, dtype=np.float64) * _LARGEST_BYTE).astype(np.int8)
    require(layout.document, "KHR_mesh_quantization")
    accessor = add_rows(layout, steps, "VEC3", _SIGNED_BYTE)
    layout.document["accessors"][accessor]["normalized"] = True
    return accessor


def add_triangles(layout: Layout, triangles: NDArray[np.integer]) -> int:
    """Add triangles ``(F, 3)``; return their accessor."""
    short = triangles.max(initial=0) < _LARGEST_SHORT
    stride, component = (2, _UNSIGNED_SHORT) if short else (4, _UNSIGNED_INT)
    data = packed_triangles(triangles)
    view = layout.add_packed(data, triangles.size, stride, {"target": INDICES}, mode="TRIANGLES")
    return layout.accessor(view, triangles.size, "SCALAR", component=component)


def add_rows(layout: Layout, values: NDArray[Any], kind: str, component: int) -> int:
    """Add numbers ``(n, k)`` of a type of glTF as they are; return their accessor.

    Rows are filled up to a multiple of four bytes, as attributes must be.
    """
    data = np.ascontiguousarray(values).view(np.uint8).reshape(len(values), -1)
    width = -(-data.shape[1] // 4) * 4
    padded = np.pad(data, ((0, 0), (0, width - data.shape[1])))
    # Other data than attributes have no stride, and no need of it.
    properties = {} if width == data.shape[1] else {"byteStride": width}
    view = layout.add_packed(packed_attributes(padded), len(data), width, properties, mode="ATTRIBUTES")
    return layout.accessor(view, len(data), kind, component=component)


def _add_attribute(layout: Layout, rows: NDArray[np.uint8], name: str) -> int:
    """Add a view of bytes ``(n, stride)`` to which a filter was applied."""
    count, stride = rows.shape
    properties = {"byteStride": stride, "target": VERTICES}
    return layout.add_packed(
        packed_attributes(rows), count, stride, properties, mode="ATTRIBUTES", filter=name
    )
