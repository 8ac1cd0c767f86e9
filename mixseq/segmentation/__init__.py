"""Cut a mesh into near-rigid parts and the joints between them."""

from mixseq.segmentation.joints import Decomposition, Joint, decompose
from mixseq.segmentation.methods import (
    METHODS,
    MethodSettings,
    Segmentation,
    chosen,
    segment,
    segment_by_labels,
)
from mixseq.segmentation.motion import MotionSettings, segment_by_motion
from mixseq.segmentation.observed import Observed, Watched, frames_to_look_at, gather, observe
from mixseq.segmentation.scores import adjusted_rand_index
from mixseq.segmentation.silhouettes import SilhouetteSettings, segment_by_silhouettes
from mixseq.segmentation.spanning_tree import SpanningTreeSettings, segment_by_spanning_tree

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
