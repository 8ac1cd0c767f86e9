"""Meshes of a written Alembic archive: new ones, or those of a copy of the original with new points.

The original is copied object by object and property by property, with metadata and sample times, which determine an
object's kind; instances stay instances. Points are in mesh space, below the archive's transforms, marked so that frames
are at their times only. Existing normals are recomputed; all other contents stay.

Specification: https://docs.alembic.io/reference/index.html (``Abc``)
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mixseq.errors import FormatError
from mixseq.mesh.measures import shared_normals
from mixseq.mesh.polygons import Polygons, difference, reversed_corners
from mixseq.mesh.surface import CornerValues
from mixseq.sequence.header import SequenceHeader
from mixseq.types import Float, FloatArray, Index, IntArray
from mixseq_io.alembic.library import (
    ERRORS,
    Abc,
    AbcCoreAbstract,
    AbcGeom,
    AbcMaterial,
    array_of,
    imath,
    length,
    open_archive,
    selector,
    stored_array,
)
from mixseq_io.alembic.reader import COLOURS, LAID_OVER, Mesh, Source, find_meshes, stored_polygons
from mixseq_io.alembic.samples import (
    Place,
    Placing,
    determinant,
    object_places,
    sample_times,
    samples_within,
    time_sampling,
    unique_names,
)
from mixseq_io.originals import match_meshes, warn_of_unretimed_motion
from mixseq_io.reader import prefix_errors, translate_read_errors, warn
from mixseq_io.scene_meshes import SceneMesh, format_names, split_meshes

_SCHEMES = {"catmullClark": "catmull-clark", "loop": "loop", "bilinear": "bilinear"}
_CORNERS = AbcGeom.GeometryScope.kFacevaryingScope
_OPAQUE = (AbcGeom.OC3fGeomParam, AbcGeom.OC3fGeomParamSample, imath.C3fArray)
_WITH_ALPHA = (AbcGeom.OC4fGeomParam, AbcGeom.OC4fGeomParamSample, imath.C4fArray)

_PER_SAMPLE = 300
"""Size in bytes of a frame's keys, sizes, places and bounds."""
_PER_OBJECT = 8000
"""Size in bytes of an object's names and headers."""


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
            arrays = self._arrays
            sample.setFaceIndices(arrays["corners"])
            sample.setFaceCounts(arrays["counts"])
            if self.subdivided:
                sample.setSubdivisionScheme(_SCHEMES[self.scene_mesh.subdivision])
            if self.scene_mesh.uvs is not None:
                uvs = arrays["uv values"], arrays["uv indices"]
                sample.setUVs(AbcGeom.OV2fGeomParamSample(*uvs, _CORNERS))
        return sample

    def add_normals(self, sample: Any, rows: FloatArray) -> Any:
        """Add normals of points ``(V, 3)`` for hard edges; return objects to keep alive until the sample is set."""
        if self.scene_mesh.hard_edges is None or self.subdivided:
            return None
        shared = shared_normals(rows[None], self.scene_mesh.polygons, self.scene_mesh.hard_edges)[0]
        normals = array_of(imath.V3fArray, shared)
        sample.setNormals(AbcGeom.ON3fGeomParamSample(normals, self._arrays["normals"], _CORNERS))
        return normals

    @cached_property
    def _order(self) -> IntArray:
        return reversed_corners(self.scene_mesh.polygons.counts, keep_first=False)

    @cached_property
    def _arrays(self) -> dict[str, Any]:
        """Constant arrays, which samples only point to."""
        scene_mesh, uvs = self.scene_mesh, self.scene_mesh.uvs
        arrays = {
            "counts": array_of(imath.IntArray, scene_mesh.polygons.counts),
            "corners": array_of(imath.IntArray, scene_mesh.polygons.indices[self._order]),
        }
        if uvs is not None:
            arrays["uv values"] = array_of(imath.V2fArray, uvs.values)
            arrays["uv indices"] = array_of(imath.UnsignedIntArray, uvs.indices[self._order])
        if scene_mesh.hard_edges is not None:
            arrays["normals"] = array_of(imath.UnsignedIntArray, scene_mesh.hard_edges[self._order])
        return arrays

    def largest_size(self, frames: int, moving: bool) -> int:
        """Return the largest possible size in the file in bytes."""
        scene_mesh = self.scene_mesh
        normals = 0 if scene_mesh.hard_edges is None else int(scene_mesh.hard_edges.max(initial=-1)) + 1
        uvs = 0 if scene_mesh.uvs is None else len(scene_mesh.uvs.values)
        colours = scene_mesh.colours
        painted = 0 if colours is None else 16 * len(colours.values) + 4 * colours.indices.size + _PER_OBJECT
        per_frame = 12 * (scene_mesh.vertex_count * (2 if moving else 1) + normals) + _PER_SAMPLE
        sets = sum(4 * each.polygons.size + _PER_OBJECT for each in scene_mesh.face_sets)
        once = (
            12 * scene_mesh.polygons.indices.size
            + 4 * scene_mesh.polygons.counts.size
            + 8 * uvs
            + painted
            + sets
            + _PER_OBJECT
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
    scene_meshes = split_meshes(header)
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


_SCHEMA = ".geom"
"""Compound property of all kinds of meshes."""

_OF_POINTS = frozenset(["P", ".velocities", "N", ".selfBnds", ".childBnds"])
"""Properties replaced on meshes with new points: the points, and what depends on them."""

_OF_CHILDREN = frozenset([".childBnds"])
_OF_THE_ARCHIVE = re.compile(r"\.childBnds|statistics|\d+\.samples")
"""Properties of the top object that summarise the archive, such as bounds; wrong with other points."""


Kept = tuple[range, int]
"""Samples of a property that are copied, and the index of their time sampling in the new archive."""


class _Copier:
    """Copier of an archive's objects, with the samples needed for frames at times ``(T,)`` in s.

    `schemas` are the copies of moved meshes by path, `moving` the first and last time of moving objects, `lost` paths.
    """

    def __init__(self, target: Any, moved: Collection[str], frames: Float, room: int) -> None:
        self._target, self._moved, self._room = target, moved, room
        self._window = float(frames[0]), float(frames[-1])
        self._above = _at_or_above(moved)
        self.schemas: dict[str, Any] = {}
        self.moving: dict[str, tuple[float, float]] = {}
        self.lost: list[str] = []

    def copy(self, top: Any) -> None:
        """Copy all objects below the top one."""
        new = self._target.getTop()
        for header in top.getProperties().propertyheaders:
            if not _OF_THE_ARCHIVE.fullmatch(header.getName()):
                self._property("/", header, top.getProperties(), new.getProperties(), frozenset())
        made, instances, stack = {}, [], [(top, new)]
        while stack:
            node, parent = stack.pop()
            for child in [node.getChild(index) for index in range(node.getNumChildren())]:
                path = str(child.getFullName())
                if child.isInstanceRoot() and path not in self._above:
                    instances.append((child, parent))
                    continue
                made[path] = self._object(path, child, parent)
                stack.append((child, made[path]))
        for child, parent in instances:
            original = made.get(str(child.instanceSourcePath()))
            if original is None or not parent.addChildInstance(original, child.getName()):
                self.lost.append(str(child.getFullName()))

    def _object(self, path: str, node: Any, parent: Any) -> Any:
        metadata = AbcCoreAbstract.MetaData(node.getMetaData())
        if path in self._moved:
            metadata.set(LAID_OVER, "1")
        new = Abc.OObject(parent, node.getName(), metadata)
        stale = _OF_POINTS if path in self._moved else _OF_CHILDREN if path in self._above else frozenset()
        for header in node.getProperties().propertyheaders:
            made = self._property(path, header, node.getProperties(), new.getProperties(), stale)
            if path in self._moved and header.getName() == _SCHEMA:
                self.schemas[path] = made
        return new

    def _property(self, path: str, header: Any, source: Any, target: Any, stale: Collection[str]) -> Any:
        """Copy a property of an object without its `stale` children; return the new one."""
        stored = source.getProperty(header.getName())
        if not header.isCompound():
            self._samples(path, header, stored, target, {})
            return None
        new = Abc.OCompoundProperty(target, header.getName(), header.getMetaData())
        fresh = [each for each in stored.propertyheaders if each.getName() not in stale]
        simple = [stored.getProperty(each.getName()) for each in fresh if not each.isCompound()]
        changing = {each.getNumSamples(): self._kept(each) for each in simple if not each.isConstant()}
        for each in fresh:
            if each.isCompound():
                self._property(path, each, stored, new, ())
            else:
                self._samples(path, each, stored.getProperty(each.getName()), new, changing)
        return new

    def _kept(self, stored: Any) -> Kept:
        """Return the samples of a property that frames need."""
        times, sampling = sample_times(stored), stored.getTimeSampling()
        kept = range(len(times))[samples_within(times, self._window)]
        if len(kept) < len(times):
            sampling = time_sampling(times[kept.start : kept.stop], float(times[1] - times[0]))
        return kept, self._target.addTimeSampling(sampling)

    def _samples(
        self, path: str, header: Any, stored: Any, target: Any, changing: Mapping[int, Kept]
    ) -> None:
        """Copy a property's samples; of a constant one, those kept of the `changing` properties beside it."""
        kind = Abc.OArrayProperty if header.isArray() else Abc.OScalarProperty
        constant, count = stored.isConstant(), stored.getNumSamples()
        kept, sampling = (changing.get(count) if constant else None) or self._kept(stored)
        if len(kept) == count:
            sampling = self._target.addTimeSampling(stored.getTimeSampling())
        try:
            # Read before anything is made that would stay empty.
            value = self._value(stored, kept[0]) if kept else None
            new = kind(target, header.getName(), header.getDataType(), header.getMetaData(), sampling)
            for sample in kept:
                if sample > kept[0] and constant:
                    new.setFromPrevious()
                else:
                    new.setValue(self._value(stored, sample) if sample > kept[0] else value)
        except (RuntimeError, TypeError):  # types that the library has no words for in Python
            self.lost.append(f"{path}.{header.getName()}")
            return
        if not constant:
            times = sample_times(stored)
            first, last = self.moving.get(path, (times[0], times[-1]))
            self.moving[path] = min(first, times[0]), max(last, times[-1])

    def _value(self, stored: Any, sample: int) -> Any:
        if stored.isArray():
            return stored_array(stored, sample, self._room)
        return stored.getValue(selector(stored, sample))


def _at_or_above(paths: Collection[str]) -> set[str]:
    """Return paths and all their ancestors."""
    return {
        "/".join(names[:end])
        for names in (path.split("/") for path in paths)
        for end in range(2, len(names) + 1)
    }


@dataclass(frozen=True, eq=False)
class Fit:
    """Mesh of the sequence matched with a mesh of the archive, whose points it replaces."""

    scene_mesh: SceneMesh
    mesh: Mesh
    corners: Index
    placing: Placing
    mirrored: bool


@dataclass(frozen=True, eq=False)
class Original:
    """Archive that fits a sequence."""

    path: Path
    archive: Any
    fits: tuple[Fit, ...]


def open_original(path: Path, header: SequenceHeader) -> Original:
    """Open an archive whose meshes may get new points."""
    with translate_read_errors(path, "Alembic", *ERRORS), prefix_errors(path):
        archive = open_archive(path)
        meshes, _ = find_meshes(path, archive)
        fits = match_meshes(
            path,
            header,
            {mesh.path: mesh for mesh in meshes},
            partial(_fitted, path, header),
            partial(_difference, path),
        )
        for fit in fits:
            try:
                fit.placing.check()
            except FormatError as error:
                raise FormatError(f"{path}: nothing can be laid over {fit.mesh.path!r}: {error}") from None
        return Original(path, archive, tuple(fits))


def _fitted(path: Path, header: SequenceHeader, scene_mesh: SceneMesh, mesh: Mesh) -> Fit | None:
    """Match a mesh of the sequence with one of the archive; None if vertices or faces differ."""
    if length(mesh.schema.getPositionsProperty(), 0) != scene_mesh.vertex_count:
        return None
    placing = Placing.at(mesh.above, header.times, header.fps)
    mirrored = determinant(placing.matrices[0]) < 0
    found = scene_mesh.match(*_polygons(path, scene_mesh, mesh, mirrored))
    return found and Fit(found[0], mesh, found[1].corners, placing, mirrored)


def _polygons(path: Path, scene_mesh: SceneMesh, mesh: Mesh, mirrored: bool) -> tuple[Polygons, Index]:
    room = path.stat().st_size
    vertices = slice(0, scene_mesh.vertex_count)
    return stored_polygons(Source(path, room, mesh, vertices, mirrored, np.zeros(1)))


def _difference(path: Path, scene_mesh: SceneMesh, mesh: Mesh) -> str:
    """Return the first difference from the only candidate mesh, in words."""
    count = length(mesh.schema.getPositionsProperty(), 0)
    if count != scene_mesh.vertex_count:
        return f"{mesh.path} has {count} vertices, the sequence {scene_mesh.vertex_count}"
    theirs, order = _polygons(path, scene_mesh, mesh, mirrored=False)
    ours = scene_mesh.polygons
    return difference(ours, Polygons(theirs.counts, theirs.indices[order]), ("the sequence", mesh.path))


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
                shared = shared_normals(own[None], polygons, self.fit.scene_mesh.normal_groups)[0]
                stored = array_of(imath.V3fArray, -shared if self.fit.mirrored else shared)
                self.normals.set(AbcGeom.ON3fGeomParamSample(stored, self._corner_groups, _CORNERS))

    @cached_property
    def _corner_groups(self) -> Any:
        return array_of(imath.UnsignedIntArray, self.fit.scene_mesh.normal_groups[self.fit.corners])


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
    per_frame = 12 * (vertices * (2 if velocities else 1) + normals) + _PER_SAMPLE * len(original.fits)
    return _GROWTH * original.path.stat().st_size + header.frame_count * per_frame + 4 * normals


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
    copier = _Copier(archive, moved, header.times, original.path.stat().st_size)
    copier.copy(original.archive.getTop())
    if copier.lost:
        warn(
            f"{path}: of {original.path} the library cannot copy {format_names(copier.lost)}; they are left out"
        )
    warn_of_unretimed_motion(path, header, dict(sorted(copier.moving.items())), sources)
    return [MovedMesh.make(fit, copier.schemas[fit.mesh.path], sampling, velocities) for fit in original.fits]
