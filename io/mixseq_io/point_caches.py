r"""Point caches PC2 and MDD: positions of all frames in one binary file, with the faces in a mesh file beside.

A cache ``walk.pc2`` belongs to ``walk.obj``, or another mesh file of that name, or the one of the option `mesh`, which
gives the faces, the surface, the name, the units and the up axis; an OBJ has neither of the latter, so Y is up. Points
are those of the cache, without any transform of the mesh's file. Written are the cache and ``<name>.obj`` with the
first frame.

PC2 (3ds Max, Blender, Maya), little-endian:

=======================  ===========================================================
``"POINTCACHE2\0"``       12 bytes
version                  int32, 1
number of points         int32
first frame              float32
frames between samples   float32
number of samples        int32
points                   float32, x, y, z of all points, sample after sample
=======================  ===========================================================

Times are evenly spaced frame numbers; `fps`, missing in the file, converts them to seconds. PC2 has no place for
uneven times, units, the up axis and velocities.

Specification: http://www.footools.com/plugins/docs/PointCache2_README.html

MDD (LightWave, Blender, Modo), big-endian:

=================  ===========================================================
number of frames   int32
number of points   int32
times              float32, seconds, one per frame
points             float32, x, y, z of all points, frame after frame
=================  ===========================================================

The frame rate is that of the median step. Times that are whole frames within float32 rounding become exactly that, in
float64. MDD has no place for units, the up axis and velocities.

Specification: http://rodolphe-vaillant.fr/?e=134
"""

from __future__ import annotations

import os
import struct
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import FormatError, InvalidSequenceError, MixseqError, OutputError, SettingsError
from mixseq.sequence.header import DEFAULT_FPS, SequenceHeader
from mixseq.types import FloatArray
from mixseq_io.files import atomic_files
from mixseq_io.numbered.files import with_article
from mixseq_io.numbered.obj import lost_in_obj, obj_encoder
from mixseq_io.reader import SequenceReader, as_float32, prefix_errors, translate_read_errors, validate_blocks
from mixseq_io.scene_meshes import snap_to_frames
from mixseq_io.surfaces import lost_scale, warn_of_losses

MeshPath = str | os.PathLike[str] | None

# Not STL, which has no order of vertices.
_MESHES = (".obj", ".ply", ".usdc", ".usda", ".usd", ".usdz", ".abc", ".glb", ".gltf", ".npz", ".h5", ".hdf5")


@dataclass(frozen=True, eq=False)
class Start:
    """Start of a cache file: its size in bytes, byte order and number of points, times ``(T,)`` in s, rate or None."""

    size: int
    order: str
    points: int
    times: NDArray[np.float64]
    fps: float | None

    @property
    def frame_size(self) -> int:
        """Size of a frame in bytes."""
        return 12 * self.points


def _check_size(file: IO[bytes], start: int, frames: int, points: int) -> None:
    """Check the numbers of frames and points against the file's size before anything is allocated."""
    if frames < 1 or points < 1:
        raise ValueError(f"it says that it has {frames} frames of {points} points")
    size, needed = os.fstat(file.fileno()).st_size, start + 12 * frames * points
    if size != needed:
        raise ValueError(f"{frames} frames of {points} points need {needed} bytes, it has {size}")


class _CacheReader(SequenceReader):
    def __init__(
        self, path: Path, header: SequenceHeader, file: IO[bytes], start: Start, stack: ExitStack
    ) -> None:
        super().__init__(path, header, stack)
        self._file, self._start = file, start

    def _read(self, what: str, size: int) -> Iterator[FloatArray]:
        start = self._start
        for first in range(0, len(start.times), size):
            count = min(size, len(start.times) - first)
            with translate_read_errors(self.path, "a point cache", ValueError):
                self._file.seek(start.size + first * start.frame_size)
                data = self._file.read(count * start.frame_size)
                points = np.frombuffer(data, f"{start.order}f4").reshape(count, start.points, 3)
            yield points.astype(np.float32, copy=False)


def open_cache(
    path: Path, kind: str, mesh: MeshPath, read_start: Callable[[IO[bytes]], Start]
) -> SequenceReader:
    """Open a point cache and its mesh."""
    with ExitStack() as stack:
        with translate_read_errors(path, with_article(kind), ValueError):
            file = stack.enter_context(path.open("rb"))
            start = read_start(file)
        mesh_path = _mesh_beside(path, kind) if mesh is None else Path(mesh)
        header = _header_of_mesh(mesh_path)
        if header.vertex_count != start.points:
            raise FormatError(
                f"{path} has {start.points} points, but its mesh {mesh_path} has {header.vertex_count} vertices; name "
                "the mesh that it was made for with mesh=... (--mesh)"
            )
        with prefix_errors(path):
            timed = header.with_times(start.times, start.fps or header.fps)
        return _CacheReader(path, timed, file, start, stack.pop_all())


def _mesh_beside(path: Path, kind: str) -> Path:
    """Return the first mesh file with the cache's name."""
    places = dict.fromkeys([path, Path(os.path.realpath(path))])
    for place in places:
        beside = {
            file.suffix.lower(): file
            for file in place.parent.iterdir()
            if file.stem == place.stem and file.is_file()
        }
        for extension in _MESHES:
            if extension in beside:
                return beside[extension]
    raise FormatError(
        f"{path}: {with_article(kind)} has no faces, and there is no mesh beside it: none of "
        f"{path.stem}{', '.join(_MESHES)}; name its mesh with mesh=... (--mesh)"
    )


def _header_of_mesh(path: Path) -> SequenceHeader:
    from mixseq_io.registry import open_sequence  # which imports the formats, this one too

    with open_sequence(path) as reader:
        return reader.header


def write_cache(
    path: Path,
    kind: str,
    header: SequenceHeader,
    blocks: Iterable[FloatArray],
    velocities: Iterable[FloatArray] | None,
    start: bytes,
    order: str,
    lost: Iterable[str],
) -> None:
    """Write a point cache, and ``<name>.obj`` with the first frame beside it; both or none.

    An existing OBJ is replaced only if it holds the same faces. `start` is the header in bytes, `order` the byte order
    "<" or ">", `lost` the properties of the times that the format cannot hold; velocities are lost.
    """
    target = Path(os.path.realpath(path))
    mesh = target.with_suffix(".obj")
    _check_mesh_in_the_way(target, mesh, header)
    warn_of_losses(
        path, f"{kind} files", [*lost, *lost_scale(header, velocities is not None), *lost_in_obj(header)]
    )
    encode = obj_encoder(mesh, header)
    with atomic_files(target) as folder, (folder / target.name).open("wb") as file:
        file.write(start)
        _, numbered = validate_blocks(header, blocks, velocities)
        for first, block, _ in numbered:
            points = as_float32(block, first, kind, header=header)
            if first == 0:
                (folder / mesh.name).write_bytes(b"".join(encode(points[0], 0)))
            file.write(points.astype(f"{order}f4", copy=False).tobytes())


def _check_mesh_in_the_way(path: Path, mesh: Path, header: SequenceHeader) -> None:
    if not mesh.is_file():
        return
    try:
        other = _header_of_mesh(mesh)
        same = other.vertex_count == header.vertex_count and other.polygons.same_as(header.polygons)
    except MixseqError:
        same = False
    if not same:
        raise OutputError(
            f"{mesh} has the name of the mesh that goes with {path.name}, but holds another mesh; remove it, or choose "
            "another name"
        )


_MAGIC = b"POINTCACHE2\0"
_PC2_HEADER = struct.Struct("<12siiffi")
_FRAME_ERROR = 1e-3
"""Largest unreported error of a time, in frames."""


def open_pc2(path: Path, mesh: MeshPath = None, fps: float = DEFAULT_FPS) -> SequenceReader:
    """Open a PC2 file."""
    if not (np.isfinite(fps) and fps > 0):
        raise SettingsError(f"fps is {fps}; a positive number is expected")
    return open_cache(path, "PC2", mesh, partial(_read_pc2, fps=fps))


def _read_pc2(file: IO[bytes], fps: float) -> Start:
    data = file.read(_PC2_HEADER.size)
    if len(data) < _PC2_HEADER.size or not data.startswith(_MAGIC):
        raise ValueError("it does not begin with POINTCACHE2 and a header")
    _, version, points, first, step, samples = _PC2_HEADER.unpack(data)
    if version != 1:
        raise ValueError(f"its version is {version}, not 1")
    _check_size(file, len(data), samples, points)
    with np.errstate(all="ignore"):
        return Start(len(data), "<", points, _seconds(first, step, samples, fps), fps)


def write_pc2(
    path: Path,
    header: SequenceHeader,
    blocks: Iterable[FloatArray],
    velocities: Iterable[FloatArray] | None = None,
) -> None:
    """Write a PC2 file, and its mesh beside it; parameters and errors are those of `write_cache`."""
    frames = header.times * header.fps
    first, step = np.float32(frames[0]), np.float32(1)
    lost = []
    if header.frame_count > 1:
        step = np.float32((frames[-1] - frames[0]) / (header.frame_count - 1))
        even = _seconds(float(first), float(step), header.frame_count, 1.0)
        if np.abs(even - frames).max() > _FRAME_ERROR:
            lost.append("uneven times (they are written as if they were even)")
        if header.fps != DEFAULT_FPS:
            lost.append(f"{header.fps:g} frames per second (read it with fps={header.fps:g})")
    start = _PC2_HEADER.pack(_MAGIC, 1, header.vertex_count, first, step, header.frame_count)
    write_cache(path, "PC2", header, blocks, velocities, start, "<", lost)


def _seconds(first: float, step: float, count: int, fps: float) -> NDArray[np.float64]:
    return (first + np.arange(count, dtype=np.float64) * step) / fps


_MDD_HEADER = struct.Struct(">ii")
_STEP_ERROR = 1e-2
"""Relative error of a single step between rounded times."""
_RATE_ERROR = 2e-4
"""Relative error of a rate from rounded times; less than the gap between 24 and 23.976."""


def open_mdd(path: Path, mesh: MeshPath = None) -> SequenceReader:
    """Open an MDD file; parameters and errors are those of `mixseq_io.point_caches.open_cache`."""
    return open_cache(path, "MDD", mesh, _read_mdd)


def _read_mdd(file: IO[bytes]) -> Start:
    data = file.read(_MDD_HEADER.size)
    if len(data) < _MDD_HEADER.size:
        raise ValueError("it has no header")
    frames, points = _MDD_HEADER.unpack(data)
    size = len(data) + 4 * frames
    _check_size(file, size, frames, points)
    times = np.frombuffer(file.read(4 * frames), ">f4").astype(np.float64)
    rate = _rate(times)
    return Start(size, ">", points, snap_to_frames(times, rate) if rate else times, rate)


def _rate(times: NDArray[np.float64]) -> float | None:
    """Return the frame rate of float32 times ``(T,)``, a whole or NTSC rate if it is near enough; None if unknown."""
    step = float(np.quantile(np.diff(times), 0.5, method="lower")) if times.size > 1 else 0.0
    if not (np.isfinite(step) and step > 0):
        return None
    span = float(times[-1] - times[0])
    if not (np.isfinite(span) and span > 0):
        return None  # non-increasing times are reported where they are used
    overall = (
        max(1, round(span / step)) / span
    )  # more exact than one step, which is rounded, if steps are even
    rate = overall if abs(overall * step - 1) < _STEP_ERROR else 1 / step
    for candidate in (round(rate), round(rate * 1.001) / 1.001):
        if abs(candidate - rate) <= _RATE_ERROR * rate:
            return float(candidate)
    return rate


def write_mdd(
    path: Path,
    header: SequenceHeader,
    blocks: Iterable[FloatArray],
    velocities: Iterable[FloatArray] | None = None,
) -> None:
    """Write an MDD file, and its mesh beside it; parameters and errors are those of `write_cache`."""
    times = header.times.astype(np.float32)
    together = np.flatnonzero(np.diff(times) <= 0)
    if together.size:
        raise InvalidSequenceError(
            f"frames {together[0]} and {together[0] + 1} are both at {times[together[0]]:.9g} s in float32, which MDD "
            "stores; write .npz or .h5"
        )
    rate = _rate(times.astype(np.float64))
    same = rate is None or abs(rate - header.fps) <= _RATE_ERROR * header.fps
    lost = [] if same else [f"{header.fps:g} frames per second"]
    start = _MDD_HEADER.pack(header.frame_count, header.vertex_count) + times.astype(">f4").tobytes()
    write_cache(path, "MDD", header, blocks, velocities, start, ">", lost)
