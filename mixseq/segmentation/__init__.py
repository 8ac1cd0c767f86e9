"""Cutting a mesh into near-rigid parts and the joints between them."""

from mixseq.segmentation.given import segment_by_labels
from mixseq.segmentation.joints import Decomposition, Joint, decompose
from mixseq.segmentation.motion import MotionSettings, segment_by_motion
from mixseq.segmentation.observed import Observed, Watched, frames_to_look_at, gather, observe

__all__ = [
    "Decomposition",
    "Joint",
    "MotionSettings",
    "Observed",
    "Watched",
    "decompose",
    "frames_to_look_at",
    "gather",
    "observe",
    "segment_by_labels",
    "segment_by_motion",
]
