"""Faces of a PolyMesh or SubD, and its surface: texture coordinates, colours, hard edges and face sets.

Alembic lists a face's corners clockwise seen from outside; applications write them from the last to the first. Values
come per face, vertex or corner (their "scope"), with or without indices.

Specification: https://docs.alembic.io/reference/index.html (``IPolyMeshSchema``, ``IGeomParam``, ``IFaceSet``)
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Float, Index
from mixseq.errors import InvalidSequenceError
from mixseq.geometry.normals import hard_edges_of_normals
from mixseq.polygons import Polygons, reversed_corners
from mixseq.surface import CornerValues, FaceSet
from mixseq_io.alembic.archive_meshes import Mesh
from mixseq_io.alembic.library import AbcGeom, AbcMaterial, selector, values
from mixseq_io.alembic.samples import sample_times
from mixseq_io.blocks import warn
from mixseq_io.colours import with_alpha
from mixseq_io.scene_meshes import SceneMesh, material_of_the_rest

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
    return found and CornerValues(with_alpha(found.values), found.indices)


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
    count = source.vertices.stop - source.vertices.start
    indices = (
        values(parameter.getIndexProperty(), 0, source.room)
        if parameter.isIndexed()
        else np.arange(len(rows))
    )
    scope, scopes = parameter.getScope(), AbcGeom.GeometryScope
    faces = np.repeat(np.arange(len(polygons.counts)), polygons.counts)
    places = {
        scopes.kFacevaryingScope: (polygons.indices.size, np.arange(polygons.indices.size)),
        scopes.kVertexScope: (count, polygons.indices),
        scopes.kVaryingScope: (count, polygons.indices),
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
    rest = (
        material_of_the_rest(whole, polygon_count, [each for each in sets if each.material]) if whole else ()
    )
    return (*rest, *sets)


def _scheme(source: Source) -> str:
    """Return a SubD's scheme; unknown ones count as Catmull-Clark, the default."""
    scheme = source.mesh.schema.getSubdivisionSchemeProperty()
    named = scheme.getValue() if scheme.valid() and scheme.getNumSamples() else ""
    if named not in (*_SCHEMES, *_SCHEMES.values()):
        warn(f"{source.path}: {source.mesh.path} is subdivided by {named!r}, which is taken as Catmull-Clark")
    return _SCHEMES.get(named, named if named in _SCHEMES.values() else "catmullClark")
