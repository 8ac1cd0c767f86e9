"""A sequence as signals over time in a shape space."""

from mixseq.signals.curve import Curve
from mixseq.signals.fit import fit
from mixseq.signals.model import Model
from mixseq.signals.pose import PoseMap

__all__ = ["Curve", "Model", "PoseMap", "fit"]
