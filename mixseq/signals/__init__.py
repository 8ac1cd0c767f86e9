"""A sequence as signals over time in a shape space."""

from typing import TYPE_CHECKING

from mixseq.forwarding import forwarded

if TYPE_CHECKING:
    from mixseq.signals.curve import Curve
    from mixseq.signals.fitting import fit
    from mixseq.signals.model import Model
    from mixseq.signals.pose import PoseMap

__all__ = ["Curve", "Model", "PoseMap", "fit"]

__getattr__ = forwarded(
    __name__,
    {
        "Curve": "mixseq.signals.curve",
        "Model": "mixseq.signals.model",
        "PoseMap": "mixseq.signals.pose",
        "fit": "mixseq.signals.fitting",
    },
)
