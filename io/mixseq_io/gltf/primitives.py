r"""Primitives of a glTF mesh as arrays, and welding of vertices that exporters have split.

Exporters split vertices where texture coordinates, normals or materials differ. Vertices with bit-identical position,
joints, weights and morph deltas are welded across all primitives; degenerate faces are kept. Files written by mixseq
store the index of the welded vertex in the attribute ``_VERTEX``.

``KHR_texture_transform`` with scale :math:`s`, rotation :math:`r` and offset :math:`o` maps texture coordinates (u, v),
v downwards, to

.. math::
    u' = s_u u \cos r + s_v v \sin r + o_u, \quad v' = -s_u u \sin r + s_v v \cos r + o_v

as in the specification's example and all renderers; the specification's code listing has another sign
(https://github.com/KhronosGroup/glTF/issues/1563). The transform of the base colour texture is preferred.

Specification: https://github.com/KhronosGroup/glTF/blob/main/extensions/2.0/Khronos/KHR_texture_transform/README.md
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixseq.types import Float, Index, IntArray
from mixseq_io.gltf.document import Document, Fields
from mixseq_io.surfaces import renumber_by_appearance

_TEXTURE_TRANSFORM = "KHR_texture_transform"
_METALLIC_TEXTURES = ("baseColorTexture", "metallicRoughnessTexture")
_OTHER_TEXTURES = ("normalTexture", "occlusionTexture", "emissiveTexture")


def texture_transform(document: Document, primitive: Fields) -> Float:
    """Return a material's transform of a primitive's TEXCOORD_0 as a matrix ``(2, 3)`` with the offset last."""
    index = primitive.index("material")
    material = Fields(document.path, "", {}) if index is None else document.item("materials", index)
    owners = (material.object("pbrMetallicRoughness"), _METALLIC_TEXTURES), (material, _OTHER_TEXTURES)
    for texture in (owner.object(name) for owner, names in owners for name in names if name in owner):
        transform = texture.object("extensions").object(_TEXTURE_TRANSFORM)
        if transform.integer("texCoord", texture.integer("texCoord", 0)) == 0:
            return _transform_matrix(transform)
    return np.eye(2, 3)


def _transform_matrix(transform: Fields) -> Float:
    offset, scale = transform.numbers("offset", 2), transform.numbers("scale", 2)
    rotation = transform.number("rotation", 0.0)
    cosine, sine = np.cos(rotation), np.sin(rotation)
    rotated = np.array([[cosine, sine], [-sine, cosine]])
    scaled = rotated * (np.ones(2) if scale is None else scale)
    return np.column_stack([scaled, np.zeros(2) if offset is None else offset])


TRIANGLES_MODE, _STRIP_MODE, _FAN_MODE = 4, 5, 6


@dataclass(frozen=True, eq=False)
class Primitive:
    """Primitive of triangles ``(F, 3)`` with positions ``(n, 3)``, and its index in the mesh."""

    document: Document
    index: int
    fields: Fields
    positions: NDArray[Any]
    triangles: NDArray[np.int32]

    @property
    def attributes(self) -> Fields:
        """Accessors of attributes by name."""
        return self.fields.object("attributes")

    def attribute(self, name: str, width: int) -> NDArray[Any] | None:
        """Return a vertex attribute ``(n, width)``, or ``(n,)`` for width 1; return None if absent."""
        return self._read(self.attributes, name, width)

    def count_sets(self, name: str) -> int:
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
    def number_count(self) -> int:
        """Count of numbers in the triangles, positions and other attributes that determine vertex motion."""
        per_vertex = 3 + 8 * self.count_sets("JOINTS") + 3 * len(self.targets)
        return self.triangles.size + len(self.positions) * per_vertex

    def deltas(self, target: int) -> NDArray[Any] | None:
        """Return a morph target's displacements ``(n, 3)``, or None if it has no displacements."""
        return self._read(self.targets[target], "POSITION", 3)

    def _read(self, owner: Fields, name: str, width: int) -> NDArray[Any] | None:
        index = owner.index(name)
        if index is None:
            return None
        values = self.document.accessor(index)
        expected = (len(self.positions),) if width == 1 else (len(self.positions), width)
        if values.shape != expected:
            raise owner.error(f"has {name} of shape {values.shape}, not {expected}")
        return values


def _read_primitives(document: Document, mesh: int) -> tuple[list[Primitive], list[int]]:
    """Return a mesh's triangle primitives, and the indices of all skipped primitives."""
    primitives: list[Primitive] = []
    skipped, numbers = [], 0
    for index, fields in enumerate(document.item("meshes", mesh).objects("primitives")):
        attributes = fields.object("attributes")
        position, mode = attributes.index("POSITION"), fields.integer("mode", TRIANGLES_MODE)
        if position is None or mode not in (TRIANGLES_MODE, _STRIP_MODE, _FAN_MODE):
            skipped.append(index)
            continue
        positions = document.accessor(position)
        if positions.ndim != 2 or positions.shape[1] != 3:
            raise attributes.error(f"has POSITION of shape {positions.shape}, not (n, 3)")
        triangles = _read_triangles(document, fields, mode, len(positions))
        primitives.append(Primitive(document, index, fields, positions, triangles))
        numbers += primitives[-1].number_count
        document.check_effort(numbers, f"meshes[{mesh}]")
    return primitives, skipped


def _read_triangles(document: Document, fields: Fields, mode: int, vertex_count: int) -> NDArray[np.int32]:
    index = fields.index("indices")
    corners: IntArray = np.arange(vertex_count) if index is None else document.accessor(index)
    if corners.ndim != 1 or corners.dtype.kind not in "ui":
        raise fields.error(f"has indices of shape {corners.shape} and type {corners.dtype}; integers are expected")
    if corners.size and int(corners.max()) >= vertex_count:
        raise fields.error(f"uses vertex {int(corners.max())}, but has {vertex_count}; the file is damaged")
    if mode == TRIANGLES_MODE and corners.size % 3:
        raise fields.error(f"has {corners.size} corners of triangles, which is not a multiple of 3")
    return split_triangles(corners.astype(np.int32), mode)


def split_triangles(corners: NDArray[np.int32], mode: int) -> NDArray[np.int32]:
    """Return the triangles ``(F, 3)`` of a list (mode 4), a strip (5) or a fan (6).

    Examples
    --------
    >>> split_triangles(np.array([0, 1, 2, 3, 4]), 5).tolist()
    [[0, 1, 2], [1, 3, 2], [2, 3, 4]]
    >>> split_triangles(np.array([0, 1, 2, 3]), 6).tolist()
    [[1, 2, 0], [2, 3, 0]]
    """
    if mode == TRIANGLES_MODE:
        return corners.reshape(-1, 3)
    first = np.arange(max(corners.size - 2, 0))
    if mode == _FAN_MODE:
        return corners[np.stack([first + 1, first + 2, 0 * first], axis=1)]
    odd = first % 2
    return corners[np.stack([first, first + 1 + odd, first + 2 - odd], axis=1)]


@dataclass(frozen=True, eq=False)
class Weld:
    """Weld of the vertices of a glTF mesh."""

    primitives: tuple[Primitive, ...]
    skipped: tuple[int, ...]  # indices of primitives that are not read
    vertex_ids: tuple[NDArray[np.int32], ...]  # per primitive, the welded vertex (n,) of each split vertex
    representatives: IntArray  # (W,) one split vertex of each welded vertex

    @property
    def vertex_count(self) -> int:
        """Number W of welded vertices."""
        return len(self.representatives)

    @cached_property
    def triangles(self) -> NDArray[np.int32]:
        """Triangles ``(F, 3)`` of all primitives as indices of welded vertices."""
        each = zip(self.primitives, self.vertex_ids, strict=True)
        return np.concatenate([vertex_ids[primitive.triangles] for primitive, vertex_ids in each])


def weld_vertices(document: Document, mesh: int) -> Weld:
    """Weld the vertices of a mesh; number welded vertices by ``_VERTEX``, or else by first appearance."""
    primitives, skipped = _read_primitives(document, mesh)
    if not primitives:
        return Weld((), tuple(skipped), (), np.zeros(0, np.int64))
    count_targets(primitives)
    labels = _read_vertex_numbers(primitives)
    if labels is None:
        labels = _label_by_motion(primitives)
    representatives = np.unique(labels, return_index=True)[1]
    ends = np.cumsum([len(each.positions) for each in primitives])
    vertex_ids = np.split(labels.astype(np.int32), ends[:-1])
    return Weld(tuple(primitives), tuple(skipped), tuple(vertex_ids), representatives)


def _read_vertex_numbers(primitives: Sequence[Primitive]) -> IntArray | None:
    """Return the indices ``(n,)`` in ``_VERTEX``, or None if numbers are missing or positions contradict them."""
    if not all("_VERTEX" in each.attributes for each in primitives):
        return None
    stored = _gather(primitives, [each.attribute("_VERTEX", 1) for each in primitives], 1)[:, 0]
    distinct, first, labels = np.unique(stored, return_index=True, return_inverse=True)
    positions = np.concatenate([each.positions for each in primitives])
    if not np.array_equal(distinct, np.arange(distinct.size)):
        return None
    return labels if np.array_equal(positions, positions[first][labels]) else None


def _label_by_motion(primitives: Sequence[Primitive]) -> IntArray:
    """Label vertices ``(n,)`` by position, joints, weights and morph deltas, in order of appearance."""
    labels: IntArray = np.zeros(sum(len(each.positions) for each in primitives), dtype=np.int64)
    for columns in _welding_columns(primitives):
        rows = np.ascontiguousarray(np.column_stack([labels, columns]) + 0.0)  # turns -0 into 0
        labels = np.unique(rows.view(f"V{rows.strides[0]}"), return_inverse=True)[1].reshape(-1)
    return renumber_by_appearance(labels)[0]


def count_targets(primitives: Sequence[Primitive]) -> int:
    """Return the number of morph targets; raise an error if the primitives of a mesh differ in this number."""
    count = len(primitives[0].targets)
    for each in primitives:
        if len(each.targets) != count:
            raise each.fields.error(f"has {len(each.targets)} morph targets, another primitive of the mesh {count}")
    return count


def _welding_columns(primitives: Sequence[Primitive]) -> Iterator[NDArray[Any]]:
    """Yield columns ``(n, k)`` of values whose equality determines welding, concatenated over all primitives."""
    yield np.concatenate([each.positions for each in primitives]).astype(np.float64)
    joints, weights = read_influences(primitives)
    for joint, weight in zip(joints.T, weights.T, strict=True):
        yield np.column_stack([joint, weight])
    for target in range(count_targets(primitives)):
        yield read_deltas(primitives, target)


def read_influences(primitives: Sequence[Primitive]) -> tuple[Index, Float]:
    """Return joints sorted per vertex, and weights, ``(n, 4 * sets)``; the joint of a weight 0 is 0."""
    set_count = max(min(each.count_sets("JOINTS"), each.count_sets("WEIGHTS")) for each in primitives)
    vertex_count = sum(len(each.positions) for each in primitives)
    joints, weights = np.zeros((2, vertex_count, 4 * set_count))
    for index in range(set_count):
        columns = slice(4 * index, 4 * index + 4)
        joints[:, columns] = _gather(primitives, [_read_joints(each, index) for each in primitives], 4)
        own_weights = [each.attribute(f"WEIGHTS_{index}", 4) for each in primitives]
        weights[:, columns] = _gather(primitives, own_weights, 4)
    used = np.where(weights == 0, 0, joints).astype(np.int64)
    order = np.argsort(used, axis=1, kind="stable")
    return np.take_along_axis(used, order, axis=1), np.take_along_axis(weights, order, axis=1)


def _read_joints(primitive: Primitive, index: int) -> NDArray[Any] | None:
    joints = primitive.attribute(f"JOINTS_{index}", 4)
    if joints is not None and joints.dtype.kind != "u":
        raise primitive.attributes.error(f"has JOINTS_{index} of type {joints.dtype}; unsigned integers are expected")
    return joints


def read_deltas(primitives: Sequence[Primitive], target: int) -> Float:
    """Return a morph target's displacements ``(n, 3)`` for the vertices of all primitives."""
    return _gather(primitives, [each.deltas(target) for each in primitives], 3)


def _gather(primitives: Sequence[Primitive], arrays: Sequence[NDArray[Any] | None], width: int) -> Float:
    """Concatenate an attribute ``(n, width)`` of all primitives; use 0 for primitives without the attribute."""
    return np.concatenate(
        [
            np.zeros((len(each.positions), width)) if values is None else values.reshape(-1, width)
            for each, values in zip(primitives, arrays, strict=True)
        ]
    ).astype(np.float64)
