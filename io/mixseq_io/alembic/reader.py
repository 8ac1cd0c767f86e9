"""Alembic, reading: points of an archive's meshes over time, in world space (.abc).

Frames are at all samples of the points and of the transforms above, others interpolated linearly; at the points' times
only where mixseq laid them over an archive. Points are float32, as in Alembic, which has no units and no up axis: tools
assume Y up.

Specification: https://docs.alembic.io/reference/index.html
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Float, FloatArray
from mixseq.errors import FormatError, InvalidSequenceError
from mixseq.sequence import SequenceHeader
from mixseq.surface import Origin
from mixseq_io.alembic.archive_meshes import Mesh, choose_meshes
from mixseq_io.alembic.library import ERRORS, length, open_archive, values
from mixseq_io.alembic.placing import Placing
from mixseq_io.alembic.polymesh import Source, read_scene_mesh
from mixseq_io.alembic.samples import (
    SAME_TIME,
    SampleWeights,
    Transforms,
    determinant,
    frame_rate,
    locate,
    moved,
    sample_times,
)
from mixseq_io.blocks import warn
from mixseq_io.choosing import common_name
from mixseq_io.key_times import joined
from mixseq_io.reader import SequenceReader, naming, reading
from mixseq_io.scene_meshes import join


def open_alembic(path: Path, prim: str | None = None) -> SequenceReader:
    """Open an Alembic file."""
    with reading(path, "Alembic", *ERRORS), naming(path):
        archive = open_archive(path)
        meshes = choose_meshes(path, archive, prim)
        frames = _frames(meshes)
        room = path.stat().st_size
        metadata = archive.getTop().getMetaData()
        fps = frame_rate(frames, metadata.get("_ai_DCC_FPS") or metadata.get("FramesPerTimeUnit"))
        animated_meshes = _animated_meshes(path, room, meshes, frames, fps)
        origin = Origin("Alembic", str(path.resolve()))
        polygons, surface = join([read_scene_mesh(animated.source) for animated in animated_meshes], origin)
        header = SequenceHeader(
            polygons=polygons,
            vertex_count=animated_meshes[-1].source.vertices.stop,
            times=frames,
            fps=fps,
            name=common_name([mesh.place for mesh in meshes]) or path.stem,
            surface=surface,
        )
        return _AlembicReader(path, header, animated_meshes, _have_velocities(path, animated_meshes))


@dataclass(frozen=True, eq=False)
class _AnimatedMesh:
    """Mesh with the samples around each frame, and the transforms above it."""

    source: Source
    samples: SampleWeights
    transforms: Transforms
    placing: Placing | None = None  # of a mesh laid over an archive whose transforms move

    def place(self, frame: int) -> str:
        """Return a frame's name for messages."""
        return f"the frame at {self.source.frames[frame]:g} s (index {frame}) of {self.source.mesh.path}"


class _AlembicReader(SequenceReader):
    def __init__(
        self, path: Path, header: SequenceHeader, animated_meshes: list[_AnimatedMesh], moving: bool
    ) -> None:
        super().__init__(path, header, has_velocities=moving)
        self._meshes = animated_meshes

    def close(self) -> None:
        """Release the archive; it closes with the last of its objects."""
        super().close()
        self._meshes = []

    def _read_blocks(self, size: int) -> Iterator[FloatArray]:
        return self._read(_world_points, size)

    def _read_velocities(self, size: int) -> Iterator[FloatArray]:
        return self._read(_world_velocities, size)

    def _read(self, values_of: Callable[[_AnimatedMesh, int], FloatArray], size: int) -> Iterator[FloatArray]:
        for start in range(0, self.header.frame_count, size):
            stop = min(start + size, self.header.frame_count)
            block = np.empty((stop - start, self.header.vertex_count, 3), np.float32)
            with reading(self.path, "Alembic", *ERRORS), naming(self.path):
                for frame in range(start, stop):
                    for animated in self._meshes:
                        block[frame - start, animated.source.vertices] = values_of(animated, frame)
            yield block


def _frames(meshes: list[Mesh]) -> Float:
    """Return the times in s at which anything changes; without changes, those of the samples."""
    laid_over = [mesh for mesh in meshes if mesh.laid_over]
    points = [mesh.schema.getPositionsProperty() for mesh in laid_over or meshes]
    if laid_over:
        return joined([sample_times(each) for each in points], SAME_TIME)
    transforms = [schema for mesh in meshes for schema in mesh.above]
    changing = [each for each in (*points, *transforms) if not each.isConstant()]
    longest = max(points, key=lambda each: int(each.getNumSamples()))
    return joined([sample_times(each) for each in changing or [longest]], SAME_TIME)


def _animated_meshes(
    path: Path, room: int, meshes: list[Mesh], frames: Float, fps: float
) -> list[_AnimatedMesh]:
    animated_meshes, vertex = [], 0
    for mesh in meshes:
        points, transforms = mesh.schema.getPositionsProperty(), Transforms.at(mesh.above, frames)
        samples = locate(sample_times(points), frames)
        end = vertex + length(points, samples.at(0)[0])
        if 12 * (end - vertex) > room:
            raise FormatError(
                f"{path}: {mesh.path} claims {end - vertex} vertices, more than the file can hold"
            )
        mirrored = determinant(transforms.to_world(0)) < 0
        source = Source(path, room, mesh, slice(vertex, end), mirrored, frames)
        still = all(schema.isConstant() for schema in mesh.above)
        placing = None if still or not mesh.laid_over else Placing.at(mesh.above, frames, fps)
        animated_meshes.append(_AnimatedMesh(source, samples, transforms, placing))
        vertex = end
    return animated_meshes


def _sampled(animated: _AnimatedMesh, array: Any, frame: int, what: str) -> NDArray[np.float32]:
    """Return an array property at a frame, interpolated between samples if needed."""
    count = animated.source.vertices.stop - animated.source.vertices.start
    sample, weight = animated.samples.at(frame)
    rows = [
        values(array, each, animated.source.room) for each in ((sample, sample + 1) if weight else (sample,))
    ]
    for each in rows:
        if each.shape != (count, 3):
            raise InvalidSequenceError(
                f"{animated.place(frame)} has {len(each)} {what}, the first frame {count} points; every frame needs "
                "the same vertices in the same order"
            )
    if not weight:
        return rows[0]
    mixed = (1 - weight) * rows[0].astype(np.float64) + weight * rows[1].astype(np.float64)
    return mixed.astype(np.float32)


def _world_points(animated: _AnimatedMesh, frame: int) -> NDArray[np.float32]:
    points = _sampled(animated, animated.source.mesh.schema.getPositionsProperty(), frame, "points")
    matrix = animated.transforms.to_world(frame)
    size = determinant(matrix)
    if size > 0 if animated.source.mirrored else size < 0:
        raise InvalidSequenceError(
            f"{animated.place(frame)}: the transform mirrors the mesh relative to the first frame, which turns its "
            "faces inside out; give the animated scale one sign"
        )
    return moved(points, matrix)


def _world_velocities(animated: _AnimatedMesh, frame: int) -> NDArray[np.float32]:
    velocities = animated.source.mesh.schema.getVelocitiesProperty()
    if not velocities.valid():  # a mesh that stands still
        return np.zeros((animated.source.vertices.stop - animated.source.vertices.start, 3), np.float32)
    own = _sampled(animated, velocities, frame, "velocities")
    if animated.placing is None:
        return moved(own, animated.transforms.to_world(frame)[:3, :3])
    points = animated.source.mesh.schema.getPositionsProperty()
    return animated.placing.world_velocities(own, _sampled(animated, points, frame, "points"), frame)


def _have_velocities(path: Path, animated_meshes: list[_AnimatedMesh]) -> bool:
    """Whether velocities of all meshes can be read; warn of others."""
    having = [
        animated
        for animated in animated_meshes
        if animated.source.mesh.schema.getVelocitiesProperty().valid()
    ]
    for animated in animated_meshes if having else []:
        mesh = animated.source.mesh
        points, velocities = mesh.schema.getPositionsProperty(), mesh.schema.getVelocitiesProperty()
        if animated not in having:
            problem = "are missing, and others have some" if mesh.moves else ""
        elif not np.array_equal(sample_times(velocities), sample_times(points)):
            problem = "are not sampled at the times of the points"
        elif length(velocities, 0) != animated.source.vertices.stop - animated.source.vertices.start:
            problem = f"are {length(velocities, 0)}, not as many as its points"
        elif not (mesh.laid_over or all(schema.isConstant() for schema in mesh.above)):
            problem = "are those under a transform that moves, too"
        elif mesh.moves and not animated.samples.exact:
            problem = "are not sampled in every frame"
        else:
            problem = ""
        if problem:
            warn(f"{path}: the velocities of {mesh.path} {problem}; velocities are left out")
            return False
    return bool(having)
