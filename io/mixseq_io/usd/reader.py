"""USD, reading: meshes over time, in world space (.usd, .usda, .usdc, .usdz).

Values come from the composed stage with references, layers, variants and value clips. Several meshes are joined. Points
are float32, as in USD. Frames are at all samples of points, transforms, skeletons and blend shapes that move a mesh,
interpolated by USD. Where more than points moves, points follow arcs, and gaps between samples are filled with the
frames of the stage's rate, as in `UsdSkel.BakeSkinning`.

Specification: https://openusd.org/release/api/class_usd_stage.html (time codes and frames per second)
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom

from mixseq.errors import FormatError, NoMeshError
from mixseq.mesh.surface import Origin
from mixseq.sequence.header import SequenceHeader
from mixseq.types import FloatArray
from mixseq_io.reader import SequenceReader, prefix_errors, warn
from mixseq_io.scene_meshes import (
    MAX_INSERTED_FRAMES,
    TIME_TOLERANCE,
    common_name,
    insert_times,
    join_meshes,
    merge_times,
    select_moving_meshes,
)
from mixseq_io.text.labels import Markings
from mixseq_io.usd.motion import AnimatedMesh, Mover, Pose, Skeleton, bound, skins_of
from mixseq_io.usd.rigs import skeleton_prim
from mixseq_io.usd.stage import (
    Notes,
    absolute,
    is_spline,
    meshes_of,
    open_stage,
    places_of,
    quiet,
    translate_usd_read_errors,
)
from mixseq_io.usd.surface import markings_of, scene_mesh_of


def open_usd(path: Path, prim: str | None = None) -> SequenceReader:
    """Open a USD file."""
    notes = Notes(path)
    with quiet() as reports, translate_usd_read_errors(path), prefix_errors(path):
        shot = _shot(path, open_stage(path), prim, notes)
        header = _header(path, shot, notes)
        speeds = [mesh.has_velocities(notes) for mesh in shot.meshes]
    # Missing layers and references may be irrelevant, so reading continues with a warning.
    if reports:
        warn(f"{path}: USD reports: {'; '.join(reports[:3])}")
    notes.warn()
    if any(speeds) and not all(speeds):
        warn(f"{path}: only some of its meshes have velocities; they are left out")
    return _UsdReader(path, header, shot, all(speeds))


def open_usd_bind_pose(path: Path, skeleton: str | None) -> SequenceReader:
    """Open the meshes of a skeleton in their bind pose; see `mixseq_io.read_bind_pose`."""
    notes = Notes(path)
    with quiet(), translate_usd_read_errors(path), prefix_errors(path):
        stage = open_stage(path)
        wanted = skeleton_prim(path, stage, skeleton)
        meshes = meshes_of(path, stage, None, notes)
        skins = skins_of(meshes, notes)
        movers = [Mover(mesh, skins.get(mesh.GetPath())) for mesh in meshes]
        movers = [each for each in movers if each.skin and each.skin.skeleton.prim == wanted]
        if not movers:
            raise NoMeshError(f"{path} has no mesh on {wanted.GetPath()}; export the character with its mesh")
        codes = np.array([stage.GetStartTimeCode()])
        shot = _Shot(stage, [AnimatedMesh(mover, codes) for mover in movers], codes, bound)
        return _UsdReader(path, _header(path, shot, notes), shot, moving=False)


@dataclass(frozen=True)
class _Shot:
    """Source of a sequence's frames."""

    stage: Usd.Stage
    meshes: Sequence[AnimatedMesh]
    codes: NDArray[np.float64]
    posed: Callable[[Skeleton, float], Pose] = Skeleton.pose

    def points(self, code: float) -> Iterator[FloatArray]:
        """Yield the points ``(V, 3)`` of each mesh at a time code; every skeleton is posed once."""
        skeletons = {mesh.mover.skin.skeleton for mesh in self.meshes if mesh.mover.skin}
        poses = {skeleton: self.posed(skeleton, code) for skeleton in skeletons}
        for mesh in self.meshes:
            skin = mesh.mover.skin
            yield mesh.points(code, poses[skin.skeleton] if skin else None)

    def velocities(self, code: float) -> Iterator[FloatArray]:
        """Yield the velocities ``(V, 3)`` of each mesh at a time code."""
        for mesh in self.meshes:
            yield mesh.velocities(code)


class _UsdReader(SequenceReader):
    def __init__(self, path: Path, header: SequenceHeader, shot: _Shot, moving: bool) -> None:
        super().__init__(path, header, has_velocities=moving)
        self._shot: _Shot | None = shot

    def markings(self) -> Markings:
        """Return the families of subsets and the joints of the meshes."""
        assert self._shot is not None, "the file is open"
        with quiet(), translate_usd_read_errors(self.path):
            return markings_of(self.header, self._shot.meshes)

    def close(self) -> None:
        """Release the stage."""
        super().close()
        self._shot = None

    def _read(self, what: str, size: int) -> Iterator[FloatArray]:
        shot = self._shot
        if shot is None:
            return
        values_at = shot.points if what == "points" else shot.velocities
        ends = np.cumsum([mesh.vertex_count for mesh in shot.meshes])
        for start in range(0, self.header.frame_count, size):
            stop = min(start + size, self.header.frame_count)
            block = np.empty((stop - start, self.header.vertex_count, 3), np.float32)
            with quiet(), translate_usd_read_errors(self.path):
                for frame, code in enumerate(shot.codes[start:stop].tolist(), start):
                    number = self.header.frame_number(frame)
                    with prefix_errors(f"{self.path}: frame {number} (time code {code:g})"):
                        for end, values in zip(ends, values_at(code), strict=True):
                            block[frame - start, end - len(values) : end] = values
            yield block


def _shot(path: Path, stage: Usd.Stage, prim: str | None, notes: Notes) -> _Shot:
    meshes = meshes_of(path, stage, prim, notes)
    skins = skins_of(meshes, notes)
    movers = [Mover(mesh, skins.get(mesh.GetPath())) for mesh in meshes]
    if prim is None:
        numbers = select_moving_meshes(path, places_of(meshes), [bool(mover.sources) for mover in movers])
        movers = [movers[i] for i in numbers]
    codes = _frame_codes(path, stage, movers)
    return _Shot(stage, [AnimatedMesh(mover, codes) for mover in movers], codes)


def _header(path: Path, shot: _Shot, notes: Notes) -> SequenceHeader:
    stage = shot.stage
    rate = stage.GetTimeCodesPerSecond()
    ends = np.cumsum([mesh.vertex_count for mesh in shot.meshes]).tolist()
    scene_meshes = [
        scene_mesh_of(mesh, end - mesh.vertex_count, shot.codes, notes)
        for mesh, end in zip(shot.meshes, ends, strict=True)
    ]
    polygons, surface = join_meshes(scene_meshes, Origin("USD", absolute(path)))
    return SequenceHeader(
        polygons=polygons,
        vertex_count=ends[-1],
        times=shot.codes / (rate if rate > 0 else 1.0),  # the header reports a rate that is none
        fps=rate,
        up_axis=str(UsdGeom.GetStageUpAxis(stage)),
        metres_per_unit=UsdGeom.GetStageMetersPerUnit(stage),
        name=common_name(places_of([each.mesh for each in shot.meshes])) or path.stem,
        surface=surface,
    )


def _frame_codes(path: Path, stage: Usd.Stage, movers: Sequence[Mover]) -> NDArray[np.float64]:
    """Return the time codes ``(T,)`` of the frames."""
    sources = list(dict.fromkeys(each for mover in movers for each in mover.sources))
    for each in sources:
        if is_spline(each):
            raise FormatError(f"{path}: {each.GetPath()} is a spline; bake it into time samples")
    channels = dict.fromkeys(tuple(each.GetTimeSamples()) for each in sources)
    codes = merge_times(map(np.array, channels), TIME_TOLERANCE * stage.GetTimeCodesPerSecond())
    if not codes.size:  # the time of the only sample of the points, if there is one
        return np.array(movers[0].mesh.GetPointsAttr().GetTimeSamples()[:1] or [0.0], dtype=np.float64)
    if all(mover.only_points_move for mover in movers):
        return codes
    played, step = _played(stage, codes[0], codes[-1])
    return insert_times(codes, played, step / 2)


def _played(stage: Usd.Stage, first: float, last: float) -> tuple[NDArray[np.float64], float]:
    """Return the time codes at the stage's frame rate from `first` to `last`, and their step."""
    start, rate = stage.GetStartTimeCode(), stage.GetFramesPerSecond()
    step = stage.GetTimeCodesPerSecond() / rate if rate else 0.0
    if not (stage.HasAuthoredTimeCodeRange() and np.isfinite(step) and step > 0 and np.isfinite(start)):
        return np.empty(0), 0.0
    begin = np.ceil((max(first, start) - start) / step)
    end = np.floor((min(last, stage.GetEndTimeCode()) - start) / step)
    if not end - begin < MAX_INSERTED_FRAMES:
        return np.empty(0), 0.0
    return start + np.arange(begin, end + 1) * step, step
