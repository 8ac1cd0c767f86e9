"""Labels of triangles and of their polygons."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mixseq.arrays import Index
from mixseq.polygons import Polygons, frozen


@dataclass(frozen=True, eq=False)
class Labels:
    """One label per triangle."""

    part_of_face: Index
    names: tuple[str, ...]

    def __post_init__(self) -> None:
        object.__setattr__(
            self, "part_of_face", frozen(np.ascontiguousarray(self.part_of_face, dtype=np.int64))
        )


def triangle_labels(of_polygon: ArrayLike, polygons: Polygons) -> Index:
    """Return the labels ``(F,)`` of triangles from those of polygons ``(P,)``."""
    return np.repeat(np.asarray(of_polygon, dtype=np.int64), polygons.counts - 2)


def polygon_labels(of_triangle: Index, polygons: Polygons) -> Index:
    """Return the most frequent label of each polygon's triangles ``(P,)``, the lowest on ties: from ``(F,)``."""
    return most_frequent(np.repeat(np.arange(len(polygons.counts)), polygons.counts - 2), of_triangle)


def most_frequent(owner: Index, value: Index) -> Index:
    """Return the most frequent value of each owner 0, 1, ..., the lowest on ties: owner, value ``(n,)``."""
    if not owner.size:
        return np.zeros(0, dtype=np.int64)
    span = int(value.max()) + 1
    pairs, times = np.unique(owner.astype(np.int64) * span + value, return_counts=True)
    order = np.lexsort((pairs % span, -times, pairs // span))
    _, first = np.unique(pairs[order] // span, return_index=True)
    return np.asarray(pairs[order][first] % span, dtype=np.int64)
