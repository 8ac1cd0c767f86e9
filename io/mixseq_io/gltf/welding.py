"""Weld vertices that glTF splits, and map each split vertex to its welded one.

Exporters split vertices where texture coordinates, normals or materials differ. Vertices with bit-identical position,
joints, weights and morph deltas are one vertex, across all primitives; faces that become degenerate stay. The
attribute ``_VERTEX`` of files written by mixseq gives the vertices directly.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import IntArray
from mixseq.errors import FormatError
from mixseq_io.gltf.document import Document
from mixseq_io.gltf.primitives import Primitive, primitives_of

Attribute = Callable[[Primitive], NDArray[Any] | None]


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
    first = np.unique(labels, return_index=True)[1]
    rank = np.empty_like(first)
    rank[np.argsort(first)] = np.arange(first.size)
    return rank[labels]


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
    joint = np.concatenate([none, *(_gathered(primitives, _joints(i), 4) for i in range(sets))], axis=1)
    weight = np.concatenate([none, *(_gathered(primitives, _weights(i), 4) for i in range(sets))], axis=1)
    joint = np.where(weight == 0, 0, joint).astype(np.int64)
    order = np.argsort(joint, axis=1, kind="stable")
    return np.take_along_axis(joint, order, axis=1), np.take_along_axis(weight, order, axis=1)


def _joints(number: int) -> Attribute:
    def joints(primitive: Primitive) -> NDArray[Any] | None:
        values = primitive.attribute(f"JOINTS_{number}", 4)
        if values is not None and values.dtype.kind != "u":
            raise primitive.attributes.error(
                f"has JOINTS_{number} of type {values.dtype}; unsigned integers are expected"
            )
        return values

    return joints


def _weights(number: int) -> Attribute:
    return lambda primitive: primitive.attribute(f"WEIGHTS_{number}", 4)


def deltas(primitives: Sequence[Primitive], target: int) -> NDArray[np.float64]:
    """Return a morph target's displacements ``(n, 3)`` of all vertices."""
    return _gathered(primitives, lambda each: each.delta(target), 3)


def _gathered(primitives: Sequence[Primitive], attribute: Attribute, width: int) -> NDArray[np.float64]:
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
