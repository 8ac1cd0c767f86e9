"""Vertices as meshoptimizer packs them: what every byte differs from that of the vertex before, in few bits.

Versions 0 (``EXT_meshopt_compression``) and 1 (``KHR_meshopt_compression``) are read, version 0 is written.

Specification: https://github.com/KhronosGroup/glTF/blob/main/extensions/2.0/Vendor/EXT_meshopt_compression/README.md
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import FormatError

_HEADER, _VERSIONS = 0xA0, (0, 1)
_TAIL = (32, 24)
_LONGEST_STRIDE = 256


def decode_attributes(data: bytes, count: int, stride: int) -> NDArray[np.uint8]:
    """Return vertices ``(count, stride)`` of bytes that were packed.

    Raises
    ------
    FormatError
        If they are damaged, or the stride is not a multiple of 4 up to 256.
    """
    from mixseq_io.meshopt.attribute_kernels import unpack

    version = data[0] - _HEADER if data else -1
    if version not in _VERSIONS or stride % 4 or not 0 < stride <= _LONGEST_STRIDE:
        raise FormatError("vertices are packed in a way that is not known here; the file is damaged")
    if len(data) < 1 + max(stride + version * (stride // 4), _TAIL[version]):
        raise FormatError("packed vertices are cut short; the file is damaged")
    rows = np.zeros((count, stride), np.uint8)
    if not unpack(np.frombuffer(data, np.uint8), version, rows):
        raise FormatError("packed vertices are damaged")
    return rows


def encode_attributes(rows: NDArray[np.uint8]) -> bytes:
    """Pack vertices ``(n, stride)`` of bytes; the stride is a multiple of 4 up to 256.

    Examples
    --------
    >>> rows = np.arange(80, dtype=np.uint8).reshape(20, 4)
    >>> bool((decode_attributes(encode_attributes(rows), 20, 4) == rows).all())
    True
    """
    from mixseq_io.meshopt.attribute_kernels import GROUP, pack

    count, stride = rows.shape
    most = 2 + stride * (count + GROUP) * 2
    data = np.zeros(most, np.uint8)
    data[0] = _HEADER
    length = pack(np.ascontiguousarray(rows), data)
    first = rows[0] if count else np.zeros(stride, np.uint8)
    return data[:length].tobytes() + bytes(max(_TAIL[0] - stride, 0)) + first.tobytes()
