"""USD, motion: what moves a mesh, when, and where its points are in the world.

Frames are all times at which something that moves a mesh has a sample: its points, the transforms above it, its
skeleton, its blend shapes. Where one of them has none, USD interpolates. Between two samples of a rotation points
move on arcs, so where there is more than points that moves, the frames at which the stage is played are added in the
gaps between samples, as `UsdSkel.BakeSkinning` does.

Specifications: https://openusd.org/release/api/class_usd_geom_xformable.html,
https://openusd.org/release/api/class_usd_geom_point_based.html (velocities)
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Usd, UsdGeom, Vt

from mixseq.errors import FormatError, InvalidSequenceError
from mixseq_io.usd.skinning import Pose, Skin
from mixseq_io.usd.stage import Notes, lineage

_SAME_TIME = 1e-6
"""Samples of different attributes that are closer than this, in seconds, make one frame."""

_MOST_PLAYED = 100_000
"""More frames than this are not added between samples; an hour has 86 400 at 24 frames per second."""


def local_to_world(prim: Usd.Prim, code: float) -> NDArray[np.float64]:
    """Return the transform (4, 4) from a prim's space to the world at a time code, for rows: p' = p M."""
    return np.array(_to_world(prim, code), dtype=np.float64)


def _to_world(prim: Usd.Prim, code: float) -> Gf.Matrix4d:
    return UsdGeom.XformCache(Usd.TimeCode(code)).GetLocalToWorldTransform(prim)


@dataclass(frozen=True, eq=False)
class Mover:
    """A mesh and what moves it.

    Parameters
    ----------
    mesh : UsdGeom.Mesh
        The mesh.
    skin : Skin or None
        Its skeleton and blend shapes.
    """

    mesh: UsdGeom.Mesh
    skin: Skin | None

    @cached_property
    def space(self) -> Usd.Prim:
        """The prim in whose space the points are: the skeleton's, if joints move them."""
        return self.skin.skeleton.prim if self.skin and self.skin.has_joints else self.mesh.GetPrim()

    @cached_property
    def sources(self) -> tuple[Usd.Attribute, ...]:
        """The attributes that change over time and move it. A single sample holds at all times."""
        deforming = self.skin.attributes() if self.skin else ()
        every = (self.mesh.GetPointsAttr(), *_transform_attributes(self.space), *deforming)
        return tuple(each for each in every if each.GetNumTimeSamples() > 1 or _is_spline(each))

    @property
    def only_points_move(self) -> bool:
        """Whether no transform, skeleton or blend shape moves it."""
        return all(each == self.mesh.GetPointsAttr() for each in self.sources)


@dataclass(frozen=True, eq=False)
class Track:
    """A mesh over the frames of a sequence.

    Parameters
    ----------
    mover : Mover
        The mesh.
    start : float
        Time code of the first frame.
    """

    mover: Mover
    start: float

    @property
    def mesh(self) -> UsdGeom.Mesh:
        """The mesh."""
        return self.mover.mesh

    @cached_property
    def vertex_count(self) -> int:
        """Number of vertices, in the first frame and to be in all others."""
        value = self.mesh.GetPointsAttr().Get(Usd.TimeCode(self.start))
        return 0 if value is None else len(value)

    @cached_property
    def _first_determinant(self) -> float:
        return _to_world(self.mover.space, self.start).GetDeterminant3()

    @property
    def mirrored(self) -> bool:
        """Whether the way to the world turns left into right."""
        skin = self.mover.skin
        bind = skin.bind_transform(self.start).GetDeterminant3() if skin and skin.has_joints else 1.0
        return bool(self._first_determinant * bind < 0)

    def points(self, code: float, pose: Pose | None) -> NDArray[np.float32]:
        """Return the points (V, 3) in the world at a time code, the skeleton being in a pose.

        Raises
        ------
        InvalidSequenceError
            If there are others than in the first frame, or the transform mirrors otherwise than there; in words
            that follow the number of the frame.
        """
        path = self.mesh.GetPath()
        value = self.mesh.GetPointsAttr().Get(Usd.TimeCode(code))
        if value is None:
            raise InvalidSequenceError(f"{path} has no points")
        if len(value) != self.vertex_count:
            raise InvalidSequenceError(
                f"{path} has {len(value)} points, the first frame {self.vertex_count}; every frame needs the same "
                "vertices in the same order"
            )
        if self.mover.skin and pose:
            value = self.mover.skin.deformed(value, pose, code)
        matrix = _to_world(self.mover.space, code)
        if matrix.GetDeterminant3() * self._first_determinant < 0:
            raise InvalidSequenceError(
                f"the transform of {path} mirrors it relative to the first frame, which turns its faces inside "
                "out; give the animated scale one sign"
            )
        return _placed(value, matrix, 1.0)

    def velocities(self, code: float) -> NDArray[np.float32]:
        """Return the velocities (V, 3) in the world, in units per second.

        Raises
        ------
        InvalidSequenceError
            If there are more or fewer than points.
        """
        value = self.mesh.GetVelocitiesAttr().Get(Usd.TimeCode(code))
        if value is None or len(value) != self.vertex_count:
            raise InvalidSequenceError(
                f"{self.mesh.GetPath()} has {len(value or ())} velocities for {self.vertex_count} points; give as many"
            )
        return _placed(value, _to_world(self.mover.space, code), 0.0)

    def has_velocities(self, notes: Notes) -> bool:
        """Whether velocities can be read; those that cannot are noted."""
        velocities = self.mesh.GetVelocitiesAttr()
        if not velocities.HasAuthoredValue():
            return False
        first = velocities.Get(Usd.TimeCode(self.start))
        if velocities.GetTimeSamples() != self.mesh.GetPointsAttr().GetTimeSamples():
            problem = "are not sampled at the times of the points"
        elif len(first or ()) != self.vertex_count:
            problem = f"are {len(first or ())} for {self.vertex_count} points"
        elif self.mover.skin or not self.mover.only_points_move:
            problem = "are those under a transform or a skeleton that moves, too"
        else:
            return True
        notes.add(self.mesh.GetPrim(), f"velocities {problem}; they are left out")
        return False


def frame_codes(path: Path, stage: Usd.Stage, movers: Sequence[Mover]) -> NDArray[np.float64]:
    """Return the time codes (T,) of the frames in which all meshes are to be read.

    Parameters
    ----------
    path : Path
        The file.
    stage : Usd.Stage
        The stage.
    movers : sequence of Mover
        The meshes.

    Raises
    ------
    FormatError
        If something moves by a spline.
    """
    sources = list(dict.fromkeys(each for mover in movers for each in mover.sources))
    for each in sources:
        if _is_spline(each):
            raise FormatError(f"{path}: {each.GetPath()} is a spline; bake it into time samples")
    codes = np.empty(0)
    for samples in dict.fromkeys(tuple(each.GetTimeSamples()) for each in sources):
        codes = _united(codes, np.array(samples), _SAME_TIME * stage.GetTimeCodesPerSecond())
    if not codes.size:  # the time of the only sample of the points, if there is one
        return np.array(movers[0].mesh.GetPointsAttr().GetTimeSamples()[:1] or [0.0], dtype=np.float64)
    if all(mover.only_points_move for mover in movers):
        return codes
    played, step = _played(stage, codes[0], codes[-1])
    return _united(codes, played, step / 2)


def _played(stage: Usd.Stage, first: float, last: float) -> tuple[NDArray[np.float64], float]:
    """Return the time codes at which the stage is played, from `first` to `last`, and the step between them."""
    start, rate = stage.GetStartTimeCode(), stage.GetFramesPerSecond()
    step = stage.GetTimeCodesPerSecond() / rate if rate else 0.0
    if not (stage.HasAuthoredTimeCodeRange() and np.isfinite(step) and step > 0 and np.isfinite(start)):
        return np.empty(0), 0.0
    begin = np.ceil((max(first, start) - start) / step)
    end = np.floor((min(last, stage.GetEndTimeCode()) - start) / step)
    if not end - begin < _MOST_PLAYED:
        return np.empty(0), 0.0
    return start + np.arange(begin, end + 1) * step, step


def _united(codes: NDArray[np.float64], more: NDArray[np.float64], tolerance: float) -> NDArray[np.float64]:
    """Return both, sorted, without those of `more` that are as good as one of `codes`.

    Examples
    --------
    >>> _united(np.array([1.0, 2.0]), np.array([1.5, 2.0 + 1e-9]), 1e-6).tolist()
    [1.0, 1.5, 2.0]
    """
    if not codes.size:
        return more
    after = np.minimum(np.searchsorted(codes, more), len(codes) - 1)
    near = (
        np.minimum(np.abs(codes[after] - more), np.abs(codes[np.maximum(after - 1, 0)] - more)) <= tolerance
    )
    return np.union1d(codes, more[~near])


def _transform_attributes(prim: Usd.Prim) -> Iterator[Usd.Attribute]:
    """Yield the attributes that the local-to-world transform depends on."""
    for each in lineage(prim):
        xformable = UsdGeom.Xformable(each)
        if xformable:
            yield from (operation.GetAttr() for operation in xformable.GetOrderedXformOps())
            if xformable.GetResetXformStack():
                return


def _is_spline(attribute: Usd.Attribute) -> bool:
    return bool(attribute.ValueMightBeTimeVarying()) and not attribute.GetNumTimeSamples()


def _placed(value: Vt.Vec3fArray, to_world: Gf.Matrix4d, weight: float) -> NDArray[np.float32]:
    """Return points (weight 1), or vectors (weight 0), in the world."""
    rows = np.array(value, dtype=np.float32).reshape(-1, 3)
    if to_world == Gf.Matrix4d(1.0):
        return rows
    matrix = np.array(to_world, dtype=np.float64)
    with np.errstate(all="ignore"):  # what overflows is reported by the reader, with its vertex
        return np.asarray(rows @ matrix[:3, :3] + weight * matrix[3, :3], dtype=np.float32)
