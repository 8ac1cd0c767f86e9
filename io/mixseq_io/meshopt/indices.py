"""Triangles, and other indices, as meshoptimizer packs them.

Triangles come back in their order; which of its corners a triangle begins with is chosen by what is short. Both kinds
are read, triangles are written.

Specification: https://github.com/KhronosGroup/glTF/blob/main/extensions/2.0/Vendor/EXT_meshopt_compression/README.md
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Index, IntArray
from mixseq.errors import FormatError

_TRIANGLES, _SEQUENCE = 0xE1, 0xD1

# Pairs of how the second and third corner of a triangle are named that are frequent, most frequent first: the last of
# the bytes hold it, so that any will do; these are meshoptimizer's.
_PAIRS = bytes.fromhex("0076875667 78a986658968980169 0000")


def decode_triangles(data: bytes, count: int) -> Index:
    """Return `count` corners of triangles that were packed, as 32-bit numbers without sign.

    Raises
    ------
    FormatError
        If they are damaged.
    """
    from mixseq_io.meshopt.index_kernels import unpack_triangles

    if data[:1] != bytes([_TRIANGLES]) or count % 3 or len(data) < 1 + count // 3 + len(_PAIRS):
        raise FormatError("packed triangles are damaged, or packed in a way that is not known here")
    corners = np.zeros(count, np.int64)
    if not unpack_triangles(np.frombuffer(data, np.uint8), corners):
        raise FormatError("packed triangles are damaged")
    return corners


def decode_sequence(data: bytes, count: int) -> Index:
    """Return `count` indices of any kind that were packed, as 32-bit numbers without sign.

    Raises
    ------
    FormatError
        If they are damaged.
    """
    from mixseq_io.meshopt.index_kernels import unpack_sequence

    if data[:1] != bytes([_SEQUENCE]) or len(data) < 1 + count + 4:
        raise FormatError("packed indices are damaged, or packed in a way that is not known here")
    indices = np.zeros(count, np.int64)
    if not unpack_sequence(np.frombuffer(data, np.uint8), indices):
        raise FormatError("packed indices are damaged")
    return indices


def encode_triangles(triangles: IntArray | NDArray[np.unsignedinteger]) -> bytes:
    """Pack triangles ``(F, 3)``; which corner each begins with is not kept.

    Examples
    --------
    >>> decode_triangles(encode_triangles(np.array([[0, 1, 2], [2, 1, 3]])), 6).tolist()
    [0, 1, 2, 2, 1, 3]
    """
    from mixseq_io.meshopt.index_kernels import pack_triangles

    corners = np.ascontiguousarray(triangles, dtype=np.int64).reshape(-1)
    data = np.zeros(1 + len(corners) // 3 * 17, np.uint8)
    data[0] = _TRIANGLES
    length = pack_triangles(corners, np.frombuffer(_PAIRS, np.uint8), data)
    return data[:length].tobytes() + _PAIRS
