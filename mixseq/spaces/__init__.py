"""Shape spaces: encode vertex positions as vectors that combine linearly, decode vectors to positions."""

from typing import TYPE_CHECKING

from mixseq.choices import SPACES, SpaceName
from mixseq.forwarding import forwarded

if TYPE_CHECKING:
    from mixseq.spaces.base import ShapeSpace
    from mixseq.spaces.edge.edge_space import EdgeSettings, EdgeSpace
    from mixseq.spaces.gradient import GradientSpace
    from mixseq.spaces.lri import LRISpace
    from mixseq.spaces.making import MixedSettings, NoSettings, SpaceSettings, make_space, space_settings
    from mixseq.spaces.mixed import MixedSpace, Projection, mixed_space
    from mixseq.spaces.vertex import VertexSpace

__all__ = [
    "SPACES",
    "EdgeSettings",
    "EdgeSpace",
    "GradientSpace",
    "LRISpace",
    "MixedSettings",
    "MixedSpace",
    "NoSettings",
    "Projection",
    "ShapeSpace",
    "SpaceName",
    "SpaceSettings",
    "VertexSpace",
    "make_space",
    "mixed_space",
    "space_settings",
]

__getattr__ = forwarded(
    __name__,
    {
        "EdgeSettings": "mixseq.spaces.edge.edge_space",
        "EdgeSpace": "mixseq.spaces.edge.edge_space",
        "GradientSpace": "mixseq.spaces.gradient",
        "LRISpace": "mixseq.spaces.lri",
        "MixedSettings": "mixseq.spaces.making",
        "MixedSpace": "mixseq.spaces.mixed",
        "NoSettings": "mixseq.spaces.making",
        "Projection": "mixseq.spaces.mixed",
        "ShapeSpace": "mixseq.spaces.base",
        "SpaceSettings": "mixseq.spaces.making",
        "VertexSpace": "mixseq.spaces.vertex",
        "make_space": "mixseq.spaces.making",
        "mixed_space": "mixseq.spaces.mixed",
        "space_settings": "mixseq.spaces.making",
    },
)
