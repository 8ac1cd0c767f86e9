"""Vertices that glTF splits, put together again, and the map of which went where.

glTF has one index per corner for everything, so that exporters split a vertex wherever its texture coordinates,
normals or materials differ. What moves as one vertex is one vertex: the same position, the same joints and weights,
the same morph deltas, bit for bit, across all primitives of the mesh. Faces that lose their area by that stay.

Where the attribute ``_VERTEX`` tells which vertex each one was, as in files that mixseq has written, nothing needs to
be found out.
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
    """The welded vertices of a glTF mesh."""

    primitives: tuple[Primitive, ...]
    skipped: tuple[int, ...]
    of_primitive: tuple[NDArray[np.int32], ...]
    representatives: IntArray

    @property
    def count(self) -> int:
        """Number of welded vertices W."""
        return len(self.representatives)

    @property
    def faces(self) -> NDArray[np.int32]:
        """Triangles ``(F, 3)`` of all primitives, one after the other, by welded vertices."""
        return np.concatenate(
            [of[each.triangles] for each, of in zip(self.primitives, self.of_primitive, strict=True)]
        ).astype(np.int32)

    @property
    def vertices(self) -> list[slice]:
        """For every primitive its vertices among those of all primitives, one after the other."""
        ends = np.cumsum([0, *(len(each.positions) for each in self.primitives)])
        return [slice(int(first), int(end)) for first, end in pairwise(ends)]


def weld(document: Document, mesh: int) -> Weld:
    """Weld the vertices of a mesh.

    The same file always gives the same vertices in the same order: that of ``_VERTEX``, or of their first appearance.
    """
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
    """Return the vertices by the attribute ``_VERTEX``, None if it is not there or does not tell 0, 1, 2 ..."""
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
    """Return the vertices by what tells them apart, in the order of their first appearance."""
    labels: IntArray = np.zeros(sum(len(each.positions) for each in primitives), dtype=np.int64)
    for columns in _columns(primitives):
        labels = numbered(np.column_stack([labels, columns]))
    first = np.unique(labels, return_index=True)[1]
    rank = np.empty_like(first)
    rank[np.argsort(first)] = np.arange(first.size)
    return rank[labels]


def target_count(primitives: Sequence[Primitive]) -> int:
    """Return the number of morph targets, which all primitives of a mesh have in common."""
    count = len(primitives[0].targets)
    for each in primitives:
        if len(each.targets) != count:
            raise each.fields.error(
                f"has {len(each.targets)} morph targets, another primitive of the mesh {count}"
            )
    return count


def _columns(primitives: Sequence[Primitive]) -> Iterator[NDArray[Any]]:
    """Yield everything that tells vertices apart, as columns for all vertices of all primitives."""
    yield np.concatenate([each.positions for each in primitives]).astype(np.float64)
    joints, weights = influences(primitives)
    for one_joint, one_weight in zip(joints.T, weights.T, strict=True):
        yield np.column_stack([one_joint, one_weight])
    for target in range(target_count(primitives)):
        yield deltas(primitives, target)


def influences(primitives: Sequence[Primitive]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return joints and weights ``(n, 4 * sets)`` of all vertices, in the order of the joints.

    Where the weight is 0 the joint is 0, too; primitives that have fewer sets than others get weights 0.
    """
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
    """Return what a morph target adds to the positions ``(n, 3)`` of all vertices."""
    return _gathered(primitives, lambda each: each.delta(target), 3)


def _gathered(primitives: Sequence[Primitive], attribute: Attribute, width: int) -> NDArray[np.float64]:
    """Put an attribute of all primitives together, 0 where a primitive does not have it."""
    found = ((each, attribute(each)) for each in primitives)
    return np.concatenate(
        [
            np.zeros((len(each.positions), width)) if values is None else values.reshape(-1, width)
            for each, values in found
        ]
    ).astype(np.float64)


def numbered(rows: NDArray[Any]) -> IntArray:
    """Number rows so that equal rows have the same number; -0 equals 0.

    Examples
    --------
    >>> numbered(np.array([[1.0, 5.0], [0.0, 2.0], [1.0, 5.0]])).tolist()
    [1, 0, 1]
    """
    order = np.lexsort(rows.T)
    if not order.size:
        return order
    ordered = rows[order]
    new = np.concatenate([[False], (ordered[1:] != ordered[:-1]).any(axis=1)])
    numbers = np.empty_like(order)
    numbers[order] = np.cumsum(new)
    return numbers
