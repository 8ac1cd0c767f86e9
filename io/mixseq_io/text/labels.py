r"""Labels of triangles and polygons, and their derivation from face sets, colours or skeletons in a file.

- *Sets*: a polygon is labelled by the set or sets that contain it, or by `UNNAMED_LABEL` if it is in no set.
- *Colours*: colours that are equal in 8 bits per channel form one label. A polygon gets the most frequent label of its
  corners, the lowest on ties. More than `MAX_LABEL_COLOURS` colours are not a segmentation.
- *Skeleton*: with skinning weights :math:`w_{vj}` of vertices v and joints j, a polygon p is labelled by the joint

  .. math:: \arg\max_j \sum_{v \in p} w_{vj},

  the lowest on ties. Joints with too small a fraction of the polygons are merged into their parents, deepest joints
  first, so that fingers become a hand. Small disconnected regions get the label with which they share most edges.

Polygons are labelled as stored in the file; each triangle has the label of its polygon.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mixseq.errors import FormatError
from mixseq.mesh.polygons import Polygons, read_only
from mixseq.mesh.surface import FaceSet
from mixseq.sequence.header import SequenceHeader
from mixseq.types import FloatArray, Index

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


UNNAMED_LABEL = "(none)"
"""Name of the label for polygons in no set."""

MAX_LABEL_COLOURS = 256

_MAX_COLOUR_VALUE = 1e6  # limit well above 1, since renderers allow colours above 1


def labels_from_sets(sets: Sequence[FaceSet], polygons: Polygons) -> Labels:
    """Label polygons by the sets that contain them, several joined by +, in their order; `UNNAMED_LABEL` is last."""
    set_ids = {name: index for index, name in enumerate(dict.fromkeys(face_set.name for face_set in sets))}
    labels = np.zeros(len(polygons.counts), dtype=np.int64)
    members: list[tuple[int, ...]] = [()]  # set ids of each label
    for name, set_id in set_ids.items():
        inside = np.unique(np.concatenate([face_set.polygons for face_set in sets if face_set.name == name]))
        old_labels, ids = np.unique(labels[inside], return_inverse=True)
        labels[inside] = len(members) + ids
        members += [(*members[label], set_id) for label in old_labels.tolist()]
    used, labels = np.unique(labels, return_inverse=True)
    used_members = [members[label] for label in used.tolist()]
    order = sorted(range(len(used_members)), key=lambda label: (not used_members[label], used_members[label]))
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))
    set_names = list(set_ids)
    names = ("+".join(set_names[set_id] for set_id in used_members[label]) for label in order)
    return Labels(triangle_labels(rank[labels], polygons), tuple(name or UNNAMED_LABEL for name in names))


def labels_from_colours(file: Path, colours: FloatArray, polygons: Polygons) -> Labels:
    """Label polygons by the colours ``(sum of counts, k)`` of their corners in a file."""
    bytes_ = np.rint(255 * np.clip(np.nan_to_num(colours), 0, _MAX_COLOUR_VALUE)).astype(np.int64)
    distinct, of_corner = np.unique(bytes_, axis=0, return_inverse=True)
    if len(distinct) > MAX_LABEL_COLOURS:
        raise FormatError(
            f"{file} has {len(distinct)} vertex colours, too many for a segmentation; paint every part in one colour, "
            f"{MAX_LABEL_COLOURS} at most"
        )
    polygon_ids = np.repeat(np.arange(len(polygons.counts)), polygons.counts)
    used, labels = np.unique(most_frequent(polygon_ids, of_corner.reshape(-1)), return_inverse=True)
    return Labels(triangle_labels(labels, polygons), tuple(_format_colour(distinct[label]) for label in used))


def labels_from_skinning(skinning: Skinning, polygons: Polygons, min_ratio: float = MIN_JOINT_FACE_RATIO) -> Labels:
    """Label each polygon by the joint with the largest sum of skinning weights at the corners."""
    from scipy.sparse import csr_array

    count, vertex_count = len(polygons.counts), skinning.weights.shape[0]
    rows = np.repeat(np.arange(count), polygons.counts)
    corners = csr_array((np.ones(rows.size), (rows, polygons.indices)), shape=(count, vertex_count))
    sums = (corners @ skinning.weights).tocoo()
    # Rounding makes sums equal that add the same weights in different orders.
    order = np.lexsort((sums.col, -np.round(sums.data, 6), sums.row))
    _, first = np.unique(sums.row[order], return_index=True)
    joints = np.asarray(sums.col[order][first], dtype=np.int64)
    joints = _merge_small_joints(skinning, joints, min_ratio * count)
    joints = merge_small_regions(joints, polygons, vertex_count, min_ratio * count)
    used, labels = np.unique(joints, return_inverse=True)
    names = shorten_paths(skinning.joints[joint] for joint in used)
    return Labels(triangle_labels(labels, polygons), tuple(names.values()))


def _merge_small_joints(skinning: Skinning, joints: Index, min_count: float) -> Index:
    """Replace joints ``(P,)`` with fewer than `min_count` polygons by their parents, deepest joints first."""
    joint_ids = {path: joint for joint, path in enumerate(skinning.joints)}
    parents = [joint_ids.get(path, -1) for path in skinning.parents]
    sizes = np.bincount(joints, minlength=len(parents)).tolist()
    targets = np.arange(len(parents))
    for joint in sorted(range(len(parents)), key=lambda joint: -_depth(joint, parents)):
        if sizes[joint] < min_count and parents[joint] >= 0:
            sizes[parents[joint]] += sizes[joint]
            targets[targets == joint] = parents[joint]
    return targets[joints]


def _depth(joint: int, parents: Sequence[int]) -> int:
    depth = 0
    while joint >= 0 and depth <= len(parents):  # the parents in damaged files can form cycles
        joint, depth = parents[joint], depth + 1
    return depth


def _format_colour(colour: NDArray[np.int64]) -> str:
    shown = colour[:3] if len(colour) < 4 or colour[3] == 255 else colour
    return "#" + "".join(f"{value:02x}" for value in shown.tolist())


def merge_small_regions(labels: Index, polygons: Polygons, vertex_count: int, min_count: float) -> Index:
    """Merge regions below `min_count` polygons, smallest first, into the label of most shared edges, if any."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    pairs = _adjacent_polygons(polygons, vertex_count)
    count = len(labels)
    same_mask = labels[pairs[:, 0]] == labels[pairs[:, 1]]
    graph = coo_array((np.ones(int(same_mask.sum())), tuple(pairs[same_mask].T)), shape=(count, count))
    regions = connected_components(graph, directed=False)[1]
    region_labels = labels[np.unique(regions, return_index=True)[1]]
    sizes = dict(enumerate(np.bincount(regions).tolist()))
    borders: dict[int, dict[int, int]] = {region: {} for region in sizes}  # shared edges by adjacent region
    for a, b in regions[pairs[~same_mask]].tolist():
        borders[a][b] = borders[a].get(b, 0) + 1
        borders[b][a] = borders[b].get(a, 0) + 1
    targets = np.arange(len(sizes))
    while small := [(size, region) for region, size in sizes.items() if size < min_count and borders[region]]:
        smallest = min(small)[1]
        target = max(borders[smallest], key=lambda region: (borders[smallest][region], -region))
        targets[targets == smallest] = target
        sizes[target] += sizes.pop(smallest)
        for region, edges in borders.pop(smallest).items():
            del borders[region][smallest]
            if region != target:
                edges += borders[target].get(region, 0)
                borders[region][target] = borders[target][region] = edges
    return np.asarray(region_labels[targets[regions]], dtype=np.int64)


def _adjacent_polygons(polygons: Polygons, vertex_count: int) -> Index:
    """Return the pairs ``(n, 2)`` of adjacent polygons, one pair for each shared edge."""
    from mixseq.mesh.topology import Topology

    polygon_ids = np.repeat(np.arange(len(polygons.counts)), polygons.counts - 2)
    pairs = polygon_ids[Topology(polygons.triangles, vertex_count).hinge_faces]
    return np.asarray(pairs[pairs[:, 0] != pairs[:, 1]], dtype=np.int64)
