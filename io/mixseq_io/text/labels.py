"""Labels of triangles and of polygons, and what they are derived from: named sets of faces, joints of skeletons."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from mixseq.mesh.polygons import Polygons, read_only
from mixseq.mesh.surface import FaceSet
from mixseq.sequence.header import SequenceHeader
from mixseq.types import Index

if TYPE_CHECKING:
    from scipy.sparse import csr_array


@dataclass(frozen=True, eq=False)
class Labels:
    """One label per triangle."""

    part_of_face: Index
    names: tuple[str, ...]

    def __post_init__(self) -> None:
        object.__setattr__(
            self, "part_of_face", read_only(np.ascontiguousarray(self.part_of_face, dtype=np.int64))
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


LABELS_SOURCE, GROUPS_SOURCE, MATERIALS_SOURCE, COLOURS_SOURCE, SKELETON_SOURCE = (
    "labels",
    "groups",
    "materials",
    "colours",
    "skeleton",
)
"""Names of sources; other families of USD subsets are sources by their own names."""

LABEL_SUBSET_FAMILY = "mixseq"
"""Family of USD subsets that are parts: the source `LABELS_SOURCE`."""

MIN_JOINT_FACE_RATIO = 0.01
"""Smallest share of the polygons of a joint that is a part of its own."""


@dataclass(frozen=True, eq=False)
class Skinning:
    """Skinning weights of vertices by joint."""

    weights: csr_array
    joints: tuple[str, ...]
    parents: tuple[str, ...]

    @classmethod
    def rigid(cls, path: str, vertex_count: int) -> Skinning:
        """Return the skinning of a mesh without a skin: it follows itself."""
        from scipy.sparse import csr_array

        return cls(csr_array(np.ones((vertex_count, 1))), (path,), ("",))


@dataclass(frozen=True, eq=False, kw_only=True)
class Markings:
    """Sets of polygons and skinning of a mesh."""

    sets: Mapping[str, tuple[FaceSet, ...]] = field(default_factory=dict)
    skinning: Skinning | None = None


def group_face_sets(header: SequenceHeader) -> dict[str, tuple[FaceSet, ...]]:
    """Return the face sets of a surface: those with materials, and the others."""
    every = header.surface.face_sets
    materials = shorten_paths(each.material for each in every if each.material)
    named = {
        GROUPS_SOURCE: tuple(each for each in every if not each.material),
        MATERIALS_SOURCE: tuple(
            FaceSet(materials[each.material], each.polygons) for each in every if each.material
        ),
    }
    return {source: sets for source, sets in named.items() if sets}


def concatenate_skinning(meshes: Sequence[Skinning]) -> Skinning:
    """Concatenate the skinning of several meshes; shared joints are merged."""
    from scipy.sparse import csr_array, vstack

    parents = {
        joint: above for each in meshes for joint, above in zip(each.joints, each.parents, strict=True)
    }
    column = {joint: number for number, joint in enumerate(parents)}
    rows = []
    for each in meshes:
        own = each.weights.tocoo()
        columns = np.array([column[joint] for joint in each.joints])[own.col]
        rows.append(csr_array((own.data, (own.row, columns)), shape=(own.shape[0], len(column))))
    return Skinning(csr_array(vstack(rows)), tuple(column), tuple(parents.values()))


def shorten_paths(paths: Iterable[str]) -> dict[str, str]:
    """Return the last name of each path, or the whole path where it is ambiguous."""
    last = {path: path.rstrip("/").rpartition("/")[2] or path for path in paths}
    often = Counter(last.values())
    return {path: name if often[name] == 1 else path for path, name in last.items()}
