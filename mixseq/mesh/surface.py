"""Mesh data besides faces: texture coordinates, colours, hard edges, face sets, and joined objects.

These data are not used in computations, but are written to files. File formats name them differently:

====================  ========================  =====================  ==========================
here                  USD                       Alembic                glTF
====================  ========================  =====================  ==========================
`FaceSet`             GeomSubset                face set               primitive
`MeshObject`          Mesh                      PolyMesh, SubD         node with a mesh
`Surface.uvs`         ``primvars:st``           UV parameter           ``TEXCOORD_0``, upside down
`Surface.colours`     displayColor and Opacity  colour parameter       ``COLOR_0``
`Surface.hard_edges`  normals, face-varying     normals, face-varying  vertices split by normals
====================  ========================  =====================  ==========================
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mixseq.errors import InvalidSequenceError
from mixseq.mesh.polygons import Polygons, as_indices, read_only
from mixseq.types import FloatArray, Index, IntArray

SUBDIVISIONS = ("none", "catmullClark", "loop", "bilinear")

DEFAULT_UV = (0.0, 0.0)  # of corners without texture coordinates, if other corners have them
DEFAULT_COLOUR = (1.0, 1.0, 1.0, 1.0)  # RGBA, of corners without a colour, if other corners have one


@dataclass(frozen=True, eq=False)
class CornerValues:
    """Values at the corners of polygons: corner ``c`` has ``values[indices[c]]``."""

    values: FloatArray
    indices: IntArray

    def __post_init__(self) -> None:
        with np.errstate(over="ignore"):
            values = np.ascontiguousarray(self.values, dtype=np.float32)
        object.__setattr__(self, "values", read_only(values))
        object.__setattr__(self, "indices", _as_flat_indices(self.indices, "values of corners"))
        if values.ndim != 2:
            raise InvalidSequenceError(f"values of corners have shape {values.shape}; (n, k) is expected")

    @classmethod
    def from_corners(cls, values: FloatArray) -> CornerValues:
        """Store the values ``(sum of counts, k)`` of all corners; equal values share one row."""
        rows, indices = np.unique(values, axis=0, return_inverse=True)
        return cls(rows, indices.reshape(-1))

    @property
    def at_corners(self) -> FloatArray:
        """Values ``(sum of counts, k)``, one per corner."""
        return self.values[self.indices]

    def select(self, corners: IntArray) -> CornerValues:
        """Return the values of the given corners, in the given order."""
        return CornerValues(self.values, self.indices[corners])

    def at_vertices(self, vertices: IntArray, count: int, default: Sequence[float]) -> NDArray[np.float32]:
        """Return the value ``(count, k)`` at each vertex's first corner, given the vertex ``(n,)`` of every corner."""
        values = np.tile(np.asarray(default, dtype=np.float32), (count, 1))
        values[vertices[::-1]] = self.at_corners[::-1]
        return values

    def one_per_vertex(self, vertices: IntArray) -> bool:
        """Return whether corners of a vertex have equal values, also nan, given the vertex ``(n,)`` of every corner."""
        default = np.zeros(self.values.shape[1])
        values = self.at_vertices(vertices, int(vertices.max(initial=-1)) + 1, default.tolist())
        return np.array_equal(values[vertices], self.at_corners, equal_nan=True)

    def weld(self, vertices: IntArray) -> CornerValues:
        """Merge bitwise equal rows at each vertex, given the vertex ``(n,)`` of every corner.

        Rows shared by several vertices stay shared, so that the number of rows never grows.
        """
        from scipy.sparse import coo_array, csgraph

        bits = self.at_corners.view(np.int32)
        keys = np.column_stack([vertices, bits])
        order = np.lexsort(keys.T)
        is_equal = (keys[order[1:]] == keys[order[:-1]]).all(axis=1)
        first, second = (self.indices[corners[is_equal]] for corners in (order[:-1], order[1:]))
        if np.array_equal(first, second):
            return self
        count = len(self.values)
        pairs = coo_array((np.ones(len(first)), (first, second)), shape=(count, count))
        _, labels = csgraph.connected_components(pairs, directed=False)
        _, first_row, component = np.unique(labels, return_index=True, return_inverse=True)
        rows = np.sort(first_row)
        return CornerValues(self.values[rows], np.searchsorted(rows, first_row[component])[self.indices])


@dataclass(frozen=True, eq=False)
class FaceSet:
    """A named set of polygons."""

    name: str
    polygons: IntArray
    material: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(
            self, "polygons", read_only(np.unique(_as_flat_indices(self.polygons, "polygons of a face set")))
        )


@dataclass(frozen=True)
class MeshObject:
    """A mesh joined into a sequence, as a range of the sequence's vertices and of its polygons."""

    name: str
    path: str
    vertex_count: int
    polygon_count: int
    subdivision: str | None = None


@dataclass(frozen=True)
class Origin:
    """The source file of a sequence, to which a writer of the same format may add new points."""

    format: str
    path: str


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Surface:
    """Mesh data besides faces."""

    uvs: CornerValues | None = None  # texture coordinates (u, v), v upwards
    # (red, green, blue, alpha) from 0 to 1, linear in formats with a defined colour space (glTF, USD), else unchanged.
    colours: CornerValues | None = None
    # (sum of counts,) int32: corners of equal number at a vertex share a normal; None if all edges are smooth.
    hard_edges: IntArray | None = None
    face_sets: tuple[FaceSet, ...] = ()  # named sets of polygons, with their materials
    objects: tuple[MeshObject, ...] = ()  # joined meshes, in order; empty if unknown
    subdivision: str = "none"  # scheme of objects that define none: none, catmullClark, loop, bilinear
    origin: Origin | None = None  # source file of the mesh

    def __post_init__(self) -> None:
        object.__setattr__(self, "face_sets", tuple(self.face_sets))
        object.__setattr__(self, "objects", tuple(self.objects))
        if self.hard_edges is not None:
            object.__setattr__(self, "hard_edges", _as_flat_indices(self.hard_edges, "hard edges"))
        for scheme in {self.subdivision: None} | dict.fromkeys(self.subdivisions):
            if scheme not in SUBDIVISIONS:
                raise InvalidSequenceError(f"subdivision is {scheme!r}; one of {', '.join(SUBDIVISIONS)} is expected")

    @property
    def subdivisions(self) -> tuple[str, ...]:
        """Subdivision schemes of the objects, or of the mesh if it has no objects."""
        schemes = (part.subdivision for part in self.objects)
        return tuple(self.subdivision if scheme is None else scheme for scheme in schemes) or (self.subdivision,)

    def __repr__(self) -> str:
        fields = {
            "uvs": self.uvs is not None and str(len(self.uvs.values)),
            "colours": self.colours is not None and str(len(self.colours.values)),
            "hard_edges": self.hard_edges is not None and "yes",
            "face_sets": self.face_sets and [face_set.name for face_set in self.face_sets],
            "objects": self.objects and [part.path or part.name for part in self.objects],
            "subdivision": any(scheme != "none" for scheme in self.subdivisions)
            and ", ".join(map(repr, dict.fromkeys(self.subdivisions))),
            "origin": self.origin is not None and repr(self.origin.path),
        }
        return f"Surface({', '.join(f'{name}={value}' for name, value in fields.items() if value)})"

    def check(self, polygons: Polygons, vertex_count: int) -> None:
        """Raise InvalidSequenceError if the data do not fit the mesh."""
        corners = polygons.indices.size
        for what, data, width in (("texture coordinates", self.uvs, 2), ("colours", self.colours, 4)):
            if data is not None:
                _check_corners(what, data.indices, corners, len(data.values))
                if data.values.shape[1] != width:
                    raise InvalidSequenceError(f"{what} have shape {data.values.shape}, not (n, {width})")
        if self.hard_edges is not None:
            _check_corners("hard edges", self.hard_edges, corners, None)
        for face_set in self.face_sets:
            outside = face_set.polygons[(face_set.polygons < 0) | (face_set.polygons >= len(polygons.counts))]
            if outside.size:
                raise InvalidSequenceError(
                    f"face set {face_set.name!r} has polygon {outside[0]}, but polygons are 0 to "
                    f"{len(polygons.counts) - 1}"
                )
        if self.objects:
            _check_objects(self.objects, polygons, vertex_count)


def renumber_by_first_use(labels: IntArray) -> Index:
    """Renumber labels to 0, 1, 2, ... in the order of their first use."""
    _, first, inverse = np.unique(labels, return_index=True, return_inverse=True)
    rank = np.empty(len(first), dtype=np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    return rank[inverse.reshape(-1)]


def _as_flat_indices(indices: ArrayLike, what: str) -> IntArray:
    return read_only(as_indices(indices, what).reshape(-1))


def _check_corners(what: str, indices: IntArray, corners: int, limit: int | None) -> None:
    if indices.size != corners:
        raise InvalidSequenceError(f"there are {indices.size} {what} for {corners} corners of polygons")
    if indices.size and (indices.min() < 0 or (limit is not None and indices.max() >= limit)):
        raise InvalidSequenceError(f"{what} of a corner are number {indices.min()} to {indices.max()} of {limit}")


def _check_objects(objects: tuple[MeshObject, ...], polygons: Polygons, vertex_count: int) -> None:
    counts = np.array([(part.vertex_count, part.polygon_count) for part in objects])
    if (counts < 0).any() or counts.sum(axis=0).tolist() != [vertex_count, len(polygons.counts)]:
        vertices, faces = counts.sum(axis=0).tolist()
        raise InvalidSequenceError(
            f"the objects have {vertices} vertices and {faces} polygons, the mesh {vertex_count} and "
            f"{len(polygons.counts)}"
        )
    object_of_polygon = np.repeat(np.arange(len(objects)), counts[:, 1])
    object_of_corner = np.repeat(object_of_polygon, polygons.counts)
    object_of_vertex = np.searchsorted(np.cumsum(counts[:, 0]), polygons.indices, side="right")
    is_wrong = object_of_vertex != object_of_corner
    if is_wrong.any():
        name = objects[object_of_corner[int(np.argmax(is_wrong))]].name
        raise InvalidSequenceError(f"a polygon of the object {name!r} uses vertices of another object")
