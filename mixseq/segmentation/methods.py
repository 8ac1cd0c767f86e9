r"""Cut a mesh into parts by a named method or by labels; score segmentations by agreement and near-rigidity.

*Adjusted Rand index* (Hubert and Arabie 1985) of two segmentations of one mesh. With :math:`n_{ij}` the total weight of
faces in part i of the first and part j of the second, :math:`a_i = \sum_j n_{ij}`, :math:`b_j = \sum_i n_{ij}`, N their
sum, and the sums of squares

.. math:: S = \sum_{ij} n_{ij}^2, \quad A = \sum_i a_i^2, \quad B = \sum_j b_j^2, \quad Q = \sum_f w_f^2,

where Q is the contribution of pairs of a face with itself, the index is

.. math:: \mathrm{ARI} = \frac{(S - Q) - E}{\frac{1}{2} (A + B) - Q - E}, \qquad
          E = \frac{(A - Q)(B - Q)}{N^2 - Q} .

For weights of one, this is the usual index of counts, since :math:`n^2 - n = 2 \binom{n}{2}`.

*Karni-Gotsman error* ("Compression of soft-body animation sequences", Computers & Graphics 2004). With B the
vertices of the first frame under the best rigid motion of their part in every frame (Kabsch),

.. math:: \mathrm{KG} = 100\, \frac{\|A - B\|_F}{\|A - \bar A\|_F},

where :math:`\bar A` is the centroid in every frame: of the part for a part's error, of all vertices for the mesh's
error. Vertices on a boundary count once in each of their parts.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mixseq.choices import SegmentationName
from mixseq.errors import SegmentationError, SettingsError
from mixseq.mesh.topology import Topology, split_labels
from mixseq.runtime.parallel import one_blas_thread
from mixseq.segmentation.motion import MotionSettings, moments, segment_by_motion
from mixseq.segmentation.silhouettes import (
    SilhouetteSettings,
    SpanningTreeSettings,
    segment_by_silhouettes,
    segment_by_spanning_tree,
)
from mixseq.types import Float, FloatArray, Index, IntArray

MethodSettings = MotionSettings | SilhouetteSettings | SpanningTreeSettings
Segmentation = SegmentationName | MethodSettings
"""Name of a method, or the settings of a method."""


class Method(NamedTuple):
    """A segmentation method: a function of points, topology, number of parts and settings; and the type of settings."""

    segment: Callable[[FloatArray, Topology, int | None, Any], Index]
    settings: type[MethodSettings]


METHODS: dict[SegmentationName, Method] = {
    "motion": Method(segment_by_motion, MotionSettings),
    "silhouettes": Method(segment_by_silhouettes, SilhouetteSettings),
    "spanning-tree": Method(segment_by_spanning_tree, SpanningTreeSettings),
}
"""Methods by name; these methods need only a mesh sequence."""


def resolve_segmentation(segmentation: Segmentation) -> tuple[SegmentationName, MethodSettings]:
    """Return the name of a method and its settings."""
    for name, method in METHODS.items():
        if isinstance(segmentation, method.settings):
            return name, segmentation
        if isinstance(segmentation, str) and segmentation == name:
            return name, method.settings()
    raise SettingsError(
        f"segmentation is {segmentation!r}; one of {', '.join(METHODS)}, or settings of one, is expected "
        "(labels of the faces are given as parts, those in files are read by mixseq_io.read_labels)"
    )


def segment(
    points: FloatArray,
    topology: Topology,
    method: SegmentationName = "motion",
    parts: int | None = None,
    settings: MethodSettings | None = None,
) -> Index:
    """Find the near-rigid part ``(F,)`` of every face, by decreasing area, from points ``(T, V, 3)`` in any unit.

    Parts are connected across edges. Without `parts`, their number is automatic, at least one per component; "motion"
    may find fewer if little moves. Raises `SettingsError` for wrong settings, or `parts` below 1 or above F.
    """
    implementation = METHODS[resolve_segmentation(method)[0]]
    if settings is not None and not isinstance(settings, implementation.settings):
        raise SettingsError(
            f"settings are {type(settings).__name__}; method {method!r} takes {implementation.settings.__name__}"
        )
    with one_blas_thread():
        return implementation.segment(points, topology, parts, settings)


def segment_by_labels(labels: ArrayLike, topology: Topology) -> NDArray[np.int64]:
    """Split face labels ``(F,)`` into connected parts ``(F,)``; raise `SegmentationError` if labels do not fit."""
    array = np.asarray(labels)
    if array.shape != (len(topology.faces),) or not np.issubdtype(array.dtype, np.integer):
        raise SegmentationError(
            f"labels have shape {array.shape} and type {array.dtype}; "
            f"one whole number for each of the {len(topology.faces)} triangles is expected"
        )
    return split_labels(topology, array)


def adjusted_rand_index(first: ArrayLike, second: ArrayLike, weights: ArrayLike | None = None) -> float:
    """Return the adjusted Rand index of two labelings ``(F,)`` of the same faces, with weights ``(F,)``."""
    a, b = np.asarray(first), np.asarray(second)
    if a.ndim != 1 or a.shape != b.shape:
        raise SegmentationError(
            f"labels have shapes {a.shape} and {b.shape}; one for each face of the same mesh are expected"
        )
    w = np.ones(len(a)) if weights is None else np.asarray(weights, dtype=np.float64)
    if w.shape != a.shape or not (np.isfinite(w).all() and (w >= 0).all()):
        raise SegmentationError(
            f"weights have shape {w.shape}; for each of the {len(a)} faces one number of at least 0 is expected"
        )
    _, i = np.unique(a, return_inverse=True)
    columns, j = np.unique(b, return_inverse=True)
    _, both = np.unique(i.astype(np.int64) * len(columns) + j, return_inverse=True)
    same_in_both, same_in_first, same_in_second = (_pair_weight(group, w) for group in (both, i, j))
    total = _pair_weight(np.zeros(len(w), dtype=np.int64), w)
    expected = same_in_first * same_in_second / total if total > 0 else 0.0
    largest = (same_in_first + same_in_second) / 2.0 - expected
    # `largest` is zero if both have a single part, or a part for every face.
    return (same_in_both - expected) / largest if largest > 0 else 1.0


def _pair_weight(group: NDArray[np.intp], weights: NDArray[np.float64]) -> float:
    """Return the weight of pairs of different faces in the same group; exactly 0 if there are no pairs."""
    squared_sums, sums_of_squares = np.bincount(group, weights) ** 2, np.bincount(group, weights**2)
    return float(np.sum(squared_sums - sums_of_squares))


def near_rigid_errors(points: FloatArray, faces: IntArray, part_of_face: IntArray) -> tuple[Float, float]:
    """Return KG errors ``(p,)`` of parts ``(F,)`` and of the mesh, with points ``(T, V, 3)``, faces ``(F, 3)``."""
    count = int(part_of_face.max(initial=-1)) + 1
    centroids = points.mean(axis=1, dtype=np.float64)[None]  # (1, T, 3)
    errors, variations, total_variation = np.zeros(count), np.zeros(count), 0.0
    for part in range(count):
        vertices = np.unique(faces[part_of_face == part])
        x = np.moveaxis(np.asarray(points[:, vertices], dtype=np.float64), 1, 0) - centroids
        errors[part] = moments(x[:, 0], x, np.ones(len(vertices))).error()
        variations[part] = np.square(x - x.mean(axis=0)).sum()
        total_variation += float(np.square(x).sum())
    ratios = np.sqrt(np.divide(errors, variations, out=np.zeros(count), where=variations > 0))
    total = float(np.sqrt(errors.sum() / total_variation)) if total_variation > 0 else 0.0
    return 100 * ratios, 100 * total
