"""Segmentation by labels that somebody else made."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mixseq.errors import SegmentationError
from mixseq.topology import Topology, split_labels


def segment_by_labels(labels: ArrayLike, topology: Topology) -> NDArray[np.int64]:
    """Make a segmentation of given face labels.

    Parameters
    ----------
    labels : (F,) int array_like
        Any number for every face; equal numbers are one part, or several where they are not connected.
    topology : Topology
        Connectivity of the mesh.

    Returns
    -------
    (F,) int64
        Part of every face, numbered 0, 1, ...; parts are connected across edges.

    Raises
    ------
    SegmentationError
        If there is not one whole number per face.

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
