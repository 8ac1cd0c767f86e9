r"""Labels of faces derived from sets, colours or skeletons in a file.

- *Sets*: a polygon's label is its sets, mostly one; without any it is `UNNAMED`.
- *Colours*: equal colours, to 8 bits a channel, are one label. A polygon takes that of most of its corners, the lowest
  on ties. More than `MOST_COLOURS` are a picture and no segmentation.
- *Skeleton*: with the weights :math:`w_{vj}` of the vertices a polygon p takes the joint

  .. math:: \arg\max_j \sum_{v \in p} w_{vj},

  the lowest on ties. Joints with a smaller share of the polygons than `smallest` join their parents, the deepest first,
  so that fingers become a hand. Small disconnected regions of a joint join the label with most common edges.

Labels belong to polygons, as authored; triangles have those of their polygons.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components

from mixseq.errors import FormatError
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import FaceSet
from mixseq.mesh.topology import Topology
from mixseq.types import FloatArray, Index
from mixseq_io.text.labels import (
    MIN_JOINT_FACE_RATIO,
    Labels,
    Skinning,
    most_frequent,
    shorten_paths,
    triangle_labels,
)

UNNAMED = "(none)"
"""Name of the label of polygons in no set."""

MOST_COLOURS = 256

_BRIGHTEST = 1e6  # renderers allow colours above 1


def labels_of_sets(sets: Sequence[FaceSet], polygons: Polygons) -> Labels:
    """Label polygons by their sets, in the order of the sets; polygons in no set come last.

    The label of several sets has all their names, joined by "+".
    """
    number = {name: index for index, name in enumerate(dict.fromkeys(each.name for each in sets))}
    label = np.zeros(len(polygons.counts), dtype=np.int64)
    members: list[tuple[int, ...]] = [()]  # the sets that every label stands for
    for name, index in number.items():
        inside = np.unique(np.concatenate([each.polygons for each in sets if each.name == name]))
        before, place = np.unique(label[inside], return_inverse=True)
        label[inside] = len(members) + place
        members += [(*members[each], index) for each in before.tolist()]
    found, label = np.unique(label, return_inverse=True)
    kinds = [members[each] for each in found.tolist()]
    order = sorted(range(len(kinds)), key=lambda each: (not kinds[each], kinds[each]))
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))
    texts = list(number)
    return Labels(
        triangle_labels(rank[label], polygons),
        tuple("+".join(texts[each] for each in kinds[kind]) or UNNAMED for kind in order),
    )


def labels_of_colours(colours: FloatArray, polygons: Polygons) -> Labels:
    """Label polygons by the colours ``(sum of counts, k)`` of their corners."""
    bytes_ = np.rint(255 * np.clip(np.nan_to_num(colours), 0, _BRIGHTEST)).astype(np.int64)
    kinds, of_corner = np.unique(bytes_, axis=0, return_inverse=True)
    if len(kinds) > MOST_COLOURS:
        raise FormatError(
            f"has {len(kinds)} vertex colours, which is no segmentation; paint every part in one colour, "
            f"{MOST_COLOURS} at most"
        )
    of_polygon = most_frequent(
        np.repeat(np.arange(len(polygons.counts)), polygons.counts), of_corner.reshape(-1)
    )
    used, dense = np.unique(of_polygon, return_inverse=True)
    return Labels(triangle_labels(dense, polygons), tuple(_hexadecimal(kinds[kind]) for kind in used))


def labels_of_skinning(
    skinning: Skinning, polygons: Polygons, smallest: float = MIN_JOINT_FACE_RATIO
) -> Labels:
    """Label polygons by the joint with the largest sum of weights."""
    count = len(polygons.counts)
    rows = np.repeat(np.arange(count), polygons.counts)
    of_polygon = csr_array(
        (np.ones(rows.size), (rows, polygons.indices)), shape=(count, skinning.weights.shape[0])
    )
    sums = (of_polygon @ skinning.weights).tocoo()
    # Rounded, so that sums of the same weights in another order are equal.
    order = np.lexsort((sums.col, -np.round(sums.data, 6), sums.row))
    _, first = np.unique(sums.row[order], return_index=True)
    followed = np.asarray(sums.col[order][first], dtype=np.int64)
    merged = _merged_up(skinning, followed, smallest * count)
    tidy = without_small_regions(merged, polygons, skinning.weights.shape[0], smallest * count)
    used, dense = np.unique(tidy, return_inverse=True)
    texts = shorten_paths(skinning.joints[joint] for joint in used)
    return Labels(triangle_labels(dense, polygons), tuple(texts.values()))


def _merged_up(skinning: Skinning, joint: Index, fewest: float) -> Index:
    """Return the joints ``(P,)`` after those of fewer than `fewest` polygons joined their parents, deepest first."""
    number = {path: index for index, path in enumerate(skinning.joints)}
    parent = [number.get(above, -1) for above in skinning.parents]
    sizes = np.bincount(joint, minlength=len(parent)).tolist()
    into = np.arange(len(parent))
    for each in sorted(range(len(parent)), key=lambda each: -_depth(each, parent)):
        if sizes[each] < fewest and parent[each] >= 0:
            sizes[parent[each]] += sizes[each]
            into[into == each] = parent[each]
    return into[joint]


def _depth(joint: int, parent: Sequence[int]) -> int:
    depth = 0
    while joint >= 0 and depth <= len(parent):  # of a damaged file, joints may be above themselves
        joint, depth = parent[joint], depth + 1
    return depth


def _hexadecimal(colour: NDArray[np.int64]) -> str:
    shown = colour[:3] if len(colour) < 4 or colour[3] == 255 else colour
    return "#" + "".join(f"{value:02x}" for value in shown.tolist())


def without_small_regions(of_polygon: Index, polygons: Polygons, vertex_count: int, fewest: float) -> Index:
    """Relabel ``(P,)`` regions of fewer than `fewest` polygons, smallest first, by the label with most common edges.

    Skinning weights leave ragged borders and stray faces. Regions that are whole connected components stay.
    """
    pairs = _beside(polygons, vertex_count)
    count = len(of_polygon)
    same = of_polygon[pairs[:, 0]] == of_polygon[pairs[:, 1]]
    graph = coo_array((np.ones(int(same.sum())), tuple(pairs[same].T)), shape=(count, count))
    region = connected_components(graph, directed=False)[1]
    label = of_polygon[np.unique(region, return_index=True)[1]]
    sizes = dict(enumerate(np.bincount(region).tolist()))
    beside: dict[int, dict[int, int]] = {each: {} for each in sizes}  # shared edges of neighbouring regions
    for a, b in region[pairs[~same]].tolist():
        beside[a][b] = beside[a].get(b, 0) + 1
        beside[b][a] = beside[b].get(a, 0) + 1
    into = np.arange(len(sizes))
    while small := [(size, each) for each, size in sizes.items() if size < fewest and beside[each]]:
        smallest = min(small)[1]
        keep = max(beside[smallest], key=lambda each: (beside[smallest][each], -each))
        into[into == smallest] = keep
        sizes[keep] += sizes.pop(smallest)
        for each, edges in beside.pop(smallest).items():
            del beside[each][smallest]
            if each != keep:
                beside[each][keep] = beside[keep][each] = beside[keep].get(each, 0) + edges
    return np.asarray(label[into[region]], dtype=np.int64)


def _beside(polygons: Polygons, vertex_count: int) -> Index:
    """Return pairs of polygons ``(n, 2)``, one for each shared edge."""
    owner = np.repeat(np.arange(len(polygons.counts)), polygons.counts - 2)
    pairs = owner[Topology(polygons.triangles, vertex_count).hinge_faces]
    return np.asarray(pairs[pairs[:, 0] != pairs[:, 1]], dtype=np.int64)
