"""The polygons of a mesh, and their triangulation."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mixseq.arrays import IntArray
from mixseq.errors import InvalidSequenceError


def frozen(array: NDArray[Any]) -> NDArray[Any]:
    """Return a read-only view of an array, for frozen dataclasses."""
    view = array.view()
    view.flags.writeable = False
    return view


@dataclass(frozen=True, eq=False)
class Polygons:
    """The faces of a mesh as its author made them: triangles, quads and n-gons.

    Parameters
    ----------
    counts : (P,) int
        Number of corners of each polygon, at least 3.
    indices : (sum(counts),) int
        Vertex index of each corner, polygon by polygon.
    """

    counts: IntArray
    indices: IntArray

    def __post_init__(self) -> None:
        counts = as_indices(self.counts, "polygon corner counts").reshape(-1)
        indices = as_indices(self.indices, "polygon corners").reshape(-1)
        if counts.size and counts.min() < 3:
            bad = int(np.argmax(counts < 3))
            raise InvalidSequenceError(
                f"polygon {bad} has {counts[bad]} corners; a face needs at least 3 (remove points and lines)"
            )
        if int(counts.sum()) != indices.size:
            raise InvalidSequenceError(
                f"polygon corner counts add up to {int(counts.sum())} but {indices.size} corners are given"
            )
        object.__setattr__(self, "counts", frozen(counts))
        object.__setattr__(self, "indices", frozen(indices))

    @classmethod
    def from_triangles(cls, faces: ArrayLike) -> Polygons:
        """Make polygons of an ``(F, 3)`` array of triangles."""
        triangles = as_indices(faces, "faces")
        if triangles.ndim != 2 or triangles.shape[1] != 3:
            raise InvalidSequenceError(f"faces have shape {triangles.shape}; (F, 3) is expected")
        return cls(np.full(len(triangles), 3, dtype=np.int32), triangles.reshape(-1))

    @cached_property
    def triangles(self) -> NDArray[np.int32]:
        """Triangulation ``(F, 3)``: a fan about each polygon's first corner.

        It depends on indices only, so that connectivity is the same in every frame.

        Examples
        --------
        >>> Polygons(np.array([4, 3]), np.array([0, 1, 2, 3, 3, 2, 4])).triangles.tolist()
        [[0, 1, 2], [0, 2, 3], [3, 2, 4]]
        """
        if self.only_triangles:
            return frozen(self.indices.reshape(-1, 3))
        starts = np.cumsum(self.counts) - self.counts
        per_polygon = self.counts - 2
        first = np.repeat(starts, per_polygon)
        step = np.arange(int(per_polygon.sum())) - np.repeat(
            np.cumsum(per_polygon) - per_polygon, per_polygon
        )
        corners = np.stack([first, first + step + 1, first + step + 2], axis=1)
        return np.asarray(frozen(self.indices[corners]), dtype=np.int32)

    @property
    def only_triangles(self) -> bool:
        """Whether every polygon has three corners."""
        return bool(np.all(self.counts == 3))

    def same_as(self, other: Polygons) -> bool:
        """Whether both have the same polygons in the same order with the same first corners."""
        return np.array_equal(self.counts, other.counts) and np.array_equal(self.indices, other.indices)


def reversed_corners(counts: IntArray, *, keep_first: bool) -> NDArray[np.intp]:
    """Return corner indices that reverse every polygon, an involution: new corner ``c`` is old ``order[c]``.

    Shapes: counts ``(P,)``.

    Examples
    --------
    >>> reversed_corners(np.array([4, 3]), keep_first=True).tolist()
    [0, 3, 2, 1, 4, 6, 5]
    >>> reversed_corners(np.array([4, 3]), keep_first=False).tolist()
    [3, 2, 1, 0, 6, 5, 4]
    """
    sizes = np.repeat(counts, counts)
    starts = np.repeat(np.cumsum(counts) - counts, counts)
    corner = np.arange(len(starts)) - starts
    new = -corner if keep_first else -corner - 1
    return np.asarray(starts + new % sizes, dtype=np.intp)


def as_indices(values: ArrayLike, what: str) -> NDArray[np.int32]:
    """Return whole numbers as int32; InvalidSequenceError with the name `what` for other types or ranges."""
    array = np.asarray(values)
    if array.size and not np.issubdtype(array.dtype, np.integer):
        raise InvalidSequenceError(f"{what} have type {array.dtype}; integers are expected")
    if array.size and (array.max() > np.iinfo(np.int32).max or array.min() < np.iinfo(np.int32).min):
        raise InvalidSequenceError(f"{what} do not fit into 32 bits")
    return np.ascontiguousarray(array, dtype=np.int32)
