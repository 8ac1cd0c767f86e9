"""The mixed shape space S_m: rigid parts by their vertices and poses, joints by lengths and angles."""

from mixseq.spaces.mixed.construction import Purpose, mixed_space
from mixseq.spaces.mixed.mixed_space import MixedSpace, Projection, as_mixed

__all__ = ["MixedSpace", "Projection", "Purpose", "as_mixed", "mixed_space"]
