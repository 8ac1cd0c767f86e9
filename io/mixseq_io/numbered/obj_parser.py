"""Parser of OBJ files: points, polygons and surface."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import FloatArray, IntArray
from mixseq.errors import FormatError
from mixseq.geometry.normals import hard_edges_of_normals
from mixseq.polygons import Polygons
from mixseq.surface import WHITE, CornerValues, Surface
from mixseq_io.blocks import warn
from mixseq_io.numbered.frame_files import MeshFile
from mixseq_io.numbered.obj_groups import Statement, grouped
from mixseq_io.numbered.text_lines import WRITTEN_BY, colours_of_words, excerpt

LAST_LINE = b"# end of mesh"
_EXPECTED = {
    b"v": "a vertex; three numbers are expected",
    b"vn": "a normal; three numbers are expected",
    b"vt": "a texture coordinate; one or two numbers are expected",
}
_FACES = (b"f", b"fo")
_LEFT_OUT = frozenset(
    b"vp cstype deg bmat step p l curv curv2 surf parm trim hole scrv sp end con s mg bevel c_interp d_interp lod "
    b"mtllib shadow_obj trace_obj ctech stech usemap maplib call csh res bsp bzp cdc cdp".split()
)
"""Statements of the specification, and of its older versions, that do not concern polygon meshes."""
_COLOUR = 3
"""Number of values behind a point that form a colour; a single one is a weight."""
_LARGEST = 2**31 - 1
_NONE = -(2**40)  # below whatever relative indices of a damaged file give


def parse_obj(file: Path, data: bytes, like: MeshFile | None) -> MeshFile:
    """Parse an OBJ file."""
    lines = _read_lines(file, data, like)
    faces = (lines.faces, lines.vertices_before)
    if like is not None and len(lines.points) == len(like.points) and faces == like.source:
        surface = Surface(colours=_colours(file, like.polygons, lines, like))
        return MeshFile(points=lines.points, polygons=like.polygons, source=faces, surface=surface)
    counts, corners = _parse_faces(file, lines)
    polygons = Polygons(counts, corners[:, 0])
    colours = _colours(file, polygons, lines, like)
    if like is not None:
        return MeshFile(
            points=lines.points, polygons=polygons, source=faces, surface=Surface(colours=colours)
        )
    name, face_sets, objects = grouped(lines.statements, polygons, len(lines.points))
    surface = Surface(
        uvs=_uvs(file, polygons, lines.uvs, corners[:, 1]),
        colours=colours,
        hard_edges=_hard_edges(file, polygons, lines.normals, corners[:, 2]),
        face_sets=face_sets,
        objects=objects,
    )
    return MeshFile(
        points=lines.points,
        polygons=polygons,
        source=faces,
        name=name,
        surface=surface,
        colour_text=lines.colour_text,
    )


@dataclass
class _Lines:
    """Lines of a file by kind, faces not yet parsed."""

    points: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    behind_points: list[bytes] = field(default_factory=list)
    uvs: list[tuple[float, ...]] = field(default_factory=list)
    normals: list[tuple[float, ...]] = field(default_factory=list)
    faces: list[bytes] = field(default_factory=list)
    vertices_before: list[int] = field(default_factory=list)
    others_before: list[tuple[int, int]] = field(default_factory=list)
    statements: list[Statement] = field(default_factory=list)

    @property
    def colour_text(self) -> bytes:
        return b"\n".join(self.behind_points)


def _read_lines(file: Path, data: bytes, like: MeshFile | None) -> _Lines:
    """Sort the lines of a first frame; of later ones only vertices and faces."""
    whole, colours = like is None, like is None or not like.told
    lines = data.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").splitlines()
    if lines and lines[0].startswith(WRITTEN_BY) and lines[-1] != LAST_LINE:
        raise FormatError(f"{file} ends in the middle; it is truncated, write it again")
    found = _Lines()
    coordinates: list[float] = []
    unknown: list[tuple[int, bytes]] = []
    for number, line in enumerate(lines, start=1):
        words = line.split(None, 1)
        kind, rest = words if len(words) == 2 else (line.strip(), b"")
        try:
            if kind == b"v":
                x, y, z, *behind = rest.split(None, 3)
                coordinates += (float(x), float(y), float(z))
                if colours:
                    found.behind_points += behind or (b"",)
            elif kind in _FACES:
                found.faces.append(rest)
                found.vertices_before.append(len(coordinates) // 3)
                if whole:
                    found.others_before.append((len(found.uvs), len(found.normals)))
            elif not whole:
                continue
            elif kind == b"vt":
                u, v = (*rest.split(), b"0")[:2]
                found.uvs.append((float(u), float(v)))
            elif kind == b"vn":
                x, y, z = rest.split()[:3]
                found.normals.append((float(x), float(y), float(z)))
            elif kind in (b"o", b"g", b"usemtl"):
                text = rest.strip().decode("utf-8", errors="replace")
                found.statements.append(
                    Statement(kind.decode(), text, len(found.faces), len(coordinates) // 3)
                )
            elif kind and kind not in _LEFT_OUT and not kind.startswith(b"#"):
                unknown.append((number, line))
        except ValueError:
            raise FormatError(f"{file}, line {number}: {excerpt(line)} is not {_EXPECTED[kind]}") from None
    if not coordinates:
        raise FormatError(f"{file} cannot be read as an OBJ file: it has no vertices (lines starting with v)")
    if unknown:
        number, line = unknown[0]
        more = f", like {len(unknown) - 1} other lines" if unknown[1:] else ""
        warn(
            f"{file}, line {number}: {excerpt(line)} is no statement of OBJ files and left out{more}; is it damaged?"
        )
    dtype = np.float32 if lines[0] == WRITTEN_BY + b"float32" else np.float64
    with np.errstate(over="ignore"):
        found.points = np.array(coordinates).reshape(-1, 3).astype(dtype)
    return found


def _parse_faces(file: Path, lines: _Lines) -> tuple[IntArray, IntArray]:
    """Parse corners ``v``, ``v/vt``, ``v//vn`` or ``v/vt/vn``; -1 is the last element before the face.

    Return counts ``(P,)`` and indices ``(sum of counts, 3)``.
    """
    counts: list[int] = []
    corners: list[tuple[int, int, int]] = []
    others = lines.others_before or [(0, 0)] * len(lines.faces)
    for face, (line, vertices, (uvs, normals)) in enumerate(
        zip(lines.faces, lines.vertices_before, others, strict=True)
    ):
        words = line.split()
        counts.append(len(words))
        try:
            for word in words:
                vertex, uv, normal = (*word.split(b"/", 2), b"", b"")[:3]
                corners.append((_index(vertex, vertices), _optional(uv, uvs), _optional(normal, normals)))
        except ValueError:
            raise FormatError(
                f"{file}, face {face}: {excerpt(b'f ' + line)} is not a face; vertex numbers from 1, or "
                "from -1 backwards, are expected"
            ) from None
    return np.array(counts, dtype=np.int64), np.array(corners, dtype=np.int64).reshape(-1, 3)


def _index(word: bytes, before: int) -> int:
    number = int(word)
    if number == 0 or abs(number) > _LARGEST:
        raise ValueError
    return number - 1 if number > 0 else before + number


def _optional(word: bytes, before: int) -> int:
    return _NONE if word in (b"", b"0") else _index(word, before)


def _uvs(
    file: Path, polygons: Polygons, values: list[tuple[float, ...]], indices: IntArray
) -> CornerValues | None:
    """Return the texture coordinates, (0, 0) at corners without."""
    if not values or (indices == _NONE).all():
        return None
    _check_numbers(file, polygons, indices, len(values), "texture coordinate")
    missing = indices == _NONE
    rows = np.array([*values, (0.0, 0.0)] if missing.any() else values)
    with np.errstate(over="ignore"):
        uvs = CornerValues(rows.astype(np.float32), np.where(missing, len(values), indices))
    return uvs.welded(polygons.indices)


def _colours(file: Path, polygons: Polygons, lines: _Lines, like: MeshFile | None) -> CornerValues | None:
    """Return the colours behind the coordinates of vertices, white for vertices without."""
    if like is not None and lines.colour_text == like.colour_text:
        return like.surface.colours
    words = (text.split() for text in lines.behind_points)
    found = {vertex: each for vertex, each in enumerate(words) if len(each) == _COLOUR}
    if not found:
        return None
    values = np.tile(WHITE, (len(lines.points), 1))
    values[list(found), :_COLOUR] = colours_of_words(file, list(found), list(found.values()), like)
    return CornerValues(values, polygons.indices)


def _hard_edges(
    file: Path, polygons: Polygons, values: list[tuple[float, ...]], indices: IntArray
) -> NDArray[np.int32] | None:
    """Return the normal's index of every corner, None unless all corners have a normal."""
    if not values or (indices == _NONE).any():
        return None
    _check_numbers(file, polygons, indices, len(values), "normal")
    normals = np.array(values)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return hard_edges_of_normals(polygons, np.nan_to_num(normals)[indices])


def _check_numbers(file: Path, polygons: Polygons, indices: IntArray, count: int, what: str) -> None:
    outside = (indices != _NONE) & ((indices < 0) | (indices >= count))
    if outside.any():
        corner = int(np.argmax(outside))
        face = int(np.searchsorted(np.cumsum(polygons.counts), corner, side="right"))
        raise FormatError(
            f"{file}, face {face} uses {what} {indices[corner] + 1}, but the file has {count}; it is damaged"
        )
