r"""Primitives of a glTF mesh as arrays, and the weld of vertices that glTF splits.

Exporters split vertices where texture coordinates, normals or materials differ. Vertices with bit-identical position,
joints, weights and morph deltas are one vertex, across all primitives; faces that become degenerate stay. The
attribute ``_VERTEX`` of files written by mixseq gives the vertices directly.

By ``KHR_texture_transform``, with scale :math:`s`, rotation :math:`r` and offset :math:`o`, texture coordinates (u, v),
v downwards, are

.. math::
    u' = s_u u \cos r + s_v v \sin r + o_u, \quad v' = -s_u u \sin r + s_v v \cos r + o_v

as in the specification's example and all renderers; its listing has another sign
(https://github.com/KhronosGroup/glTF/issues/1563). The base colour's texture decides, or else the first.

Specification: https://github.com/KhronosGroup/glTF/blob/main/extensions/2.0/Khronos/KHR_texture_transform/README.md
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import FormatError
from mixseq.types import IntArray
from mixseq_io.gltf.document import Document, Fields
from mixseq_io.surfaces import renumber_by_appearance

_NAME = "KHR_texture_transform"
_TEXTURES = ("normalTexture", "occlusionTexture", "emissiveTexture")


def texture_transform(document: Document, primitive: Fields) -> NDArray[np.float64]:
    """Return a material's transform of TEXCOORD_0 as a matrix ``(2, 3)``, the offset in the last column."""
    index = primitive.index("material")
    textures = [] if index is None else _textures(document.item("materials", index))
    for texture in textures:
        transform = texture.object("extensions").object(_NAME)
        if transform.integer("texCoord", texture.integer("texCoord", 0)) == 0:
            return _matrix(transform)
    return np.eye(2, 3)


def _textures(material: Fields) -> Iterator[Fields]:
    """Yield the textures of a material, the base colour's first."""
    metal = material.object("pbrMetallicRoughness")
    for owner, names in (
        (metal, ("baseColorTexture", "metallicRoughnessTexture")),
        (material, _TEXTURES),
    ):
        yield from (owner.object(name) for name in names if name in owner)


def _matrix(transform: Fields) -> NDArray[np.float64]:
    offset, scale = transform.numbers("offset", 2), transform.numbers("scale", 2)
    rotation = transform.number("rotation", 0.0)
    cosine, sine = np.cos(rotation), np.sin(rotation)
    turn = np.array([[cosine, sine], [-sine, cosine]])
    scaled = turn * (np.ones(2) if scale is None else scale)
    return np.column_stack([scaled, np.zeros(2) if offset is None else offset])


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


@dataclass(frozen=True, eq=False)
class Weld:
    """Welded vertices of a glTF mesh."""

    primitives: tuple[Primitive, ...]
    skipped: tuple[int, ...]
    of_primitive: tuple[NDArray[np.int32], ...]
    representatives: IntArray

    @property
    def count(self) -> int:
        """Number W of welded vertices."""
        return len(self.representatives)

    @property
    def faces(self) -> NDArray[np.int32]:
        """Triangles ``(F, 3)`` of all primitives by welded vertices."""
        return np.concatenate(
            [of[each.triangles] for each, of in zip(self.primitives, self.of_primitive, strict=True)]
        ).astype(np.int32)

    @property
    def vertices(self) -> list[slice]:
        """Range of each primitive among the vertices of all primitives."""
        ends = np.cumsum([0, *(len(each.positions) for each in self.primitives)])
        return [slice(int(first), int(end)) for first, end in pairwise(ends)]


def weld(document: Document, mesh: int) -> Weld:
    """Weld the vertices of a mesh, in the order of ``_VERTEX``, or of their first appearance."""
    primitives, skipped = primitives_of(document, mesh)
    if not primitives:
        raise FormatError(f"{document.path}: meshes[{mesh}] has no triangles")
    target_count(primitives)
    labels = _told(primitives)
    if labels is None:
        labels = _found(primitives)
    representatives = np.unique(labels, return_index=True)[1]
    ends = np.cumsum([len(each.positions) for each in primitives])
    split = np.split(labels.astype(np.int32), ends[:-1])
    return Weld(tuple(primitives), tuple(skipped), tuple(split), representatives)


def _told(primitives: Sequence[Primitive]) -> IntArray | None:
    """Return the vertices ``(n,)`` from ``_VERTEX``, None if it is absent or other than 0, 1, 2, ..."""
    if not all("_VERTEX" in each.attributes for each in primitives):
        return None
    numbers = _gathered(primitives, lambda each: each.attribute("_VERTEX", 1), 1)[:, 0]
    distinct, first, labels = np.unique(numbers, return_index=True, return_inverse=True)
    positions = np.concatenate([each.positions for each in primitives])
    sound = np.array_equal(distinct, np.arange(distinct.size)) and np.array_equal(
        positions, positions[first][labels]
    )
    return labels if sound else None


def _found(primitives: Sequence[Primitive]) -> IntArray:
    """Return the vertices ``(n,)`` by their distinct positions and motion, in order of first appearance."""
    labels: IntArray = np.zeros(sum(len(each.positions) for each in primitives), dtype=np.int64)
    for columns in _columns(primitives):
        labels = numbered(np.column_stack([labels, columns]))
    return renumber_by_appearance(labels)[0]


def target_count(primitives: Sequence[Primitive]) -> int:
    """Return the number of morph targets, common to all primitives of a mesh."""
    count = len(primitives[0].targets)
    for each in primitives:
        if len(each.targets) != count:
            raise each.fields.error(
                f"has {len(each.targets)} morph targets, another primitive of the mesh {count}"
            )
    return count


def _columns(primitives: Sequence[Primitive]) -> Iterator[NDArray[Any]]:
    """Yield the columns ``(n, k)`` that distinguish vertices, over all primitives."""
    yield np.concatenate([each.positions for each in primitives]).astype(np.float64)
    joints, weights = influences(primitives)
    for one_joint, one_weight in zip(joints.T, weights.T, strict=True):
        yield np.column_stack([one_joint, one_weight])
    for target in range(target_count(primitives)):
        yield deltas(primitives, target)


def influences(primitives: Sequence[Primitive]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return joints and weights ``(n, 4 * sets)`` of all vertices by joint; joints of weight 0, and padding, are 0."""
    sets = max(min(each.sets("JOINTS"), each.sets("WEIGHTS")) for each in primitives)
    none = np.zeros((sum(len(each.positions) for each in primitives), 0))
    joints = [_gathered(primitives, partial(_joints, number=i), 4) for i in range(sets)]
    weights = [_gathered(primitives, partial(_weights, number=i), 4) for i in range(sets)]
    joint, weight = np.concatenate([none, *joints], axis=1), np.concatenate([none, *weights], axis=1)
    joint = np.where(weight == 0, 0, joint).astype(np.int64)
    order = np.argsort(joint, axis=1, kind="stable")
    return np.take_along_axis(joint, order, axis=1), np.take_along_axis(weight, order, axis=1)


def _joints(primitive: Primitive, number: int) -> NDArray[Any] | None:
    values = primitive.attribute(f"JOINTS_{number}", 4)
    if values is not None and values.dtype.kind != "u":
        raise primitive.attributes.error(
            f"has JOINTS_{number} of type {values.dtype}; unsigned integers are expected"
        )
    return values


def _weights(primitive: Primitive, number: int) -> NDArray[Any] | None:
    return primitive.attribute(f"WEIGHTS_{number}", 4)


def deltas(primitives: Sequence[Primitive], target: int) -> NDArray[np.float64]:
    """Return a morph target's displacements ``(n, 3)`` of all vertices."""
    return _gathered(primitives, lambda each: each.delta(target), 3)


def _gathered(
    primitives: Sequence[Primitive], attribute: Callable[[Primitive], NDArray[Any] | None], width: int
) -> NDArray[np.float64]:
    """Concatenate an attribute ``(n, width)`` of all primitives, 0 for primitives without."""
    found = ((each, attribute(each)) for each in primitives)
    return np.concatenate(
        [
            np.zeros((len(each.positions), width)) if values is None else values.reshape(-1, width)
            for each, values in found
        ]
    ).astype(np.float64)


def numbered(rows: NDArray[Any]) -> IntArray:
    """Number rows ``(n, k)`` so that equal rows share a number ``(n,)``; -0 equals 0."""
    order = np.lexsort(rows.T)
    if not order.size:
        return order
    ordered = rows[order]
    new = np.concatenate([[False], (ordered[1:] != ordered[:-1]).any(axis=1)])
    numbers = np.empty_like(order)
    numbers[order] = np.cumsum(new)
    return numbers
