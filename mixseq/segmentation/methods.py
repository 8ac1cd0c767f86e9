"""Cut a mesh into parts by a named method, or by given labels."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mixseq.arrays import FloatArray, Index
from mixseq.choices import SegmentationName
from mixseq.errors import SegmentationError, SettingsError
from mixseq.segmentation.motion import MotionSettings, segment_by_motion
from mixseq.segmentation.silhouettes import SilhouetteSettings, segment_by_silhouettes
from mixseq.segmentation.spanning_tree import SpanningTreeSettings, segment_by_spanning_tree
from mixseq.threads import one_blas_thread
from mixseq.topology import Topology, split_labels

MethodSettings = MotionSettings | SilhouetteSettings | SpanningTreeSettings
Segmentation = SegmentationName | MethodSettings
"""Name of a method, or settings of it."""


class Method(NamedTuple):
    """A way to find parts: a function of points, topology, number of parts and settings, and their type."""

    segment: Callable[[FloatArray, Topology, int | None, Any], Index]
    settings: type[MethodSettings]


METHODS: dict[SegmentationName, Method] = {
    "motion": Method(segment_by_motion, MotionSettings),
    "silhouettes": Method(segment_by_silhouettes, SilhouetteSettings),
    "spanning-tree": Method(segment_by_spanning_tree, SpanningTreeSettings),
}
"""Methods that need the moving mesh alone."""


def chosen(segmentation: Segmentation) -> tuple[SegmentationName, MethodSettings]:
    """Return a method and its settings."""
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
    """Find the near-rigid part ``(F,)`` of every face, numbered by decreasing area: points ``(T, V, 3)`` in any unit.

    Parts are connected across edges. Without `parts` their number is automatic, at least one per component; "motion"
    may find fewer where little moves. Raises `SettingsError` for wrong settings, or `parts` below 1 or above F.
    """
    found = METHODS[chosen(method)[0]]
    if settings is not None and not isinstance(settings, found.settings):
        raise SettingsError(
            f"settings are {type(settings).__name__}; method {method!r} takes {found.settings.__name__}"
        )
    with one_blas_thread():
        return found.segment(points, topology, parts, settings)


def segment_by_labels(labels: ArrayLike, topology: Topology) -> NDArray[np.int64]:
    """Split face labels ``(F,)`` into connected parts ``(F,)``; raise `SegmentationError` if they do not fit."""
    given = np.asarray(labels)
    if given.shape != (len(topology.faces),) or not np.issubdtype(given.dtype, np.integer):
        raise SegmentationError(
            f"labels have shape {given.shape} and type {given.dtype}; "
            f"one whole number for each of the {len(topology.faces)} triangles is expected"
        )
    return split_labels(topology, given)
