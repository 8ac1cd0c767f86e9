"""Where a joint's free vertices would be if they followed the parts around them.

Linear blend skinning from a reference frame: every free vertex moves with all parts that hold fixed vertices of
its joint, with harmonic weights (1 at the vertices of a part, 0 at those of the others, smooth in between). Close
to the reference this is a start without folds, where lengths and angles between two frames do not fit together.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mixseq.arrays import Float, Index
from mixseq.shells.patch import Patch


@dataclass(frozen=True, eq=False)
class Blend:
    """How the free vertices of a joint follow its parts.

    Attributes
    ----------
    parts : (k,) int64
        Parts that hold fixed vertices of the joint.
    weights : (f, k) float64
        Weights of the free vertices; rows add up to one.
    rest : (f, 3) float64
        The free vertices in the reference frame.
    """

    parts: Index
    weights: Float
    rest: Float

    @classmethod
    def of(cls, patch: Patch, owner: Index, rest: Float) -> Blend:
        """Find the weights of a patch.

        Parameters
        ----------
        patch : Patch
            The joint.
        owner : (n,) int64
            Part that holds each vertex, looked at where the vertex is fixed.
        rest : (n, 3) float64
            The joint in the reference frame.
        """
        parts, number = np.unique(owner[patch.fixed], return_inverse=True)
        boundary = np.eye(len(parts))[number.reshape(-1)]
        coupling = patch.laplacian[patch.free][:, patch.fixed]
        return cls(parts, -patch.laplacian_factor.solve(coupling @ boundary), rest[patch.free])

    def place(self, rotations: Float, translations: Float) -> Float:
        """Move the free vertices ``(f, 3)`` with motions ``x -> R x + t`` of all parts from the reference frame."""
        moved = np.einsum("kij,fj->fki", rotations[self.parts], self.rest) + translations[self.parts]
        return np.asarray(np.einsum("fk,fki->fi", self.weights, moved))

    @cached_property
    def nearest(self) -> Index:
        """Part ``(f,)`` that every free vertex follows most."""
        return np.asarray(self.parts[self.weights.argmax(axis=1)])
