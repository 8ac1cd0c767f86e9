"""Read and write numbered OFF and STL files, which store only triangles, and no surface but colours of OFF's vertices.

OFF and COFF files are text. They are read by trimesh, which triangulates quads. Points are written with enough digits
to restore the same float32 or float64; a comment states this precision. Points of files without this comment are read
as float64. Specification: http://www.geomview.org/docs/html/OFF.html

STL stores the three positions of every triangle. Corners that coincide in all frames become one vertex, so that parts
that touch in some frames only stay apart; vertices are numbered in order of appearance. Programs that compute a vertex
once per triangle leave its corners apart in the last digit: such cracks are closed in the first frame. Binary files are
float32; text is read as float64, with all solids as one mesh. Files are written as binary with normals. Text has its
own parser: trimesh 5.2 skips invalid lines and data after an unclosed solid (100 of 732 damaged files were read), and
rejects a solid with "vertex" in its name.
Specification: https://www.loc.gov/preservation/digital/formats/fdd/fdd000504.shtml
"""

from __future__ import annotations

from collections.abc import Iterable
from io import StringIO
from pathlib import Path

import numpy as np

from mixseq.errors import FormatError, InvalidSequenceError
from mixseq.mesh.measures import vector_areas
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import CornerValues, Surface
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
from mixseq_io.reader import DamageError, as_float32, warn
from mixseq_io.surfaces import (
    ensure_alpha,
    format_vertex_colours,
    lost_colours,
    lost_polygons,
    lost_surface,
    renumber_by_appearance,
)

_MAX_FACE_COLOUR_VALUES = 4
"""Largest number of colour values that may follow the corners of a face."""


def parse_off(file: Path, data: bytes, first: MeshFile | None) -> MeshFile:
    """Parse an OFF file."""
    from trimesh.exchange.off import load_off

    data = strip_byte_order_mark(file, data, "an OFF file")
    lines = [content for line in data.splitlines() if (content := line.partition(b"#")[0].strip())]
    vertex_lines = _vertex_lines(file, lines)
    text = b"\n".join(lines).decode("ascii")
    if len(text.splitlines()) != len(lines):
        raise DamageError("it has line breaks of text files within a line")
    mesh = load_off(StringIO(text))
    is_single = data.removeprefix(b"C").startswith(b"OFF\n" + PRECISION_COMMENT + b"float32")
    polygons = Polygons.from_triangles(np.asarray(mesh["faces"]).reshape(-1, 3).astype(np.int64))
    has_colours = lines[0].startswith(b"C") and not (first is not None and first.has_changing_colours)
    texts = [b"".join(line.split(None, 3)[3:]) for line in vertex_lines] if has_colours else []
    colour_text = b"\n".join(texts)
    if first is not None and colour_text == first.colour_text:
        surface = first.surface
    else:
        colours = _colours(file, texts, first)
        surface = Surface(colours=None if colours is None else CornerValues(colours, polygons.indices))
    return MeshFile(
        points=np.asarray(mesh["vertices"]).astype(np.float32 if is_single else np.float64),
        polygons=polygons,
        surface=surface,
        colour_text=colour_text,
    )


def _colours(file: Path, texts: list[bytes], first: MeshFile | None) -> FloatArray | None:
    """Return the colours ``(V, 4)`` of vertices if all colours have three or all have four numbers, else None."""
    rows = [text.split() for text in texts]
    if not rows or len(rows[0]) not in (3, 4) or any(len(row) != len(rows[0]) for row in rows):
        return None
    return ensure_alpha(parse_colours(file, range(len(rows)), rows, first))


def _vertex_lines(file: Path, lines: list[bytes]) -> list[bytes]:
    """Return the lines of vertices; reject a file whose numbers of lines or corners differ from the stated counts."""
    counts_on_first_line = lines[0].removeprefix(b"C").removeprefix(b"OFF").split() if lines else []
    words = counts_on_first_line or (lines[1].split() if len(lines) > 1 else [])
    counts = [int(word) for word in words[:2]]
    vertices, faces = counts if len(counts) == 2 and min(counts) >= 0 else (0, 0)
    body = lines[1 if counts_on_first_line else 2 :]
    if not body or len(body) != vertices + faces:
        raise FormatError(
            f"{file} announces {vertices} vertices and {faces} faces and has {len(body)} lines of them; it is "
            "truncated or damaged, write it again"
        )
    for face, line in enumerate(body[vertices:]):
        words = line.split()
        corners = int(words[0])
        if corners < 3 or not 0 <= len(words) - 1 - corners <= _MAX_FACE_COLOUR_VALUES:
            raise FormatError(
                f"{file}, face {face}: {quote_line(line)} is not a face; a number of corners, 3 or more, and a vertex "
                "number for each are expected"
            )
    return body[:vertices]


def _off_encoder(path: Path, header: SequenceHeader) -> Encoder:
    counts = f"{header.vertex_count} {len(header.faces)} 0\n".encode()
    faces = "".join(f"3 {a} {b} {c}\n" for a, b, c in header.faces.tolist()).encode()
    colours = format_vertex_colours(header, 4)
    kind = b"COFF\n" if colours else b"OFF\n"

    def encode(points: FloatArray, frame: int) -> Iterable[bytes]:
        yield kind + PRECISION_COMMENT + str(points.dtype).encode() + b"\n" + counts
        yield format_number_lines("", points, colours)
        yield faces

    return encode


OFF_FORMAT = FrameFormat(
    "OFF",
    parse_off,
    _off_encoder,
    lambda header: [
        *lost_surface(header, held=("colours",)),
        *lost_colours(header, corners=False),
        *lost_polygons(header),
    ],
    is_text=True,
    damage_errors=(ValueError, TypeError, IndexError, NameError, OverflowError),
)


_TRIANGLE_DTYPE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_PREAMBLE_BYTES = 80
_MAX_WELD_STEPS = 4.0  # largest difference of coordinates of one vertex, in steps of float32 or of the last digit
_MAX_TEXT_DECIMALS = 12  # decimals beyond which text is as fine as float32
_MAX_TEXT_STEP = 1e-5  # coarsest last digit of text relative to the largest coordinate: six digits
_FAR_COORDINATE = 1e300  # in place of infinite coordinates in searches


def parse_stl(file: Path, data: bytes, first: MeshFile | None) -> MeshFile:
    """Parse an STL file; of the corners that are one vertex in other frames, weld those that coincide in this one."""
    corners = _read_corners(file, data)
    if first is None:
        indices, first_corners = _weld(corners)
    elif len(corners) == first.polygons.indices.size:
        indices, first_corners = _split(corners, first.polygons.indices, first.stored_faces)
    else:
        raise InvalidSequenceError(
            f"it has {len(corners) // 3} triangles, the first frame has {first.polygons.indices.size // 3}; every "
            "frame needs the same triangles in the same order"
        )
    polygons = Polygons(np.full(len(corners) // 3, 3), indices)
    return MeshFile(points=corners[first_corners], polygons=polygons, stored_faces=first_corners)


def _weld(corners: FloatArray) -> tuple[IntArray, IntArray]:
    """Weld corners ``(3 F, 3)``, also across cracks by rounding; return vertices ``(3 F,)``, first corners ``(V,)``."""
    points, indices = np.unique(corners + 0.0, axis=0, return_inverse=True)  # + 0.0 turns -0 into 0
    triangles = indices.reshape(-1, 3)
    edges, uses = np.unique(np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)), axis=0, return_counts=True)
    crack_ids = np.unique(edges[uses % 2 == 1])
    clusters = np.arange(len(points))
    clusters[crack_ids] = crack_ids[_cluster(points[crack_ids], _weld_tolerance(corners))]
    welded, is_distinct = clusters[triangles], triangles != np.roll(triangles, 1, axis=1)
    is_lost = (is_distinct & (welded == np.roll(welded, 1, axis=1))).any(axis=1)
    is_lost_cluster = np.isin(clusters, welded[is_lost])  # their triangles are as small as rounding
    clusters[is_lost_cluster] = np.flatnonzero(is_lost_cluster)
    return renumber_by_appearance(clusters[indices.reshape(-1)])


def _split(corners: FloatArray, vertices: IntArray, first_corners: IntArray) -> tuple[IntArray, IntArray]:
    """Split vertices ``(3 F,)`` of other frames, with first corners ``(V,)``, where corners ``(3 F, 3)`` are apart."""
    at_vertices = corners[first_corners][vertices]
    if np.array_equal(at_vertices, corners):
        return vertices, first_corners
    tolerance = _weld_tolerance(corners)
    is_near = (np.abs(corners - at_vertices) <= tolerance).all(axis=1)
    if is_near.all():
        return vertices, first_corners
    clusters = np.array(first_corners)[vertices]
    split_corners = np.flatnonzero(np.isin(vertices, vertices[~is_near]))
    rows, row_ids = np.unique(
        np.column_stack([vertices[split_corners], corners[split_corners]]), axis=0, return_inverse=True
    )
    labels = _cluster(rows[:, 1:], tolerance, rows[:, 0])[row_ids.reshape(-1)]
    clusters[split_corners] = len(corners) + labels
    return renumber_by_appearance(clusters)


def _cluster(points: FloatArray, tolerance: float, groups: FloatArray | None = None) -> IntArray:
    """Return a point of its cluster for each point ``(n, 3)``: neighbours by tolerance, of equal groups if given."""
    from scipy.sparse import coo_array, csgraph
    from scipy.spatial import KDTree

    finite = np.nan_to_num(
        points.astype(np.float64), nan=_FAR_COORDINATE, posinf=_FAR_COORDINATE, neginf=-_FAR_COORDINATE
    )  # reported later
    pairs = KDTree(finite).query_pairs(tolerance, p=np.inf, output_type="ndarray")
    if groups is not None:
        pairs = pairs[groups[pairs[:, 0]] == groups[pairs[:, 1]]]
    graph = coo_array((np.ones(len(pairs)), pairs.T), shape=(len(points), len(points)))
    _, labels = csgraph.connected_components(graph, directed=False)
    return np.unique(labels, return_index=True)[1][labels]


def _weld_tolerance(corners: FloatArray) -> float:
    """Return the largest difference of coordinates between corners of a vertex, from the last digits of a file."""
    sizes = np.abs(corners[np.isfinite(corners)]).astype(np.float64)
    largest = float(sizes.max(initial=0.0))
    step = float(np.spacing(np.float32(largest)))
    if corners.dtype == np.float64:  # text, where the largest numbers have the coarsest last digits
        coarse = sizes[sizes >= largest / 10]
        decimals = next((d for d in range(_MAX_TEXT_DECIMALS) if (coarse.round(d) == coarse).all()), _MAX_TEXT_DECIMALS)
        step = max(step, min(10.0**-decimals, _MAX_TEXT_STEP * largest))
    return _MAX_WELD_STEPS * step


def _read_corners(file: Path, data: bytes) -> FloatArray:
    """Return the corners ``(3 F, 3)``, as float32 for a binary file, as float64 for a text file."""
    start = _PREAMBLE_BYTES + 4
    count = int.from_bytes(data[_PREAMBLE_BYTES:start], "little")
    if len(data) >= start and len(data) == start + count * _TRIANGLE_DTYPE.itemsize:
        triangles = np.frombuffer(data, _TRIANGLE_DTYPE, count, start)
        return np.ascontiguousarray(triangles["corners"].reshape(-1, 3), dtype=np.float32)
    data = strip_byte_order_mark(file, data, "an STL file")
    if data.lstrip()[:5].lower() == b"solid":
        return _parse_text(file, data)
    raise FormatError(
        f"{file} cannot be read as an STL file: it has {len(data)} bytes, {count} triangles need "
        f"{start + count * _TRIANGLE_DTYPE.itemsize}; it is truncated, damaged or of another type"
    )


def _parse_text(file: Path, data: bytes) -> FloatArray:
    corners: list[list[float]] = []
    open_solid = False
    facets = 0
    for number, line in enumerate(data.splitlines(), start=1):
        match line.lower().split():
            case [b"solid", *_] if not open_solid:
                open_solid = True
            case [b"endsolid", *_] if open_solid and len(corners) == 3 * facets:
                open_solid = False
            case [b"endfacet" | b"end", *_] if open_solid and len(corners) == 3 * facets:
                pass
            case [b"facet", *_] if open_solid and len(corners) == 3 * facets:
                facets += 1
            case [b"vertex", x, y, z] if open_solid:
                corners.append(_parse_vertex(file, number, line, (x, y, z)))
            case [] | [b"outer" | b"endloop" | b"color", *_]:
                pass
            case _:
                raise FormatError(
                    f"{file}, line {number}: {quote_line(line)} is not expected here; an STL file has solids of "
                    "facets of three vertices"
                )
    if open_solid:
        raise FormatError(f"{file} ends in the middle: endsolid is missing; it is truncated, write it again")
    return np.array(corners, dtype=np.float64).reshape(-1, 3)


def _parse_vertex(file: Path, number: int, line: bytes, words: tuple[bytes, ...]) -> list[float]:
    try:
        return [float(word) for word in words]
    except ValueError:
        raise FormatError(
            f"{file}, line {number}: {quote_line(line)} is not a vertex; three numbers are expected"
        ) from None


def _stl_encoder(path: Path, header: SequenceHeader) -> Encoder:
    polygons = Polygons.from_triangles(header.faces)
    welded: list[IntArray] = []  # vertices and first corners that will be read of the frames so far

    def encode(points: FloatArray, frame: int) -> Iterable[bytes]:
        single = as_float32(points[None], frame, "STL", header=header)
        triangles = np.zeros(len(header.faces), dtype=_TRIANGLE_DTYPE)
        areas = vector_areas(single, polygons)[0]
        lengths = np.linalg.norm(areas, axis=1, keepdims=True)
        triangles["normal"] = areas / np.where(lengths > 0, lengths, 1.0)
        triangles["corners"] = single[0][header.faces]
        corners = triangles["corners"].reshape(-1, 3)
        welded[:] = _split(corners, *welded) if welded else _weld(corners)
        if frame == header.frame_count - 1:
            _warn_of_changed_vertices(path, header, *welded)
        yield b"Written by mixseq".ljust(_PREAMBLE_BYTES) + len(triangles).to_bytes(4, "little")
        yield triangles.tobytes()

    return encode


def _warn_of_changed_vertices(path: Path, header: SequenceHeader, indices: IntArray, first_corners: IntArray) -> None:
    if len(first_corners) != header.vertex_count:
        warn(
            f"{path}: STL stores no shared vertices; {len(first_corners)} will be read instead of "
            f"{header.vertex_count}, as unused ones are lost and those at one position in all frames are merged; "
            "OBJ and PLY keep them"
        )
    elif not np.array_equal(indices, header.faces.reshape(-1)):
        warn(f"{path}: STL stores no vertex order; vertices will be read in another; OBJ and PLY keep it")


STL_FORMAT = FrameFormat(
    "STL", parse_stl, _stl_encoder, lambda header: lost_surface(header) + lost_polygons(header), is_welded=True
)
