"""Numbered OFF files: one text file per frame, read by trimesh, which triangulates quads.

Vertices and faces of OFF and COFF files are read, with colours of vertices. Points are written with the digits that
give back the same float32 or float64, stated by a comment; points of other files are read as float64. OFF has no place
for polygons, the name, times, frame rate, units, the up axis, velocities, and the surface but one colour per vertex.

Specification: http://www.geomview.org/docs/html/OFF.html
"""

from __future__ import annotations

from collections.abc import Iterable
from io import StringIO
from pathlib import Path

import numpy as np

from mixseq.arrays import FloatArray
from mixseq.errors import FormatError
from mixseq.polygons import Polygons
from mixseq.sequence import SequenceHeader
from mixseq.surface import CornerValues, Surface
from mixseq_io.colours import colours_of_vertices, with_alpha
from mixseq_io.losses import lost_colours, lost_polygons, lost_surface
from mixseq_io.numbered.frame_files import Encoder, FrameFormat, MeshFile
from mixseq_io.numbered.text_lines import WRITTEN_BY, colours_of_words, excerpt, number_lines

_COLOUR = 4
"""Largest number of values behind the corners of a face."""


def parse_off(file: Path, data: bytes, like: MeshFile | None) -> MeshFile:
    """Parse an OFF file."""
    from trimesh.exchange.off import load_off

    lines = [line for each in data.splitlines() if (line := each.partition(b"#")[0].strip())]
    of_vertices = _check_lines(file, lines)
    text = b"\n".join(lines).decode("ascii")
    if len(text.splitlines()) != len(lines):
        raise ValueError("it has characters that end a line of text only")
    mesh = load_off(StringIO(text))
    is_single = data.removeprefix(b"C").startswith(b"OFF\n" + WRITTEN_BY + b"float32")
    polygons = Polygons.from_triangles(np.asarray(mesh["faces"]).reshape(-1, 3).astype(np.int64))
    coloured = lines[0].startswith(b"C") and not (like is not None and like.told)
    texts = [b"".join(line.split(None, 3)[3:]) for line in of_vertices] if coloured else []
    colour_text = b"\n".join(texts)
    if like is not None and colour_text == like.colour_text:
        surface = like.surface
    else:
        numbers = _colours(file, texts, like)
        surface = Surface(colours=None if numbers is None else CornerValues(numbers, polygons.indices))
    return MeshFile(
        points=np.asarray(mesh["vertices"]).astype(np.float32 if is_single else np.float64),
        polygons=polygons,
        surface=surface,
        colour_text=colour_text,
    )


def _colours(file: Path, texts: list[bytes], like: MeshFile | None) -> FloatArray | None:
    """Return the colours ``(V, 4)`` of vertices, if all have three or all have four numbers."""
    rows = [text.split() for text in texts]
    if not rows or len(rows[0]) not in (3, 4) or any(len(row) != len(rows[0]) for row in rows):
        return None
    return with_alpha(colours_of_words(file, range(len(rows)), rows, like))


def _check_lines(file: Path, lines: list[bytes]) -> list[bytes]:
    """Return the lines of vertices; refuse other numbers of lines or corners than announced, which trimesh ignores."""
    first = lines[0].removeprefix(b"C").removeprefix(b"OFF").split() if lines else []
    counts = [int(word) for word in (first or (lines[1].split() if len(lines) > 1 else []))[:2]]
    vertices, faces = counts if len(counts) == 2 and min(counts) >= 0 else (0, 0)
    body = lines[1 if first else 2 :]
    if not body or len(body) != vertices + faces:
        raise FormatError(
            f"{file} announces {vertices} vertices and {faces} faces and has {len(body)} lines of them; it is "
            "truncated or damaged, write it again"
        )
    for face, line in enumerate(body[vertices:]):
        words = line.split()
        corners = int(words[0])
        if corners < 3 or not 0 <= len(words) - 1 - corners <= _COLOUR:
            raise FormatError(
                f"{file}, face {face}: {excerpt(line)} is not a face; a number of corners, 3 or more, and so many "
                "numbers of vertices are expected"
            )
    return body[:vertices]


def _encoder(path: Path, header: SequenceHeader) -> Encoder:
    counts = f"{header.vertex_count} {len(header.faces)} 0\n".encode()
    faces = "".join(f"3 {a} {b} {c}\n" for a, b, c in header.faces.tolist()).encode()
    colours = colours_of_vertices(header, 4)
    kind = b"COFF\n" if colours else b"OFF\n"

    def encode(points: FloatArray, frame: int) -> Iterable[bytes]:
        yield kind + WRITTEN_BY + str(points.dtype).encode() + b"\n" + counts
        yield number_lines("", points, colours)
        yield faces

    return encode


def _lost(header: SequenceHeader) -> list[str]:
    return (
        lost_surface(header, held=("colours",)) + lost_colours(header, corners=False) + lost_polygons(header)
    )


OFF = FrameFormat(
    "OFF",
    parse_off,
    _encoder,
    _lost,
    is_text=True,
    damage=(ValueError, TypeError, IndexError, NameError, OverflowError),
)
