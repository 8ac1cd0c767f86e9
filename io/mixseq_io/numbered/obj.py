"""Numbered Wavefront OBJ files: one text file per frame, polygons and vertex order as in the files.

==================================  ==============================================================
in the file                         here
==================================  ==============================================================
``v``, without weights              points
``v`` with six numbers              colours of vertices, of the first frame
``f``                               polygons
``vt``                              texture coordinates, of the first frame
``vn``                              hard edges: where the first frame has several normals at a vertex
``o``, one                          the name
``o``, several                      objects, if each has vertices of its own that follow each other,
                                    else face sets
``usemtl``                          face sets with that material
``g``                               face sets without a material; ``g a b`` is in both
==================================  ==============================================================

The parser is mixseq's own to keep the order of vertices: trimesh merges and splits vertices and triangulates polygons.
Points are written with the digits that give back the same float32 or float64. Comments in the files state which, and
whether the file is whole; points of other files are read as float64. Normals are written for hard edges only, for every
frame; hard edges that are flat in the first frame are lost when read. Names of materials are the last part of their
path. OBJ has no place for times, frame rate, units, the up axis, velocities, subdivision, alpha, several colours at a
vertex, and two materials on one polygon; the library of materials (``mtllib``) is not kept.

Specification: https://paulbourke.net/dataformats/obj/
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import FormatError
from mixseq.mesh.measures import corner_normals, hard_edges_from_normals
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import DEFAULT_COLOUR, CornerValues, FaceSet, MeshObject, Surface
from mixseq.sequence.header import SequenceHeader
from mixseq.types import FloatArray, IntArray
from mixseq_io.numbered.files import (
    WRITTEN_BY,
    Encoder,
    FrameFormat,
    MeshFile,
    colours_of_words,
    excerpt,
    number_lines,
)
from mixseq_io.reader import warn
from mixseq_io.surfaces import format_vertex_colours, lost_colours, lost_surface

NOTHING = "(null)"
"""Name for no group or no material after faces that had one, as exporters write it."""


@dataclass(frozen=True)
class Statement:
    """Line ``o``, ``g`` or ``usemtl``, which holds until the next of its kind."""

    kind: str
    text: str
    face: int
    vertex: int


def grouped(
    statements: Sequence[Statement], polygons: Polygons, vertex_count: int
) -> tuple[str, tuple[FaceSet, ...], tuple[MeshObject, ...]]:
    """Return the name of the mesh ("" if there is none or several), its face sets and its objects."""
    kinds = {kind: [each for each in statements if each.kind == kind] for kind in ("o", "g", "usemtl")}
    count = len(polygons.counts)
    sets = [FaceSet(name, faces, name) for name, faces in _runs(kinds["usemtl"], count).items()]
    sets += [FaceSet(name, faces) for name, faces in _runs(kinds["g"], count, several=True).items()]
    if len(kinds["o"]) == 1:
        return kinds["o"][0].text, tuple(sets), ()
    objects = _objects(kinds["o"], polygons, vertex_count)
    if len(objects) == 1:
        return objects[0].name, tuple(sets), ()
    if not objects:
        sets += [FaceSet(name, faces) for name, faces in _runs(kinds["o"], count).items()]
    return "", tuple(sets), objects


def _runs(statements: Sequence[Statement], count: int, several: bool = False) -> dict[str, IntArray]:
    """Return the faces of every name, or of each of `several` names in a statement."""
    faces: dict[str, list[IntArray]] = {}
    ends = [*(each.face for each in statements[1:]), count]
    for each, end in zip(statements, ends, strict=False):
        for name in each.text.split() if several else [each.text]:
            if end > each.face and name not in ("", NOTHING):
                faces.setdefault(name, []).append(np.arange(each.face, end))
    return {name: np.concatenate(parts) for name, parts in faces.items()}


def _objects(
    statements: Sequence[Statement], polygons: Polygons, vertex_count: int
) -> tuple[MeshObject, ...]:
    """Return the objects, or none if their vertices are not consecutive."""
    if not statements or statements[0].face > 0:
        return ()
    faces = np.array([*(each.face for each in statements), len(polygons.counts)])
    corners = np.concatenate([[0], np.cumsum(polygons.counts)])[faces]
    used = [polygons.indices[a:b] for a, b in pairwise(corners)]
    as_written = [0, *(each.vertex for each in statements[1:]), vertex_count]
    for bounds in (as_written, _bounds_of_use(used, vertex_count)):
        if all(
            a <= b and (not own.size or (own.min() >= a and own.max() < b))
            for own, (a, b) in zip(used, pairwise(bounds), strict=True)
        ):
            sizes = zip(statements, np.diff(bounds).tolist(), np.diff(faces).tolist(), strict=True)
            return tuple(MeshObject(each.text, "", own, count) for each, own, count in sizes if own or count)
    return ()


def _bounds_of_use(used: Sequence[IntArray], vertex_count: int) -> list[int]:
    """Return the first vertex of every object in files with all vertices before the objects."""
    bounds = [vertex_count]
    for own in reversed(used[1:]):
        bounds.append(int(own.min()) if own.size else bounds[-1])
    return [0, *reversed(bounds)]


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
        polygons = like.polygons
    else:
        counts, corners = _parse_faces(file, lines)
        polygons = Polygons(counts, corners[:, 0])
    colours = _colours(file, polygons, lines, like)
    if like is not None:
        surface = Surface(colours=colours)
        return MeshFile(points=lines.points, polygons=polygons, source=faces, surface=surface)
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
    return uvs.weld(polygons.indices)


def _colours(file: Path, polygons: Polygons, lines: _Lines, like: MeshFile | None) -> CornerValues | None:
    """Return the colours behind the coordinates of vertices, white for vertices without."""
    if like is not None and lines.colour_text == like.colour_text:
        return like.surface.colours
    words = (text.split() for text in lines.behind_points)
    found = {vertex: each for vertex, each in enumerate(words) if len(each) == _COLOUR}
    if not found:
        return None
    values = np.tile(DEFAULT_COLOUR, (len(lines.points), 1))
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
    return hard_edges_from_normals(polygons, np.nan_to_num(normals)[indices])


def _check_numbers(file: Path, polygons: Polygons, indices: IntArray, count: int, what: str) -> None:
    outside = (indices != _NONE) & ((indices < 0) | (indices >= count))
    if outside.any():
        corner = int(np.argmax(outside))
        face = int(np.searchsorted(np.cumsum(polygons.counts), corner, side="right"))
        raise FormatError(
            f"{file}, face {face} uses {what} {indices[corner] + 1}, but the file has {count}; it is damaged"
        )


def obj_encoder(path: Path, header: SequenceHeader) -> Encoder:
    """Return the encoder of points ``(V, 3)`` into the parts of an OBJ file; other parts are made once."""
    objects = header.objects
    vertices = np.cumsum([0, *(each.vertex_count for each in objects)])
    polygons = np.cumsum([0, *(each.polygon_count for each in objects)])
    names = [f"o {_one_line(each.name)}\n".encode(errors="replace") for each in objects]
    lines = _face_lines(header)
    faces = ["".join(lines[a:b]).encode(errors="replace") for a, b in pairwise(polygons)]
    uvs = b"" if header.surface.uvs is None else number_lines("vt ", header.surface.uvs.values)
    hard_edges = header.surface.hard_edges
    colours = format_vertex_colours(header, 3)

    def encode(points: FloatArray, frame: int) -> Iterable[bytes]:
        yield WRITTEN_BY + str(points.dtype).encode() + b"\n"
        yield uvs
        if hard_edges is not None:
            yield number_lines("vn ", corner_normals(points[None], header.polygons, hard_edges)[0])
        for name, (a, b), own in zip(names, pairwise(vertices), faces, strict=True):
            yield name
            yield number_lines("v ", points[a:b], colours[a:b])
            yield own
        yield LAST_LINE + b"\n"

    return encode


def lost_in_obj(header: SequenceHeader) -> list[str]:
    """Return the parts of a sequence's surface that OBJ cannot hold."""
    lost = lost_surface(header, held=("uvs", "colours", "hard_edges", "face_sets", "objects"))
    lost += lost_colours(header, corners=False, alpha=False)
    sets = header.surface.face_sets
    names = _material_names(sets)
    with_material = [each for each in sets if each.material]
    used = np.zeros(len(header.polygons.counts), dtype=int)
    for each in with_material:
        used[each.polygons] += 1
    if (used > 1).any():
        lost.append("several materials on one polygon (the first one is written)")
    if any(each.name != names[each.material] for each in with_material):
        lost.append("names of face sets that differ from their materials' (the material's is written)")
    if any(len(each.name.split()) != 1 for each in sets if not each.material):
        lost.append("spaces in the names of face sets (underscores are written)")
    return lost


def _face_lines(header: SequenceHeader) -> list[str]:
    """Return the lines of every polygon: group or material changes, and the face."""
    surface = header.surface
    corners = [str(index) for index in (header.polygons.indices + 1).tolist()]
    if surface.uvs is not None:
        uvs = (surface.uvs.indices + 1).tolist()
        corners = [f"{corner}/{uv}" for corner, uv in zip(corners, uvs, strict=True)]
    if surface.hard_edges is not None:
        slashes = "/" if surface.uvs is not None else "//"
        normals = (surface.hard_edges + 1).tolist()
        corners = [f"{corner}{slashes}{normal}" for corner, normal in zip(corners, normals, strict=True)]
    ends = np.cumsum([0, *header.polygons.counts.tolist()]).tolist()
    lines = [f"f {' '.join(corners[a:b])}\n" for a, b in pairwise(ends)]
    groups, materials = _labels(surface.face_sets, len(lines))
    for keyword, labels in (("g", groups), ("usemtl", materials)):
        previous = ""
        for polygon, label in enumerate(labels):
            if label != previous:
                lines[polygon] = f"{keyword} {label or NOTHING}\n{lines[polygon]}"
            previous = label
    return lines


def _labels(sets: Sequence[FaceSet], count: int) -> tuple[list[str], list[str]]:
    """Return the groups and the material of every polygon."""
    names = _material_names(sets)
    groups, materials = [""] * count, [""] * count
    for each in sets:
        group = "_".join(each.name.split()) or "_"
        for polygon in each.polygons.tolist():
            if each.material:
                materials[polygon] = materials[polygon] or names[each.material]
            else:
                groups[polygon] = f"{groups[polygon]} {group}".lstrip()
    return groups, materials


def _material_names(sets: Sequence[FaceSet]) -> dict[str, str]:
    """Return the last part of every material's path, or the whole path for duplicates."""
    materials = {each.material for each in sets if each.material}
    last = {material: _one_line(material.rstrip("/").rpartition("/")[2]) for material in materials}
    count = Counter(last.values())
    several = {name for name in count if not name or count[name] > 1}
    return {material: _one_line(material) if name in several else name for material, name in last.items()}


def _one_line(name: str) -> str:
    return " ".join(name.split())


OBJ = FrameFormat("OBJ", parse_obj, obj_encoder, lost_in_obj, is_text=True)
