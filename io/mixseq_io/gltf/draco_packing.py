"""Draco compression of primitives, which reorders vertices and triangles, by DracoPy (extra `gltf`)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import MissingExtraError, OutputError
from mixseq_io.colours import nearest_bytes

_POSITION_BITS, _UV_BITS, _NORMAL_BITS = 11, 11, 7
"""Bits per number: a point is off by 1/4000 of the mesh's largest side, a normal by one degree."""

_BEST = 10
"""DracoPy's level of the strongest compression."""

_NAMES = {0: "POSITION", 1: "NORMAL", 2: "COLOR_0", 3: "TEXCOORD_0"}
"""glTF attribute names by Draco type."""


@dataclass(frozen=True, eq=False)
class DracoTriangles:
    """Compressed triangles."""

    data: bytes
    attributes: Mapping[str, NDArray[Any]]
    identifiers: Mapping[str, int]
    triangle_count: int


def compressed_triangles(
    triangles: NDArray[np.uint32],
    points: NDArray[np.float32],
    normals: NDArray[np.float32],
    uvs: NDArray[np.float32] | None,
    colours: NDArray[np.float32] | None,
) -> DracoTriangles:
    """Compress triangles ``(F, 3)``, points, normals ``(n, 3)``, uvs ``(n, 2)``, and colours ``(n, 4)`` as bytes."""
    library = _library()
    try:
        data = library.encode(
            points,
            triangles,
            quantization_bits=_POSITION_BITS,
            compression_level=_BEST,
            colors=None if colours is None else nearest_bytes(colours),
            normals=normals.astype(np.float64),
            normal_quantization_bits=_NORMAL_BITS,
            tex_coord=None if uvs is None else uvs.astype(np.float64),
            tex_coord_quantization_bits=None if uvs is None else _UV_BITS,
        )
        decoded = library.decode(data)
    except (library.EncodingFailedException, library.FileTypeException, ValueError) as error:
        raise OutputError(f"Draco cannot compress the first frame ({error}); write it plain") from error
    found = {_NAMES[each["attribute_type"]]: each for each in decoded.attributes}
    return DracoTriangles(
        data,
        {name: each["data"] for name, each in found.items()},
        {name: int(each["unique_id"]) for name, each in found.items()},
        len(decoded.faces),
    )


def _library() -> ModuleType:
    try:
        import DracoPy
    except ImportError as error:
        raise MissingExtraError(
            "a .glb is smallest with DracoPy; get it with: pip install 'mixseq[gltf]', or write a plain still "
            "(--still plain)"
        ) from error
    library: ModuleType = DracoPy
    return library
