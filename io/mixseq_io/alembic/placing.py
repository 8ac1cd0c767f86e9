"""Where transforms place a mesh in every frame: from its own space to the world, and back, with velocities.

Points that are laid over an archive stay in the space of their mesh, below the transforms that the archive has there.
So what else hangs on these transforms stays where it was, and caches of other programs can be pointed at the result.
With p the own points and M the matrix of a frame, points of the world and their velocities are

    w = p M,    w' = p' M + p M'.

M' is taken over one frame, half before and half after, as renderers see a transform while the shutter is open.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Float, FloatArray
from mixseq.errors import FormatError
from mixseq_io.alembic.samples import Transforms, moved

_FLAT = 1e-12
"""Smallest determinant, relative to the cube of the largest scale, of a matrix that is inverted; the value is ours."""


@dataclass(frozen=True, eq=False)
class Placing:
    """The transforms above a mesh in every frame, and how fast they move."""

    matrices: Float
    rates: Float

    @classmethod
    def at(cls, above: tuple[Any, ...], frames: Float, fps: float) -> Placing:
        """Find transforms, the nearest to the mesh first, at the times of frames ``(T,)`` in seconds.

        Samples that no frame needs are not looked at, so that a copy without them tells the same.
        """
        window = float(frames[0]), float(frames[-1])
        now, before, after = (_matrices(above, frames + shift / fps, window) for shift in (0.0, -0.5, 0.5))
        return cls(now, (after - before) * fps)

    def check(self) -> None:
        """Check that nothing is made flat."""
        with np.errstate(all="ignore"):
            sizes = np.abs(np.linalg.det(self.matrices[:, :3, :3]))
            largest = np.abs(self.matrices[:, :3, :3]).max(axis=(1, 2))
        flat = ~(sizes > _FLAT * largest**3)
        if flat.any():
            raise FormatError(f"the transforms above it make it flat in frame {int(flat.argmax())}")

    def own_points(self, world: FloatArray, frame: int) -> NDArray[np.float32]:
        """Return points ``(V, 3)`` of a frame in the space of the mesh."""
        return moved(world, np.linalg.inv(self.matrices[frame]))

    def own_velocities(self, world: FloatArray, own_points: FloatArray, frame: int) -> NDArray[np.float32]:
        """Return velocities ``(V, 3)`` of a frame in the space of the mesh, where its points are `own_points`."""
        inverse = np.linalg.inv(self.matrices[frame])[:3, :3]
        return moved(world - self._carried(own_points, frame), inverse)

    def world_velocities(self, own: FloatArray, own_points: FloatArray, frame: int) -> NDArray[np.float32]:
        """Return the velocities of which `own_velocities` made its own."""
        turned = own.astype(np.float64) @ self.matrices[frame, :3, :3]
        return (turned + self._carried(own_points, frame)).astype(np.float32)

    def _carried(self, own_points: FloatArray, frame: int) -> Float:
        """Return how fast points that rest in the space of the mesh are in the world."""
        return own_points.astype(np.float64) @ self.rates[frame, :3, :3] + self.rates[frame, 3, :3]


def _matrices(above: tuple[Any, ...], frames: Float, window: tuple[float, float]) -> Float:
    transforms = Transforms.at(above, frames, window)
    if all(schema.isConstant() for schema in above):
        return np.broadcast_to(transforms.to_world(0), (len(frames), 4, 4))
    return np.stack([transforms.to_world(frame) for frame in range(len(frames))])
