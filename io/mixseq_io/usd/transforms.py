"""USD, transforms: placement of prims in the world, and its sources of motion.

Operations that invert the next one at all times, as written by `mixseq_io.usd.holding`, are dropped with it, so that
the transform is exact and their samples make no frames.

Specification: https://openusd.org/release/api/class_usd_geom_xformable.html
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from pxr import Gf, Usd, UsdGeom

from mixseq_io.usd.prims import lineage

Operations = tuple[UsdGeom.XformOp, ...]


@dataclass(frozen=True, eq=False)
class Placement:
    """Transform from a prim's space to the world."""

    prim: Usd.Prim

    @cached_property
    def operations(self) -> Operations:
        """Operations on points, the innermost first, without mutually inverse ones."""
        left: list[UsdGeom.XformOp] = []
        for operation in self._all:
            if left and _undo_each_other(left[-1], operation):
                left.pop()
            else:
                left.append(operation)
        return tuple(left)

    @property
    def moves(self) -> bool:
        """Whether the transform changes over time."""
        return any(varies(each.GetAttr()) for each in self.operations)

    def to_world(self, code: float) -> Gf.Matrix4d:
        """Return the local-to-world transform at a time code, for row vectors: p' = p M."""
        if len(self.operations) == len(self._all):
            return UsdGeom.XformCache(Usd.TimeCode(code)).GetLocalToWorldTransform(self.prim)
        return product(self.operations, code)

    @cached_property
    def _all(self) -> Operations:
        return tuple(operations_of(self.prim))


def operations_of(prim: Usd.Prim) -> Iterator[UsdGeom.XformOp]:
    """Yield the operations on a prim's points, the innermost first."""
    for each in lineage(prim):
        if xformable := UsdGeom.Xformable(each):
            yield from reversed(xformable.GetOrderedXformOps())
            if xformable.GetResetXformStack():
                return


def product(operations: Operations, code: float) -> Gf.Matrix4d:
    """Return the product of operations, the innermost first, at a time code."""
    matrix = Gf.Matrix4d(1.0)
    for each in operations:
        matrix *= each.GetOpTransform(Usd.TimeCode(code))
    return matrix


def varies(attribute: Usd.Attribute) -> bool:
    """Whether an attribute changes over time; a single sample is constant."""
    return attribute.GetNumTimeSamples() > 1 or is_spline(attribute)


def is_spline(attribute: Usd.Attribute) -> bool:
    """Whether an attribute is animated by a spline instead of samples."""
    return bool(attribute.ValueMightBeTimeVarying()) and not attribute.GetNumTimeSamples()


def _undo_each_other(one: UsdGeom.XformOp, other: UsdGeom.XformOp) -> bool:
    """Whether two operations of different prims are inverse at all times."""
    mine, theirs = one.GetAttr(), other.GetAttr()
    if one.IsInverseOp() == other.IsInverseOp() or mine.GetPrim() == theirs.GetPrim():
        return False
    if one.GetOpType() != other.GetOpType() or mine.GetTypeName() != theirs.GetTypeName():
        return False
    if not (varies(mine) or varies(theirs)):
        earliest = Usd.TimeCode.EarliestTime()
        return bool(mine.Get(earliest) == theirs.Get(earliest))
    times, same = mine.GetTimeSamples(), theirs.GetTimeSamples()
    if len(times) != len(same) or is_spline(mine) or is_spline(theirs):
        return False
    # USD scales the times of a layer that has another rate than the one above it.
    if not np.allclose(times, same, rtol=1e-12, atol=1e-9):
        return False
    return all(mine.Get(a) == theirs.Get(b) for a, b in zip(times, same, strict=True))
