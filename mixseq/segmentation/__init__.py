"""Cut a mesh into near-rigid parts and the joints between them.

Methods segment by motion, by a spanning tree of distances between parts, or by silhouettes of deformation
(`methods`); `joints` completes their labels to a decomposition.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mixseq.runtime.lazy import forwarded

if TYPE_CHECKING:
    from mixseq.segmentation.joints import (
        Decomposition,
        Joint,
        Observed,
        Watched,
        decompose,
        frames_to_look_at,
        gather,
        observe,
    )
    from mixseq.segmentation.methods import (
        METHODS,
        MethodSettings,
        Segmentation,
        adjusted_rand_index,
        chosen,
        segment,
        segment_by_labels,
    )
    from mixseq.segmentation.motion import MotionSettings, segment_by_motion
    from mixseq.segmentation.silhouettes import (
        SilhouetteSettings,
        SpanningTreeSettings,
        segment_by_silhouettes,
        segment_by_spanning_tree,
    )

__all__ = [
    "METHODS",
    "Decomposition",
    "Joint",
    "MethodSettings",
    "MotionSettings",
    "Observed",
    "Segmentation",
    "SilhouetteSettings",
    "SpanningTreeSettings",
    "Watched",
    "adjusted_rand_index",
    "chosen",
    "decompose",
    "frames_to_look_at",
    "gather",
    "observe",
    "segment",
    "segment_by_labels",
    "segment_by_motion",
    "segment_by_silhouettes",
    "segment_by_spanning_tree",
]

__getattr__ = forwarded(
    __name__,
    {
        "Decomposition": "mixseq.segmentation.joints",
        "Joint": "mixseq.segmentation.joints",
        "METHODS": "mixseq.segmentation.methods",
        "MethodSettings": "mixseq.segmentation.methods",
        "MotionSettings": "mixseq.segmentation.motion",
        "Observed": "mixseq.segmentation.joints",
        "Segmentation": "mixseq.segmentation.methods",
        "SilhouetteSettings": "mixseq.segmentation.silhouettes",
        "SpanningTreeSettings": "mixseq.segmentation.silhouettes",
        "Watched": "mixseq.segmentation.joints",
        "adjusted_rand_index": "mixseq.segmentation.methods",
        "chosen": "mixseq.segmentation.methods",
        "decompose": "mixseq.segmentation.joints",
        "frames_to_look_at": "mixseq.segmentation.joints",
        "gather": "mixseq.segmentation.joints",
        "observe": "mixseq.segmentation.joints",
        "segment": "mixseq.segmentation.methods",
        "segment_by_labels": "mixseq.segmentation.methods",
        "segment_by_motion": "mixseq.segmentation.motion",
        "segment_by_silhouettes": "mixseq.segmentation.silhouettes",
        "segment_by_spanning_tree": "mixseq.segmentation.silhouettes",
    },
)
