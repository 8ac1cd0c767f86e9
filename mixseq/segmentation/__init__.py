"""Cut a mesh into near-rigid parts and the joints between them.

`methods` finds parts on the `elements` of a mesh: by rigid `motion`, by `silhouettes` or a
spanning tree; a single frame is cut by its shape (`still`). `joints` adds the joints between parts.
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

_NAMES = {
    "joints": ("PartShapes", "decompose", "join_part_motion", "measure_part_motion", "sample_frame_ids"),
    "methods": ("METHODS", "segment", "segment_by_labels"),
    "motion": ("MotionSettings", "segment_by_motion"),
    "silhouettes": ("SilhouetteSettings", "SpanningTreeSettings"),
}
__getattr__ = lazy_getattr(
    __name__, {name: f"{__name__}.{module}" for module, names in _NAMES.items() for name in names}
)
