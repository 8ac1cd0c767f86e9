"""Reader of Alembic archives (.abc) as animated meshes in world space.

Frames are at all samples of the points and of the transforms above them. In a copy of an original written by mixseq,
frames are at the samples of the new points only. Values between samples are interpolated linearly. Points are float32,
as in Alembic, or float64 if transforms move them far from zero. Alembic has no units and no up axis; programs assume Y
up. Instances are read as ordinary objects.

Alembic lists the corners of a face clockwise, seen from outside; applications reverse this order. The "scope" of values
is per face, vertex or corner; values may be indexed.

Specification: https://docs.alembic.io/reference/index.html (``IPolyMeshSchema``, ``IGeomParam``, ``IFaceSet``)
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import FormatError, InvalidSequenceError
from mixseq.mesh.measures import hard_edges_from_normals
from mixseq.mesh.polygons import Polygons, reversed_winding
from mixseq.mesh.surface import CornerValues, FaceSet, Origin
from mixseq.sequence.frame_rates import estimate_frame_rate
from mixseq.sequence.header import DEFAULT_FPS, SequenceHeader
from mixseq.types import Float, FloatArray, Index, Single
from mixseq_io.alembic.samples import (
    LIBRARY_ERRORS,
    TIME_TOLERANCE,
    Abc,
    AbcGeom,
    AbcMaterial,
    LocatedFrames,
    MeshTransform,
    Transforms,
    determinant,
    locate_frames,
    open_archive,
    read_sample,
    sample_length,
    sample_selector,
    sample_times,
    transform_points,
)
from mixseq_io.reader import SequenceReader, prefix_errors, translate_read_errors, warn
from mixseq_io.scene_meshes import (
    SceneMesh,
    SceneObject,
    base_face_set,
    check_finite,
    common_name,
    format_names,
    join_meshes,
    merge_times,
    read_valid_meshes,
    select_meshes,
    snap_to_frames,
)
from mixseq_io.surfaces import ensure_alpha

_MAX_OBJECT_COUNT = 1_000_000
_MAX_OBJECT_DEPTH = 200

OVERLAY_KEY = "mixseq_laid_over"
"""Metadata key of meshes with new points: only these points determine frames; velocities are in mesh space."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """Unread mesh in an archive, with the schemas of its points and of the transforms above, the nearest first."""

    file: Path
    file_size: int  # in bytes
    node: Any
    scene_object: SceneObject
    schema: Any
    transforms: tuple[Any, ...]
    is_hidden: bool  # as the mesh or an ancestor is
    has_animated_visibility: bool  # of the mesh or an ancestor

    @property
    def path(self) -> str:
        """Full path of the mesh in the archive."""
        return self.scene_object.path

    @property
    def is_subdivided(self) -> bool:
        """Whether the mesh is a SubD."""
        return bool(AbcGeom.ISubD.matches(self.node.getMetaData()))

    @property
    def is_overlaid(self) -> bool:
        """Whether mixseq has replaced the points of this mesh in a copy of the original."""
        return bool(self.node.getMetaData().get(OVERLAY_KEY))

    @property
    def is_moving(self) -> bool:
        """Whether the points have several samples, even if equal, or a transform above changes."""
        is_sampled = self.schema.getPositionsProperty().getNumSamples() > 1
        return is_sampled or not self.has_static_transforms

    @property
    def has_static_transforms(self) -> bool:
        """Whether all transforms above the mesh are constant."""
        return all(schema.isConstant() for schema in self.transforms)


def _choose_meshes(path: Path, archive: Any, prim: str | None) -> list[Mesh]:
    """Return the meshes below `prim`, or else all visible meshes, in the archive's order."""
    meshes, others = find_meshes(path, archive)
    if not meshes:
        contents = ", ".join(f"{count} {kind}" for kind, count in sorted(others.items())) or "nothing else"
        raise FormatError(f"{path} has no mesh; it has {contents}. Export meshes, as PolyMesh or SubD")
    if prim is not None:
        named = [meshes[i] for i in select_meshes(path, [mesh.scene_object for mesh in meshes], prim)]
        return [mesh for mesh in named if not mesh.is_hidden] or named
    visible = [mesh for mesh in meshes if not mesh.is_hidden]
    if not visible:
        hidden = format_names([mesh.path for mesh in meshes])
        raise FormatError(f"{path}: its meshes are hidden; name one by prim (--prim): {hidden}")
    return visible


def find_meshes(path: Path, archive: Any) -> tuple[list[Mesh], Counter[str]]:
    """Return all meshes with points, and the counts of other objects by kind."""
    meshes: list[Mesh] = []
    others: Counter[str] = Counter()
    stack: list[tuple[Any, SceneObject, tuple[Any, ...], bool, bool, int]] = []
    stack.append((archive.getTop(), SceneObject("/", ()), (), False, False, 0))
    count, file_size = 0, path.stat().st_size
    while stack:
        node, scene_object, transforms, is_hidden, has_animated_visibility, depth = stack.pop()
        count += 1
        if depth > _MAX_OBJECT_DEPTH or count > _MAX_OBJECT_COUNT:
            raise FormatError(f"{path}: its objects nest without end; it is damaged, or an instance contains itself")
        metadata = node.getMetaData()
        visibility = AbcGeom.GetVisibilityProperty(node) if depth else None
        if visibility is not None and visibility.valid() and visibility.getNumSamples():
            if visibility.isConstant():
                is_hidden |= visibility.getValue() == 0  # 0 is hidden, 1 visible, -1 inherited
            else:
                has_animated_visibility = True
        existing = Abc.WrapExistingFlag.kWrapExisting
        if AbcGeom.IPolyMesh.matches(metadata) or AbcGeom.ISubD.matches(metadata):
            kind = AbcGeom.IPolyMesh if AbcGeom.IPolyMesh.matches(metadata) else AbcGeom.ISubD
            try:
                schema = kind(node, existing).getSchema()
                if schema.getPositionsProperty().getNumSamples():
                    visibility = is_hidden, has_animated_visibility
                    meshes.append(Mesh(path, file_size, node, scene_object, schema, transforms, *visibility))
            except LIBRARY_ERRORS:
                warn(f"{path}: {scene_object.path} lacks properties of a mesh; it is damaged, and is left out")
        elif AbcGeom.IXform.matches(metadata):
            transforms = (AbcGeom.IXform(node, existing).getSchema(), *transforms)
        elif not AbcGeom.IFaceSet.matches(metadata) and metadata.get("schema"):
            others[metadata.get("schema").removeprefix("AbcGeom_").partition("_")[0]] += 1
        for child in reversed([node.getChild(index) for index in range(node.getNumChildren())]):
            child_object = SceneObject(str(child.getFullName()), (str(child.getName()),), scene_object)
            stack.append((child, child_object, transforms, is_hidden, has_animated_visibility, depth + 1))
    return meshes, others


COLOUR_PARAMETER = "Cd"
"""Name of the geometry parameter for colours."""

_COLOUR_TYPES = (AbcGeom.IC3fGeomParam, AbcGeom.IC4fGeomParam)
_SCHEME_NAMES = {"catmull-clark": "catmullClark", "": "catmullClark", "loop": "loop", "bilinear": "bilinear"}


def _read_scene_mesh(animated: _AnimatedMesh) -> SceneMesh:
    """Return a mesh whose polygons are counter-clockwise, seen from outside."""
    mesh = animated.mesh
    stored, order = stored_polygons(mesh, animated.is_mirrored, animated.times)
    polygons = Polygons(stored.counts, stored.indices[order])
    uvs, colours, hard_edges = _read_uvs(mesh, stored), _read_colours(mesh, stored), None
    if not mesh.is_subdivided:
        normals = _read_corner_values(mesh, mesh.schema.getNormalsParam(), stored, "normals")
        if normals is not None and normals.values.shape[1] == 3:
            hard_edges = hard_edges_from_normals(polygons, normals.at_corners[order])
    return SceneMesh(
        name=mesh.scene_object.name,
        path=mesh.path,
        vertices=animated.vertices,
        polygons=polygons,
        uvs=uvs and uvs.select(order),
        colours=colours and colours.select(order),
        hard_edges=hard_edges,
        face_sets=_read_face_sets(mesh, len(stored.counts)),
        subdivision=_read_scheme(mesh) if mesh.is_subdivided else "none",
    )


def stored_polygons(mesh: Mesh, is_mirrored: bool, times: Float) -> tuple[Polygons, Index]:
    """Return the polygons as stored, and the stored corner of each corner in mixseq's order."""
    properties = mesh.schema.getFaceCountsProperty(), mesh.schema.getFaceIndicesProperty()
    stored = Polygons(*(_read_constant(mesh, array, times) for array in properties))
    if is_mirrored:
        return stored, np.arange(stored.indices.size)
    return stored, reversed_winding(stored.counts, keep_first=False)


def _read_constant(mesh: Mesh, array: Any, times: Float) -> NDArray[np.int32]:
    """Return an array property's constant value; raise an error if its samples differ."""
    time = _find_change(array)
    if time is not None:
        index = int(np.searchsorted(times, time))
        raise InvalidSequenceError(
            f"the faces of {mesh.path} change at {time:g} s (index {index}); every frame needs the same "
            "faces: export without remeshing, or the part of the time line before it"
        )
    return read_sample(array, 0, mesh.file_size)


def _find_change(array: Any) -> float | None:
    """Return the time in s of the first sample that differs from sample 0, or None if all samples are equal."""
    if array.isConstant():
        return None
    first = array.getKey(sample_selector(array, 0))
    times = enumerate(sample_times(array))
    return next((time for sample, time in times if array.getKey(sample_selector(array, sample)) != first), None)


def _read_uvs(mesh: Mesh, polygons: Polygons) -> CornerValues | None:
    parameters, parameter = mesh.schema.getArbGeomParams(), mesh.schema.getUVsParam()
    headers = parameters.propertyheaders if parameters.valid() else ()
    others = [header.getName() for header in headers if header.isUV()]
    if others:
        kept = "the standard ones are kept" if parameter.valid() else "they are left out"
        warn(f"{mesh.file}: {mesh.path} has more texture coordinates, {', '.join(others)}; {kept}")
    _warn_if_animated(mesh, parameter, "texture coordinates")
    return _read_corner_values(mesh, parameter, polygons, "texture coordinates")


def _read_colours(mesh: Mesh, polygons: Polygons) -> CornerValues | None:
    """Return the colour parameter ``Cd``, or else the first colour parameter, as RGBA."""
    parameters = mesh.schema.getArbGeomParams()
    headers = parameters.propertyheaders if parameters.valid() else ()
    types = {each.getName(): kind for each in headers for kind in _COLOUR_TYPES if kind.matches(each)}
    if not types:
        return None
    name = COLOUR_PARAMETER if COLOUR_PARAMETER in types else next(iter(types))
    if len(types) > 1:
        warn(f"{mesh.file}: {mesh.path} has several sets of colours; {name} is kept")
    parameter = types[name](parameters, name)
    _warn_if_animated(mesh, parameter, "colours")
    colours = _read_corner_values(mesh, parameter, polygons, "colours")
    return colours and CornerValues(ensure_alpha(colours.values), colours.indices)


def _warn_if_animated(mesh: Mesh, parameter: Any, label: str) -> None:
    if not parameter.valid():
        return
    arrays = [parameter.getValueProperty()]
    if parameter.isIndexed():
        arrays.append(parameter.getIndexProperty())
    if any(_find_change(array) is not None for array in arrays):
        warn(f"{mesh.file}: {label} of {mesh.path} that change over time stay as they are in the first frame")


def _read_corner_values(mesh: Mesh, parameter: Any, polygons: Polygons, label: str) -> CornerValues | None:
    """Return a geometry parameter's first sample, of any scope, as values at corners in stored order."""
    if not parameter.valid() or not parameter.getNumSamples():
        return None
    values = read_sample(parameter.getValueProperty(), 0, mesh.file_size)
    indices = np.arange(len(values))
    if parameter.isIndexed():
        indices = read_sample(parameter.getIndexProperty(), 0, mesh.file_size)
    scopes, vertex_count = AbcGeom.GeometryScope, sample_length(mesh.schema.getPositionsProperty(), 0)
    faces = np.repeat(np.arange(len(polygons.counts)), polygons.counts)
    elements = {
        scopes.kFacevaryingScope: (polygons.indices.size, np.arange(polygons.indices.size)),
        scopes.kVertexScope: (vertex_count, polygons.indices),
        scopes.kVaryingScope: (vertex_count, polygons.indices),
        scopes.kUniformScope: (len(polygons.counts), faces),
        scopes.kConstantScope: (1, np.zeros_like(faces)),
    }
    # Values without scope, which the library takes for constant, get the first with the right number of elements.
    fitting = (each for each in elements.values() if each[0] == len(indices))
    declared = elements.get(parameter.getScope()) if parameter.getMetaData().get("geoScope") else None
    size, of_corner = declared or next(fitting, (-1, faces))
    is_valid = size == len(indices) and indices.min(initial=0) >= 0 and indices.max(initial=-1) < len(values)
    if not is_valid or of_corner.min(initial=0) < 0 or of_corner.max(initial=-1) >= len(indices):
        warn(f"{mesh.file}: the {label} of {mesh.path} do not fit its faces; they are left out")
        return None
    return CornerValues(values, indices[of_corner])


def _read_face_sets(mesh: Mesh, polygon_count: int) -> tuple[FaceSet, ...]:
    """Return the face sets, preceded by a face set for the material that is assigned to the mesh, if any."""
    face_sets = []
    for name in mesh.schema.getFaceSetNames():
        node = mesh.schema.getFaceSet(name)
        faces = node.getSchema().getFacesProperty()
        if faces.getNumSamples():
            polygons = read_sample(faces, 0, mesh.file_size)
            face_sets.append(FaceSet(name, polygons, AbcMaterial.getMaterialAssignmentPath(node)))
    if material := AbcMaterial.getMaterialAssignmentPath(mesh.node):
        face_sets[:0] = base_face_set(material, polygon_count, [each for each in face_sets if each.material])
    return tuple(face_sets)


def _read_scheme(mesh: Mesh) -> str:
    """Return a SubD's subdivision scheme; unknown schemes are read as Catmull-Clark."""
    scheme = mesh.schema.getSubdivisionSchemeProperty()
    name = scheme.getValue() if scheme.valid() and scheme.getNumSamples() else ""
    if name in _SCHEME_NAMES.values():
        return str(name)
    if name not in _SCHEME_NAMES:
        warn(f"{mesh.file}: {mesh.path} is subdivided by {name!r}, which is read as Catmull-Clark")
    return _SCHEME_NAMES.get(name, "catmullClark")


def open_alembic(path: Path, prim: str | None = None) -> SequenceReader:
    """Open an Alembic file."""
    with translate_read_errors(path, "Alembic", *LIBRARY_ERRORS), prefix_errors(path):
        archive = open_archive(path)
        meshes = _choose_meshes(path, archive, prim)
        is_moving = [prim is None and mesh.is_moving for mesh in meshes]
        metadata = archive.getTop().getMetaData()
        try:
            declared_rate = float(metadata.get("_ai_DCC_FPS") or metadata.get("FramesPerTimeUnit") or 0)
        except ValueError:
            declared_rate = 0.0

        def prepare(chosen: list[int]) -> Callable[[int], tuple[_AnimatedMesh, SceneMesh, float]]:
            times = _choose_times([meshes[index] for index in chosen])
            fps = estimate_frame_rate(times, declared_rate) or DEFAULT_FPS
            vertex_counts = [0]

            def read(index: int) -> tuple[_AnimatedMesh, SceneMesh, float]:
                animated = _locate_frames(meshes[index], times, fps, sum(vertex_counts))
                vertex_counts.append(animated.vertex_count)
                scene_mesh = _read_scene_mesh(animated)
                check_finite(_read_world_points(animated, 0), animated.describe_frame(0))
                return animated, scene_mesh, fps

            return read

        objects = [mesh.scene_object for mesh in meshes]
        animated_meshes, scene_meshes, rates = zip(*read_valid_meshes(path, objects, is_moving, prepare), strict=True)
        read_meshes = [animated.mesh for animated in animated_meshes]
        visible_at_times = [mesh.path for mesh in read_meshes if mesh.has_animated_visibility]
        if visible_at_times:
            warn(f"{path}: {format_names(visible_at_times)} are hidden at times; they are read as visible")
        polygons, surface = join_meshes(scene_meshes, Origin("Alembic", str(path.resolve())))
        header = SequenceHeader(
            polygons=polygons,
            vertex_count=animated_meshes[-1].vertices.stop,
            times=snap_to_frames(animated_meshes[0].times, rates[0]),
            fps=rates[0],
            name=common_name([mesh.scene_object for mesh in read_meshes]) or path.stem,
            surface=surface,
        )
        return _AlembicReader(path, header, animated_meshes, _have_velocities(path, animated_meshes))


@dataclass(frozen=True, eq=False)
class _AnimatedMesh:
    """Mesh with its samples and transforms at frame times ``(T,)`` in s."""

    mesh: Mesh
    vertices: slice  # in the sequence
    is_mirrored: bool  # in the first frame
    times: Float
    samples: LocatedFrames
    transforms: Transforms
    overlay_transform: MeshTransform | None = None  # of new points below moving transforms

    @property
    def vertex_count(self) -> int:
        """Number V of vertices."""
        return int(self.vertices.stop - self.vertices.start)

    def describe_frame(self, frame: int) -> str:
        """Return a description of a frame for messages."""
        return f"the frame at {self.times[frame]:g} s (index {frame}) of {self.mesh.path}"


class _AlembicReader(SequenceReader):
    def __init__(
        self, path: Path, header: SequenceHeader, animated_meshes: Sequence[_AnimatedMesh], has_velocities: bool
    ) -> None:
        super().__init__(path, header, has_velocities=has_velocities)
        self._meshes: Sequence[_AnimatedMesh] = animated_meshes

    def close(self) -> None:
        """Release all objects of the archive; the library then closes it."""
        super().close()
        self._meshes = ()

    def _read(self, what: str, size: int) -> Iterator[FloatArray]:
        read_vectors = _read_world_points if what == "points" else _read_world_velocities
        for start in range(0, self.header.frame_count, size):
            stop = min(start + size, self.header.frame_count)
            block = np.empty((stop - start, self.header.vertex_count, 3))
            with translate_read_errors(self.path, "Alembic", *LIBRARY_ERRORS), prefix_errors(self.path):
                for frame in range(start, stop):
                    for animated in self._meshes:
                        block[frame - start, animated.vertices] = read_vectors(animated, frame)
            with np.errstate(
                over="ignore", under="ignore"
            ):  # values that are not finite are reported with their vertex
                yield self._round(block) if what == "points" else block.astype(np.float32)


def _choose_times(meshes: list[Mesh]) -> Float:
    """Return the sample times in s of animated points and transforms, or of static points if nothing is animated."""
    overlaid = [mesh for mesh in meshes if mesh.is_overlaid]
    points = [mesh.schema.getPositionsProperty() for mesh in overlaid or meshes]
    if overlaid:
        return merge_times(map(sample_times, points), TIME_TOLERANCE)
    transforms = [schema for mesh in meshes for schema in mesh.transforms]
    changing = [each for each in (*points, *transforms) if not each.isConstant()]
    longest = max(points, key=lambda each: int(each.getNumSamples()))
    return merge_times(map(sample_times, changing or [longest]), TIME_TOLERANCE)


def _locate_frames(mesh: Mesh, times: Float, fps: float, first_vertex: int) -> _AnimatedMesh:
    """Locate frame times ``(T,)`` between the samples of a mesh and its transforms."""
    points, transforms = mesh.schema.getPositionsProperty(), Transforms.from_schemas(mesh.transforms, times)
    samples = locate_frames(sample_times(points), times)
    count = sample_length(points, samples[0][0])
    if not count:
        raise InvalidSequenceError(f"{mesh.path} has no points")
    if 12 * count > mesh.file_size:
        raise FormatError(f"{mesh.file}: {mesh.path} claims {count} vertices, more than the file can hold")
    is_mirrored, vertices = determinant(transforms.to_world(0)) < 0, slice(first_vertex, first_vertex + count)
    overlay_transform = None
    if mesh.is_overlaid and not mesh.has_static_transforms:
        overlay_transform = MeshTransform.from_schemas(mesh.transforms, times, fps)
    animated = _AnimatedMesh(mesh, vertices, is_mirrored, times, samples, transforms, overlay_transform)
    for frame in range(0 if points.isConstant() else len(times)):
        _check_count(animated, frame, sample_length(points, samples[frame][0]), "points")
    return animated


def _check_count(animated: _AnimatedMesh, frame: int, count: int, label: str) -> None:
    if count != animated.vertex_count:
        raise InvalidSequenceError(
            f"{animated.describe_frame(frame)} has {count} {label}, the first frame {animated.vertex_count} "
            "points; every frame needs the same vertices in the same order"
        )


def _interpolate(animated: _AnimatedMesh, array: Any, frame: int, label: str) -> Single:
    """Return the value ``(V, 3)`` of an array property at a frame, interpolated between samples if needed."""
    sample, weight = animated.samples[frame]
    arrays = [
        read_sample(array, index, animated.mesh.file_size) for index in ((sample, sample + 1) if weight else (sample,))
    ]
    for each in arrays:
        _check_count(animated, frame, len(each), label)
    if not weight:
        return arrays[0]
    blend = (1 - weight) * arrays[0].astype(np.float64) + weight * arrays[1].astype(np.float64)
    return blend.astype(np.float32)


def _read_world_points(animated: _AnimatedMesh, frame: int) -> FloatArray:
    points = _interpolate(animated, animated.mesh.schema.getPositionsProperty(), frame, "points")
    matrix = animated.transforms.to_world(frame)
    if determinant(matrix) * (-1 if animated.is_mirrored else 1) < 0:
        raise InvalidSequenceError(
            f"{animated.describe_frame(frame)}: the transform mirrors the mesh relative to the first frame, which "
            "turns its faces inside out; animate the scale without a change of sign"
        )
    return transform_points(points, matrix)


def _read_world_velocities(animated: _AnimatedMesh, frame: int) -> FloatArray:
    velocities = animated.mesh.schema.getVelocitiesProperty()
    if not velocities.valid():  # only static meshes may lack velocities
        return np.zeros((animated.vertex_count, 3), np.float32)
    own = _interpolate(animated, velocities, frame, "velocities")
    if animated.overlay_transform is None:
        return transform_points(own, animated.transforms.to_world(frame)[:3, :3])
    points = _interpolate(animated, animated.mesh.schema.getPositionsProperty(), frame, "points")
    return animated.overlay_transform.to_world_velocities(own, points, frame)


def _have_velocities(path: Path, animated_meshes: Sequence[_AnimatedMesh]) -> bool:
    """Whether velocities of all moving meshes can be read; warn if only some can."""
    properties = [animated.mesh.schema.getVelocitiesProperty() for animated in animated_meshes]
    if not any(velocities.valid() for velocities in properties):
        return False
    for animated, velocities in zip(animated_meshes, properties, strict=True):
        mesh = animated.mesh
        points = mesh.schema.getPositionsProperty()
        if not velocities.valid():
            problem = "are missing, and others have some" if mesh.is_moving else ""
        elif not np.array_equal(sample_times(velocities), sample_times(points)):
            problem = "are not sampled at the times of the points"
        elif sample_length(velocities, 0) != animated.vertex_count:
            problem = f"are {sample_length(velocities, 0)}, not as many as its points"
        elif not (mesh.is_overlaid or mesh.has_static_transforms):
            problem = "do not contain the motion of its transforms"
        elif mesh.is_moving and not _are_at_samples(animated.samples):
            problem = "are not sampled in every frame"
        else:
            problem = ""
        if problem:
            warn(f"{path}: the velocities of {mesh.path} {problem}; velocities are left out")
            return False
    return True


def _are_at_samples(located: LocatedFrames) -> bool:
    """Whether every frame is at a sample of its own."""
    return not any(weight for _, weight in located) and all(a < b for (a, _), (b, _) in pairwise(located))
