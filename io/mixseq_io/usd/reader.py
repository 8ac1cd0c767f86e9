"""USD, reading: meshes over time, in world space (.usd, .usda, .usdc, .usdz).

Values come from the composed stage, so that references, layers, variants and value clips count. Several meshes are
joined; see `mixseq_io.usd.meshes` for which, `mixseq_io.usd.timing` for when, `mixseq_io.usd.motion` for where,
`mixseq_io.usd.skinning` for characters, and `mixseq_io.usd.surface` for what is on them. Points are float32, which is
USD's precision.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom

from mixseq.arrays import FloatArray
from mixseq.sequence import SequenceHeader
from mixseq.surface import Origin
from mixseq_io.blocks import warn
from mixseq_io.choosing import common_name, moving
from mixseq_io.labels.markings import Markings
from mixseq_io.reader import SequenceReader, naming
from mixseq_io.scene_meshes import join
from mixseq_io.usd.diagnostics import quiet, reading_usd
from mixseq_io.usd.markings import markings_of
from mixseq_io.usd.meshes import meshes_of, places_of
from mixseq_io.usd.motion import Mover, Track
from mixseq_io.usd.skinning import skins_of
from mixseq_io.usd.stage import Notes, absolute, open_stage
from mixseq_io.usd.surface import scene_mesh_of
from mixseq_io.usd.timing import frame_codes


def open_usd(path: Path, prim: str | None = None) -> SequenceReader:
    """Open a USD file.

    Parameters
    ----------
    path : Path
        The file.
    prim : str, optional
        Path of a mesh, or of a prim above meshes, or its name where no other prim has it: all meshes at or below it
        are read, ``/`` for all of the stage. By default those that move; all if none does.

    Raises
    ------
    AmbiguousError
        If several prims have the name `prim`.
    FormatError
        If there is no mesh, or its motion is a spline.
    InvalidSequenceError
        If the faces change over time.

    Warns
    -----
    MixseqWarning
        Of what cannot be read: meshes that stand still beside others that move, point instances, visibility that
        changes, holes, further texture coordinates, and what USD itself reports.
    """
    notes = Notes(path)
    with quiet() as reports, reading_usd(path), naming(path):
        shot = _shot(path, open_stage(path), prim, notes)
        header = _header(path, shot, notes)
        speeds = [track.has_velocities(notes) for track in shot.tracks]
    # What could not be found (a layer, a reference) may matter or not: reading goes on, but not in silence.
    if reports:
        warn(f"{path}: USD reports: {'; '.join(reports[:3])}")
    notes.warn()
    if any(speeds) and not all(speeds):
        warn(f"{path}: only some of its meshes have velocities; they are left out")
    return _UsdReader(path, header, shot, all(speeds))


@dataclass(frozen=True)
class _Shot:
    """Where the frames come from.

    Parameters
    ----------
    stage : Usd.Stage
        Held, because prims die with their stage.
    tracks : sequence of Track
        The meshes, in the order of their vertices.
    codes : (T,) float64
        Time codes of the frames.
    """

    stage: Usd.Stage
    tracks: Sequence[Track]
    codes: NDArray[np.float64]

    def points(self, code: float) -> Iterator[FloatArray]:
        """Yield the points of all meshes at a time code; every skeleton is posed once."""
        skeletons = {track.mover.skin.skeleton for track in self.tracks if track.mover.skin}
        poses = {skeleton: skeleton.pose(code) for skeleton in skeletons}
        for track in self.tracks:
            skin = track.mover.skin
            yield track.points(code, poses[skin.skeleton] if skin else None)

    def velocities(self, code: float) -> Iterator[FloatArray]:
        """Yield the velocities of all meshes at a time code."""
        for track in self.tracks:
            yield track.velocities(code)


class _UsdReader(SequenceReader):
    def __init__(self, path: Path, header: SequenceHeader, shot: _Shot, moving: bool) -> None:
        super().__init__(path, header, has_velocities=moving)
        self._shot: _Shot | None = shot

    def markings(self) -> Markings:
        """Return what tells parts of the meshes apart."""
        assert self._shot is not None, "the file is open"
        with quiet(), reading_usd(self.path):
            return markings_of(self.header, self._shot.tracks)

    def close(self) -> None:
        """Let the stage go."""
        super().close()
        self._shot = None

    def _read_blocks(self, size: int) -> Iterator[FloatArray]:
        return self._read(_Shot.points, size)

    def _read_velocities(self, size: int) -> Iterator[FloatArray]:
        return self._read(_Shot.velocities, size)

    def _read(
        self, values_of: Callable[[_Shot, float], Iterator[FloatArray]], size: int
    ) -> Iterator[FloatArray]:
        shot = self._shot
        if shot is None:
            return
        ends = np.cumsum([track.vertex_count for track in shot.tracks])
        for start in range(0, self.header.frame_count, size):
            stop = min(start + size, self.header.frame_count)
            block = np.empty((stop - start, self.header.vertex_count, 3), np.float32)
            with quiet(), reading_usd(self.path):
                for frame, code in enumerate(shot.codes[start:stop].tolist(), start):
                    with naming(f"{self.path}: frame {frame} (time code {code:g})"):
                        for end, values in zip(ends, values_of(shot, code), strict=True):
                            block[frame - start, end - len(values) : end] = values
            yield block


def _shot(path: Path, stage: Usd.Stage, prim: str | None, notes: Notes) -> _Shot:
    meshes = meshes_of(path, stage, prim, notes)
    skins = skins_of(meshes, notes)
    movers = [Mover(mesh, skins.get(mesh.GetPath())) for mesh in meshes]
    if prim is None:
        numbers = moving(path, places_of(meshes), [bool(mover.sources) for mover in movers])
        movers = [movers[i] for i in numbers]
    codes = frame_codes(path, stage, movers)
    return _Shot(stage, [Track(mover, codes) for mover in movers], codes)


def _header(path: Path, shot: _Shot, notes: Notes) -> SequenceHeader:
    stage = shot.stage
    rate = stage.GetTimeCodesPerSecond()
    ends = np.cumsum([track.vertex_count for track in shot.tracks]).tolist()
    scene_meshes = [
        scene_mesh_of(track, end - track.vertex_count, shot.codes, notes)
        for track, end in zip(shot.tracks, ends, strict=True)
    ]
    polygons, surface = join(path, scene_meshes, Origin("USD", absolute(path)))
    return SequenceHeader(
        polygons=polygons,
        vertex_count=ends[-1],
        times=shot.codes / (rate if rate > 0 else 1.0),  # the header reports a rate that is none
        fps=rate,
        up_axis=str(UsdGeom.GetStageUpAxis(stage)),
        metres_per_unit=UsdGeom.GetStageMetersPerUnit(stage),
        name=common_name(places_of([track.mesh for track in shot.tracks])) or path.stem,
        surface=surface,
    )
