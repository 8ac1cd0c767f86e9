"""Align source and target as a whole: by a rotation and a scale.

Motions are transferred by it: a map F of the source becomes :math:`G F G^T` of the target, and a shift d is s G d. The
scale is the ratio of radii, instead of that of least squares: with source and target exchanged it is the inverse.

With other proportions the best rotation is a little askew: a camel's neck and hump turn it eight degrees against a
horse beside it. So the nearest quarter turn (or none) is taken, unless it fits clearly worse.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

from mixseq.arrays import Float
from mixseq.errors import InvalidSequenceError
from mixseq.geometry.rigid import kabsch

ASKEW = 1.5
"""Largest ratio of distances of a quarter turn to those of the best rotation at which it is taken."""


ONE_PLACE = 1e-12
"""Extent of points, relative to their distance from the origin, below which they are one place."""


@dataclass(frozen=True, eq=False)
class Alignment:
    """A rotation G ``(3, 3)``, proper, and a scale s > 0."""

    rotation: Float
    scale: float

    def shifted(self, shifts: Float) -> Float:
        """Return shifts ``(..., 3)`` of the source in the frame and scale of the target."""
        return np.asarray(self.scale * shifts @ self.rotation.T)

    def turned_points(self, points: Float) -> Float:
        """Return points ``(..., 3)`` of the source rotated to the target."""
        return np.asarray(points @ self.rotation.T)

    def turned(self, matrices: Float) -> Float:
        """Return matrices ``(..., 3, 3)`` of the source as matrices of the target."""
        return np.asarray(self.rotation @ matrices @ self.rotation.T)


def align(source: Float, target: Float, weights: Float) -> Alignment:
    """Find the rotation and scale from source to target points ``(n, 3)`` with weights ``(n,)``."""
    if not weights.sum() > 0:
        raise InvalidSequenceError(
            "where the target corresponds to the source it has no area at rest, so that nothing tells how it moves; "
            "give a target with triangles that are not flat"
        )
    weights = weights / weights.sum()
    from_centre, to_centre = source - weights @ source, target - weights @ target
    radii = [np.sqrt(weights @ np.square(x).sum(axis=1)) for x in (from_centre, to_centre)]
    for name, radius, points in zip(("source", "target"), radii, (source, target), strict=True):
        if not radius > ONE_PLACE * np.abs(points).max():
            raise InvalidSequenceError(
                f"all that corresponds of the {name} is in one place at rest, so that it has no size; give another "
                "rest or another mesh"
            )
    scale = float(radii[1] / radii[0])
    best, _ = kabsch(from_centre, to_centre, weights)
    simple = max(_quarter_turns(), key=lambda turn: float(np.sum(turn * best)))
    away = [
        np.sqrt(weights @ np.square(to_centre - scale * from_centre @ turn.T).sum(axis=1))
        for turn in (best, simple)
    ]
    return Alignment(simple if away[1] <= ASKEW * away[0] else best, scale)


def _quarter_turns() -> list[Float]:
    """Return the 24 rotations that permute axes."""
    matrices = [
        np.array(signs)[:, None] * np.eye(3)[list(order)]
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    ]
    return [matrix for matrix in matrices if np.linalg.det(matrix) > 0]
