"""Read and write PC2 and MDD caches, binary files with the points of all frames, and a mesh file with the faces.

A cache ``walk.pc2`` belongs to ``walk.obj``, to another mesh file with this name, or to the file of the option `mesh`.
The mesh file has the faces, the surface, the name, the units and the up axis; for an OBJ file, Y is up. Transforms in
the mesh file are not applied to the points. The writer makes the cache and ``<name>.obj`` with the first frame.

PC2 (3ds Max, Blender, Maya) is little-endian. Times are evenly spaced frame numbers, which the option `fps` converts to
seconds, since the file has no frame rate. MDD (LightWave, Blender, Modo) is big-endian. Its frame rate is estimated
from the median time step, and times within float32 rounding of whole frames are snapped to these frames in float64.

Specifications: http://www.footools.com/plugins/docs/PointCache2_README.html, http://rodolphe-vaillant.fr/?e=134
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

from mixseq.errors import FormatError, InvalidSequenceError, MixseqError, OutputError
from mixseq.sequence.frame_rates import estimate_frame_rate
from mixseq.sequence.header import DEFAULT_FPS, SequenceHeader
from mixseq.types import FloatArray
from mixseq_io.files import atomic_files
from mixseq_io.numbered.files import with_article
from mixseq_io.numbered.obj import lost_in_obj, obj_encoder
from mixseq_io.reader import (
    DamageError,
    SequenceReader,
    as_float32,
    prefix_errors,
    translate_read_errors,
    validate_blocks,
)
from mixseq_io.registry import open_sequence
from mixseq_io.scene_meshes import snap_to_frames
from mixseq_io.surfaces import lost_scale, warn_of_losses

MeshPath = str | os.PathLike[str] | None

_USD_EXTENSIONS = (".usdc", ".usda", ".usd", ".usdz")
_MESH_EXTENSIONS = (".obj", ".ply", *_USD_EXTENSIONS, ".abc", ".glb", ".gltf", ".npz", ".h5", ".hdf5")
"""Extensions of mesh files in order of preference, without STL, which has no order of vertices."""


@dataclass(frozen=True, eq=False)
class CacheHeader:
    """Header of a cache file."""

    size: int  # in bytes
    byte_order: str  # "<" or ">"
    point_count: int
    times: NDArray[np.float64]  # (T,) times in seconds
    fps: float | None


def _check_size(file: IO[bytes], header_size: int, frame_count: int, point_count: int) -> None:
    """Check that the counts match the file's size, before memory is allocated."""
    if frame_count < 1 or point_count < 1:
        raise DamageError(f"its header has {frame_count} frames of {point_count} points")
    size, expected = os.fstat(file.fileno()).st_size, header_size + 12 * frame_count * point_count
    if size != expected:
        raise DamageError(f"{frame_count} frames of {point_count} points need {expected} bytes, it has {size}")


class _CacheReader(SequenceReader):
    def __init__(
        self, path: Path, header: SequenceHeader, file: IO[bytes], cache: CacheHeader, stack: ExitStack
    ) -> None:
        super().__init__(path, header, stack)
        self._file, self._cache = file, cache

    def _read(self, what: str, size: int) -> Iterator[FloatArray]:
        cache = self._cache
        frame_bytes = 12 * cache.point_count
        for first in range(0, len(cache.times), size):
            count = min(size, len(cache.times) - first)
            with translate_read_errors(self.path, "a point cache", ValueError):
                self._file.seek(cache.size + first * frame_bytes)
                data = self._file.read(count * frame_bytes)
                points = np.frombuffer(data, f"{cache.byte_order}f4").reshape(count, cache.point_count, 3)
            yield points.astype(np.float32, copy=False)


def open_cache(
    path: Path, format_name: str, mesh: MeshPath, read_header: Callable[[IO[bytes]], CacheHeader]
) -> SequenceReader:
    """Open a point cache and its mesh."""
    with ExitStack() as stack:
        with translate_read_errors(path, with_article(format_name), ValueError):
            file = stack.enter_context(path.open("rb"))
            cache = read_header(file)
        mesh_path = _find_mesh(path, format_name) if mesh is None else Path(mesh)
        with open_sequence(mesh_path) as reader:
            header = reader.header
        if header.vertex_count != cache.point_count:
            raise FormatError(
                f"{path} has {cache.point_count} points, but its mesh {mesh_path} has {header.vertex_count} vertices; "
                "name the mesh that it was made for with mesh=... (--mesh)"
            )
        with prefix_errors(path):
            timed_header = header.with_times(cache.times, cache.fps or header.fps)
        return _CacheReader(path, timed_header, file, cache, stack.pop_all())


def _find_mesh(path: Path, format_name: str) -> Path:
    """Return the mesh file with the cache's name and the most preferred extension."""
    for cache_path in dict.fromkeys([path, Path(os.path.realpath(path))]):
        same_name = [file for file in cache_path.parent.iterdir() if file.stem == cache_path.stem]
        meshes = {file.suffix.lower(): file for file in same_name if file.is_file()}
        for extension in _MESH_EXTENSIONS:
            if extension in meshes:
                return meshes[extension]
    raise FormatError(
        f"{path}: {with_article(format_name)} has no faces, and there is no mesh beside it: none of "
        f"{path.stem}{', '.join(_MESH_EXTENSIONS)}; name its mesh with mesh=... (--mesh)"
    )


def write_cache(
    path: Path,
    format_name: str,
    header: SequenceHeader,
    blocks: Iterable[FloatArray],
    velocities: Iterable[FloatArray] | None,
    cache_header: bytes,
    byte_order: str,
    losses: Iterable[str],
) -> None:
    """Write a cache, and beside it ``<name>.obj`` with the first frame, or neither; `losses` describe lost times."""
    target = Path(os.path.realpath(path))
    mesh = target.with_suffix(".obj")
    _check_existing_mesh(target, mesh, header)
    all_losses = [*losses, *lost_scale(header, velocities is not None), *lost_in_obj(header)]
    warn_of_losses(path, f"{format_name} files", all_losses)
    encode = obj_encoder(mesh, header)
    with atomic_files(target) as folder, (folder / target.name).open("wb") as file:
        file.write(cache_header)
        _, frame_blocks = validate_blocks(header, blocks, velocities)
        for first, block, _ in frame_blocks:
            points = as_float32(block, first, format_name, header=header)
            if first == 0:
                (folder / mesh.name).write_bytes(b"".join(encode(points[0], 0)))
            file.write(points.astype(f"{byte_order}f4", copy=False).tobytes())


def _check_existing_mesh(path: Path, mesh: Path, header: SequenceHeader) -> None:
    if not mesh.is_file():
        return
    try:
        with open_sequence(mesh) as reader:
            existing = reader.header
        is_same = existing.vertex_count == header.vertex_count and existing.polygons.same_as(header.polygons)
    except MixseqError:
        is_same = False
    if not is_same:
        raise OutputError(
            f"{mesh} has the name of the mesh of {path.name}, but is another mesh; remove it, or choose another name"
        )


_PC2_MAGIC = b"POINTCACHE2\0"
_PC2_STRUCT = struct.Struct("<12siiffi")
"""Magic, version, number of points, first frame, frames between samples, number of samples; then points of samples."""

_MAX_TIME_ERROR_FRAMES = 1e-3
"""Largest error of a time without a warning."""


def open_pc2(path: Path, mesh: MeshPath = None, fps: float = DEFAULT_FPS) -> SequenceReader:
    """Open a PC2 file."""
    return open_cache(path, "PC2", mesh, partial(_read_pc2_header, fps=fps))


def _read_pc2_header(file: IO[bytes], fps: float) -> CacheHeader:
    data = file.read(_PC2_STRUCT.size)
    if len(data) < _PC2_STRUCT.size or not data.startswith(_PC2_MAGIC):
        raise DamageError("it does not begin with POINTCACHE2 and a header")
    _, version, point_count, first, step, frame_count = _PC2_STRUCT.unpack(data)
    if version != 1:
        raise DamageError(f"its version is {version}, not 1")
    _check_size(file, len(data), frame_count, point_count)
    with np.errstate(all="ignore"):
        return CacheHeader(len(data), "<", point_count, _even_times(first, step, frame_count, fps), fps)


def write_pc2(
    path: Path, header: SequenceHeader, blocks: Iterable[FloatArray], velocities: Iterable[FloatArray] | None = None
) -> None:
    """Write a PC2 file and its mesh file; parameters and errors are those of `write_cache`."""
    frame_numbers = header.times * header.fps
    first, step = np.float32(frame_numbers[0]), np.float32(1)
    losses = []
    if header.frame_count > 1:
        step = np.float32((frame_numbers[-1] - frame_numbers[0]) / (header.frame_count - 1))
        even_numbers = _even_times(float(first), float(step), header.frame_count, 1.0)
        if np.abs(even_numbers - frame_numbers).max() > _MAX_TIME_ERROR_FRAMES:
            losses.append("uneven times (even ones are written)")
        if header.fps != DEFAULT_FPS:
            losses.append(f"{header.fps:g} frames per second (read it with fps={header.fps:g})")
    cache_header = _PC2_STRUCT.pack(_PC2_MAGIC, 1, header.vertex_count, first, step, header.frame_count)
    write_cache(path, "PC2", header, blocks, velocities, cache_header, "<", losses)


def _even_times(first: float, step: float, count: int, fps: float) -> NDArray[np.float64]:
    return (first + np.arange(count, dtype=np.float64) * step) / fps


_MDD_STRUCT = struct.Struct(">ii")
"""Numbers of frames and points; then the times in seconds, and the points of all frames, in float32."""

_MAX_RATE_ERROR_RATIO = 2e-4
"""Largest relative error of a rate that follows from rounded times without a warning."""


def open_mdd(path: Path, mesh: MeshPath = None) -> SequenceReader:
    """Open an MDD file; parameters and errors are those of `mixseq_io.point_caches.open_cache`."""
    return open_cache(path, "MDD", mesh, _read_mdd_header)


def _read_mdd_header(file: IO[bytes]) -> CacheHeader:
    data = file.read(_MDD_STRUCT.size)
    if len(data) < _MDD_STRUCT.size:
        raise DamageError("it has no header")
    frame_count, point_count = _MDD_STRUCT.unpack(data)
    header_size = len(data) + 4 * frame_count
    _check_size(file, header_size, frame_count, point_count)
    times = np.frombuffer(file.read(4 * frame_count), ">f4").astype(np.float64)
    fps = estimate_frame_rate(times)
    return CacheHeader(header_size, ">", point_count, snap_to_frames(times, fps) if fps else times, fps)


def write_mdd(
    path: Path, header: SequenceHeader, blocks: Iterable[FloatArray], velocities: Iterable[FloatArray] | None = None
) -> None:
    """Write an MDD file and its mesh file; parameters and errors are those of `write_cache`."""
    times = header.times.astype(np.float32)
    is_equal = np.diff(times) <= 0
    if is_equal.any():
        frame = int(np.argmax(is_equal))
        raise InvalidSequenceError(
            f"frames {frame} and {frame + 1} are both at {times[frame]:.9g} s in float32, which MDD stores; write .npz "
            "or .h5"
        )
    stored_fps = estimate_frame_rate(times.astype(np.float64))
    is_exact = stored_fps is None or abs(stored_fps - header.fps) <= _MAX_RATE_ERROR_RATIO * header.fps
    losses = [] if is_exact else [f"{header.fps:g} frames per second"]
    cache_header = _MDD_STRUCT.pack(header.frame_count, header.vertex_count) + times.astype(">f4").tobytes()
    write_cache(path, "MDD", header, blocks, velocities, cache_header, ">", losses)
