"""Copies of Alembic archives, in which meshes have new points.

All objects and properties of the original are copied with their sample times and metadata, which determine an object's
type; instances stay instances. New points are in mesh space below the archive's transforms. Meshes with new points are
marked, so that only these points determine the frames. Existing normals are recomputed; all other contents stay.

Specification: https://docs.alembic.io/reference/index.html (``Abc``)
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from mixseq.errors import FormatError
from mixseq.mesh.measures import bounding_box, corner_normals
from mixseq.mesh.polygons import Polygons, describe_difference
from mixseq.sequence.header import SequenceHeader
from mixseq.types import Float, FloatArray, Index
from mixseq_io.alembic.reader import OVERLAY_KEY, Mesh, find_meshes, stored_polygons
from mixseq_io.alembic.samples import (
    LIBRARY_ERRORS,
    Abc,
    AbcCoreAbstract,
    AbcGeom,
    MeshTransform,
    create_array,
    create_time_sampling,
    imath,
    open_archive,
    read_imath_sample,
    sample_length,
    sample_selector,
    sample_times,
    select_samples,
    transform_points,
)
from mixseq_io.reader import prefix_errors, translate_read_errors, warn
from mixseq_io.scene_meshes import SceneMesh, format_names, match_meshes, warn_of_unretimed_motion
from mixseq_io.surfaces import RoundingMonitor

CORNER_SCOPE = AbcGeom.GeometryScope.kFacevaryingScope

SAMPLE_OVERHEAD_BYTES = 300
"""Upper bound in bytes on a frame's keys, sizes, offsets and bounds in the file."""

_GEOMETRY_PROPERTY = ".geom"
"""Name of the compound property that holds a mesh's schema."""

_POINT_PROPERTIES = frozenset(["P", ".velocities", "N", ".selfBnds", ".childBnds"])
"""Names of mesh properties that depend on the points."""

_CHILD_PROPERTIES = frozenset([".childBnds"])
_ARCHIVE_PROPERTIES = re.compile(r"\.childBnds|statistics|\d+\.samples")
"""Names of properties of the top object that summarise the archive, such as bounds."""


WriteSamples = Callable[[int, FloatArray, FloatArray | None, RoundingMonitor], None]
"""Function that adds a mesh's samples of frames from the first index on; points and velocities are the sequence's."""

KeptSamples = tuple[range, int]
"""Range of a property's copied samples, and the index of their time sampling in the copy."""


class _Copier:
    """Copier of an archive's objects, with the samples needed for frames at times ``(T,)`` in s.

    The meshes at `paths` get new points, and `schemas` are their copied schemas. `spans` are the first and last sample
    times of animated objects; `lost` are the paths of objects and properties that cannot be copied.
    """

    def __init__(self, copy: Any, paths: Collection[str], times: Float, file_size: int) -> None:
        self._copy, self._paths, self._file_size = copy, paths, file_size
        self._window = float(times[0]), float(times[-1])
        self._lineage = _with_ancestors(paths)
        self.schemas: dict[str, Any] = {}
        self.spans: dict[str, tuple[float, float]] = {}
        self.lost: list[str] = []

    def copy_objects(self, top: Any) -> None:
        """Copy the properties of the top object, and all objects below it."""
        new_top = self._copy.getTop()
        for header in top.getProperties().propertyheaders:
            if not _ARCHIVE_PROPERTIES.fullmatch(header.getName()):
                self._copy_property("/", header, top.getProperties(), new_top.getProperties(), frozenset())
        copies, instances, stack = {}, [], [(top, new_top)]
        while stack:
            node, parent = stack.pop()
            for child in [node.getChild(index) for index in range(node.getNumChildren())]:
                path = str(child.getFullName())
                if child.isInstanceRoot() and path not in self._lineage:
                    instances.append((child, parent))
                    continue
                copies[path] = self._copy_object(path, child, parent)
                stack.append((child, copies[path]))
        for child, parent in instances:
            source = copies.get(str(child.instanceSourcePath()))
            if source is None or not parent.addChildInstance(source, child.getName()):
                self.lost.append(str(child.getFullName()))

    def _copy_object(self, path: str, node: Any, parent: Any) -> Any:
        metadata, stale = AbcCoreAbstract.MetaData(node.getMetaData()), frozenset[str]()
        if path in self._paths:
            metadata.set(OVERLAY_KEY, "1")
            stale = _POINT_PROPERTIES
        elif path in self._lineage:
            stale = _CHILD_PROPERTIES
        copy, source = Abc.OObject(parent, node.getName(), metadata), node.getProperties()
        for header in source.propertyheaders:
            property_copy = self._copy_property(path, header, source, copy.getProperties(), stale)
            if path in self._paths and header.getName() == _GEOMETRY_PROPERTY:
                self.schemas[path] = property_copy
        return copy

    def _copy_property(self, path: str, header: Any, source: Any, parent: Any, stale: Collection[str]) -> Any:
        """Copy an object's property without its `stale` children; return the copy of a compound property, else None."""
        stored = source.getProperty(header.getName())
        if not header.isCompound():
            self._copy_samples(path, header, stored, parent, {})
            return None
        copy = Abc.OCompoundProperty(parent, header.getName(), header.getMetaData())
        headers = [each for each in stored.propertyheaders if each.getName() not in stale]
        simple = [stored.getProperty(each.getName()) for each in headers if not each.isCompound()]
        animated = {each.getNumSamples(): self._select(each) for each in simple if not each.isConstant()}
        for each in headers:
            if each.isCompound():
                self._copy_property(path, each, stored, copy, ())
            else:
                self._copy_samples(path, each, stored.getProperty(each.getName()), copy, animated)
        return copy

    def _select(self, stored: Any) -> KeptSamples:
        """Select the samples of a property that determine its values at the frames."""
        times, sampling = sample_times(stored), stored.getTimeSampling()
        kept = range(len(times))[select_samples(times, self._window)]
        if len(kept) < len(times):
            sampling = create_time_sampling(times[kept.start : kept.stop], float(times[1] - times[0]))
        return kept, self._copy.addTimeSampling(sampling)

    def _copy_samples(
        self, path: str, header: Any, stored: Any, parent: Any, animated: Mapping[int, KeptSamples]
    ) -> None:
        """Copy a property's samples, for constant ones as selected in an `animated` property of equal sample count."""
        property_type = Abc.OArrayProperty if header.isArray() else Abc.OScalarProperty
        is_constant, count = stored.isConstant(), stored.getNumSamples()
        kept, sampling = (animated.get(count) if is_constant else None) or self._select(stored)
        if len(kept) == count:
            sampling = self._copy.addTimeSampling(stored.getTimeSampling())
        try:
            # The first sample is read before the property is created: an error must not leave an empty property.
            value = self._read_value(stored, kept[0]) if kept else None
            data_type, metadata = header.getDataType(), header.getMetaData()
            copy = property_type(parent, header.getName(), data_type, metadata, sampling)
            for sample in kept:
                if sample > kept[0] and is_constant:
                    copy.setFromPrevious()
                else:
                    copy.setValue(self._read_value(stored, sample) if sample > kept[0] else value)
        except (RuntimeError, TypeError):  # types without a Python binding
            self.lost.append(f"{path}.{header.getName()}")
            return
        if not is_constant:
            times = sample_times(stored)
            first, last = self.spans.get(path, (times[0], times[-1]))
            self.spans[path] = min(first, times[0]), max(last, times[-1])

    def _read_value(self, stored: Any, sample: int) -> Any:
        if stored.isArray():
            return read_imath_sample(stored, sample, self._file_size)
        return stored.getValue(sample_selector(stored, sample))


def _with_ancestors(paths: Collection[str]) -> set[str]:
    """Return paths and all their ancestors."""
    return {"/".join(names[:end]) for names in (path.split("/") for path in paths) for end in range(2, len(names) + 1)}


@dataclass(frozen=True, eq=False)
class MeshMatch:
    """Mesh of the sequence, and the matching mesh of the archive, which gets its points."""

    scene_mesh: SceneMesh
    mesh: Mesh
    corners: Index  # (C,) the sequence's corner of each stored corner
    transform: MeshTransform

    def replace_points(self, schema: Any, sampling: int, has_velocities: bool) -> WriteSamples:
        """Create the properties that depend on points in a copied schema; return the writer of their samples."""
        stored = self.mesh.schema
        header = stored.getPositionsProperty().getHeader()
        positions = Abc.OArrayProperty(schema, "P", header.getDataType(), header.getMetaData(), sampling)
        bounds = Abc.OBox3dProperty(schema, ".selfBnds", sampling)
        own_velocities = Abc.OV3fArrayProperty(schema, ".velocities", sampling) if has_velocities else None
        normals = None
        if not self.mesh.is_subdivided and stored.getNormalsParam().valid():
            normals = AbcGeom.ON3fGeomParam(schema, "N", True, CORNER_SCOPE, 1, sampling)
            normal_ids = create_array(imath.UnsignedIntArray, self.scene_mesh.normal_groups[self.corners])

        def write(first: int, points: FloatArray, velocities: FloatArray | None, rounding: RoundingMonitor) -> None:
            mesh, transform = self.scene_mesh, self.transform
            for frame, world in enumerate(points[:, mesh.vertices]):
                own = transform.to_mesh_points(world, first + frame)
                rounding.measure(first + frame, world, transform_points(own, transform.matrices[first + frame]))
                # A sample refers to its array, which must be alive until it is set.
                array = create_array(imath.V3fArray, own)
                positions.setValue(array)
                bounds.setValue(_compute_bounds(own))
                if own_velocities is not None and velocities is not None:
                    rates = transform.to_mesh_velocities(velocities[frame, mesh.vertices], own, first + frame)
                    array = create_array(imath.V3fArray, rates)
                    own_velocities.setValue(array)
                if normals is not None:
                    unit = corner_normals(own[None], mesh.polygons, mesh.normal_groups)[0]
                    array = create_array(imath.V3fArray, -unit if self.transform.is_mirrored else unit)
                    normals.set(AbcGeom.ON3fGeomParamSample(array, normal_ids, CORNER_SCOPE))

        return write


@dataclass(frozen=True, eq=False)
class Original:
    """Original archive, with the matches of a sequence's meshes."""

    path: Path
    archive: Any
    matches: tuple[MeshMatch, ...]


def match_archive(path: Path, header: SequenceHeader) -> Original:
    """Open an archive, and match its meshes with the meshes of a sequence."""
    with translate_read_errors(path, "Alembic", *LIBRARY_ERRORS), prefix_errors(path):
        archive = open_archive(path)
        meshes, _ = find_meshes(path, archive)
        matches = match_meshes(
            path,
            header,
            {mesh.path: mesh for mesh in meshes},
            partial(_match, header),
            partial(_describe_difference, header),
        )
        for match in matches:
            try:
                match.transform.check_invertible()
            except FormatError as error:
                raise FormatError(f"{path}: {match.mesh.path!r} cannot get new points: {error}") from None
        return Original(path, archive, tuple(matches))


def _match(header: SequenceHeader, scene_mesh: SceneMesh, mesh: Mesh) -> MeshMatch | None:
    """Match a mesh of the sequence with a mesh of the archive; return None if vertices or faces differ."""
    if sample_length(mesh.schema.getPositionsProperty(), 0) != scene_mesh.vertex_count:
        return None
    transform = MeshTransform.from_schemas(mesh.transforms, header.times, header.fps)
    found = scene_mesh.match(*stored_polygons(mesh, transform.is_mirrored, header.times))
    return found and MeshMatch(found[0], mesh, found[1].corners, transform)


def _describe_difference(header: SequenceHeader, scene_mesh: SceneMesh, mesh: Mesh) -> str:
    """Describe the first difference between a mesh of the sequence and the only candidate mesh in the archive."""
    count = sample_length(mesh.schema.getPositionsProperty(), 0)
    if count != scene_mesh.vertex_count:
        return f"{mesh.path} has {count} vertices, the sequence {scene_mesh.vertex_count}"
    transform = MeshTransform.from_schemas(mesh.transforms, header.times, header.fps)
    stored, order = stored_polygons(mesh, transform.is_mirrored, header.times)
    polygons = Polygons(stored.counts, stored.indices[order])
    return describe_difference(scene_mesh.polygons, polygons, ("the sequence", mesh.path))


_MAX_COPY_GROWTH = 2
"""Largest size ratio of a copy to its archive, since moving instances become separate objects."""


def _compute_bounds(points: FloatArray) -> Any:
    """Return the bounding box of points ``(n, 3)``, or an empty box without points."""
    if not len(points):
        return imath.Box3d()
    return imath.Box3d(*(imath.V3d(*map(float, end)) for end in bounding_box(points)))


def bound_copy_size(original: Original, header: SequenceHeader, has_velocities: bool) -> int:
    """Return an upper bound on the size of a copy in bytes."""
    vertex_count = sum(match.scene_mesh.vertex_count for match in original.matches)
    normal_count = sum(match.corners.size for match in original.matches)
    per_frame = 12 * (vertex_count * (2 if has_velocities else 1) + normal_count)
    per_frame += SAMPLE_OVERHEAD_BYTES * len(original.matches)
    return _MAX_COPY_GROWTH * original.path.stat().st_size + header.frame_count * per_frame + 4 * normal_count


def copy_archive(
    copy: Any,
    path: Path,
    original: Original,
    header: SequenceHeader,
    sampling: int,
    has_velocities: bool,
    sources: ArrayLike | None = None,
) -> list[WriteSamples]:
    """Copy an archive into the empty one `copy`; return writers of the meshes that get new points."""
    paths = {match.mesh.path for match in original.matches}
    copier = _Copier(copy, paths, header.times, original.path.stat().st_size)
    copier.copy_objects(original.archive.getTop())
    if copier.lost:
        warn(f"{path}: of {original.path} the library cannot copy {format_names(copier.lost)}; they are left out")
    warn_of_unretimed_motion(path, header, dict(sorted(copier.spans.items())), sources)
    return [
        match.replace_points(copier.schemas[match.mesh.path], sampling, has_velocities) for match in original.matches
    ]
