"""Placement of a mesh by its transforms in every frame: local to world and back, with velocities.

New points over an archive stay in mesh space, so that other children of its transforms keep their place, and caches of
other programs can refer to the result. With p the own points and M the matrix of a frame, world points and velocities
are

    w = p M,    w' = p' M + p M'.

M' is the central difference over one frame, as renderers see a transform while the shutter is open.
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
"""Smallest determinant of an inverted matrix, relative to the cube of the largest scale."""


@dataclass(frozen=True, eq=False)
class Placing:
    """Transforms above a mesh in every frame, and their rates."""

    matrices: Float
    rates: Float

    @classmethod
    def at(cls, above: tuple[Any, ...], frames: Float, fps: float) -> Placing:
        """Evaluate transforms, the nearest to the mesh first, at times of frames ``(T,)`` in seconds.

        Only samples that frames need are used, so that a copy without the others gives the same result.
        """
        window = float(frames[0]), float(frames[-1])
        now, before, after = (_matrices(above, frames + shift / fps, window) for shift in (0.0, -0.5, 0.5))
        return cls(now, (after - before) * fps)

    def check(self) -> None:
        """Raise an error if a frame's matrix is singular."""
        with np.errstate(all="ignore"):
            sizes = np.abs(np.linalg.det(self.matrices[:, :3, :3]))
            largest = np.abs(self.matrices[:, :3, :3]).max(axis=(1, 2))
        flat = ~(sizes > _FLAT * largest**3)
        if flat.any():
            raise FormatError(f"the transforms above it make it flat in frame {int(flat.argmax())}")

    def own_points(self, world: FloatArray, frame: int) -> NDArray[np.float32]:
        """Return a frame's points ``(V, 3)`` in mesh space."""
        return moved(world, np.linalg.inv(self.matrices[frame]))

    def own_velocities(self, world: FloatArray, own_points: FloatArray, frame: int) -> NDArray[np.float32]:
        """Return a frame's velocities ``(V, 3)`` in mesh space, given its points `own_points` there."""
        inverse = np.linalg.inv(self.matrices[frame])[:3, :3]
        return moved(world - self._carried(own_points, frame), inverse)

    def world_velocities(self, own: FloatArray, own_points: FloatArray, frame: int) -> NDArray[np.float32]:
        """Return the world velocities ``(V, 3)``, the inverse of `own_velocities`."""
        turned = own.astype(np.float64) @ self.matrices[frame, :3, :3]
        return (turned + self._carried(own_points, frame)).astype(np.float32)

    def _carried(self, own_points: FloatArray, frame: int) -> Float:
        """Return the world velocities ``(V, 3)`` of points at rest in mesh space."""
        return own_points.astype(np.float64) @ self.rates[frame, :3, :3] + self.rates[frame, 3, :3]


def _matrices(above: tuple[Any, ...], frames: Float, window: tuple[float, float]) -> Float:
    transforms = Transforms.at(above, frames, window)
    if all(schema.isConstant() for schema in above):
        return np.broadcast_to(transforms.to_world(0), (len(frames), 4, 4))
    return np.stack([transforms.to_world(frame) for frame in range(len(frames))])
