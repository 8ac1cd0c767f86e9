"""Define labels of triangles and polygons, and the face sets and skinning weights from which labels are derived."""

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
        labels = np.ascontiguousarray(self.part_of_face, dtype=np.int64)
        object.__setattr__(self, "part_of_face", read_only(labels))


def triangle_labels(of_polygon: ArrayLike, polygons: Polygons) -> Index:
    """Expand labels of polygons ``(P,)`` to triangles ``(F,)``."""
    return np.repeat(np.asarray(of_polygon, dtype=np.int64), polygons.counts - 2)


def polygon_labels(of_triangle: Index, polygons: Polygons) -> Index:
    """Return the most frequent label of each polygon's triangles ``(F,)`` as ``(P,)``, the lowest on ties."""
    return most_frequent(np.repeat(np.arange(len(polygons.counts)), polygons.counts - 2), of_triangle)


def most_frequent(groups: Index, values: Index) -> Index:
    """Return each group's most frequent value, the lowest on ties, from group ids ``(n,)`` and values ``(n,)``."""
    if not groups.size:
        return np.zeros(0, dtype=np.int64)
    base = int(values.max()) + 1
    pairs, counts = np.unique(groups.astype(np.int64) * base + values, return_counts=True)
    order = np.lexsort((pairs % base, -counts, pairs // base))
    _, first = np.unique(pairs[order] // base, return_index=True)
    return np.asarray(pairs[order][first] % base, dtype=np.int64)


LABELS_SOURCE = "labels"
GROUPS_SOURCE = "groups"
MATERIALS_SOURCE = "materials"
COLOURS_SOURCE = "colours"
SKELETON_SOURCE = "skeleton"
"""Names of label sources; any other family of USD subsets is a source with the name of the family."""

LABEL_SUBSET_FAMILY = "mixseq"
"""Family of USD subsets that mixseq writes for parts; it is read as the source `LABELS_SOURCE`."""

MIN_JOINT_FACE_RATIO = 0.01
"""Smallest fraction of the mesh's polygons that makes a joint a part."""


@dataclass(frozen=True, eq=False)
class Skinning:
    """Skinning weights of every vertex and joint."""

    weights: csr_array  # (V, J)
    joints: tuple[str, ...]  # paths of the joints
    parents: tuple[str, ...]  # path of each joint's parent, "" for roots

    @classmethod
    def rigid(cls, path: str, vertex_count: int) -> Skinning:
        """Return the skinning of a mesh without skinning weights, with the mesh's path as its only joint."""
        from scipy.sparse import csr_array

        return cls(csr_array(np.ones((vertex_count, 1))), (path,), ("",))


@dataclass(frozen=True, eq=False, kw_only=True)
class Markings:
    """Sets of polygons and skinning of a mesh."""

    sets: Mapping[str, tuple[FaceSet, ...]] = field(default_factory=dict)
    skinning: Skinning | None = None


def group_face_sets(header: SequenceHeader) -> dict[str, tuple[FaceSet, ...]]:
    """Separate the face sets of a surface into groups and materials."""
    face_sets = header.surface.face_sets
    groups = tuple(face_set for face_set in face_sets if not face_set.material)
    names = shorten_paths(face_set.material for face_set in face_sets if face_set.material)
    materials = tuple(FaceSet(names[item.material], item.polygons) for item in face_sets if item.material)
    return {source: sets for source, sets in ((GROUPS_SOURCE, groups), (MATERIALS_SOURCE, materials)) if sets}


def concatenate_skinning(meshes: Sequence[Skinning]) -> Skinning:
    """Concatenate the skinning weights of several meshes, and merge joints with the same path."""
    from scipy.sparse import csr_array, vstack

    parents = dict(pair for mesh in meshes for pair in zip(mesh.joints, mesh.parents, strict=True))
    joint_ids = {joint: number for number, joint in enumerate(parents)}
    blocks = []
    for mesh in meshes:
        weights = mesh.weights.tocoo()
        columns = np.array([joint_ids[joint] for joint in mesh.joints])[weights.col]
        shape = (weights.shape[0], len(joint_ids))
        blocks.append(csr_array((weights.data, (weights.row, columns)), shape=shape))
    return Skinning(csr_array(vstack(blocks)), tuple(joint_ids), tuple(parents.values()))


def shorten_paths(paths: Iterable[str]) -> dict[str, str]:
    """Map each path to its last component, or to the whole path if several paths have the same last component."""
    names = {path: path.rstrip("/").rpartition("/")[2] or path for path in paths}
    counts = Counter(names.values())
    return {path: name if counts[name] == 1 else path for path, name in names.items()}
