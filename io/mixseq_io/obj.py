"""Numbered Wavefront OBJ files: one text file per frame, polygons and vertex order as in the files.

Read are the vertices (``v``, without weights and colours), the faces (``f``) and the first object's name
(``o``). The parser is our own because the order of vertices matters here: trimesh, for one, merges vertices,
splits those with several texture coordinates, and cuts polygons into triangles.

Points are written with the digits that give back the same float32 or float64. Comments in our own files tell
which of them it was, and whether the file is whole; points of other files are read as float64. OBJ has no
place for times, frame rate, units, the up axis or velocities.

Specification: https://paulbourke.net/dataformats/obj/
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np

from mixseq.errors import FormatError, InvalidSequenceError, OutputError, SettingsError
from mixseq.sequence import DEFAULT_FPS, FloatArray, IntArray, Polygons, SequenceHeader
from mixseq_io.atomic import replacing_many
from mixseq_io.blocks import checked, warn
from mixseq_io.numbered import files_of_pattern, find_frames, is_pattern, numbered_name
from mixseq_io.reader import SequenceReader, naming, reading

_FIRST_LINE = b"# Written by mixseq, "
_LAST_LINE = b"# end of mesh"
_LARGEST = 2**31 - 1


def open_obj(path: Path, fps: float = DEFAULT_FPS, allow_gaps: bool = False) -> SequenceReader:
    """Open numbered OBJ files.

    Parameters
    ----------
    path : Path
        A pattern (``walk_####.obj``, ``walk_%04d.obj``, ``walk_*.obj``), a folder, or one file.
    fps : float
        Frames per second: a frame's time is ``(number - first number) / fps``.
    allow_gaps : bool
        Accept missing numbers.

    Raises
    ------
    InvalidSequenceError
        If numbers are missing, or a file's faces differ from the first's.
    """
    if not (np.isfinite(fps) and fps > 0):
        raise SettingsError(f"fps is {fps}; a positive number is expected")
    files, numbers = find_frames(path, allow_gaps)
    first = _read_mesh(files[0])
    with naming(files[0]):
        header = SequenceHeader(
            polygons=first.polygons,
            vertex_count=len(first.points),
            times=(np.array(numbers) - numbers[0]) / fps,
            fps=fps,
            name=first.name or files[0].stem.rstrip("0123456789").rstrip("_-. ") or "mesh",
        )
    return _ObjReader(path, header, files, first)


@dataclass(frozen=True)
class _Mesh:
    """One file: points (V, 3), its faces, also as they are written, and the object's name."""

    points: FloatArray
    face_lines: list[bytes]
    polygons: Polygons
    name: str


class _ObjReader(SequenceReader):
    def __init__(self, path: Path, header: SequenceHeader, files: list[Path], first: _Mesh) -> None:
        super().__init__(path, header)
        self._files = files
        self._first = first

    def _read_blocks(self, size: int) -> Iterator[FloatArray]:
        for start in range(0, len(self._files), size):
            frames = range(start, min(start + size, len(self._files)))
            yield np.stack([self._points(frame) for frame in frames], dtype=self._first.points.dtype)

    def _points(self, frame: int) -> FloatArray:
        mesh = _read_mesh(self._files[frame], like=self._first)
        where = f"{self._files[frame]} (frame {frame})"
        if len(mesh.points) != self.header.vertex_count:
            raise InvalidSequenceError(
                f"{where} has {len(mesh.points)} vertices, {self._files[0]} has {self.header.vertex_count}; "
                "every frame needs the same vertices in the same order"
            )
        if not mesh.polygons.same_as(self.header.polygons):
            raise InvalidSequenceError(
                f"{where} has other faces than {self._files[0]}; every frame needs the same faces in "
                "the same order (export with the vertex order kept)"
            )
        return mesh.points


def _read_mesh(file: Path, like: _Mesh | None = None) -> _Mesh:
    """Parse a file; one whose face lines are those of `like` need not have them parsed again."""
    with reading(file, "an OBJ file"):
        lines = file.read_bytes().replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").splitlines()
    if lines and lines[0].startswith(_FIRST_LINE) and lines[-1] != _LAST_LINE:
        raise FormatError(f"{file} ends in the middle; it is truncated, write it again")
    points: list[list[float]] = []
    face_lines: list[bytes] = []
    vertices_before: list[int] = []
    name = b""
    for number, line in enumerate(lines, start=1):
        kind, _, rest = line.replace(b"\t", b" ").lstrip().partition(b" ")
        if kind == b"v":
            points.append(_coordinates(file, number, rest))
        elif kind == b"f":
            face_lines.append(rest)
            vertices_before.append(len(points))
        elif kind == b"o" and not name:
            name = rest.strip()
    if not points:
        raise FormatError(f"{file} cannot be read as an OBJ file: it has no vertices (lines starting with v)")
    if like is not None and len(points) == len(like.points) and face_lines == like.face_lines:
        polygons = like.polygons
    else:
        polygons = _parse_faces(file, face_lines, vertices_before)
    dtype = np.float32 if lines[0] == _FIRST_LINE + b"float32" else np.float64
    return _Mesh(np.array(points, dtype), face_lines, polygons, name.decode("utf-8", errors="replace"))


def _coordinates(file: Path, number: int, text: bytes) -> list[float]:
    try:
        x, y, z = text.split()[:3]
        return [float(x), float(y), float(z)]
    except ValueError:
        raise FormatError(
            f"{file}, line {number}: {_excerpt(b'v ' + text)} is not a vertex; three numbers are expected"
        ) from None


def _parse_faces(file: Path, lines: list[bytes], vertices_before: list[int]) -> Polygons:
    """Parse corners ``v``, ``v/vt``, ``v//vn`` or ``v/vt/vn``, where -1 is the vertex before the face."""
    counts: list[int] = []
    indices: list[int] = []
    for face, (line, before) in enumerate(zip(lines, vertices_before, strict=True)):
        try:
            corners = [int(corner.partition(b"/")[0]) for corner in line.split()]
        except ValueError:
            corners = [0]
        if any(corner == 0 or abs(corner) > _LARGEST for corner in corners):
            raise FormatError(
                f"{file}, face {face}: {_excerpt(b'f ' + line)} is not a face; vertex numbers from 1, or "
                "from -1 backwards, are expected"
            )
        counts.append(len(corners))
        indices.extend(corner - 1 if corner > 0 else before + corner for corner in corners)
    with naming(file):
        return Polygons(np.array(counts, dtype=np.int64), np.array(indices, dtype=np.int64))


def _excerpt(line: bytes) -> str:
    return repr(line[:40].decode("ascii", errors="replace"))


def write_obj(
    path: Path,
    header: SequenceHeader,
    blocks: Iterable[FloatArray],
    velocities: Iterable[FloatArray] | None = None,
    start: int = 1,
) -> None:
    """Write one OBJ file per frame.

    Parameters
    ----------
    path : Path
        A pattern (``walk_####.obj``, ``walk_%04d.obj``), or a file name if there is only one frame.
    header, blocks, velocities
        See `mixseq_io.write_blocks`; velocities are lost.
    start : int
        Number of the first file.

    Raises
    ------
    OutputError
        If there are several frames and no pattern, or files cannot be written.
    SettingsError
        If `start` is negative.
    """
    if start < 0:
        raise SettingsError(f"start is {start}; files are numbered from 0 or more")
    if header.frame_count > 1 and not is_pattern(path):
        raise OutputError(
            f"{path}: an OBJ file holds one frame, this sequence has {header.frame_count}; give a pattern "
            f"such as {path.stem.rstrip('*')}_####.obj"
        )
    _warn_of_losses(path, header, velocities is not None)
    faces = _face_lines(header.polygons)
    names = [numbered_name(path, number) for number in range(start, start + header.frame_count)]
    with replacing_many(path) as folder:
        _, numbered = checked(header, blocks, velocities)
        for first, block, _ in numbered:
            for name, points in zip(names[first:], block, strict=False):
                with (folder / name).open("wb") as file:
                    _write_mesh(file, header.name, points, faces)
    if is_pattern(path):
        _warn_of_others(path, set(names))


def _write_mesh(file: IO[bytes], name: str, points: FloatArray, faces: bytes) -> None:
    digits = "%.9g" if points.dtype == np.float32 else "%.17g"
    line = f"v {digits} {digits} {digits}\n"
    file.write(
        _FIRST_LINE
        + str(points.dtype).encode()
        + b"\no "
        + " ".join(name.split()).encode(errors="replace")
        + b"\n"
    )
    file.write((line * len(points) % tuple(points.reshape(-1).tolist())).encode())
    file.write(faces)
    file.write(_LAST_LINE + b"\n")


def _face_lines(polygons: Polygons) -> bytes:
    ends = np.cumsum(polygons.counts)
    corners: list[IntArray] = np.split(polygons.indices + 1, ends[:-1])
    return "".join(f"f {' '.join(map(str, polygon.tolist()))}\n" for polygon in corners).encode()


def _warn_of_losses(path: Path, header: SequenceHeader, moving: bool) -> None:
    lost = []
    still = header.frame_count == 1  # a single frame has no rate
    if header.fps != DEFAULT_FPS and not still:
        lost.append(f"{header.fps:g} frames per second")
    if not still and not np.allclose(
        header.times * header.fps, np.arange(header.frame_count), rtol=1e-9, atol=1e-9
    ):
        lost.append("the times of the frames")
    if header.up_axis != "Y":
        lost.append(f"{header.up_axis} up")
    if header.metres_per_unit != 1.0:
        lost.append(f"{header.metres_per_unit:g} metres per unit")
    if moving:
        lost.append("velocities")
    if lost:
        warn(f"{path}: OBJ files cannot hold {', '.join(lost)}; USD, .npz and .h5 can")


def _warn_of_others(path: Path, written: set[str]) -> None:
    """Warn of files that another, longer sequence left behind, with which this one would be read."""
    others = sorted({file.name for _, file in files_of_pattern(path)} - written)
    if others:
        warn(
            f"{path}: {len(others)} files of another sequence, {others[0]} to {others[-1]}, match as well; "
            "remove them, else they will be read as frames of this one"
        )
