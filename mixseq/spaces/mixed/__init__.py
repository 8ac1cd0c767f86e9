"""The mixed shape space S_m: rigid parts by their vertices, joints by lengths and angles, and poses."""

from mixseq.spaces.mixed.anchored import AnchoredSpace
from mixseq.spaces.mixed.construction import FAR, NEVER, mixed_space
from mixseq.spaces.mixed.free import FreeSpace
from mixseq.spaces.mixed.mixed_space import MixedSpace

__all__ = [
    "FAR",
    "NEVER",
    "AnchoredSpace",
    "FreeSpace",
    "MixedSpace",
    "mixed_space",
]
