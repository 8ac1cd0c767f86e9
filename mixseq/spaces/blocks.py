"""What the numbers of a vector of S_m are."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixseq.reconstruction.links import Poses

Float = NDArray[np.float64]


class MixedBlocks(NamedTuple):
    """The blocks of T vectors of S_m: p parts with N vertices in all, g poses, n links.

    Attributes
    ----------
    lengths : (T, E')
        Edge lengths, joint by joint.
    angles : (T, H')
        Hinge angles in radians, joint by joint, unwrapped.
    parts : (T, N, 3)
        Vertices of the parts, aligned to their mean shapes, part by part.
    rotations : (T, g, 3)
        Rotation vectors from the mean shape to the frame, unwrapped.
    translations : (T, g, 3)
        Where the centre of the mean shape goes.
    turns : (T, n, 3)
        Rotation vectors between linked parts, from their mean, unwrapped.
    gaps : (T, n, 3)
        Gaps at the pivots of the links.
    """

    lengths: Float
    angles: Float
    parts: Float
    rotations: Float
    translations: Float
    turns: Float
    gaps: Float

    @property
    def poses(self) -> Poses:
        """What says where parts are."""
        return Poses(self.rotations, self.translations, self.turns, self.gaps)
