"""What the camera of a page must know of a moving mesh: where it is, and what it covers on the screen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mixseq.arrays import Float, FloatArray
from mixseq.plots.camera import View


@dataclass(frozen=True, eq=False)
class Extent:
    """Where a mesh is in all its poses, Y up.

    Attributes
    ----------
    low, high : (3,) float
        Corners of its bounding box.
    seen : (views, 5) float
        Left, right, bottom and top on the screen of each view, whose middle is the origin of space, and the bottom of
        what is at height zero below the mesh.
    """

    low: Float
    high: Float
    seen: Float

    @property
    def centre(self) -> Float:
        """Middle of the bounding box."""
        return np.asarray((self.low + self.high) / 2)

    @property
    def side(self) -> float:
        """Longest side of the bounding box."""
        return float((self.high - self.low).max())

    def joined(self, other: Extent | None) -> Extent:
        """Return what holds both."""
        if other is None:
            return self
        low, high = np.minimum(self.low, other.low), np.maximum(self.high, other.high)
        nearer, farther = np.minimum(self.seen, other.seen), np.maximum(self.seen, other.seen)
        return Extent(low, high, np.where([True, False, True, False, True], nearer, farther))

    def rectangles(self, views: Sequence[View]) -> Float:
        """Return left, right, bottom and top ``(views, 4)`` of the mesh and of its shadow on the ground."""
        floors = [
            view.rows[1, 1] * self.low[1] + seen[4] for view, seen in zip(views, self.seen, strict=True)
        ]
        left, right, bottom, top, _ = self.seen.T
        return np.stack([left, right, np.minimum(bottom, floors), top], axis=1)


def extent_of(world: FloatArray, views: Sequence[View]) -> Extent:
    """Return the extent of poses ``(B, V, 3)``, Y up, in some views."""
    seen = []
    for view in views:
        right, up, _ = view.rows
        # sums in a fixed order: a page has the same bytes on every machine
        x, y, z = world[..., 0], world[..., 1], world[..., 2]
        across, flat = x * right[0] + z * right[2], x * up[0] + z * up[2]
        above = flat + y * up[1]
        seen.append([across.min(), across.max(), above.min(), above.max(), flat.min()])
    return Extent(world.min(axis=(0, 1)), world.max(axis=(0, 1)), np.array(seen))
