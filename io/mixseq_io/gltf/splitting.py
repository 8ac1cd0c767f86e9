"""A mesh as glTF holds it: triangles by material, one vertex per combination of everything at a corner.

glTF's primitives have one material and one index for all attributes of a vertex, so that a vertex at a seam of the
texture, at a hard edge, or between materials becomes several. Every one of them tells which it was in the attribute
``_VERTEX``, so that they can be welded again without guessing.

Specification: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html#meshes
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import IntArray
from mixseq.polygons import Polygons
from mixseq.surface import FaceSet
from mixseq_io.scene_meshes import SceneMesh


@dataclass(frozen=True, eq=False)
class Primitive:
    """Triangles of one material, and their vertices.

    Parameters
    ----------
    vertices : (n,) int
        Vertex of the mesh that each glTF vertex is a copy of.
    normals : (n,) int
        Its group of corners that share a normal, see `mixseq.geometry.normals.shared_normals`.
    uvs : (n, 2) float32 or None
        Its texture coordinates, v upwards.
    triangles : (m, 3) uint32
        Indices of glTF vertices.
    face_set : FaceSet or None
        The face set that the triangles are of.
    """

    vertices: IntArray
    normals: IntArray
    uvs: NDArray[np.float32] | None
    triangles: NDArray[np.uint32]
    face_set: FaceSet | None


def split_corners(mesh: SceneMesh) -> list[Primitive]:
    """Split a mesh into primitives: one per face set that has polygons of its own, one for the rest.

    Vertices keep their order within a primitive. Those that no polygon uses are in the first one, without
    triangles, so that their number stays the same.
    """
    owner = owners(mesh)
    of_corner = np.repeat(owner, mesh.polygons.counts)
    groups = mesh.polygons.indices if mesh.hard_edges is None else mesh.hard_edges
    rows = np.zeros_like(groups) if mesh.uvs is None else mesh.uvs.indices
    keys = np.stack([mesh.polygons.indices, groups, rows], axis=1)
    triangles = Polygons(mesh.polygons.counts, np.arange(of_corner.size)).triangles  # of corners
    unused = np.setdiff1d(np.arange(mesh.vertex_count), mesh.polygons.indices)
    unused_keys = np.stack([unused, np.zeros_like(unused), np.zeros_like(unused)], axis=1)
    primitives: list[Primitive] = []
    for number in np.unique(owner):
        corners = np.flatnonzero(of_corner == number)
        some = np.concatenate([keys[corners], unused_keys if not primitives else unused_keys[:0]])
        found, copies = np.unique(some, axis=0, return_inverse=True)
        place = np.zeros(of_corner.size, dtype=np.uint32)
        place[corners] = copies.reshape(-1)[: corners.size]
        primitives.append(
            Primitive(
                vertices=found[:, 0],
                normals=found[:, 1],
                uvs=None if mesh.uvs is None else mesh.uvs.values[found[:, 2]],
                triangles=place[triangles[of_corner[triangles[:, 0]] == number]],
                face_set=None if number < 0 else mesh.face_sets[number],
            )
        )
    return primitives


def owners(mesh: SceneMesh) -> IntArray:
    """Return which of the face sets has each polygon ``(P,)``, -1 for none.

    Where they overlap, the first with a material wins, then the first.
    """
    owner = np.full(len(mesh.polygons.counts), -1)
    numbers = [number for number, each in enumerate(mesh.face_sets) if distinguishes(each, mesh)]
    for number in sorted(numbers, key=lambda number: not mesh.face_sets[number].material)[::-1]:
        owner[mesh.face_sets[number].polygons] = number
    return owner


def distinguishes(face_set: FaceSet, mesh: SceneMesh) -> bool:
    """Whether a face set tells more than that these are all polygons of the mesh."""
    return bool(face_set.material) or face_set.polygons.size < len(mesh.polygons.counts)
