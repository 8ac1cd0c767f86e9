"""Several meshes of a file joined into one sequence, and split into meshes again.

Readers make a `SceneMesh` of every mesh and `join` them; writers `split` a header into its meshes. Mesh ``i`` owns the
vertices ``meshes[i].vertices`` of every frame.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mixseq.arrays import Index, IntArray
from mixseq.coding.renumbering import numbering_of
from mixseq.polygon_matching import PolygonMatch, matched
from mixseq.polygons import Polygons
from mixseq.sequence import SequenceHeader
from mixseq.surface import NO_UV, WHITE, CornerValues, FaceSet, MeshObject, Origin, Surface


@dataclass(frozen=True, eq=False, kw_only=True)
class SceneMesh:
    """Mesh of a scene: `polygons` by its own vertices, and its surface, see `Surface` and `MeshObject`.

    `vertices` are a slice or ``(V,)`` int64 of the sequence's vertices. A face set of all polygons is the whole mesh's
    material.
    """

    name: str
    path: str
    vertices: slice | Index
    polygons: Polygons
    uvs: CornerValues | None = None
    colours: CornerValues | None = None
    hard_edges: IntArray | None = None
    face_sets: tuple[FaceSet, ...] = ()
    subdivision: str = "none"

    @property
    def vertex_count(self) -> int:
        """Number of vertices V."""
        if isinstance(self.vertices, slice):
            return int(self.vertices.stop - self.vertices.start)
        return len(self.vertices)

    def as_numbered(self, original: Polygons) -> SceneMesh | None:
        """Return the mesh with the vertex order of a file (only compressed models renumber), None for another mesh."""
        found = numbering_of(self.polygons, original, [self.vertex_count])
        if found is None or found.order != "free":
            return None if found is None else self
        order = found.inverse.vertices
        vertices = (
            np.arange(self.vertices.start, self.vertices.stop)
            if isinstance(self.vertices, slice)
            else self.vertices
        )
        return replace(
            self,
            vertices=vertices[order],
            polygons=Polygons(self.polygons.counts, found.vertices[self.polygons.indices]),
        )

    def matched_to(self, original: Polygons) -> tuple[SceneMesh, PolygonMatch] | None:
        """Return the mesh as `as_numbered`, and the match of its polygons with the file's; None for another mesh."""
        ours = self.as_numbered(original)
        match = None if ours is None else matched(original, ours.polygons)
        return None if ours is None or match is None else (ours, match)


def join(meshes: Sequence[SceneMesh], origin: Origin | None) -> tuple[Polygons, Surface]:
    """Join meshes into one, their vertices concatenated."""
    first_vertex = np.cumsum([0, *(mesh.vertex_count for mesh in meshes)])
    polygons = Polygons(
        np.concatenate([mesh.polygons.counts for mesh in meshes]),
        np.concatenate(
            [mesh.polygons.indices + first for mesh, first in zip(meshes, first_vertex, strict=False)]
        ),
    )
    first_polygon = np.cumsum([0, *(len(mesh.polygons.counts) for mesh in meshes)])
    usual = Counter(mesh.subdivision for mesh in meshes).most_common(1)[0][0]
    surface = Surface(
        uvs=_joined_values(meshes, [mesh.uvs for mesh in meshes], NO_UV),
        colours=_joined_values(meshes, [mesh.colours for mesh in meshes], WHITE),
        hard_edges=_joined_hard_edges(meshes),
        face_sets=tuple(
            FaceSet(each.name, each.polygons + first, each.material)
            for mesh, first in zip(meshes, first_polygon, strict=False)
            for each in mesh.face_sets
        ),
        objects=tuple(
            MeshObject(
                mesh.name,
                mesh.path,
                mesh.vertex_count,
                len(mesh.polygons.counts),
                subdivision=None if mesh.subdivision == usual else mesh.subdivision,
            )
            for mesh in meshes
        ),
        subdivision=usual,
        origin=origin,
    )
    return polygons, surface


def _joined_values(
    meshes: Sequence[SceneMesh], on: Sequence[CornerValues | None], default: Sequence[float]
) -> CornerValues | None:
    """Concatenate welded values of all meshes; meshes without values get the default. None if none has any."""
    if all(own is None for own in on):
        return None
    values, indices, count = [], [], 0
    for mesh, own in zip(meshes, on, strict=True):
        there = own or CornerValues(np.array([default]), np.zeros(mesh.polygons.indices.size, dtype=np.int32))
        welded = there.welded(mesh.polygons.indices)
        values.append(welded.values)
        indices.append(welded.indices + count)
        count += len(welded.values)
    return CornerValues(np.concatenate(values), np.concatenate(indices))


def _joined_hard_edges(meshes: Sequence[SceneMesh]) -> IntArray | None:
    """Concatenate indices of normals ``(corners,)``; meshes without hard edges have one normal per vertex."""
    if all(mesh.hard_edges is None for mesh in meshes):
        return None
    joined, count = [], 0
    for mesh in meshes:
        hard_edges = mesh.polygons.indices if mesh.hard_edges is None else mesh.hard_edges
        joined.append(hard_edges + count)
        count += int(hard_edges.max(initial=-1)) + 1
    return np.concatenate(joined)


def material_of_the_rest(path: str, polygon_count: int, bound: Iterable[FaceSet]) -> tuple[FaceSet, ...]:
    """Return a mesh's material as a face set of the polygons ``(P,)`` that no bound face set contains, if any."""
    taken = [each.polygons for each in bound]
    rest = np.setdiff1d(np.arange(polygon_count), np.concatenate(taken) if taken else ())
    return (FaceSet(path.rpartition("/")[2], rest, path),) if rest.size else ()


def split(header: SequenceHeader) -> list[SceneMesh]:
    """Return the meshes that a sequence joins, in order, without defaults added by `join`."""
    surface, polygons = header.surface, header.polygons
    corners = np.concatenate([[0], np.cumsum(polygons.counts)])
    several = len(header.objects) > 1
    meshes, vertex, polygon = [], 0, 0
    for each, scheme in zip(header.objects, surface.subdivisions, strict=True):
        end = polygon + each.polygon_count
        inside = slice(int(corners[polygon]), int(corners[end]))
        own = Polygons(polygons.counts[polygon:end], polygons.indices[inside] - vertex)
        hard_edges = None if surface.hard_edges is None else _renumbered(surface.hard_edges[inside])
        if several and hard_edges is not None and _is_smooth(own, hard_edges):
            hard_edges = None
        meshes.append(
            SceneMesh(
                name=each.name,
                path=each.path,
                vertices=slice(vertex, vertex + each.vertex_count),
                polygons=own,
                uvs=_own_values(surface.uvs, inside, NO_UV if several else ()),
                colours=_own_values(surface.colours, inside, WHITE if several else ()),
                hard_edges=hard_edges,
                face_sets=tuple(_inside(surface.face_sets, polygon, end)),
                subdivision=scheme,
            )
        )
        vertex, polygon = vertex + each.vertex_count, end
    return meshes


def _own_values(joined: CornerValues | None, corners: slice, default: Sequence[float]) -> CornerValues | None:
    """Return the values of some corners with unused ones removed; None if all are the default."""
    if joined is None:
        return None
    rows, used = np.unique(joined.indices[corners], return_inverse=True)
    own = CornerValues(joined.values[rows], used)
    return None if default and (own.values == default).all() else own


def _renumbered(hard_edges: IntArray) -> IntArray:
    return np.unique(hard_edges, return_inverse=True)[1].astype(np.int32)


def _is_smooth(polygons: Polygons, hard_edges: IntArray) -> bool:
    """Whether corners share a normal if and only if they share a vertex."""
    pairs = np.unique(np.column_stack([polygons.indices, hard_edges]), axis=0)
    return all(len(np.unique(column)) == len(pairs) for column in pairs.T)


def _inside(face_sets: Sequence[FaceSet], first: int, end: int) -> list[FaceSet]:
    """Return face sets restricted to the polygons from `first` to before `end`, numbered from 0."""
    cut = [
        FaceSet(
            each.name, each.polygons[(each.polygons >= first) & (each.polygons < end)] - first, each.material
        )
        for each in face_sets
    ]
    return [each for each in cut if each.polygons.size]
