"""Buffer views that meshoptimizer packs: vertices, triangles and other indices, in few bytes.

Packing and unpacking are meshoptimizer's own; what is unpacked comes from a stranger, and so in a process of its own.

Packages: meshopt (extra `gltf`).

Specification: https://github.com/KhronosGroup/glTF/blob/main/extensions/2.0/Vendor/EXT_meshopt_compression/README.md
"""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mixseq.errors import MissingExtraError, SettingsError
from mixseq_io.gltf.document import Document
from mixseq_io.gltf.json_fields import Fields
from mixseq_io.isolation import call_isolated

Rows = NDArray[np.uint8]

_LARGEST = 2**23 - 1
"""Of the whole numbers that the filter EXPONENTIAL has."""


def unpacked_view(document: Document, packed: Fields) -> bytes:
    """Return what is in a view, given what the extension says of it.

    Raises
    ------
    MissingExtraError
        If the package meshopt is not installed.
    FormatError
        If the data are damaged, or packed in a way that is not known here.
    """
    require_package(f"{document.path} is compressed by meshoptimizer; to read it")
    count, stride = packed.integer("count"), packed.integer("byteStride")
    mode, name = packed.text("mode"), packed.text("filter", "NONE")
    data = document.part(packed)
    here = "mixseq_io.gltf.meshopt:unpacked"
    rows = call_isolated(here, document.path, data, packed.place, count, stride, mode, name)
    return bytes(rows.tobytes())


def unpacked(path: Path, data: bytes, place: str, count: int, stride: int, mode: str, name: str) -> Rows:
    """Unpack a view; see `unpacked_view`. A damaged one may end the process."""
    import meshopt

    try:
        rows = meshopt.decode_gltf_buffer(data, count, stride, mode, name)
    except (ValueError, RuntimeError, TypeError) as error:
        raise Fields(path, place, {}).error(
            f"cannot be unpacked by meshoptimizer ({mode[:40]!r}, {name[:40]!r}, {stride} bytes each): {error}"
        ) from None
    return np.ascontiguousarray(rows).view(np.uint8)


def require_package(purpose: str) -> None:
    """Refuse to go on without the package; the message begins with the purpose.

    Raises
    ------
    MissingExtraError
        If it is not installed.
    """
    if find_spec("meshopt") is None:
        raise MissingExtraError(f"{purpose}: pip install 'mixseq[gltf]'")


def packed_attributes(rows: Rows) -> bytes:
    """Pack vertices ``(n, stride)`` of bytes; the stride is a multiple of 4 up to 256."""
    import meshopt

    return bytes(meshopt.encode_gltf_buffer(rows, "ATTRIBUTES")) if len(rows) else b""


def packed_triangles(triangles: NDArray[Any]) -> bytes:
    """Pack triangles ``(F, 3)``; their order is kept, which corner each begins with is not."""
    import meshopt

    return bytes(meshopt.encode_gltf_buffer(triangles.astype(np.uint32).reshape(-1), "TRIANGLES"))


def order_for_packing(
    triangles: NDArray[Any], vertex_count: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return an order that packs well, of triangles as strips would go, of vertices as triangles need them.

    Parameters
    ----------
    triangles : (F, 3) unsigned int
        Vertices of every triangle, below `vertex_count`.
    vertex_count : int
        How many vertices there are; those that no triangle uses come last.

    Returns
    -------
    triangles : (F, 3) int
        The same triangles in another order, of renumbered vertices.
    order : (V,) int
        Which vertex each of the new ones was.
    """
    import meshopt

    corners = np.ascontiguousarray(triangles, dtype=np.uint32).reshape(-1)
    renumbered, places, _ = meshopt.reorder_mesh(corners, True, True)
    # The package knows no vertices beyond the last that is used, and gives those between no place.
    unused = np.setdiff1d(np.arange(vertex_count), corners)
    used = np.unique(corners)
    order = np.concatenate([used[np.argsort(places[used])], unused]).astype(np.int64)
    return renumbered.astype(np.int64).reshape(-1, 3), order


def octahedral(vectors: ArrayLike, bits: int) -> Rows:
    """Return unit vectors ``(n, 3)`` for the filter OCTAHEDRAL: ``(n, 4)`` bytes of at most 8 bits."""
    import meshopt

    padded = np.pad(np.asarray(vectors, dtype=np.float32), [(0, 0), (0, 1)])
    return np.asarray(meshopt.encode_filter_oct(padded, 4, bits), dtype=np.uint8)


def fixed_point(values: ArrayLike, exponent: int) -> Rows:
    """Return numbers ``(n, k)`` for the filter EXPONENTIAL, ``(n, 4 k)`` bytes, in steps of ``2**exponent``.

    Floats :math:`m 2^e` with 24 bits of `m` and 8 of `e`. With one `e` for all they are fixed-point numbers;
    meshoptimizer chooses it by the largest number, we by the error that is allowed.

    Raises
    ------
    SettingsError
        If a number is more than 2**23 such steps.
    """
    steps = np.rint(np.ldexp(np.asarray(values, dtype=np.float64), -exponent))
    if not np.abs(steps).max(initial=0) <= _LARGEST:
        raise SettingsError(
            f"numbers up to {np.abs(values).max():g} are too large for steps of {2.0**exponent:g}: only "
            f"{_LARGEST} steps can be told apart; let coordinates begin near 0, or write without compression"
        )
    stored = steps.astype(np.int64) & 0xFFFFFF | (exponent & 0xFF) << 24
    return np.ascontiguousarray(stored.astype("<u4")).view(np.uint8).reshape(len(steps), -1)
