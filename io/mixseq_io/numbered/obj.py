"""Numbered Wavefront OBJ files: one text file per frame, polygons and vertex order as in the files.

==================================  ==============================================================
in the file                         here
==================================  ==============================================================
``v``, without weights and colours  points
``f``                               polygons
``vt``                              texture coordinates, of the first frame
``vn``                              hard edges: where the first frame has several normals at a vertex
``o``, one                          the name
``o``, several                      objects, if each has vertices of its own that follow each other,
                                    else face sets
``usemtl``                          face sets with that material
``g``                               face sets without a material; ``g a b`` is in both
==================================  ==============================================================

The parser is our own because the order of vertices matters here: trimesh, for one, merges vertices, splits those
with several texture coordinates, and cuts polygons into triangles.

Points are written with the digits that give back the same float32 or float64. Comments in our own files tell which
of them it was, and whether the file is whole; points of other files are read as float64. Normals are only written
where there are hard edges, anew for every frame; one across which the first frame is flat cannot be told from none
when they are read. A name of a material is the last part of its path. OBJ has no place
for times, frame rate, units, the up axis, velocities, subdivision, and two materials on one polygon; the library of
materials (``mtllib``) is not kept.

Specification: https://paulbourke.net/dataformats/obj/
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from mixseq.arrays import FloatArray
from mixseq.sequence import DEFAULT_FPS, SequenceHeader
from mixseq_io.numbered.files import open_files, write_files
from mixseq_io.numbered.obj_encoder import lost_in_obj, obj_encoder
from mixseq_io.numbered.obj_parser import parse_obj
from mixseq_io.reader import SequenceReader


def open_obj(path: Path, fps: float = DEFAULT_FPS, allow_gaps: bool = False) -> SequenceReader:
    """Open numbered OBJ files; parameters and errors are those of `mixseq_io.numbered.files.open_files`."""
    return open_files(path, ".obj", parse_obj, fps, allow_gaps)


def write_obj(
    path: Path,
    header: SequenceHeader,
    blocks: Iterable[FloatArray],
    velocities: Iterable[FloatArray] | None = None,
    start: int = 1,
) -> None:
    """Write one OBJ file per frame; parameters and errors are those of `mixseq_io.numbered.files.write_files`."""
    write_files(
        path,
        "OBJ",
        header,
        blocks,
        velocities,
        obj_encoder(header),
        start=start,
        lost=lost_in_obj(header),
    )
