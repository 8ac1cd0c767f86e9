"""USD, reading: the points of one mesh over time, in world space, and velocities (.usd, .usda, .usdc, .usdz).

Values come from the composed stage, so that references, layers, variants and value clips count. Frames are
all times at which the points or a transform above them have a sample; where one of them has none, USD
interpolates linearly. The mesh's local-to-world transform is applied to the points. Points are float32, which
is USD's precision. Velocities are read where they are sampled as the points are, as USD asks for, and no transform
moves.

Specifications: https://openusd.org/release/api/class_usd_geom_mesh.html,
https://openusd.org/release/api/class_usd_geom_xformable.html
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from secrets import token_hex

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Sdf, Usd, UsdGeom

from mixseq.errors import FormatError, InvalidSequenceError
from mixseq.sequence import FloatArray, Polygons, SequenceHeader
from mixseq_io.blocks import warn
from mixseq_io.reader import SequenceReader, naming
from mixseq_io.usd_diagnostics import quiet, reading_usd
from mixseq_io.usd_meshes import choose_mesh, is_animated, is_skinned


def open_usd(path: Path, prim: str | None = None) -> SequenceReader:
    """Open a USD file.

    Parameters
    ----------
    path : Path
        The file.
    prim : str, optional
        Path of the mesh, or of a prim above it, where the stage has several.

    Raises
    ------
    AmbiguousError
        If there are several meshes to choose from.
    FormatError
        If there is no mesh, or its motion is only in a skeleton or spline.
    InvalidSequenceError
        If the faces change over time.
    """
    if not path.is_file():
        raise FormatError(f"{path} does not exist")
    with quiet() as reports, reading_usd(path), naming(path):
        stage = _open_stage(path)
        source = _source(path, stage, choose_mesh(path, stage, prim))
        header = _header(source)
        moving = _has_velocities(path, source, header.vertex_count)
    # What could not be found (a layer, a reference) may matter or not: reading goes on, but not in silence.
    if reports:
        warn(f"{path}: USD reports: {'; '.join(reports[:3])}")
    return _UsdReader(path, header, source, moving)


@dataclass(frozen=True)
class _Source:
    """Where the frames come from.

    Parameters
    ----------
    stage : Usd.Stage
        Held, because prims die with their stage.
    mesh : UsdGeom.Mesh
        The mesh.
    codes : (T,) float64
        Time codes of the frames.
    mirrored : bool
        Whether the transform of the first frame turns left into right.
    """

    stage: Usd.Stage
    mesh: UsdGeom.Mesh
    codes: NDArray[np.float64]
    mirrored: bool

    def place(self, frame: int) -> str:
        """Name a frame in a message."""
        return f"frame {frame} (time code {self.codes[frame]:g}) of {self.mesh.GetPath()}"


class _UsdReader(SequenceReader):
    def __init__(self, path: Path, header: SequenceHeader, source: _Source, moving: bool) -> None:
        super().__init__(path, header, has_velocities=moving)
        self._source: _Source | None = source

    def close(self) -> None:
        """Let the stage go."""
        super().close()
        self._source = None

    def _read_blocks(self, size: int) -> Iterator[FloatArray]:
        return self._read(_world_points, size)

    def _read_velocities(self, size: int) -> Iterator[FloatArray]:
        return self._read(_world_velocities, size)

    def _read(self, frame_of: Callable[[_Source, int, int], FloatArray], size: int) -> Iterator[FloatArray]:
        source = self._source
        if source is None:
            return
        for start in range(0, self.header.frame_count, size):
            stop = min(start + size, self.header.frame_count)
            block = np.empty((stop - start, self.header.vertex_count, 3), np.float32)
            with quiet(), reading_usd(self.path), naming(self.path):
                for frame in range(start, stop):
                    block[frame - start] = frame_of(source, frame, self.header.vertex_count)
            yield block


def _open_stage(path: Path) -> Usd.Stage:
    # A process shares its layers by their identifier, with an application's unsaved edits in them, or with
    # what the file held before it was replaced. An argument that no one else gives makes this one our own.
    layer = Sdf.Layer.FindOrOpen(str(path.resolve()), {"mixseq": token_hex(8)})
    if not layer:
        raise FormatError(f"{path} cannot be read as USD; it is damaged, truncated or of another type")
    return Usd.Stage.Open(layer, Usd.Stage.LoadAll)


def _source(path: Path, stage: Usd.Stage, mesh: UsdGeom.Mesh) -> _Source:
    points = mesh.GetPointsAttr()
    if not is_animated(mesh) and is_skinned(mesh):
        raise FormatError(
            f"{path}: {mesh.GetPath()} is moved by a skeleton (UsdSkel) and has no points over time; bake "
            "the skinning into the points first, with UsdSkel.BakeSkinning or an export from Blender"
        )
    sampled = [points, *_transform_attributes(mesh.GetPrim())]
    for attribute in sampled:
        if attribute.ValueMightBeTimeVarying() and not attribute.GetNumTimeSamples():
            raise FormatError(f"{path}: {attribute.GetPath()} is a spline; bake it into time samples")
    # A single sample holds at all times, so that its own time means nothing unless there is no other.
    moving = [attribute.GetTimeSamples() for attribute in sampled if attribute.GetNumTimeSamples() > 1]
    codes = sorted({code for samples in moving for code in samples}) or points.GetTimeSamples() or [0.0]
    mirrored = _to_world(mesh, codes[0]).GetDeterminant3() < 0
    return _Source(stage, mesh, np.array(codes, dtype=np.float64), mirrored)


def _transform_attributes(prim: Usd.Prim) -> Iterator[Usd.Attribute]:
    """Yield the attributes that the local-to-world transform depends on."""
    while prim and not prim.IsPseudoRoot():
        xformable = UsdGeom.Xformable(prim)
        if xformable:
            yield from (operation.GetAttr() for operation in xformable.GetOrderedXformOps())
            if xformable.GetResetXformStack():
                return
        prim = prim.GetParent()


def _to_world(mesh: UsdGeom.Mesh, code: float) -> Gf.Matrix4d:
    return mesh.ComputeLocalToWorldTransform(Usd.TimeCode(code))


def _header(source: _Source) -> SequenceHeader:
    stage, prim = source.stage, source.mesh.GetPrim()
    rate = stage.GetTimeCodesPerSecond()
    return SequenceHeader(
        polygons=_polygons(source),
        vertex_count=len(_local_points(source, 0)),
        times=source.codes / (rate if rate > 0 else 1.0),  # the header reports a rate that is none
        fps=rate,
        up_axis=str(UsdGeom.GetStageUpAxis(stage)),
        metres_per_unit=UsdGeom.GetStageMetersPerUnit(stage),
        name=prim.GetDisplayName() or prim.GetName(),
    )


def _polygons(source: _Source) -> Polygons:
    """Return the polygons, counter-clockwise seen from outside in world space.

    A left-handed mesh lists them clockwise; a transform that mirrors turns clockwise into counter-clockwise.
    """
    mesh = source.mesh
    counts = _constant(source, mesh.GetFaceVertexCountsAttr())
    indices = _constant(source, mesh.GetFaceVertexIndicesAttr())
    left_handed = mesh.GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded
    polygons = Polygons(counts, indices)
    return flipped(polygons) if left_handed != source.mirrored else polygons


def _constant(source: _Source, attribute: Usd.Attribute) -> NDArray[np.int32]:
    """Return the value of an attribute that must not change; some exporters repeat it at every sample."""
    first = np.array(attribute.Get(Usd.TimeCode(source.codes[0])) or (), dtype=np.int32)
    for code in attribute.GetTimeSamples():
        if not np.array_equal(first, np.array(attribute.Get(Usd.TimeCode(code)) or (), dtype=np.int32)):
            frame = int(np.searchsorted(source.codes, code))
            raise InvalidSequenceError(
                f"{attribute.GetPath()} changes at time code {code:g} (frame {frame}); every frame needs the "
                "same faces: export without remeshing, or the part of the time line before it"
            )
    return first


def flipped(polygons: Polygons) -> Polygons:
    """Return the polygons with their corners in reverse order, each from the same first corner.

    Examples
    --------
    >>> flipped(Polygons(np.array([4, 3]), np.array([0, 1, 2, 3, 7, 8, 9]))).indices.tolist()
    [0, 3, 2, 1, 7, 9, 8]
    """
    counts = np.repeat(polygons.counts, polygons.counts)
    starts = np.repeat(np.cumsum(polygons.counts) - polygons.counts, polygons.counts)
    corner = np.arange(len(starts)) - starts
    return Polygons(polygons.counts, polygons.indices[starts + (counts - corner) % counts])


def _local_points(source: _Source, frame: int) -> NDArray[np.float32]:
    value = source.mesh.GetPointsAttr().Get(Usd.TimeCode(source.codes[frame]))
    if value is None:
        raise InvalidSequenceError(f"{source.place(frame)} has no points")
    return np.array(value, dtype=np.float32).reshape(-1, 3)


def _world_points(source: _Source, frame: int, vertex_count: int) -> NDArray[np.float32]:
    points = _local_points(source, frame)
    if len(points) != vertex_count:
        raise InvalidSequenceError(
            f"{source.place(frame)} has {len(points)} points, the first frame {vertex_count}; every frame "
            "needs the same vertices in the same order"
        )
    matrix = _to_world(source.mesh, source.codes[frame])
    if matrix == Gf.Matrix4d(1.0):
        return points
    determinant = matrix.GetDeterminant3()
    if determinant > 0 if source.mirrored else determinant < 0:
        raise InvalidSequenceError(
            f"{source.place(frame)}: the transform mirrors the mesh relative to the first frame, which turns "
            "its faces inside out; give the animated scale one sign"
        )
    rows = np.array(matrix, dtype=np.float64)  # points are row vectors: p' = p M
    with np.errstate(all="ignore"):  # what overflows is reported by the reader, with its vertex
        world = points.astype(np.float64) @ rows[:3, :3] + rows[3, :3]
        return world.astype(np.float32)


def _has_velocities(path: Path, source: _Source, vertex_count: int) -> bool:
    """Whether velocities can be read; warn of those that cannot."""
    mesh = source.mesh
    attribute = mesh.GetVelocitiesAttr()
    first = attribute.Get(Usd.TimeCode(source.codes[0]))
    if first is None:
        return False
    if attribute.GetTimeSamples() != mesh.GetPointsAttr().GetTimeSamples():
        problem = "are not sampled at the times of the points"
    elif len(first) != vertex_count:
        problem = f"are {len(first)} for {vertex_count} points"
    elif any(each.GetNumTimeSamples() > 1 for each in _transform_attributes(mesh.GetPrim())):
        problem = "are those under a transform that moves, too"
    else:
        return True
    warn(f"{path}: the velocities of {mesh.GetPath()} {problem}; they are left out")
    return False


def _world_velocities(source: _Source, frame: int, vertex_count: int) -> NDArray[np.float32]:
    velocities = np.array(
        source.mesh.GetVelocitiesAttr().Get(Usd.TimeCode(source.codes[frame])), dtype=np.float32
    )
    if velocities.shape != (vertex_count, 3):
        raise InvalidSequenceError(
            f"{source.place(frame)} has {len(velocities)} velocities for {vertex_count} points; give as many"
        )
    matrix = _to_world(source.mesh, source.codes[frame])
    if matrix == Gf.Matrix4d(1.0):
        return velocities
    with np.errstate(all="ignore"):
        world = velocities.astype(np.float64) @ np.array(matrix, dtype=np.float64)[:3, :3]
        return world.astype(np.float32)
