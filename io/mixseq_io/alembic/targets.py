"""Mesh of a written Alembic file: the object, its face sets, and a sample per frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from mixseq.arrays import FloatArray, IntArray
from mixseq.geometry.normals import shared_normals
from mixseq.polygons import reversed_corners
from mixseq.sequence import SequenceHeader
from mixseq.surface import CornerValues
from mixseq_io.alembic.library import AbcGeom, AbcMaterial, array_of, imath
from mixseq_io.alembic.object_paths import Place, object_places, unique_names
from mixseq_io.alembic.polymesh import COLOURS
from mixseq_io.scene_meshes import SceneMesh, split

_SCHEMES = {"catmullClark": "catmull-clark", "loop": "loop", "bilinear": "bilinear"}
_CORNERS = AbcGeom.GeometryScope.kFacevaryingScope
_OPAQUE = (AbcGeom.OC3fGeomParam, AbcGeom.OC3fGeomParamSample, imath.C3fArray)
_WITH_ALPHA = (AbcGeom.OC4fGeomParam, AbcGeom.OC4fGeomParamSample, imath.C4fArray)


@dataclass(frozen=True, eq=False)
class Target:
    """Mesh to be written."""

    scene_mesh: SceneMesh
    place: Place

    @property
    def subdivided(self) -> bool:
        """Whether the mesh becomes a SubD, which has no normals."""
        return self.scene_mesh.subdivision != "none"

    def make(self, parent: Any, sampling: int) -> MadeMesh:
        """Create the object and its face sets, without samples."""
        mesh = (AbcGeom.OSubD if self.subdivided else AbcGeom.OPolyMesh)(parent, self.place[-1], sampling)
        sets = self.scene_mesh.face_sets
        together = np.concatenate([each.polygons for each in sets]) if sets else np.zeros(0)
        exclusive = len(np.unique(together)) == len(together)
        for each, name in zip(sets, unique_names(each.name for each in sets), strict=True):
            node = mesh.getSchema().createFaceSet(name)
            polygons = array_of(imath.IntArray, each.polygons)  # held until it is set
            node.getSchema().set(AbcGeom.OFaceSetSchemaSample(polygons))
            if exclusive:
                node.getSchema().setFaceExclusivity(AbcGeom.FaceSetExclusivity.kFaceSetExclusive)
            if each.material:
                AbcMaterial.addMaterialAssignment(node, each.material)
        if self.scene_mesh.colours is not None:
            self._add_colours(mesh.getSchema(), self.scene_mesh.colours)
        return MadeMesh(self, mesh)

    def _add_colours(self, schema: Any, colours: CornerValues) -> None:
        """Add constant colours in a sample of their own, without alpha if all are opaque."""
        opaque = bool((colours.values[:, 3] == 1).all())
        parameter, sample, kind = _OPAQUE if opaque else _WITH_ALPHA
        values = array_of(kind, colours.values)  # held until they are set
        indices = array_of(imath.UnsignedIntArray, colours.indices[self._order])
        made = parameter(schema.getArbGeomParams(), COLOURS, True, _CORNERS, 1)
        made.set(sample(values, indices, _CORNERS))

    def sample(self, positions: Any, complete: bool) -> Any:
        """Return a sample of points; a `complete` one includes constant properties."""
        sample = AbcGeom.OSubDSchemaSample() if self.subdivided else AbcGeom.OPolyMeshSchemaSample()
        sample.setPositions(positions)
        if complete:
            sample.setFaceIndices(self._corners)
            sample.setFaceCounts(self._counts)
            if self.subdivided:
                sample.setSubdivisionScheme(_SCHEMES[self.scene_mesh.subdivision])
            if self.scene_mesh.uvs is not None:
                sample.setUVs(AbcGeom.OV2fGeomParamSample(self._uv_values, self._uv_indices, _CORNERS))
        return sample

    def add_normals(self, sample: Any, rows: FloatArray) -> Any:
        """Add normals of points ``(V, 3)`` for hard edges; return objects to keep alive until the sample is set."""
        if self.scene_mesh.hard_edges is None or self.subdivided:
            return None
        shared = shared_normals(rows[None], self.scene_mesh.polygons, self.scene_mesh.hard_edges)[0]
        normals = array_of(imath.V3fArray, shared)
        sample.setNormals(AbcGeom.ON3fGeomParamSample(normals, self._groups, _CORNERS))
        return normals

    @cached_property
    def _order(self) -> IntArray:
        return reversed_corners(self.scene_mesh.polygons.counts, keep_first=False)

    @cached_property
    def _corners(self) -> Any:
        return array_of(imath.IntArray, self.scene_mesh.polygons.indices[self._order])

    @cached_property
    def _counts(self) -> Any:
        return array_of(imath.IntArray, self.scene_mesh.polygons.counts)

    @cached_property
    def _uv_values(self) -> Any:
        return None if self.scene_mesh.uvs is None else array_of(imath.V2fArray, self.scene_mesh.uvs.values)

    @cached_property
    def _uv_indices(self) -> Any:
        uvs = self.scene_mesh.uvs
        return None if uvs is None else array_of(imath.UnsignedIntArray, uvs.indices[self._order])

    @cached_property
    def _groups(self) -> Any:
        hard_edges = self.scene_mesh.hard_edges
        return None if hard_edges is None else array_of(imath.UnsignedIntArray, hard_edges[self._order])

    def largest_size(self, frames: int, moving: bool) -> int:
        """Return the largest possible size in the file in bytes."""
        scene_mesh = self.scene_mesh
        normals = 0 if scene_mesh.hard_edges is None else int(scene_mesh.hard_edges.max(initial=-1)) + 1
        uvs = 0 if scene_mesh.uvs is None else len(scene_mesh.uvs.values)
        colours = scene_mesh.colours
        painted = 0 if colours is None else 16 * len(colours.values) + 4 * colours.indices.size + PER_OBJECT
        per_frame = 12 * (scene_mesh.vertex_count * (2 if moving else 1) + normals) + PER_SAMPLE
        sets = sum(4 * each.polygons.size + PER_OBJECT for each in scene_mesh.face_sets)
        once = (
            12 * scene_mesh.polygons.indices.size
            + 4 * scene_mesh.polygons.counts.size
            + 8 * uvs
            + painted
            + sets
            + PER_OBJECT
        )
        return frames * per_frame + once


@dataclass(frozen=True, eq=False)
class MadeMesh:
    """Mesh in the file that samples are added to."""

    target: Target
    mesh: Any

    def write(self, first: int, points: FloatArray, velocities: FloatArray | None) -> None:
        """Add samples of a block of frames, from frame `first` on: points, velocities ``(B, V, 3)`` of the sequence."""
        schema, vertices = self.mesh.getSchema(), self.target.scene_mesh.vertices
        for frame, rows in enumerate(points[:, vertices]):
            # A sample only points to its arrays: they must stay until it is set.
            positions, speeds = array_of(imath.V3fArray, rows), None
            sample = self.target.sample(positions, complete=not schema.getNumSamples())
            if velocities is not None:
                speeds = array_of(imath.V3fArray, velocities[frame, vertices])
                sample.setVelocities(speeds)
            normals = self.target.add_normals(sample, rows)
            schema.set(sample)
            del speeds, normals


def make_targets(header: SequenceHeader) -> list[Target]:
    """Return the meshes to write of a stand-alone sequence."""
    scene_meshes = split(header)
    return list(map(Target, scene_meshes, object_places(header, scene_meshes)))


def make_meshes(top: Any, targets: Sequence[Target], sampling: int) -> list[MadeMesh]:
    """Create all meshes below identity transforms."""
    made: dict[Place, Any] = {(): top}
    for target in targets:
        for end in range(1, len(target.place)):
            place = target.place[:end]
            if place not in made:
                made[place] = AbcGeom.OXform(made[place[:-1]], place[-1])
    return [target.make(made[target.place[:-1]], sampling) for target in targets]


PER_SAMPLE = 300
"""Size in bytes of a frame's keys, sizes, places and bounds."""
PER_OBJECT = 8000
"""Size in bytes of an object's names and headers."""
