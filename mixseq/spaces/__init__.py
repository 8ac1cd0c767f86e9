"""Shape spaces encode vertex positions as vectors that combine linearly, and decode vectors to positions.

`base` defines the contract, `making` makes spaces by name. `edge`, `gradient` and `lri` are spaces of whole
meshes; `mixed` is S_m, with parts and joints. `pieces` registers connected pieces, `temporal` interpolates poses.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mixseq.runtime.lazy import lazy_getattr

if TYPE_CHECKING:
    from mixseq.spaces.edge import EdgeSettings
    from mixseq.spaces.making import make_space
    from mixseq.spaces.mixed.construction import mixed_space
    from mixseq.spaces.mixed.mixed_space import MixedSpace

__all__ = ["EdgeSettings", "MixedSpace", "make_space", "mixed_space"]

__getattr__ = lazy_getattr(
    __name__,
    {
        "EdgeSettings": "mixseq.spaces.edge",
        "MixedSpace": "mixseq.spaces.mixed.mixed_space",
        "make_space": "mixseq.spaces.making",
        "mixed_space": "mixseq.spaces.mixed.construction",
    },
)
