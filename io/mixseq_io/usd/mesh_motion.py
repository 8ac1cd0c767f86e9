"""USD, motion: sources of a mesh's motion, and its points in world space.

Specification: https://openusd.org/release/api/class_usd_geom_point_based.html (velocities)
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Usd, UsdGeom, Vt

from mixseq.errors import InvalidSequenceError
from mixseq_io.usd.prims import Notes
from mixseq_io.usd.seams import Weld, weld
from mixseq_io.usd.skeletons import Pose, Skin
from mixseq_io.usd.transforms import Placement, varies


@dataclass(frozen=True, eq=False)
class Mover:
    """Mesh and its sources of motion."""

    mesh: UsdGeom.Mesh
    skin: Skin | None

    @cached_property
    def placement(self) -> Placement:
        """Placement of the points' space: the skeleton's if joints move them, else the mesh's."""
        return Placement(
            self.skin.skeleton.prim if self.skin and self.skin.has_joints else self.mesh.GetPrim()
        )

    @cached_property
    def sources(self) -> tuple[Usd.Attribute, ...]:
        """Attributes that move the mesh over time."""
        deforming = self.skin.attributes() if self.skin else ()
        transforms = (each.GetAttr() for each in self.placement.operations)
        every = (self.mesh.GetPointsAttr(), *transforms, *deforming)
        return tuple(each for each in every if varies(each))

    @property
    def only_points_move(self) -> bool:
        """Whether neither transforms nor skeletons nor blend shapes move the mesh."""
        return all(each == self.mesh.GetPointsAttr() for each in self.sources)


@dataclass(frozen=True, eq=False)
class AnimatedMesh:
    """Mesh over the frames of a sequence."""

    mover: Mover
    codes: NDArray[np.float64]

    @property
    def start(self) -> float:
        """Time code of the first frame."""
        return float(self.codes[0])

    @property
    def mesh(self) -> UsdGeom.Mesh:
        """The mesh."""
        return self.mover.mesh

    @cached_property
    def weld(self) -> Weld:
        """Map of points to vertices, from the first frame, for all frames."""
        value = self.mesh.GetPointsAttr().Get(Usd.TimeCode(self.start))
        return weld(self.mesh, np.array(value or (), dtype=np.float32).reshape(-1, 3))

    @property
    def point_count(self) -> int:
        """Number of points."""
        return len(self.weld.of_point)

    @property
    def vertex_count(self) -> int:
        """Number of vertices."""
        return self.weld.vertex_count

    @cached_property
    def _first_determinant(self) -> float:
        """Determinant in the first frame with a nonzero one, since objects may appear by scaling up from zero."""
        every = (self.mover.placement.to_world(code).GetDeterminant3() for code in self.codes.tolist())
        return next((each for each in every if each), 1.0)

    @property
    def mirrored(self) -> bool:
        """Whether the transform to the world mirrors."""
        skin = self.mover.skin
        bind = skin.bind_transform(self.start).GetDeterminant3() if skin and skin.has_joints else 1.0
        return bool(self._first_determinant * bind < 0)

    def points(self, code: float, pose: Pose | None) -> NDArray[np.float32]:
        """Return the vertices ``(V, 3)`` in world space at a time code, with the skeleton in a pose."""
        path = self.mesh.GetPath()
        value = self.mesh.GetPointsAttr().Get(Usd.TimeCode(code))
        if value is None:
            raise InvalidSequenceError(f"{path} has no points")
        if len(value) != self.point_count:
            raise InvalidSequenceError(
                f"{path} has {len(value)} points, the first frame {self.point_count}; every frame needs the same "
                "vertices in the same order"
            )
        if self.mover.skin and pose:
            value = self.mover.skin.deformed(value, pose, code)
        matrix = self.mover.placement.to_world(code)
        if matrix.GetDeterminant3() * self._first_determinant < 0:
            raise InvalidSequenceError(
                f"the transform of {path} mirrors it relative to earlier frames, which turns its faces inside "
                "out; give the animated scale one sign"
            )
        return _placed(value, matrix, 1.0)[self.weld.representatives]

    def velocities(self, code: float) -> NDArray[np.float32]:
        """Return the velocities ``(V, 3)`` in world space, in units per second."""
        value = self.mesh.GetVelocitiesAttr().Get(Usd.TimeCode(code))
        if value is None or len(value) != self.point_count:
            raise InvalidSequenceError(
                f"{self.mesh.GetPath()} has {len(value or ())} velocities for {self.point_count} points; give as many"
            )
        return _placed(value, self.mover.placement.to_world(code), 0.0)[self.weld.representatives]

    def has_velocities(self, notes: Notes) -> bool:
        """Whether velocities can be read; problems are noted."""
        velocities = self.mesh.GetVelocitiesAttr()
        if not velocities.HasAuthoredValue():
            return False
        first = velocities.Get(Usd.TimeCode(self.start))
        if velocities.GetTimeSamples() != self.mesh.GetPointsAttr().GetTimeSamples():
            problem = "are not sampled at the times of the points"
        elif len(first or ()) != self.point_count:
            problem = f"are {len(first or ())} for {self.point_count} points"
        elif self.mover.skin or not self.mover.only_points_move:
            problem = "are those under a transform or a skeleton that moves, too"
        else:
            return True
        notes.add(self.mesh.GetPrim(), f"velocities {problem}; they are left out")
        return False


def _placed(value: Vt.Vec3fArray, to_world: Gf.Matrix4d, weight: float) -> NDArray[np.float32]:
    """Return points (weight 1) or vectors (weight 0) ``(n, 3)`` in world space."""
    rows = np.array(value, dtype=np.float32).reshape(-1, 3)
    if to_world == Gf.Matrix4d(1.0):
        return rows
    matrix = np.array(to_world, dtype=np.float64)
    with np.errstate(all="ignore"):  # overflow is reported by the reader, with its vertex
        return np.asarray(rows @ matrix[:3, :3] + weight * matrix[3, :3], dtype=np.float32)
