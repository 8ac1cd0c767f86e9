"""Unpack meshopt-compressed buffer views in a process of its own; package: meshopt (extra `gltf`).

Specification: https://github.com/KhronosGroup/glTF/blob/main/extensions/2.0/Vendor/EXT_meshopt_compression/README.md
"""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import MissingExtraError
from mixseq_io.gltf.document import Document
from mixseq_io.gltf.json_fields import Fields
from mixseq_io.isolation import call_isolated

Rows = NDArray[np.uint8]


def unpacked_view(document: Document, packed: Fields) -> bytes:
    """Return the unpacked bytes of a view, given its extension object."""
    if find_spec("meshopt") is None:
        raise MissingExtraError(
            f"{document.path} is compressed by meshoptimizer; to read it: pip install 'mixseq[gltf]'"
        )
    count, stride = packed.integer("count"), packed.integer("byteStride")
    mode, name = packed.text("mode"), packed.text("filter", "NONE")
    data = document.part(packed)
    here = "mixseq_io.gltf.meshopt:unpacked"
    rows = call_isolated(here, document.path, data, packed.place, count, stride, mode, name)
    return bytes(rows.tobytes())


def unpacked(path: Path, data: bytes, place: str, count: int, stride: int, mode: str, name: str) -> Rows:
    """Unpack a view; see `unpacked_view`. Damaged data may end the process."""
    import meshopt

    try:
        rows = meshopt.decode_gltf_buffer(data, count, stride, mode, name)
    except (ValueError, RuntimeError, TypeError) as error:
        raise Fields(path, place, {}).error(
            f"cannot be unpacked by meshoptimizer ({mode[:40]!r}, {name[:40]!r}, {stride} bytes each): {error}"
        ) from None
    return np.ascontiguousarray(rows).view(np.uint8)
