"""Alembic, writing: an archive copied with new points in some of its meshes.

Points are in mesh space, below the archive's transforms, marked so that frames are at their times only. Existing
normals are recomputed; all other contents stay.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from mixseq.arrays import FloatArray, IntArray
from mixseq.geometry.normals import shared_normals
from mixseq.sequence import SequenceHeader
from mixseq_io.alembic.archive_copy import copy_archive
from mixseq_io.alembic.library import Abc, AbcGeom, array_of, imath
from mixseq_io.alembic.original import Fit, Original
from mixseq_io.alembic.targets import PER_SAMPLE
from mixseq_io.blocks import warn
from mixseq_io.choosing import listed
from mixseq_io.originals import warn_of_other_times

_CORNERS = AbcGeom.GeometryScope.kFacevaryingScope

_GROWTH = 2
"""Largest ratio of a copy's size to the archive's; moving instances become separate objects."""


@dataclass(frozen=True, eq=False)
class MovedMesh:
    """Mesh of the copy whose points are written."""

    fit: Fit
    positions: Any
    bounds: Any
    velocities: Any | None
    normals: Any | None

    @classmethod
    def make(cls, fit: Fit, schema: Any, sampling: int, velocities: bool) -> MovedMesh:
        """Create the properties in the copied schema; `write` adds the samples."""
        stored, place = fit.mesh.schema, (sampling,)
        header = stored.getPositionsProperty().getHeader()
        positions = Abc.OArrayProperty(schema, "P", header.getDataType(), header.getMetaData(), *place)
        bounds = Abc.OBox3dProperty(schema, ".selfBnds", *place)
        speeds = Abc.OV3fArrayProperty(schema, ".velocities", *place) if velocities else None
        has_normals = not fit.mesh.subdivided and stored.getNormalsParam().valid()
        normals = AbcGeom.ON3fGeomParam(schema, "N", True, _CORNERS, 1, *place) if has_normals else None
        return cls(fit, positions, bounds, speeds, normals)

    def write(self, first: int, points: FloatArray, velocities: FloatArray | None) -> None:
        """Add samples of a block of frames, from frame `first` on: points, velocities ``(B, V, 3)`` of the sequence."""
        vertices, placing = self.fit.scene_mesh.vertices, self.fit.placing
        for row, world in enumerate(points[:, vertices]):
            own = placing.own_points(world, first + row)
            # A sample only points to its array, which must stay until it is set.
            stored = array_of(imath.V3fArray, own)
            self.positions.setValue(stored)
            self.bounds.setValue(_bounds(own))
            if self.velocities is not None and velocities is not None:
                rates = placing.own_velocities(velocities[row, vertices], own, first + row)
                stored = array_of(imath.V3fArray, rates)
                self.velocities.setValue(stored)
            if self.normals is not None:
                polygons = self.fit.scene_mesh.polygons
                shared = shared_normals(own[None], polygons, self._groups)[0]
                stored = array_of(imath.V3fArray, -shared if self.fit.mirrored else shared)
                self.normals.set(AbcGeom.ON3fGeomParamSample(stored, self._corner_groups, _CORNERS))

    @property
    def _groups(self) -> IntArray:
        scene_mesh = self.fit.scene_mesh
        return scene_mesh.polygons.indices if scene_mesh.hard_edges is None else scene_mesh.hard_edges

    @cached_property
    def _corner_groups(self) -> Any:
        return array_of(imath.UnsignedIntArray, self._groups[self.fit.corners])


def _bounds(points: FloatArray) -> Any:
    """Return the bounding box of points ``(n, 3)``; the library's empty box without any."""
    if not len(points):
        return imath.Box3d()
    return imath.Box3d(
        *(imath.V3d(*map(float, corner)) for corner in (points.min(axis=0), points.max(axis=0)))
    )


def largest_size(original: Original, header: SequenceHeader, velocities: bool) -> int:
    """Return the largest possible size of the copy in bytes."""
    vertices = sum(fit.scene_mesh.vertex_count for fit in original.fits)
    normals = sum(fit.corners.size for fit in original.fits)
    per_frame = 12 * (vertices * (2 if velocities else 1) + normals) + PER_SAMPLE * len(original.fits)
    return _GROWTH * original.room + header.frame_count * per_frame + 4 * normals


def lay_over(
    archive: Any,
    path: Path,
    original: Original,
    header: SequenceHeader,
    sampling: int,
    velocities: bool,
    sources: ArrayLike | None = None,
) -> list[MovedMesh]:
    """Copy an archive into an empty one, and return the copy's meshes whose points are to be written.

    `sampling` is the index of the frames' time sampling, `sources` ``(T,)`` are the archive's times in seconds that the
    frames show, `path` is for warnings.
    """
    moved = {fit.mesh.path for fit in original.fits}
    copied = copy_archive(original.archive, archive, moved, header.times, original.room)
    if copied.lost:
        warn(f"{path}: of {original.path} the library cannot copy {listed(copied.lost)}; they are left out")
    warn_of_other_times(path, header, dict(sorted(copied.moving.items())), sources)
    return [MovedMesh.make(fit, copied.schemas[fit.mesh.path], sampling, velocities) for fit in original.fits]
