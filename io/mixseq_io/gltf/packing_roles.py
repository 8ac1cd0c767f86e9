"""What the accessors of a glTF document are for, and so how `mixseq_io.gltf.packing` rounds and packs them.

A morph target is rounded together with the points that it moves: ``x + d`` is on the same grid as ``x``, so that a
frame that is a target is off by no more than the first one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixseq.diagonal import Diagonal
from mixseq_io.gltf.buffers import Layout
from mixseq_io.gltf.document import Document
from mixseq_io.gltf.json_fields import Fields
from mixseq_io.gltf.packed_meshes import (
    UV_EXPONENT,
    add_fixed_point,
    add_normal_changes,
    add_normals,
    add_rows,
    add_triangles,
    exponent_within,
    rounded,
)

Values = NDArray[Any]
Add = Callable[[Layout, Values, Fields], int | None]
"""Adds the numbers of an accessor to a layout and returns the new accessor; None if it had better stay as it is."""

_TRIANGLES = 4
_EXPONENTS = {"TEXCOORD": UV_EXPONENT, "COLOR": -10, "NORMAL": -6, "_VERTEX": 0}
"""Of attributes by the first word of their names; normals only of some morph targets. Colours are off by 1/2048."""

_UNIT = 1e-3
"""Vectors whose length differs less from 1 are normals."""

_SHORTEST = 0.25
"""Normals that would be shorter have too few bits of a byte: they would be off by more than two degrees; ours."""

_MOST_STEPS = 2**23


@dataclass(frozen=True)
class _Grid:
    """Where the points of a mesh may be: steps of ``2**exponent``; and its diagonal."""

    exponent: int
    diagonal: float


class Roles:
    """What the accessors of a document are for, and so how they are added to another one.

    Attributes
    ----------
    adding : dict of int to callable
        By accessor, where that is not as it is.
    rounding : float
        How far points were off that have been added, in diagonals.
    """

    def __init__(self, document: Document, error: float) -> None:
        self._document = document
        self.adding: dict[int, Add] = {}
        self.rounding = 0.0
        for mesh in document.items("meshes"):
            primitives = mesh.objects("primitives")
            grid = self._grid(primitives, error)
            for primitive in primitives:
                self._read(primitive, grid)

    def _grid(self, primitives: list[Fields], error: float) -> _Grid:
        points = [self._points(each) for each in primitives]
        everything = np.concatenate([np.zeros((0, 3)), *(each for each in points if each is not None)])
        diagonal = Diagonal.of(everything).length if len(everything) else 0.0
        return _Grid(exponent_within(error * (diagonal or 1.0)), diagonal or 1.0)

    def _points(self, primitive: Fields) -> Values | None:
        """Return the points of a primitive, None if they are not floats."""
        index = primitive.object("attributes").index("POSITION")
        points = None if index is None else self._document.accessor(index)
        return points if points is not None and points.dtype.kind == "f" and points.ndim == 2 else None

    def _read(self, primitive: Fields, grid: _Grid) -> None:
        indices = primitive.index("indices")
        if indices is not None and primitive.integer("mode", _TRIANGLES) == _TRIANGLES:
            self.adding.setdefault(indices, _add_triangles)
        attributes, points = primitive.object("attributes"), self._points(primitive)
        for name, accessor in attributes.values.items():
            if name == "POSITION" and points is not None:
                self.adding.setdefault(accessor, self._adding_points(grid, np.zeros(points.shape)))
            elif name == "NORMAL":
                self.adding.setdefault(accessor, _add_normals)
            else:
                self.adding.setdefault(accessor, _adding(name))
        for target in primitive.objects("targets"):
            for name, accessor in target.values.items():
                if name == "POSITION" and points is not None:
                    self.adding.setdefault(accessor, self._adding_points(grid, points))
                elif name == "NORMAL" and "NORMAL" in attributes:
                    base = self._document.accessor(attributes.integer("NORMAL"))
                    self.adding.setdefault(accessor, _adding_normal_changes(base))
                else:
                    self.adding.setdefault(accessor, _adding(name))

    def _adding_points(self, grid: _Grid, base: Values) -> Add:
        """Return what adds points, or what moves points that are at `base`."""

        def add(layout: Layout, values: Values, accessor: Fields) -> int:
            if values.dtype.kind != "f" or values.shape != base.shape:
                return _add_attribute(layout, values, accessor)
            there = rounded(base, grid.exponent).astype(np.float64)
            wanted = base.astype(np.float64) + values
            moved = rounded(wanted, grid.exponent) - there
            off = np.sqrt(np.square(there + moved - wanted).sum(axis=1).max(initial=0.0))
            self.rounding = max(self.rounding, float(off) / grid.diagonal)
            return add_fixed_point(layout, moved, grid.exponent, bounds=True)

        return add


def _adding(name: str) -> Add:
    """Return what adds an attribute of some name."""
    exponent = _EXPONENTS.get(name.rpartition("_")[0] or name)
    return _add_attribute if exponent is None else _fixed_point(exponent)


def add_as_it_is(layout: Layout, values: Values, accessor: Fields) -> int | None:
    """Add numbers of any use without loss, if their rows need not be filled up."""
    return None if values.itemsize * values.shape[1] % 4 else _add_attribute(layout, values, accessor)


def _add_attribute(layout: Layout, values: Values, accessor: Fields) -> int:
    """Add numbers of vertices without loss."""
    made = add_rows(layout, values, accessor.text("type"), accessor.integer("componentType"))
    kept = {name: accessor.values[name] for name in ("normalized", "min", "max") if name in accessor}
    layout.document["accessors"][made].update(kept)
    return made


def _add_triangles(layout: Layout, values: Values, accessor: Fields) -> int | None:
    if values.dtype.kind != "u" or values.dtype.itemsize == 1 or len(values) % 3:
        return None
    return add_triangles(layout, values.reshape(-1, 3))


def _add_normals(layout: Layout, values: Values, accessor: Fields) -> int:
    if values.dtype.kind != "f":
        return _add_attribute(layout, values, accessor)
    return add_normals(layout, values)


def _adding_normal_changes(base: Values) -> Add:
    """Return what adds changes of normals, which are bytes if they are not larger than 1, or can be made so."""

    def add(layout: Layout, values: Values, accessor: Fields) -> int:
        if values.dtype.kind != "f" or values.shape != base.shape:
            return _add_attribute(layout, values, accessor)
        changes = _within_one(base.astype(np.float64), values.astype(np.float64))
        if changes is None:
            return add_fixed_point(layout, values, _EXPONENTS["NORMAL"])
        return add_normal_changes(layout, changes)

    return add


def _within_one(base: Values, changes: Values) -> Values | None:
    """Return changes of normals ``(n, 3)`` between -1 and 1, None if there are none that do the same.

    A target that turns normals into others is a frame: renderers make what they get unit vectors, so that a normal
    which turns far may be shorter, with a smaller change.
    """
    if np.abs(changes).max(initial=0) <= 1:
        return changes
    normals = base + changes
    if np.abs(np.linalg.norm(normals, axis=1) - 1).max() > _UNIT:
        return None
    with np.errstate(divide="ignore"):
        lengths = np.where(np.abs(changes) > 1, (1 - np.abs(base)) / np.abs(normals), 1.0)
    shortened: Values = np.clip(lengths.min(axis=1, keepdims=True) * normals - base, -1, 1)
    return shortened if lengths.min() > _SHORTEST else None


def _fixed_point(exponent: int) -> Add:
    """Return what adds floats as fixed-point numbers, unless they are too large for that."""

    def add(layout: Layout, values: Values, accessor: Fields) -> int:
        fits = np.abs(values).max(initial=0) < np.ldexp(_MOST_STEPS - 1, exponent)
        if values.dtype.kind != "f" or not fits:
            return _add_attribute(layout, values, accessor)
        return add_fixed_point(layout, values, exponent)

    return add
