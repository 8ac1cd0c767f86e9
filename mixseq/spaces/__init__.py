"""Shape spaces: encode vertex positions as vectors that combine linearly, decode vectors to positions."""

from mixseq.spaces.base import ShapeSpace
from mixseq.spaces.mixed import MixedSpace
from mixseq.spaces.of_sequence import mixed_space
from mixseq.spaces.vertex import VertexSpace

__all__ = ["MixedSpace", "ShapeSpace", "VertexSpace", "mixed_space"]
