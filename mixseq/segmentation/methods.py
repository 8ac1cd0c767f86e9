"""Cut a mesh into parts: by a method with a name, or by labels that somebody else made."""

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
"""A method by its name, or with settings of its own, which tell what method they are for."""


class Method(NamedTuple):
    """A way to find parts: a function of points, topology, number of parts and settings, and their type."""

    segment: Callable[[FloatArray, Topology, int | None, Any], Index]
    settings: type[MethodSettings]


METHODS: dict[SegmentationName, Method] = {
    "motion": Method(segment_by_motion, MotionSettings),
    "silhouettes": Method(segment_by_silhouettes, SilhouetteSettings),
    "spanning-tree": Method(segment_by_spanning_tree, SpanningTreeSettings),
}
"""The methods that need nothing but the moving mesh."""


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
    """Find the near-rigid parts of a moving mesh.

    Parameters
    ----------
    points : (T, V, 3) float
        The sequence; any unit.
    topology : Topology
        Its connectivity.
    method : {"motion", "silhouettes", "spanning-tree"}
        How: by rigid motion (ours, the default), by augmented silhouettes (Marras et al. 2012, the paper's choice), or
        by cutting a spanning tree (Wuhrer and Brunton 2010).
    parts : int, optional
        Number of parts; found automatically if not given. Every connected component has at least one. Where little
        moves, the motion method may find fewer than asked for.
    settings : MotionSettings, SilhouetteSettings or SpanningTreeSettings, optional
        Details of the method.

    Returns
    -------
    (F,) int64
        Part of every face, numbered 0, 1, ... by decreasing area. Parts are connected across edges.

    Raises
    ------
    SettingsError
        If there is no such method, the settings are another method's, or `parts` is below one or above the number of
        faces.
    """
    found = METHODS[chosen(method)[0]]
    if settings is not None and not isinstance(settings, found.settings):
        raise SettingsError(
            f"settings are {type(settings).__name__}; method {method!r} takes {found.settings.__name__}"
        )
    with one_blas_thread():
        return found.segment(points, topology, parts, settings)


def segment_by_labels(labels: ArrayLike, topology: Topology) -> NDArray[np.int64]:
    """Make a segmentation of given face labels: labels ``(F,)``; result ``(F,)``.

    Examples
    --------
    >>> strip = Topology(np.array([[0, 1, 2], [2, 1, 3], [2, 3, 4]]), 5)
    >>> segment_by_labels([7, 5, 7], strip).tolist()
    [1, 0, 2]
    """
    given = np.asarray(labels)
    if given.shape != (len(topology.faces),) or not np.issubdtype(given.dtype, np.integer):
        raise SegmentationError(
            f"labels have shape {given.shape} and type {given.dtype}; "
            f"one whole number for each of the {len(topology.faces)} triangles is expected"
        )
    return split_labels(topology, given)
