"""Draco-compressed primitives, unpacked by Google's library (DracoPy, extra `gltf`) in a process of its own.

Specification: https://github.com/KhronosGroup/glTF/blob/main/extensions/2.0/Khronos/KHR_draco_mesh_compression/README.md
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import MissingExtraError
from mixseq_io.gltf.document import Document
from mixseq_io.gltf.json_fields import Fields
from mixseq_io.isolation import call_isolated


@dataclass(frozen=True)
class Wanted:
    """Layout that an accessor expects."""

    unique_id: int | None
    dtype: np.dtype[Any]
    count: int
    width: int

    @property
    def size(self) -> int:
        """Its size in bytes."""
        return self.count * self.width * self.dtype.itemsize


def unpacked_primitive(
    document: Document, packed: Fields, wanted: Sequence[Wanted], sizes: Sequence[int]
) -> bytes:
    """Return the numbers of several accessors one after the other, each padded to its size in bytes."""
    if find_spec("DracoPy") is None:
        raise MissingExtraError(
            f"{document.path} is compressed with Draco; to read it: pip install 'mixseq[gltf]'"
        )
    data = document.part(document.item("bufferViews", packed.integer("bufferView")))
    arrays = call_isolated("mixseq_io.gltf.draco:decoded", document.path, data, packed.place, list(wanted))
    return b"".join(each.tobytes().ljust(size, b"\0") for each, size in zip(arrays, sizes, strict=True))


def decoded(path: Path, data: bytes, place: str, wanted: Sequence[Wanted]) -> list[NDArray[Any]]:
    """Decode a primitive; see `unpacked_primitive`. Damaged data may end the process."""
    import DracoPy

    fields = Fields(path, place, {})
    try:
        mesh = DracoPy.decode(data)
        attributes = {each["unique_id"]: each["data"] for each in mesh.attributes}
        attributes[None] = mesh.faces.reshape(-1)
    except (DracoPy.FileTypeException, ValueError, AttributeError, TypeError) as error:
        raise fields.error(f"cannot be decoded by Draco: {error}") from None
    return [_fitted(fields, attributes.get(each.unique_id), each) for each in wanted]


def _fitted(fields: Fields, values: NDArray[Any] | None, wanted: Wanted) -> NDArray[Any]:
    """Convert values to the accessor's layout; DracoPy returns integers as floats."""
    if values is None or values.size != wanted.count * wanted.width:
        has = "nothing" if values is None else f"{values.size} numbers"
        raise fields.error(
            f"has {has} where {wanted.count} times {wanted.width} are expected; the file is damaged"
        )
    if wanted.dtype.kind == "f":
        return values.astype(wanted.dtype)
    limits = np.iinfo(wanted.dtype)
    whole = np.clip(np.rint(np.nan_to_num(values)), limits.min, limits.max)
    return np.asarray(whole, dtype=wanted.dtype)
