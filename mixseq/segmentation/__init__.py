"""Cut a mesh into near-rigid parts and the joints between them.

`methods` finds parts by `motion` or by `silhouettes` (and a spanning tree), on the `elements` of the mesh; `joints`
completes them to a decomposition.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mixseq.runtime.lazy import lazy_getattr

if TYPE_CHECKING:
    from mixseq.segmentation.joints import (
        PartShapes,
        decompose,
        join_part_motion,
        measure_part_motion,
        sample_frame_ids,
    )
    from mixseq.segmentation.methods import METHODS, segment, segment_by_labels
    from mixseq.segmentation.motion import MotionSettings, segment_by_motion
    from mixseq.segmentation.silhouettes import SilhouetteSettings, SpanningTreeSettings

__all__ = [
    "METHODS",
    "MotionSettings",
    "PartShapes",
    "SilhouetteSettings",
    "SpanningTreeSettings",
    "decompose",
    "join_part_motion",
    "measure_part_motion",
    "sample_frame_ids",
    "segment",
    "segment_by_labels",
    "segment_by_motion",
]

__getattr__ = lazy_getattr(
    __name__,
    {
        "METHODS": "mixseq.segmentation.methods",
        "MotionSettings": "mixseq.segmentation.motion",
        "SilhouetteSettings": "mixseq.segmentation.silhouettes",
        "SpanningTreeSettings": "mixseq.segmentation.silhouettes",
        "PartShapes": "mixseq.segmentation.joints",
        "decompose": "mixseq.segmentation.joints",
        "sample_frame_ids": "mixseq.segmentation.joints",
        "join_part_motion": "mixseq.segmentation.joints",
        "measure_part_motion": "mixseq.segmentation.joints",
        "segment": "mixseq.segmentation.methods",
        "segment_by_labels": "mixseq.segmentation.methods",
        "segment_by_motion": "mixseq.segmentation.motion",
    },
)
