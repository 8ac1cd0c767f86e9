"""Face sets and objects from the statements ``o``, ``g`` and ``usemtl`` of OBJ files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from mixseq.arrays import IntArray
from mixseq.polygons import Polygons
from mixseq.surface import FaceSet, MeshObject

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
