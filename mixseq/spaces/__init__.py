"""Shape spaces: encode vertex positions as vectors that combine linearly, decode vectors to positions.

`base` is the contract. `vertex`, `edge`, `gradient` and `lri` are spaces of whole meshes; `mixed` is S_m, of parts
and joints, on `pieces` that are registered and the `temporal` interpolation of their poses. `making` builds each by
name.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mixseq.runtime.lazy import forwarded

if TYPE_CHECKING:
    from mixseq.choices import SPACES, SpaceName
    from mixseq.spaces.base import ShapeSpace
    from mixseq.spaces.edge import EdgeSettings, EdgeSpace
    from mixseq.spaces.gradient import GradientSpace
    from mixseq.spaces.lri import LRISpace
    from mixseq.spaces.making import MixedSettings, NoSettings, SpaceSettings, make_space, space_settings
    from mixseq.spaces.mixed.construction import mixed_space
    from mixseq.spaces.mixed.mixed_space import MixedSpace, Projection
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
        "EdgeSettings": "mixseq.spaces.edge",
        "EdgeSpace": "mixseq.spaces.edge",
        "GradientSpace": "mixseq.spaces.gradient",
        "LRISpace": "mixseq.spaces.lri",
        "MixedSettings": "mixseq.spaces.making",
        "MixedSpace": "mixseq.spaces.mixed.mixed_space",
        "NoSettings": "mixseq.spaces.making",
        "Projection": "mixseq.spaces.mixed.mixed_space",
        "SPACES": "mixseq.choices",
        "ShapeSpace": "mixseq.spaces.base",
        "SpaceName": "mixseq.choices",
        "SpaceSettings": "mixseq.spaces.making",
        "VertexSpace": "mixseq.spaces.vertex",
        "make_space": "mixseq.spaces.making",
        "mixed_space": "mixseq.spaces.mixed.construction",
        "space_settings": "mixseq.spaces.making",
    },
)
