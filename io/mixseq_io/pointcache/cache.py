"""Point caches: positions only, with the faces in a mesh file beside.

A cache ``walk.pc2`` belongs to ``walk.obj``, or another mesh file of that name, or the one of the option `mesh`, which
gives the faces, the surface, the name, the units and the up axis; an OBJ has neither of the latter, so Y is up. Points
are those of the cache, without any transform of the mesh's file. Written are the cache and ``<name>.obj`` with the
first frame.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import FloatArray
from mixseq.errors import FormatError, MixseqError, OutputError
from mixseq.sequence import SequenceHeader
from mixseq_io.atomic import replacing_many
from mixseq_io.blocks import as_float32, checked
from mixseq_io.losses import lost_scale, warn_of_losses
from mixseq_io.numbered.frame_files import a_file
from mixseq_io.numbered.obj import lost_in_obj, obj_encoder
from mixseq_io.reader import SequenceReader, naming, reading

MeshPath = str | os.PathLike[str] | None

# Not STL, which has no order of vertices.
_MESHES = (".obj", ".ply", ".usdc", ".usda", ".usd", ".usdz", ".abc", ".glb", ".gltf", ".npz", ".h5", ".hdf5")


@dataclass(frozen=True)
class Layout:
    """Layout of the points in a cache file."""

    start: int
    frames: int
    points: int
    order: str

    @property
    def frame_size(self) -> int:
        """Size of a frame in bytes."""
        return 12 * self.points

    def check_size(self, file: IO[bytes]) -> None:
        """Check the layout against the file's size before anything is allocated."""
        if self.frames < 1 or self.points < 1:
            raise ValueError(f"it says that it has {self.frames} frames of {self.points} points")
        size, needed = os.fstat(file.fileno()).st_size, self.start + self.frames * self.frame_size
        if size != needed:
            raise ValueError(
                f"{self.frames} frames of {self.points} points need {needed} bytes, it has {size}"
            )


@dataclass(frozen=True, eq=False)
class Timing:
    """Times ``(T,)`` of the frames in seconds, and frames per second or None."""

    times: NDArray[np.float64]
    fps: float | None


class PointCacheReader(SequenceReader):
    """Reader of the points of a cache whose header has been read."""

    def __init__(
        self, path: Path, header: SequenceHeader, file: IO[bytes], layout: Layout, stack: ExitStack
    ) -> None:
        super().__init__(path, header, stack)
        self._file = file
        self._layout = layout

    def _read_blocks(self, size: int) -> Iterator[FloatArray]:
        layout = self._layout
        for first in range(0, layout.frames, size):
            count = min(size, layout.frames - first)
            with reading(self.path, "a point cache", ValueError):
                self._file.seek(layout.start + first * layout.frame_size)
                data = self._file.read(count * layout.frame_size)
                points = np.frombuffer(data, f"{layout.order}f4").reshape(count, layout.points, 3)
            yield points.astype(np.float32, copy=False)


def open_cache(
    path: Path, kind: str, mesh: MeshPath, read_start: Callable[[IO[bytes]], tuple[Layout, Timing]]
) -> SequenceReader:
    """Open a point cache and its mesh."""
    with ExitStack() as stack:
        with reading(path, a_file(kind), ValueError):
            file = stack.enter_context(path.open("rb"))
            layout, timing = read_start(file)
        mesh_path = _mesh_beside(path, kind) if mesh is None else Path(mesh)
        header = _header_of_mesh(mesh_path)
        if header.vertex_count != layout.points:
            raise FormatError(
                f"{path} has {layout.points} points, but its mesh {mesh_path} has {header.vertex_count} vertices; name "
                "the mesh that it was made for with mesh=... (--mesh)"
            )
        with naming(path):
            timed = header.with_times(timing.times, timing.fps or header.fps)
        return PointCacheReader(path, timed, file, layout, stack.pop_all())


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
        f"{path}: {a_file(kind)} has no faces, and there is no mesh beside it: none of "
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
    with replacing_many(target) as folder, (folder / target.name).open("wb") as file:
        file.write(start)
        _, numbered = checked(header, blocks, velocities)
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
