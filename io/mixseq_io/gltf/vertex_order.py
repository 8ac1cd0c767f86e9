"""Triangles and vertices of a glTF document in an order that packs well, neighbours side by side.

meshoptimizer packs the difference of each vertex from the one before, and triangles by the edges that they share with
those before. Only primitives whose vertices have numbers (``_VERTEX``) get another order: with these a reader restores
the vertices of the sequence. Nothing tells the order that triangles had; they are read in the new one.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixseq_io.gltf.document import Document
from mixseq_io.gltf.json_fields import Fields
from mixseq_io.gltf.meshopt import order_for_packing

_TRIANGLES = 4


def neighbours_together(document: Document) -> Document:
    """Return a document with the same meshes, whose triangles and vertices are in an order that packs well.

    Primitives stay as they are that share data with others, or have sparse data, or no ``_VERTEX``.

    Parameters
    ----------
    document : Document
        Without compression.

    Raises
    ------
    FormatError
        If it is damaged.
    """
    primitives = [each for mesh in document.items("meshes") for each in mesh.objects("primitives")]
    users = Counter(number for each in primitives for number in _accessors(each))
    edits = _Edits(document)
    for primitive in primitives:
        if primitive.integer("mode", _TRIANGLES) == _TRIANGLES and "indices" in primitive:
            alone = all(users[number] == 1 for number in _accessors(primitive))
            if alone and "_VERTEX" in primitive.object("attributes"):
                edits.reorder(_accessors(primitive))
    return edits.document()


def _accessors(primitive: Fields) -> list[int]:
    """Return the accessors of a primitive: indices first, if there are any, then all that its vertices have."""
    indices = primitive.index("indices")
    objects = [primitive.object("attributes"), *primitive.objects("targets")]
    return [
        *([] if indices is None else [indices]),
        *(each.integer(name) for each in objects for name in each.values),
    ]


class _Edits:
    """A document with some primitives in another order, in the making."""

    def __init__(self, document: Document) -> None:
        self._original = document
        self._json = dict(document.json)
        for kind in ("accessors", "bufferViews", "buffers"):
            self._json[kind] = list(self._json.get(kind, ()))
        self._unpacking = dict(document.unpacking)

    def document(self) -> Document:
        """Return it."""
        return self._original.edited(self._json, self._unpacking)

    def reorder(self, numbers: list[int]) -> None:
        """Give a primitive another order, if its accessors, indices first, are as they should be."""
        accessors = [self._original.item("accessors", number) for number in numbers]
        if any("sparse" in each or "bufferView" not in each for each in accessors):
            return
        corners = self._original.stored(accessors[0])
        counts = {each.integer("count") for each in accessors[1:]}
        if corners.size % 3 or len(counts) > 1 or corners.max(initial=0) >= min(counts):
            return
        triangles, order = order_for_packing(corners.reshape(-1, 3), min(counts))
        self._replace(numbers[0], lambda: triangles.astype(corners.dtype))
        for number, accessor in zip(numbers[1:], accessors[1:], strict=True):
            self._replace(number, _permuted(self._original, accessor, order))

    def _replace(self, number: int, values: Callable[[], NDArray[Any]]) -> None:
        """Let an accessor have other values, which are made when they are read."""
        entry = {
            **self._json["accessors"][number],
            "byteOffset": 0,
            "bufferView": len(self._json["bufferViews"]),
        }
        accessor = self._original.item("accessors", number)
        length = self._original.stored(accessor).nbytes
        view = {"buffer": len(self._json["buffers"]), "byteLength": length}
        self._unpacking[view["buffer"]] = lambda: values().tobytes()
        self._json["accessors"][number] = entry
        self._json["bufferViews"].append(view)
        self._json["buffers"].append({"byteLength": length})


def _permuted(document: Document, accessor: Fields, order: NDArray[np.integer]) -> Callable[[], NDArray[Any]]:
    return lambda: document.stored(accessor)[order]
