"""Primitives of a glTF mesh as arrays: triangles and vertex attributes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import IntArray
from mixseq_io.gltf.document import Document
from mixseq_io.gltf.json_fields import Fields

_TRIANGLES, _STRIP, _FAN = 4, 5, 6


@dataclass(frozen=True, eq=False)
class Primitive:
    """Primitive of triangles."""

    document: Document
    number: int
    fields: Fields
    positions: NDArray[Any]
    triangles: NDArray[np.int32]

    @property
    def attributes(self) -> Fields:
        """Accessors of its attributes by name."""
        return self.fields.object("attributes")

    def attribute(self, name: str, width: int) -> NDArray[Any] | None:
        """Return an attribute ``(n, width)`` of its vertices, ``(n,)`` for width 1; None if absent."""
        return self._attribute(self.attributes, name, width)

    def sets(self, name: str) -> int:
        """Return the number of attributes ``name_0``, ``name_1``, ..."""
        count = 0
        while f"{name}_{count}" in self.attributes:
            count += 1
        return count

    @cached_property
    def targets(self) -> list[Fields]:
        """Morph targets."""
        return self.fields.objects("targets")

    @property
    def size(self) -> int:
        """Count of numbers in its triangles and vertex motion."""
        return self.triangles.size + len(self.positions) * (
            3 + 8 * self.sets("JOINTS") + 3 * len(self.targets)
        )

    def delta(self, target: int) -> NDArray[Any] | None:
        """Return a morph target's displacements ``(n, 3)``, None if it has none."""
        return self._attribute(self.targets[target], "POSITION", 3)

    def _attribute(self, owner: Fields, name: str, width: int) -> NDArray[Any] | None:
        index = owner.index(name)
        if index is None:
            return None
        values = self.document.accessor(index)
        expected = (len(self.positions),) if width == 1 else (len(self.positions), width)
        if values.shape != expected:
            raise owner.error(f"has {name} of shape {values.shape}, not {expected}")
        return values


def primitives_of(document: Document, mesh: int) -> tuple[list[Primitive], list[int]]:
    """Return a mesh's primitives of triangles, and the indices of the others."""
    found: list[Primitive] = []
    others, numbers = [], 0
    for number, fields in enumerate(document.item("meshes", mesh).objects("primitives")):
        attributes = fields.object("attributes")
        position, mode = attributes.index("POSITION"), fields.integer("mode", _TRIANGLES)
        if position is None or mode not in (_TRIANGLES, _STRIP, _FAN):
            others.append(number)
            continue
        positions = document.accessor(position)
        if positions.ndim != 2 or positions.shape[1] != 3:
            raise attributes.error(f"has POSITION of shape {positions.shape}, not (n, 3)")
        triangles = _triangles(document, fields, mode, len(positions))
        found.append(Primitive(document, number, fields, positions, triangles))
        numbers += found[-1].size
        document.check_effort(numbers, f"meshes[{mesh}]")
    return found, others


def _triangles(document: Document, fields: Fields, mode: int, vertices: int) -> NDArray[np.int32]:
    index = fields.index("indices")
    corners: IntArray = np.arange(vertices) if index is None else document.accessor(index)
    if corners.ndim != 1 or corners.dtype.kind not in "ui":
        raise fields.error(
            f"has indices of shape {corners.shape} and type {corners.dtype}; integers are expected"
        )
    if corners.size and int(corners.max()) >= vertices:
        raise fields.error(f"uses vertex {int(corners.max())}, but has {vertices}; the file is damaged")
    if mode == _TRIANGLES and corners.size % 3:
        raise fields.error(f"has {corners.size} corners of triangles, which is not a multiple of 3")
    return resolved(corners.astype(np.int32), mode)


def resolved(corners: NDArray[np.int32], mode: int) -> NDArray[np.int32]:
    """Return triangles ``(F, 3)`` of a list (mode 4), a strip (5) or a fan (6).

    Examples
    --------
    >>> resolved(np.array([0, 1, 2, 3, 4]), 5).tolist()
    [[0, 1, 2], [1, 3, 2], [2, 3, 4]]
    >>> resolved(np.array([0, 1, 2, 3]), 6).tolist()
    [[1, 2, 0], [2, 3, 0]]
    """
    if mode == _TRIANGLES:
        return corners.reshape(-1, 3)
    first = np.arange(max(corners.size - 2, 0))
    if mode == _FAN:
        return corners[np.stack([first + 1, first + 2, 0 * first], axis=1)]
    odd = first % 2
    return corners[np.stack([first, first + 1 + odd, first + 2 - odd], axis=1)]
