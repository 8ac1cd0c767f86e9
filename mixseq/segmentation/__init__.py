"""Cut a mesh into near-rigid parts and the joints between them.

`methods` finds parts by `motion` or by `silhouettes` (and a spanning tree), on the `elements` of the mesh; `joints`
completes them to a decomposition.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mixseq.runtime.lazy import forwarded

if TYPE_CHECKING:
    from mixseq.segmentation.joints import Watched, decompose, frames_to_look_at, gather, observe
    from mixseq.segmentation.methods import METHODS, segment, segment_by_labels
    from mixseq.segmentation.motion import MotionSettings, segment_by_motion
    from mixseq.segmentation.silhouettes import SilhouetteSettings, SpanningTreeSettings

__all__ = [
    "METHODS",
    "MotionSettings",
    "SilhouetteSettings",
    "SpanningTreeSettings",
    "Watched",
    "decompose",
    "frames_to_look_at",
    "gather",
    "observe",
    "segment",
    "segment_by_labels",
    "segment_by_motion",
]

__getattr__ = forwarded(
    __name__,
    {
        "METHODS": "mixseq.segmentation.methods",
        "MotionSettings": "mixseq.segmentation.motion",
        "SilhouetteSettings": "mixseq.segmentation.silhouettes",
        "SpanningTreeSettings": "mixseq.segmentation.silhouettes",
        "Watched": "mixseq.segmentation.joints",
        "decompose": "mixseq.segmentation.joints",
        "frames_to_look_at": "mixseq.segmentation.joints",
        "gather": "mixseq.segmentation.joints",
        "observe": "mixseq.segmentation.joints",
        "segment": "mixseq.segmentation.methods",
        "segment_by_labels": "mixseq.segmentation.methods",
        "segment_by_motion": "mixseq.segmentation.motion",
    },
)
