"""Read and write numbered Wavefront OBJ files, one text file per frame, with unchanged polygons and vertex order.

The first frame gives the surface: colours (``v`` with six numbers), texture coordinates (``vt``), hard edges (``vn``,
where a vertex has several normals), face sets with a material (``usemtl``) and without one (``g``; ``g a b`` puts faces
in both), and objects (``o``), if each has separate, consecutive vertices; others are face sets. A single one is a name.

mixseq has a parser for OBJ, because trimesh merges and splits vertices and triangulates polygons. Points are written
with enough digits to restore the same float32 or float64. A comment at the start states this precision, and a comment
at the end marks a complete file. Points of files without these comments are read as float64. Every frame has normals if
the mesh has hard edges. Reading loses hard edges that are flat in the first frame.

Specification: https://paulbourke.net/dataformats/obj/
"""

from __future__ import annotations

import re
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
from mixseq.runtime.text_files import strip_byte_order_mark
from mixseq.sequence.header import SequenceHeader
from mixseq.types import FloatArray, IntArray
from mixseq_io.numbered.files import (
    PRECISION_COMMENT,
    Encoder,
    FrameFormat,
    MeshFile,
    format_number_lines,
    parse_colours,
    quote_line,
)
from mixseq_io.reader import warn
from mixseq_io.surfaces import format_vertex_colours, lost_colours, lost_surface

NO_NAME = "(null)"
"""Name by which exporters end a group or material without starting another one."""


@dataclass(frozen=True)
class Statement:
    """Line ``o``, ``g`` or ``usemtl``, which applies until the next line with the same keyword."""

    kind: str
    text: str
    face: int  # index of the first face after the line
    vertex: int  # index of the first vertex after the line


def group_faces(
    statements: Sequence[Statement], polygons: Polygons, vertex_count: int
) -> tuple[str, tuple[FaceSet, ...], tuple[MeshObject, ...]]:
    """Return the mesh's name, which is "" for no name or several names, its face sets and its objects."""
    by_kind = {kind: [item for item in statements if item.kind == kind] for kind in ("o", "g", "usemtl")}
    count = len(polygons.counts)
    sets = [FaceSet(name, faces, name) for name, faces in _faces_by_name(by_kind["usemtl"], count).items()]
    sets += [FaceSet(name, faces) for name, faces in _faces_by_name(by_kind["g"], count, split=True).items()]
    if len(by_kind["o"]) == 1:
        return by_kind["o"][0].text, tuple(sets), ()
    objects = _split_objects(by_kind["o"], polygons, vertex_count)
    if len(objects) == 1:
        return objects[0].name, tuple(sets), ()
    if not objects:
        sets += [FaceSet(name, faces) for name, faces in _faces_by_name(by_kind["o"], count).items()]
    return "", tuple(sets), objects


def _faces_by_name(statements: Sequence[Statement], count: int, split: bool = False) -> dict[str, IntArray]:
    """Return the faces of every name; if `split` is true, a text may hold several names."""
    faces: dict[str, list[IntArray]] = {}
    ends = [*(statement.face for statement in statements[1:]), count]
    for statement, end in zip(statements, ends, strict=False):
        for name in statement.text.split() if split else [statement.text]:
            if end > statement.face and name not in ("", NO_NAME):
                faces.setdefault(name, []).append(np.arange(statement.face, end))
    return {name: np.concatenate(ranges) for name, ranges in faces.items()}


def _split_objects(statements: Sequence[Statement], polygons: Polygons, vertex_count: int) -> tuple[MeshObject, ...]:
    """Return the objects, or an empty tuple if the vertices of an object are not consecutive."""
    if not statements or statements[0].face > 0:
        return ()
    faces = np.array([*(statement.face for statement in statements), len(polygons.counts)])
    corners = np.concatenate([[0], np.cumsum(polygons.counts)])[faces]
    used = [polygons.indices[start:end] for start, end in pairwise(corners)]
    bounds_in_file = [0, *(statement.vertex for statement in statements[1:]), vertex_count]
    for bounds in (bounds_in_file, _vertex_bounds_of_faces(used, vertex_count)):
        if all(
            start <= end and (not indices.size or (indices.min() >= start and indices.max() < end))
            for indices, (start, end) in zip(used, pairwise(bounds), strict=True)
        ):
            names = (statement.text for statement in statements)
            sizes = zip(names, np.diff(bounds).tolist(), np.diff(faces).tolist(), strict=True)
            return tuple(MeshObject(name, "", points, count) for name, points, count in sizes if points or count)
    return ()


def _vertex_bounds_of_faces(used: Sequence[IntArray], vertex_count: int) -> list[int]:
    """Return the bounds of the vertex ranges of objects, for files in which all vertices precede the objects."""
    bounds = [vertex_count]
    for indices in reversed(used[1:]):
        bounds.append(int(indices.min()) if indices.size else bounds[-1])
    return [0, *reversed(bounds)]


END_COMMENT = b"# end of mesh"
_EXPECTED_VALUES = {
    b"v": "a vertex; three numbers are expected",
    b"vn": "a normal; three numbers are expected",
    b"vt": "a texture coordinate; one or two numbers are expected",
}
_FACE_KEYWORDS = (b"f", b"fo")
_CONTINUATION_PATTERN = re.compile(rb"\\[ \t]*(\r\n|\r|\n)")
_IGNORED_KEYWORDS = frozenset(
    b"vp cstype deg bmat step p l curv curv2 surf parm trim hole scrv sp end con s mg bevel c_interp d_interp lod "
    b"mtllib shadow_obj trace_obj ctech stech usemap maplib call csh res bsp bzp cdc cdp".split()
)
"""Keywords of current and older specifications that do not describe polygon meshes."""
_COLOUR_CHANNELS = 3
"""Number of values after the coordinates of a coloured vertex; a single value is a weight."""
_MAX_INDEX = 2**31 - 1
_MISSING_INDEX = -(2**40)  # below all relative indices that damaged files can contain


def parse_obj(file: Path, data: bytes, first: MeshFile | None) -> MeshFile:
    """Parse an OBJ file."""
    lines = _read_lines(file, data, first)
    stored_faces = (lines.faces, lines.vertex_counts)
    if first is not None and len(lines.points) == len(first.points) and stored_faces == first.stored_faces:
        polygons = first.polygons
    else:
        counts, corners = _parse_faces(file, lines)
        polygons = Polygons(counts, corners[:, 0])
    colours = _colours(file, polygons, lines, first)
    if first is not None:
        surface = Surface(colours=colours)
        return MeshFile(points=lines.points, polygons=polygons, stored_faces=stored_faces, surface=surface)
    name, face_sets, objects = group_faces(lines.statements, polygons, len(lines.points))
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
        stored_faces=stored_faces,
        name=name,
        surface=surface,
        colour_text=b"\n".join(lines.colour_texts),
    )


@dataclass
class _Lines:
    """Lines of a file, sorted by kind, with unparsed faces."""

    points: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    colour_texts: list[bytes] = field(default_factory=list)  # text after the coordinates of each vertex
    uvs: list[tuple[float, ...]] = field(default_factory=list)
    normals: list[tuple[float, ...]] = field(default_factory=list)
    faces: list[bytes] = field(default_factory=list)
    vertex_counts: list[int] = field(default_factory=list)  # number of vertices before each face
    uv_and_normal_counts: list[tuple[int, int]] = field(default_factory=list)  # numbers before each face
    statements: list[Statement] = field(default_factory=list)


def _read_lines(file: Path, data: bytes, first: MeshFile | None) -> _Lines:
    """Sort the lines of a first frame by kind; for later frames, collect only vertices and faces."""
    is_first, has_colours = first is None, first is None or not first.has_changing_colours
    data = strip_byte_order_mark(file, data, "an OBJ file")
    lines = _CONTINUATION_PATTERN.sub(b" ", data).splitlines() if b"\\" in data else data.splitlines()
    if lines and lines[0].startswith(PRECISION_COMMENT) and lines[-1] != END_COMMENT:
        raise FormatError(f"{file} ends in the middle; it is truncated, write it again")
    result = _Lines()
    coordinates: list[float] = []
    unknown: list[tuple[int, bytes]] = []
    for number, line in enumerate(lines, start=1):
        words = line.split(None, 1)
        keyword, values = words if len(words) == 2 else (line.strip(), b"")
        try:
            if keyword == b"v":
                x, y, z, *colour = values.split(None, 3)
                coordinates += (float(x), float(y), float(z))
                if has_colours:
                    result.colour_texts += colour or (b"",)
            elif keyword in _FACE_KEYWORDS:
                result.faces.append(values)
                result.vertex_counts.append(len(coordinates) // 3)
                if is_first:
                    result.uv_and_normal_counts.append((len(result.uvs), len(result.normals)))
            elif not is_first:
                continue
            elif keyword == b"vt":
                u, v = (*values.split(), b"0")[:2]
                result.uvs.append((float(u), float(v)))
            elif keyword == b"vn":
                x, y, z = values.split()[:3]
                result.normals.append((float(x), float(y), float(z)))
            elif keyword in (b"o", b"g", b"usemtl"):
                text = values.strip().decode("utf-8", errors="replace")
                vertex = len(coordinates) // 3
                result.statements.append(Statement(keyword.decode(), text, len(result.faces), vertex))
            elif keyword and keyword not in _IGNORED_KEYWORDS and not keyword.startswith(b"#"):
                unknown.append((number, line))
        except ValueError:
            expected = _EXPECTED_VALUES[keyword]
            raise FormatError(f"{file}, line {number}: {quote_line(line)} is not {expected}") from None
    if not coordinates:
        raise FormatError(f"{file} cannot be read as an OBJ file: it has no vertices (lines starting with v)")
    if unknown:
        number, line = unknown[0]
        more = f", like {len(unknown) - 1} other lines" if unknown[1:] else ""
        warn(
            f"{file}, line {number}: {quote_line(line)} is not a statement of OBJ files and is skipped{more}; is the "
            "file damaged?"
        )
    dtype = np.float32 if lines[0] == PRECISION_COMMENT + b"float32" else np.float64
    with np.errstate(over="ignore"):
        result.points = np.array(coordinates).reshape(-1, 3).astype(dtype)
    return result


def _parse_faces(file: Path, lines: _Lines) -> tuple[IntArray, IntArray]:
    """Return the corner counts ``(P,)`` of faces, and the indices ``(C, 3)`` of corners ``v/vt/vn``."""
    counts: list[int] = []
    corners: list[tuple[int, int, int]] = []
    other_counts = lines.uv_and_normal_counts or [(0, 0)] * len(lines.faces)
    for face, (line, vertices, (uvs, normals)) in enumerate(
        zip(lines.faces, lines.vertex_counts, other_counts, strict=True)
    ):
        words = line.split()
        counts.append(len(words))
        try:
            for word in words:
                vertex, uv, normal = (*word.split(b"/", 2), b"", b"")[:3]
                corners.append(
                    (
                        _parse_index(vertex, vertices),
                        _parse_optional_index(uv, uvs),
                        _parse_optional_index(normal, normals),
                    )
                )
        except ValueError:
            raise FormatError(
                f"{file}, face {face}: {quote_line(b'f ' + line)} is not a face; vertex numbers from 1, or "
                "from -1 backwards, are expected"
            ) from None
    return np.array(counts, dtype=np.int64), np.array(corners, dtype=np.int64).reshape(-1, 3)


def _parse_index(word: bytes, before: int) -> int:
    number = int(word)
    if number == 0 or abs(number) > _MAX_INDEX:
        raise ValueError
    return number - 1 if number > 0 else before + number


def _parse_optional_index(word: bytes, before: int) -> int:
    return _MISSING_INDEX if word in (b"", b"0") else _parse_index(word, before)


def _uvs(file: Path, polygons: Polygons, values: list[tuple[float, ...]], indices: IntArray) -> CornerValues | None:
    """Return the texture coordinates, which are (0, 0) at corners without an index."""
    missing_mask = indices == _MISSING_INDEX
    if not values or missing_mask.all():
        return None
    _check_indices(file, polygons, indices, len(values), "texture coordinate")
    rows = np.array([*values, (0.0, 0.0)] if missing_mask.any() else values)
    with np.errstate(over="ignore"):
        uvs = CornerValues(rows.astype(np.float32), np.where(missing_mask, len(values), indices))
    return uvs.weld(polygons.indices)


def _colours(file: Path, polygons: Polygons, lines: _Lines, first: MeshFile | None) -> CornerValues | None:
    """Return the colours of vertices, white for a vertex without a colour."""
    if first is not None and b"\n".join(lines.colour_texts) == first.colour_text:
        return first.surface.colours
    rows = {vertex: text.split() for vertex, text in enumerate(lines.colour_texts)}
    rows = {vertex: words for vertex, words in rows.items() if len(words) == _COLOUR_CHANNELS}
    if not rows:
        return None
    values = np.tile(DEFAULT_COLOUR, (len(lines.points), 1))
    values[list(rows), :_COLOUR_CHANNELS] = parse_colours(file, list(rows), list(rows.values()), first)
    return CornerValues(values, polygons.indices)


def _hard_edges(
    file: Path, polygons: Polygons, values: list[tuple[float, ...]], indices: IntArray
) -> NDArray[np.int32] | None:
    """Return the index of every corner's normal, or None if a corner has no normal."""
    if not values or (indices == _MISSING_INDEX).any():
        return None
    _check_indices(file, polygons, indices, len(values), "normal")
    normals = np.array(values)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return hard_edges_from_normals(polygons, np.nan_to_num(normals)[indices])


def _check_indices(file: Path, polygons: Polygons, indices: IntArray, count: int, what: str) -> None:
    outside_mask = (indices != _MISSING_INDEX) & ((indices < 0) | (indices >= count))
    if outside_mask.any():
        corner = int(np.argmax(outside_mask))
        face = int(np.searchsorted(np.cumsum(polygons.counts), corner, side="right"))
        raise FormatError(
            f"{file}, face {face} uses {what} {indices[corner] + 1}, but the file has {count}; it is damaged"
        )


def obj_encoder(path: Path, header: SequenceHeader) -> Encoder:
    """Return the encoder of points ``(V, 3)`` into an OBJ file; constant contents are encoded only once."""
    objects = header.objects
    vertices = np.cumsum([0, *(part.vertex_count for part in objects)])
    polygons = np.cumsum([0, *(part.polygon_count for part in objects)])
    names = [f"o {_collapse_spaces(part.name)}\n".encode(errors="replace") for part in objects]
    lines = _face_lines(header)
    faces = ["".join(lines[a:b]).encode(errors="replace") for a, b in pairwise(polygons)]
    uvs = b"" if header.surface.uvs is None else format_number_lines("vt ", header.surface.uvs.values)
    hard_edges = header.surface.hard_edges
    colours = format_vertex_colours(header, 3)

    def encode(points: FloatArray, frame: int) -> Iterable[bytes]:
        yield PRECISION_COMMENT + str(points.dtype).encode() + b"\n"
        yield uvs
        if hard_edges is not None:
            yield format_number_lines("vn ", corner_normals(points[None], header.polygons, hard_edges)[0])
        for name, (a, b), own in zip(names, pairwise(vertices), faces, strict=True):
            yield name
            yield format_number_lines("v ", points[a:b], colours[a:b])
            yield own
        yield END_COMMENT + b"\n"

    return encode


def lost_in_obj(header: SequenceHeader) -> list[str]:
    """Return descriptions of the parts of a sequence's surface that OBJ cannot store."""
    losses = lost_surface(header, held=("uvs", "colours", "hard_edges", "face_sets", "objects"))
    losses += lost_colours(header, corners=False, alpha=False)
    sets = header.surface.face_sets
    names = _material_names(sets)
    with_material = [face_set for face_set in sets if face_set.material]
    material_counts = np.zeros(len(header.polygons.counts), dtype=int)
    for face_set in with_material:
        material_counts[face_set.polygons] += 1
    if (material_counts > 1).any():
        losses.append("several materials on one polygon (the first one is written)")
    if any(face_set.name != names[face_set.material] for face_set in with_material):
        losses.append("names of face sets that differ from their materials' (the material's is written)")
    if any(len(face_set.name.split()) != 1 for face_set in sets if not face_set.material):
        losses.append("spaces in the names of face sets (underscores are written)")
    return losses


def _face_lines(header: SequenceHeader) -> list[str]:
    """Return the text of every polygon: changes of groups and material, and the face."""
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
    groups, materials = _polygon_labels(surface.face_sets, len(lines))
    for keyword, labels in (("g", groups), ("usemtl", materials)):
        previous = ""
        for polygon, label in enumerate(labels):
            if label != previous:
                lines[polygon] = f"{keyword} {label or NO_NAME}\n{lines[polygon]}"
            previous = label
    return lines


def _polygon_labels(sets: Sequence[FaceSet], count: int) -> tuple[list[str], list[str]]:
    """Return the groups and the material of every polygon."""
    names = _material_names(sets)
    groups, materials = [""] * count, [""] * count
    for face_set in sets:
        group = "_".join(face_set.name.split()) or "_"
        for polygon in face_set.polygons.tolist():
            if face_set.material:
                materials[polygon] = materials[polygon] or names[face_set.material]
            else:
                groups[polygon] = f"{groups[polygon]} {group}".lstrip()
    return groups, materials


def _material_names(sets: Sequence[FaceSet]) -> dict[str, str]:
    """Return a name for every material: the last part of its path, or the whole path if that part is not unique."""
    materials = {face_set.material for face_set in sets if face_set.material}
    names = {material: _collapse_spaces(material.rstrip("/").rpartition("/")[2]) for material in materials}
    counts = Counter(names.values())
    return {
        material: name if name and counts[name] == 1 else _collapse_spaces(material) for material, name in names.items()
    }


def _collapse_spaces(name: str) -> str:
    return " ".join(name.split())


OBJ_FORMAT = FrameFormat("OBJ", parse_obj, obj_encoder, lost_in_obj, is_text=True)
