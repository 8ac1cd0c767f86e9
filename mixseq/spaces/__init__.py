"""Shape spaces: encode vertex positions as vectors that combine linearly, decode vectors to positions."""

from mixseq.choices import SPACES, SpaceName
from mixseq.spaces.base import ShapeSpace
from mixseq.spaces.edge.edge_space import EdgeSettings, EdgeSpace
from mixseq.spaces.gradient import GradientSpace
from mixseq.spaces.lri import LRISpace
from mixseq.spaces.making import MixedSettings, NoSettings, SpaceSettings, make_space, space_settings
from mixseq.spaces.mixed import AnchoredSpace, FreeSpace, MixedSpace, mixed_space
from mixseq.spaces.vertex import VertexSpace

__all__ = [
    "SPACES",
    "AnchoredSpace",
    "EdgeSettings",
    "EdgeSpace",
    "FreeSpace",
    "GradientSpace",
    "LRISpace",
    "MixedSettings",
    "MixedSpace",
    "NoSettings",
    "ShapeSpace",
    "SpaceName",
    "SpaceSettings",
    "VertexSpace",
    "make_space",
    "mixed_space",
    "space_settings",
]
