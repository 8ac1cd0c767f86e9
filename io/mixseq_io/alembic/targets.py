"""One mesh of an Alembic file as it is written: the object, its face sets, and a sample for every frame."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from mixseq.arrays import FloatArray, IntArray
from mixseq.geometry.normals import shared_normals
from mixseq.polygons import reversed_corners
from mixseq_io.alembic.library import AbcGeom, AbcMaterial, array_of, imath
from mixseq_io.scene_meshes import SceneMesh

_SCHEMES = {"catmullClark": "catmull-clark", "loop": "loop", "bilinear": "bilinear"}
_CORNERS = AbcGeom.GeometryScope.kFacevaryingScope


@dataclass(frozen=True, eq=False)
class Target:
    """A mesh to be written.

    Parameters
    ----------
    scene_mesh : SceneMesh
        The mesh.
    name : str
        Its name in the file.
    """

    scene_mesh: SceneMesh
    name: str

    @property
    def subdivided(self) -> bool:
        """Whether it becomes a SubD, which has no normals."""
        return self.scene_mesh.subdivision != "none"

    def make(self, parent: Any, sampling: int) -> Any:
        """Make the object and its face sets; `write` adds the samples."""
        mesh = (AbcGeom.OSubD if self.subdivided else AbcGeom.OPolyMesh)(parent, self.name, sampling)
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
        return mesh

    def write(self, mesh: Any, points: FloatArray, velocities: FloatArray | None) -> None:
        """Add samples for a block of frames.

        Parameters
        ----------
        mesh : OPolyMesh or OSubD
            What `make` made.
        points, velocities : (B, V, 3) float32
            The frames of the whole sequence.
        """
        schema, own = mesh.getSchema(), points[:, self.scene_mesh.vertices]
        for frame, rows in enumerate(own):
            # A sample only points to its arrays: they must stay until it is set.
            positions, speeds, normals = array_of(imath.V3fArray, rows), None, None
            sample = self._sample(positions, complete=not schema.getNumSamples())
            if velocities is not None:
                speeds = array_of(imath.V3fArray, velocities[frame, self.scene_mesh.vertices])
                sample.setVelocities(speeds)
            if self.scene_mesh.hard_edges is not None and not self.subdivided:
                shared = shared_normals(rows[None], self.scene_mesh.polygons, self.scene_mesh.hard_edges)[0]
                normals = array_of(imath.V3fArray, shared)
                sample.setNormals(AbcGeom.ON3fGeomParamSample(normals, self._groups, _CORNERS))
            schema.set(sample)

    def _sample(self, positions: Any, complete: bool) -> Any:
        """Return a sample of points; a complete one has everything that does not change."""
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
        """Return how many bytes it takes in the file at most."""
        scene_mesh = self.scene_mesh
        normals = 0 if scene_mesh.hard_edges is None else int(scene_mesh.hard_edges.max(initial=-1)) + 1
        uvs = 0 if scene_mesh.uvs is None else len(scene_mesh.uvs.values)
        per_frame = 12 * (scene_mesh.vertex_count * (2 if moving else 1) + normals) + _PER_SAMPLE
        sets = sum(4 * each.polygons.size + _PER_OBJECT for each in scene_mesh.face_sets)
        once = (
            12 * scene_mesh.polygons.indices.size
            + 4 * scene_mesh.polygons.counts.size
            + 8 * uvs
            + sets
            + _PER_OBJECT
        )
        return frames * per_frame + once


_PER_SAMPLE = 300
"""Bytes of keys, sizes, places and bounds of one frame."""
_PER_OBJECT = 8000
"""Bytes of names and headers."""


def valid_name(name: str) -> str:
    """Return a name that an object can have: any but an empty one, without slashes."""
    return name.replace("/", "_") or "mesh"


def unique_names(names: Iterable[str]) -> list[str]:
    """Return valid names, those that occur again with a number.

    Examples
    --------
    >>> unique_names(["a", "a/b", "a", "a_2"])
    ['a', 'a_b', 'a_2', 'a_2_2']
    """
    taken: dict[str, None] = {}
    numbers: dict[str, int] = {}
    for name in map(valid_name, names):
        number, free = numbers.get(name, 1), name
        while free in taken:
            number += 1
            free = f"{name}_{number}"
        numbers[name] = number
        taken[free] = None
    return list(taken)
