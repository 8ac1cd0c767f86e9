"""A sequence as signals over time in a shape space."""

from mixseq.signals.fit import fit
from mixseq.signals.model import Model

__all__ = ["Model", "fit"]
