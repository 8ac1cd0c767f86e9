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
from itertools import pairwise
from pathlib import Path

import numpy as np

from mixseq.arrays import FloatArray
from mixseq.geometry.normals import shared_normals
from mixseq.sequence import SequenceHeader
from mixseq.surface import FaceSet
from mixseq_io.colours import colours_of_vertices
from mixseq_io.losses import lost_colours, lost_surface
from mixseq_io.numbered.frame_files import Encoder, FrameFormat
from mixseq_io.numbered.obj_groups import NOTHING
from mixseq_io.numbered.obj_parser import LAST_LINE, parse_obj
from mixseq_io.numbered.text_lines import WRITTEN_BY, number_lines


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
    colours = colours_of_vertices(header, 3)

    def encode(points: FloatArray, frame: int) -> Iterable[bytes]:
        yield WRITTEN_BY + str(points.dtype).encode() + b"\n"
        yield uvs
        if hard_edges is not None:
            yield number_lines("vn ", shared_normals(points[None], header.polygons, hard_edges)[0])
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
