"""Numbered PLY files: one file per frame, text or binary, polygons and vertex order as in the files.

Read are the properties ``x``, ``y``, ``z`` of the vertices, the list ``vertex_indices`` (or ``vertex_index``) of the
faces, and texture coordinates: ``s t`` or ``u v`` of the vertices, or the list ``texcoord`` of the faces. Colours
``red``, ``green``, ``blue`` are read as labels of parts only (`mixseq_io.labels`). Other properties and elements
(normals, confidence) are skipped. Points keep the file's precision, ``float`` or
``double``; integers become float64.

Written are little-endian binary files in the precision of the points, texture coordinates as ``s t`` if every vertex
has a single one, else as ``texcoord``. PLY has no place for the name, times, frame rate, units, the up axis,
velocities, hard edges, face sets, objects and subdivision.

The parser is our own because trimesh refuses binary files with triangles and quads, and cuts polygons of text files
into triangles.

Specification: https://paulbourke.net/dataformats/ply/
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import FloatArray, IntArray
from mixseq.errors import FormatError
from mixseq.polygons import Polygons
from mixseq.sequence import DEFAULT_FPS, SequenceHeader
from mixseq.surface import CornerValues, Surface
from mixseq_io.losses import lost_surface
from mixseq_io.numbered.frame_files import Encoder, MeshFile, open_files, write_files
from mixseq_io.numbered.ply_elements import Columns, read_elements
from mixseq_io.reader import SequenceReader, read_whole, reading

_UV_NAMES = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))


def open_ply(path: Path, fps: float = DEFAULT_FPS, allow_gaps: bool = False) -> SequenceReader:
    """Open numbered PLY files; parameters and errors are those of `mixseq_io.numbered.frame_files.open_files`."""
    return open_files(path, ".ply", parse_ply, fps, allow_gaps)


def write_ply(
    path: Path,
    header: SequenceHeader,
    blocks: Iterable[FloatArray],
    velocities: Iterable[FloatArray] | None = None,
    start: int | None = None,
) -> None:
    """Write one PLY file per frame; parameters and errors are those of `mixseq_io.numbered.frame_files.write_files`."""
    lost = lost_surface(header, held=("uvs",))
    write_files(path, "PLY", header, blocks, velocities, ply_encoder(header), start=start, lost=lost)


def parse_ply(file: Path, like: MeshFile | None = None) -> MeshFile:
    """Read a PLY file; one whose faces are the same bytes as in `like` need not have them parsed again.

    Raises
    ------
    FormatError
        If the file is damaged, or has no vertices or faces.
    InvalidSequenceError
        If a face has less than three corners.
    """
    with reading(file, "a PLY file", ValueError, OverflowError, UnicodeDecodeError):
        elements, source = read_elements(read_whole(file), None if like is None else like.source)
        points = _side_by_side(elements.get("vertex", {}), "x", "y", "z")
        if points is None:
            raise FormatError(f"{file} cannot be read as a PLY file: it has no vertices with x, y and z")
        if like is not None and "face" not in elements:
            return MeshFile(points=points, polygons=like.polygons, source=source)
        faces = elements.get("face", {})
        if "tristrips" in elements:
            raise FormatError(f"{file} has triangle strips, which are not read; export its faces one by one")
        corners = faces.get("vertex_indices", faces.get("vertex_index"))
        if corners is None or corners.counts is None:
            raise FormatError(f"{file} cannot be read as a PLY file: it has no faces with vertex_indices")
        indices = _whole(corners.values)
    polygons = Polygons(corners.counts, indices)
    return MeshFile(
        points=points,
        polygons=polygons,
        source=source,
        surface=Surface(uvs=_uvs(file, elements, polygons)),
        colours=_colours(elements, polygons),
    )


def _side_by_side(columns: Columns, *names: str) -> FloatArray | None:
    """Return numbers (n, k) of some properties, if all are there; float32 if all are."""
    found = [columns[name].values for name in names if name in columns and columns[name].counts is None]
    if len(found) < len(names):
        return None
    single = all(each.dtype == np.float32 for each in found)
    return np.stack(found, axis=1).astype(np.float32 if single else np.float64)


def _whole(numbers: NDArray[np.generic]) -> IntArray:
    """Return indices, which text files give as float64, as integers."""
    limit = np.iinfo(np.int32).max
    values = numbers.astype(np.float64)
    if not (
        np.isfinite(values).all() and (np.abs(values) <= limit).all() and (values == np.rint(values)).all()
    ):
        raise ValueError("a face has a corner that is no vertex number")
    return values.astype(np.int32)


def _uvs(file: Path, elements: dict[str, Columns], polygons: Polygons) -> CornerValues | None:
    """Return the texture coordinates, those of faces before those of vertices; faces without get (0, 0)."""
    vertices, faces = elements["vertex"], elements["face"]
    wedges = faces.get("texcoord")
    with np.errstate(over="ignore"):
        if wedges is not None and wedges.counts is not None and wedges.counts.any():
            wrong = (wedges.counts != 0) & (wedges.counts != 2 * polygons.counts)
            if wrong.any():
                face = int(np.argmax(wrong))
                raise FormatError(
                    f"{file}, face {face} has {wedges.counts[face]} numbers of texture coordinates for "
                    f"{polygons.counts[face]} corners; it is damaged"
                )
            pairs = np.zeros((polygons.indices.size, 2), dtype=np.float32)
            pairs[np.repeat(wedges.counts > 0, polygons.counts)] = wedges.values.reshape(-1, 2)
            rows, indices = np.unique(pairs, axis=0, return_inverse=True)
            return CornerValues(rows, indices.reshape(-1))
        for names in _UV_NAMES:
            values = _side_by_side(vertices, *names)
            if values is not None:
                return CornerValues(values.astype(np.float32), polygons.indices)
    return None


def _colours(elements: dict[str, Columns], polygons: Polygons) -> FloatArray | None:
    """Return colours (sum of counts, 3) of the corners: those of their vertices, or else those of their faces."""
    names = ("red", "green", "blue")
    for element in ("vertex", "face"):
        values = _side_by_side(elements[element], *names)
        if values is not None:
            kind = elements[element]["red"].values.dtype
            # Text gives floats for integers, too.
            largest = (
                float(np.iinfo(kind).max) if kind.kind != "f" else 255.0 if values.max(initial=0) > 1 else 1.0
            )
            of_face = np.repeat(np.arange(len(polygons.counts)), polygons.counts)
            rows = polygons.indices if element == "vertex" else of_face
            # Faces may still name vertices that are not there, which is for the header to tell.
            return np.asarray(np.take(values, rows, axis=0, mode="clip") / largest) if len(values) else None
    return None


def ply_encoder(header: SequenceHeader) -> Encoder:
    """Return what turns points ``(V, 3)`` into the parts of a PLY file; the faces are made once."""
    polygons, uvs = header.polygons, header.surface.uvs
    of_vertex = None if uvs is None else _uvs_of_vertices(uvs, polygons, header.vertex_count)
    of_corner = None if uvs is None or of_vertex is not None else uvs.at_corners
    columns = ["x", "y", "z"] + ([] if of_vertex is None else ["s", "t"])
    face_lists = ["property list uint int vertex_indices"]
    face_lists += [] if of_corner is None else ["property list uint float texcoord"]
    faces = _face_bytes(polygons, of_corner)

    def encode(points: FloatArray, frame: int) -> Iterable[bytes]:
        number = points.dtype.newbyteorder("<")
        kinds = [("double" if points.dtype == np.float64 else "float")] * 3 + ["float", "float"]
        properties = [f"property {kind} {name}" for kind, name in zip(kinds, columns, strict=False)]
        lines = (
            "ply",
            "format binary_little_endian 1.0",
            "comment Written by mixseq",
            f"element vertex {len(points)}",
            *properties,
            f"element face {len(polygons.counts)}",
            *face_lists,
            "end_header",
        )
        yield "".join(f"{line}\n" for line in lines).encode()
        rows = np.empty(len(points), dtype=[("points", number, 3), ("uvs", "<f4", len(columns) - 3)])
        rows["points"] = points
        if of_vertex is not None:
            rows["uvs"] = of_vertex
        yield rows.tobytes()
        yield faces

    return encode


def _uvs_of_vertices(uvs: CornerValues, polygons: Polygons, count: int) -> NDArray[np.float32] | None:
    """Return the texture coordinates (V, 2) of vertices, if none has several."""
    values = np.zeros((count, 2), dtype=np.float32)
    values[polygons.indices] = uvs.at_corners
    return values if np.array_equal(values[polygons.indices], uvs.at_corners) else None


def _face_bytes(polygons: Polygons, uvs: NDArray[np.float32] | None) -> bytes:
    """Return the rows of the faces: the number of corners and the corners, and maybe the same of their uvs.

    All numbers have four bytes, so that rows of any lengths are laid out at once in an array of such words.
    """
    counts = polygons.counts.astype(np.int64)
    lengths = 1 + counts if uvs is None else 2 + 3 * counts
    starts = np.cumsum(lengths) - lengths
    words = np.empty(int(lengths.sum()), dtype="<i4")
    step = np.arange(polygons.indices.size) - np.repeat(np.cumsum(counts) - counts, counts)
    words[starts] = counts
    words[np.repeat(starts + 1, counts) + step] = polygons.indices
    if uvs is not None:
        words[starts + 1 + counts] = 2 * counts
        place = np.repeat(starts + 2 + counts, counts) + 2 * step
        pairs = np.ascontiguousarray(uvs, dtype="<f4").view("<i4")
        words[place], words[place + 1] = pairs[:, 0], pairs[:, 1]
    return words.tobytes()
