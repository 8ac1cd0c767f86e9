"""Polygons of a mesh in Blender and their attributes, from a model's header."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mixseq.arrays import FloatArray, Index, IntArray, Mask
from mixseq.blender.motion import part_of
from mixseq.sequence_header import SequenceHeader


@dataclass(frozen=True, eq=False)
class MeshParts:
    """One of the meshes of a model.

    Of P polygons: `counts` (P,) int32 of corners; `corners` (C,) int32, vertices numbered from the mesh's first. Per
    corner, or None: `uvs` (C, 2) and linear `colours` (C, 4) RGBA float32; `groups` (C,) int32, equal for corners of a
    vertex with one normal. Names of `materials`, and `material_of_polygon` (P,) int32.
    """

    counts: IntArray
    corners: IntArray
    uvs: FloatArray | None
    colours: FloatArray | None
    groups: IntArray | None
    materials: tuple[str, ...]
    material_of_polygon: IntArray

    @classmethod
    def of(cls, header: SequenceHeader, name: str) -> MeshParts:
        """Return the mesh of a name, with the errors of `part_of`."""
        vertices, polygons = part_of(header, name)
        ends = np.concatenate([[0], np.cumsum(header.polygons.counts)])
        corners = slice(ends[polygons.start], ends[polygons.stop])
        surface = header.surface
        materials, of_polygon = _materials(header)
        used, slots = np.unique(of_polygon[polygons], return_inverse=True)
        return cls(
            header.polygons.counts[polygons],
            header.polygons.indices[corners] - vertices.start,
            None if surface.uvs is None else surface.uvs.at_corners[corners],
            None if surface.colours is None else surface.colours.at_corners[corners],
            None if surface.hard_edges is None else surface.hard_edges[corners],
            tuple(materials[number] for number in used),
            slots.astype(np.int32).reshape(-1),
        )

    @property
    def starts(self) -> Index:
        """First corner ``(P,)`` of every polygon."""
        return np.cumsum(self.counts) - self.counts

    def sharp(self, edges: IntArray) -> Mask:
        """Return which edges are hard: adjacent corners at an end have separate normals; edges ``(sum of counts,)``."""
        hard = np.zeros(int(edges.max(initial=-1)) + 1, dtype=bool)
        if self.groups is None:
            return hard
        after = np.arange(1, len(edges) + 1)
        after[self.starts + self.counts - 1] = self.starts
        ends = np.concatenate(
            [np.arange(len(edges)), after]
        )  # the two corners of a polygon at every edge of it
        rows = np.column_stack([np.tile(edges, 2), self.corners[ends], self.groups[ends]])
        rows = rows[np.lexsort(rows.T[::-1])]
        beside = (rows[1:, :2] == rows[:-1, :2]).all(axis=1)
        hard[rows[1:][beside & (rows[1:, 2] != rows[:-1, 2]), 0]] = True
        return hard


def _materials(header: SequenceHeader) -> tuple[list[str], IntArray]:
    """Return names of materials, and the material of every polygon; of polygons in no face set that of none."""
    names = [""]
    of_polygon = np.zeros(len(header.polygons.counts), dtype=np.int32)
    for face_set in header.surface.face_sets:
        name = face_set.material.rpartition("/")[2] or face_set.name
        if name not in names:
            names.append(name)
        of_polygon[face_set.polygons] = names.index(name)
    return names, of_polygon
