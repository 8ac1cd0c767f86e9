"""Shape spaces: encode vertex positions as vectors that combine linearly, decode vectors to positions."""

from mixseq.spaces.base import ShapeSpace
from mixseq.spaces.mixed import MixedSpace, mixed_space

__all__ = ["MixedSpace", "ShapeSpace", "mixed_space"]
