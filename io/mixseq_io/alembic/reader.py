"""Alembic, reading: meshes of an archive (.abc) over time, in world space.

Frames are at all samples of the points and of the transforms above, others interpolated linearly; at the points' times
only where mixseq laid them over an archive. Points are float32, as in Alembic, which has no units and no up axis: tools
assume Y up. Instances appear as the objects they stand for.

Alembic lists a face's corners clockwise seen from outside; applications write them from the last to the first. Values
come per face, vertex or corner (their "scope"), with or without indices.

Specification: https://docs.alembic.io/reference/index.html (``IPolyMeshSchema``, ``IGeomParam``, ``IFaceSet``)
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import FormatError, InvalidSequenceError
from mixseq.mesh.measures import hard_edges_of_normals
from mixseq.mesh.polygons import Polygons, reversed_corners
from mixseq.mesh.surface import CornerValues, FaceSet, Origin
from mixseq.sequence.header import SequenceHeader
from mixseq.types import Float, FloatArray, Index
from mixseq_io.alembic.library import (
    ERRORS,
    Abc,
    AbcGeom,
    AbcMaterial,
    length,
    open_archive,
    selector,
    values,
)
from mixseq_io.alembic.samples import (
    TIME_TOLERANCE,
    Placing,
    SampleWeights,
    Transforms,
    determinant,
    frame_rate,
    locate,
    moved,
    sample_times,
)
from mixseq_io.reader import SequenceReader, prefix_errors, translate_read_errors, warn
from mixseq_io.scene_meshes import (
    SceneMesh,
    SceneObject,
    base_face_set,
    common_name,
    format_names,
    join_meshes,
    merge_times,
    select_meshes,
    select_moving_meshes,
)
from mixseq_io.surfaces import ensure_alpha

_MOST_OBJECTS = 1_000_000
LAID_OVER = "mixseq_laid_over"
"""Metadata of meshes laid over an archive: frames at their points' times only, velocities as rates in mesh space."""

_DEEPEST = 200
"""Largest depth of objects; instances of their own ancestors would nest without end."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """Unread mesh: its object, place, schema, and transforms above, the nearest first.

    `hidden` and `flickers`: it or an ancestor is hidden at all times, or at some.
    """

    node: Any
    place: SceneObject
    schema: Any
    above: tuple[Any, ...]
    hidden: bool
    flickers: bool

    @property
    def path(self) -> str:
        """Full name."""
        return self.place.path

    @property
    def name(self) -> str:
        """Own name."""
        return self.place.name

    @property
    def subdivided(self) -> bool:
        """Whether it is a SubD."""
        return bool(AbcGeom.ISubD.matches(self.node.getMetaData()))

    @property
    def laid_over(self) -> bool:
        """Whether mixseq laid its points over an archive."""
        return bool(self.node.getMetaData().get(LAID_OVER))

    @property
    def moves(self) -> bool:
        """Whether its points have several samples, even equal ones, or a transform above changes."""
        sampled = self.schema.getPositionsProperty().getNumSamples() > 1
        return sampled or not all(each.isConstant() for each in self.above)


def choose_meshes(path: Path, archive: Any, prim: str | None) -> list[Mesh]:
    """Return the meshes to read, in the archive's order."""
    meshes, others = find_meshes(path, archive)
    if not meshes:
        found = (
            ", ".join(f"{count} {kind}" for kind, count in sorted(others.items())) or "nothing else either"
        )
        raise FormatError(f"{path} has no mesh; it has {found}. Export meshes, as PolyMesh or SubD")
    if prim is not None:
        named = [meshes[i] for i in select_meshes(path, [mesh.place for mesh in meshes], prim)]
        picked = [mesh for mesh in named if not mesh.hidden] or named
    else:
        shown = [mesh for mesh in meshes if not mesh.hidden]
        if not shown:
            hidden = format_names([mesh.path for mesh in meshes])
            raise FormatError(f"{path}: its meshes are hidden; name one by prim (--prim): {hidden}")
        numbers = select_moving_meshes(path, [mesh.place for mesh in shown], [mesh.moves for mesh in shown])
        picked = [shown[i] for i in numbers]
    flickering = [mesh.path for mesh in picked if mesh.flickers]
    if flickering:
        warn(f"{path}: {format_names(flickering)} are hidden at times; they are taken as visible")
    return picked


def find_meshes(path: Path, archive: Any) -> tuple[list[Mesh], Counter[str]]:
    """Return all meshes with points, and the number of objects by other kind."""
    meshes: list[Mesh] = []
    others: Counter[str] = Counter()
    top = SceneObject("/", ())
    stack: list[tuple[Any, SceneObject, tuple[Any, ...], bool, bool, int]] = [
        (archive.getTop(), top, (), False, False, 0)
    ]
    seen = 0
    while stack:
        node, place, above, hidden, flickers, depth = stack.pop()
        seen += 1
        if depth > _DEEPEST or seen > _MOST_OBJECTS:
            raise FormatError(
                f"{path}: its objects nest without end; it is damaged, or an instance contains itself"
            )
        metadata = node.getMetaData()
        visibility = AbcGeom.GetVisibilityProperty(node) if depth else None
        if visibility is not None and visibility.valid() and visibility.getNumSamples():
            if visibility.isConstant():
                hidden |= visibility.getValue() == 0  # 1 is visible, -1 leaves it to the parent
            else:
                flickers = True
        existing = Abc.WrapExistingFlag.kWrapExisting
        if AbcGeom.IPolyMesh.matches(metadata) or AbcGeom.ISubD.matches(metadata):
            kind = AbcGeom.IPolyMesh if AbcGeom.IPolyMesh.matches(metadata) else AbcGeom.ISubD
            schema = kind(node, existing).getSchema()
            if schema.getPositionsProperty().getNumSamples():
                meshes.append(Mesh(node, place, schema, above, hidden, flickers))
        elif AbcGeom.IXform.matches(metadata):
            above = (AbcGeom.IXform(node, existing).getSchema(), *above)
        elif not AbcGeom.IFaceSet.matches(metadata) and metadata.get("schema"):
            others[metadata.get("schema").removeprefix("AbcGeom_").partition("_")[0]] += 1
        children = [node.getChild(index) for index in range(node.getNumChildren())]
        stack += [
            (
                child,
                SceneObject(str(child.getFullName()), (str(child.getName()),), place),
                above,
                hidden,
                flickers,
                depth + 1,
            )
            for child in reversed(children)
        ]
    return meshes, others


COLOURS = "Cd"
"""Name of colours among a mesh's geometry parameters."""

_COLOUR_KINDS = (AbcGeom.IC3fGeomParam, AbcGeom.IC4fGeomParam)
_SCHEMES = {"catmull-clark": "catmullClark", "": "catmullClark", "loop": "loop", "bilinear": "bilinear"}


@dataclass(frozen=True, eq=False)
class Source:
    """Mesh to be read from a file of `room` bytes; its vertices in the sequence, and frame times ``(T,)`` in s.

    `mirrored`: the transforms above it mirror. Path and times are for messages.
    """

    path: Path
    room: int
    mesh: Mesh
    vertices: slice
    mirrored: bool
    frames: Float

    @property
    def vertex_count(self) -> int:
        """Number of vertices."""
        return int(self.vertices.stop - self.vertices.start)


def read_scene_mesh(source: Source) -> SceneMesh:
    """Return a mesh, its polygons counter-clockwise seen from outside."""
    schema, mesh = source.mesh.schema, source.mesh
    stored, order = stored_polygons(source)
    polygons = Polygons(stored.counts, stored.indices[order])
    uvs, colours, hard_edges = _texture_coordinates(source, stored), _colours(source, stored), None
    if not mesh.subdivided:
        normals = _corner_values(source, schema.getNormalsParam(), stored, "normals")
        if normals is not None and normals.values.shape[1] == 3:
            hard_edges = hard_edges_of_normals(polygons, normals.at_corners[order])
    return SceneMesh(
        name=mesh.name,
        path=mesh.path,
        vertices=source.vertices,
        polygons=polygons,
        uvs=uvs and uvs.taken(order),
        colours=colours and colours.taken(order),
        hard_edges=hard_edges,
        face_sets=_face_sets(source, len(stored.counts)),
        subdivision=_scheme(source) if mesh.subdivided else "none",
    )


def stored_polygons(source: Source) -> tuple[Polygons, Index]:
    """Return the polygons as stored, and the stored corner of each corner in mixseq's order."""
    schema = source.mesh.schema
    stored = Polygons(
        _constant(source, schema.getFaceCountsProperty()), _constant(source, schema.getFaceIndicesProperty())
    )
    if source.mirrored:
        return stored, np.arange(stored.indices.size)
    return stored, reversed_corners(stored.counts, keep_first=False)


def _constant(source: Source, array: Any) -> NDArray[np.int32]:
    """Return an array that must be constant; some exporters repeat it at every sample."""
    time = _change(array)
    if time is not None:
        index = int(np.searchsorted(source.frames, time))
        raise InvalidSequenceError(
            f"the faces of {source.mesh.path} change at {time:g} s (index {index}); every frame needs the same "
            "faces: export without remeshing, or the part of the time line before it"
        )
    return values(array, 0, source.room)


def _change(array: Any) -> float | None:
    """Return the time in s of an array's first changed sample, None if it is constant."""
    if array.isConstant():
        return None
    first = array.getKey(selector(array, 0))
    times = enumerate(sample_times(array))
    return next((time for sample, time in times if array.getKey(selector(array, sample)) != first), None)


def _texture_coordinates(source: Source, polygons: Polygons) -> CornerValues | None:
    schema = source.mesh.schema
    others = schema.getArbGeomParams()
    more = [each.getName() for each in others.propertyheaders if each.isUV()] if others.valid() else []
    parameter = schema.getUVsParam()
    if more:
        kept = "the standard ones are kept" if parameter.valid() else "they are left out"
        warn(f"{source.path}: {source.mesh.path} has more texture coordinates, {', '.join(more)}; {kept}")
    _warn_of_changes(source, parameter, "texture coordinates")
    return _corner_values(source, parameter, polygons, "texture coordinates")


def _colours(source: Source, polygons: Polygons) -> CornerValues | None:
    """Return the colours ``Cd``, or the first colour parameter."""
    others = source.mesh.schema.getArbGeomParams()
    kinds = {
        each.getName(): kind
        for each in (others.propertyheaders if others.valid() else ())
        for kind in _COLOUR_KINDS
        if kind.matches(each)
    }
    if not kinds:
        return None
    name = COLOURS if COLOURS in kinds else next(iter(kinds))
    if len(kinds) > 1:
        warn(f"{source.path}: {source.mesh.path} has several sets of colours; {name} is kept")
    parameter = kinds[name](others, name)
    _warn_of_changes(source, parameter, "colours")
    found = _corner_values(source, parameter, polygons, "colours")
    return found and CornerValues(ensure_alpha(found.values), found.indices)


def _warn_of_changes(source: Source, parameter: Any, what: str) -> None:
    if not parameter.valid():
        return
    arrays = [
        parameter.getValueProperty(),
        *([parameter.getIndexProperty()] if parameter.isIndexed() else []),
    ]
    if any(_change(array) is not None for array in arrays):
        warn(
            f"{source.path}: {what} of {source.mesh.path} that change over time stay as they are in the first frame"
        )


def _corner_values(source: Source, parameter: Any, polygons: Polygons, what: str) -> CornerValues | None:
    """Return a geometry parameter's first sample at the corners, in stored order, for any scope."""
    if not parameter.valid() or not parameter.getNumSamples():
        return None
    rows = values(parameter.getValueProperty(), 0, source.room)
    indices = (
        values(parameter.getIndexProperty(), 0, source.room)
        if parameter.isIndexed()
        else np.arange(len(rows))
    )
    scope, scopes = parameter.getScope(), AbcGeom.GeometryScope
    faces = np.repeat(np.arange(len(polygons.counts)), polygons.counts)
    places = {
        scopes.kFacevaryingScope: (polygons.indices.size, np.arange(polygons.indices.size)),
        scopes.kVertexScope: (source.vertex_count, polygons.indices),
        scopes.kVaryingScope: (source.vertex_count, polygons.indices),
        scopes.kUniformScope: (len(polygons.counts), faces),
        scopes.kConstantScope: (1, np.zeros_like(faces)),
    }
    # Without a scope, what fits.
    size, place = places.get(scope) or next((p for p in places.values() if p[0] == len(indices)), (-1, faces))
    fits = size == len(indices) and indices.min(initial=0) >= 0 and indices.max(initial=-1) < len(rows)
    if not fits or place.min(initial=0) < 0 or place.max(initial=-1) >= len(indices):
        warn(f"{source.path}: the {what} of {source.mesh.path} do not fit its faces; they are left out")
        return None
    return CornerValues(rows, indices[place])


def _face_sets(source: Source, polygon_count: int) -> tuple[FaceSet, ...]:
    """Return the mesh's material on faces without a face set's material, and the face sets."""
    sets = []
    for name in source.mesh.schema.getFaceSetNames():
        node = source.mesh.schema.getFaceSet(name)
        faces = node.getSchema().getFacesProperty()
        if faces.getNumSamples():
            polygons = values(faces, 0, source.room)
            sets.append(FaceSet(name, polygons, AbcMaterial.getMaterialAssignmentPath(node)))
    whole = AbcMaterial.getMaterialAssignmentPath(source.mesh.node)
    rest = base_face_set(whole, polygon_count, [each for each in sets if each.material]) if whole else ()
    return (*rest, *sets)


def _scheme(source: Source) -> str:
    """Return a SubD's scheme; unknown ones count as Catmull-Clark, the default."""
    scheme = source.mesh.schema.getSubdivisionSchemeProperty()
    named = scheme.getValue() if scheme.valid() and scheme.getNumSamples() else ""
    if named not in (*_SCHEMES, *_SCHEMES.values()):
        warn(f"{source.path}: {source.mesh.path} is subdivided by {named!r}, which is taken as Catmull-Clark")
    return _SCHEMES.get(named, named if named in _SCHEMES.values() else "catmullClark")


def open_alembic(path: Path, prim: str | None = None) -> SequenceReader:
    """Open an Alembic file."""
    with translate_read_errors(path, "Alembic", *ERRORS), prefix_errors(path):
        archive = open_archive(path)
        meshes = choose_meshes(path, archive, prim)
        frames = _frames(meshes)
        room = path.stat().st_size
        metadata = archive.getTop().getMetaData()
        fps = frame_rate(frames, metadata.get("_ai_DCC_FPS") or metadata.get("FramesPerTimeUnit"))
        animated_meshes = _animated_meshes(path, room, meshes, frames, fps)
        origin = Origin("Alembic", str(path.resolve()))
        polygons, surface = join_meshes(
            [read_scene_mesh(animated.source) for animated in animated_meshes], origin
        )
        header = SequenceHeader(
            polygons=polygons,
            vertex_count=animated_meshes[-1].source.vertices.stop,
            times=frames,
            fps=fps,
            name=common_name([mesh.place for mesh in meshes]) or path.stem,
            surface=surface,
        )
        return _AlembicReader(path, header, animated_meshes, _have_velocities(path, animated_meshes))


@dataclass(frozen=True, eq=False)
class _AnimatedMesh:
    """Mesh with the samples around each frame, and the transforms above it."""

    source: Source
    samples: SampleWeights
    transforms: Transforms
    placing: Placing | None = None  # of a mesh laid over an archive whose transforms move

    def place(self, frame: int) -> str:
        """Return a frame's name for messages."""
        return f"the frame at {self.source.frames[frame]:g} s (index {frame}) of {self.source.mesh.path}"


class _AlembicReader(SequenceReader):
    def __init__(
        self, path: Path, header: SequenceHeader, animated_meshes: list[_AnimatedMesh], moving: bool
    ) -> None:
        super().__init__(path, header, has_velocities=moving)
        self._meshes = animated_meshes

    def close(self) -> None:
        """Release the archive; it closes with the last of its objects."""
        super().close()
        self._meshes = []

    def _read(self, what: str, size: int) -> Iterator[FloatArray]:
        values_of = _world_points if what == "points" else _world_velocities
        for start in range(0, self.header.frame_count, size):
            stop = min(start + size, self.header.frame_count)
            block = np.empty((stop - start, self.header.vertex_count, 3), np.float32)
            with translate_read_errors(self.path, "Alembic", *ERRORS), prefix_errors(self.path):
                for frame in range(start, stop):
                    for animated in self._meshes:
                        block[frame - start, animated.source.vertices] = values_of(animated, frame)
            yield block


def _frames(meshes: list[Mesh]) -> Float:
    """Return the times in s at which anything changes; without changes, those of the samples."""
    laid_over = [mesh for mesh in meshes if mesh.laid_over]
    points = [mesh.schema.getPositionsProperty() for mesh in laid_over or meshes]
    if laid_over:
        return merge_times([sample_times(each) for each in points], TIME_TOLERANCE)
    transforms = [schema for mesh in meshes for schema in mesh.above]
    changing = [each for each in (*points, *transforms) if not each.isConstant()]
    longest = max(points, key=lambda each: int(each.getNumSamples()))
    return merge_times([sample_times(each) for each in changing or [longest]], TIME_TOLERANCE)


def _animated_meshes(
    path: Path, room: int, meshes: list[Mesh], frames: Float, fps: float
) -> list[_AnimatedMesh]:
    animated_meshes, vertex = [], 0
    for mesh in meshes:
        points, transforms = mesh.schema.getPositionsProperty(), Transforms.at(mesh.above, frames)
        samples = locate(sample_times(points), frames)
        end = vertex + length(points, samples.at(0)[0])
        if 12 * (end - vertex) > room:
            raise FormatError(
                f"{path}: {mesh.path} claims {end - vertex} vertices, more than the file can hold"
            )
        mirrored = determinant(transforms.to_world(0)) < 0
        source = Source(path, room, mesh, slice(vertex, end), mirrored, frames)
        still = all(schema.isConstant() for schema in mesh.above)
        placing = None if still or not mesh.laid_over else Placing.at(mesh.above, frames, fps)
        animated_meshes.append(_AnimatedMesh(source, samples, transforms, placing))
        vertex = end
    return animated_meshes


def _sampled(animated: _AnimatedMesh, array: Any, frame: int, what: str) -> NDArray[np.float32]:
    """Return an array property at a frame, interpolated between samples if needed."""
    count = animated.source.vertex_count
    sample, weight = animated.samples.at(frame)
    rows = [
        values(array, each, animated.source.room) for each in ((sample, sample + 1) if weight else (sample,))
    ]
    for each in rows:
        if each.shape != (count, 3):
            raise InvalidSequenceError(
                f"{animated.place(frame)} has {len(each)} {what}, the first frame {count} points; every frame needs "
                "the same vertices in the same order"
            )
    if not weight:
        return rows[0]
    mixed = (1 - weight) * rows[0].astype(np.float64) + weight * rows[1].astype(np.float64)
    return mixed.astype(np.float32)


def _world_points(animated: _AnimatedMesh, frame: int) -> NDArray[np.float32]:
    points = _sampled(animated, animated.source.mesh.schema.getPositionsProperty(), frame, "points")
    matrix = animated.transforms.to_world(frame)
    size = determinant(matrix)
    if size > 0 if animated.source.mirrored else size < 0:
        raise InvalidSequenceError(
            f"{animated.place(frame)}: the transform mirrors the mesh relative to the first frame, which turns its "
            "faces inside out; give the animated scale one sign"
        )
    return moved(points, matrix)


def _world_velocities(animated: _AnimatedMesh, frame: int) -> NDArray[np.float32]:
    velocities = animated.source.mesh.schema.getVelocitiesProperty()
    if not velocities.valid():  # a mesh that stands still
        return np.zeros((animated.source.vertex_count, 3), np.float32)
    own = _sampled(animated, velocities, frame, "velocities")
    if animated.placing is None:
        return moved(own, animated.transforms.to_world(frame)[:3, :3])
    points = animated.source.mesh.schema.getPositionsProperty()
    return animated.placing.world_velocities(own, _sampled(animated, points, frame, "points"), frame)


def _have_velocities(path: Path, animated_meshes: list[_AnimatedMesh]) -> bool:
    """Whether velocities of all meshes can be read; warn of others."""
    having = [
        animated
        for animated in animated_meshes
        if animated.source.mesh.schema.getVelocitiesProperty().valid()
    ]
    for animated in animated_meshes if having else []:
        mesh = animated.source.mesh
        points, velocities = mesh.schema.getPositionsProperty(), mesh.schema.getVelocitiesProperty()
        if animated not in having:
            problem = "are missing, and others have some" if mesh.moves else ""
        elif not np.array_equal(sample_times(velocities), sample_times(points)):
            problem = "are not sampled at the times of the points"
        elif length(velocities, 0) != animated.source.vertex_count:
            problem = f"are {length(velocities, 0)}, not as many as its points"
        elif not (mesh.laid_over or all(schema.isConstant() for schema in mesh.above)):
            problem = "are those under a transform that moves, too"
        elif mesh.moves and (animated.samples.weight.any() or (np.diff(animated.samples.before) <= 0).any()):
            problem = "are not sampled in every frame"
        else:
            problem = ""
        if problem:
            warn(f"{path}: the velocities of {mesh.path} {problem}; velocities are left out")
            return False
    return bool(having)
