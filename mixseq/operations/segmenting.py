"""The parts of a sequence, by any method."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mixseq import segmentation
from mixseq.choices import SegmentationName
from mixseq.public import public
from mixseq.segmentation import MethodSettings
from mixseq.sequence import MeshSequence, check_frames
from mixseq.topology import Topology


@public
def segment(
    sequence: MeshSequence,
    method: SegmentationName = "motion",
    parts: int | None = None,
    settings: MethodSettings | None = None,
) -> NDArray[np.int64]:
    """Find the near-rigid parts of a sequence, as labels that `mixseq.fit` takes as its `parts`.

    Parameters
    ----------
    sequence : MeshSequence
        The animation, or poses of one mesh.
    method : {"motion", "silhouettes", "spanning-tree"}
        By rigid motion (the default), by augmented silhouettes (Marras et al. 2012), or by cutting a spanning tree
        (Wuhrer and Brunton 2010).
    parts : int, optional
        Number of parts, by default automatic. Every connected component has at least one. Where little moves, the
        motion method may find fewer.
    settings : MotionSettings, SilhouetteSettings or SpanningTreeSettings, optional
        Details of the method.

    Returns
    -------
    (F,) int64
        Part of every triangle, numbered from 0 by decreasing area. Parts are connected across edges.

    Raises
    ------
    InvalidSequenceError
        If the argument is no sequence.
    SettingsError
        If there is no such method, the settings are another method's, or `parts` is out of range.
    """
    check_frames(sequence)
    topology = Topology(sequence.faces, sequence.vertex_count)
    return segmentation.segment(sequence.points, topology, method, parts, settings)
