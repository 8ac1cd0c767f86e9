"""Selection of meshes in a scene, and their conversion to and from one mesh sequence.

Readers make a `SceneObject` of every mesh and its ancestors, select those below `prim` or those that move, and join
their `SceneMesh`. Writers split a header into its meshes again. Mesh ``i`` owns the vertices ``meshes[i].vertices`` of
every frame. Key times of several channels are merged where they differ only by rounding.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mixseq.compression.numbering import find_numbering
from mixseq.errors import AmbiguousError, FormatError
from mixseq.mesh.polygons import PolygonMatch, Polygons, matched
from mixseq.mesh.surface import NO_UV, WHITE, CornerValues, FaceSet, MeshObject, Origin, Surface
from mixseq.sequence.header import SequenceHeader
from mixseq.types import Float, Index, IntArray
from mixseq_io.reader import warn

_LONGEST_LIST = 20


@dataclass(frozen=True, eq=False)
class SceneObject:
    """An object of a scene, with or without a mesh."""

    path: str
    names: tuple[str, ...]
    above: SceneObject | None = None

    @property
    def name(self) -> str:
        """Name to show, "" if it has none."""
        return next(filter(None, self.names), "")

    @property
    def lineage(self) -> list[SceneObject]:
        """The object and its ancestors, the root last."""
        found, here = [], self
        while True:
            found.append(here)
            if here.above is None:
                return found
            here = here.above


def select_meshes(
    file: Path, meshes: Sequence[SceneObject], prim: str, among: Sequence[SceneObject] | None = None
) -> list[int]:
    """Return the indices of the meshes at or below an object, given by path or name."""
    among = meshes if among is None else among
    if not prim.strip("/"):
        return list(range(len(among)))
    root = _path_of(file, meshes, prim)
    return [number for number, place in enumerate(among) if root in (each.path for each in place.lineage)]


def _path_of(file: Path, meshes: Sequence[SceneObject], prim: str) -> str:
    """Return the path of the object named by `prim`: a listed path, a name, or a path without its end slashes."""
    paths = {each.path.strip("/"): each.path for mesh in meshes for each in mesh.lineage}
    path = paths.get(prim.strip("/"))
    if path == prim:
        return path
    # The outermost of those that are in each other.
    named = {each.path for mesh in meshes for each in [own for own in mesh.lineage if prim in own.names][-1:]}
    if len(named) > 1:
        raise AmbiguousError(
            f"{file}: {prim!r} is in several places, {format_names(sorted(named))}; give its path"
        )
    found = next(iter(named), path)
    if found is None:
        raise FormatError(
            f"{file} has no mesh at or below {prim!r}; its meshes are {format_names([mesh.path for mesh in meshes])}"
        )
    return found


def select_moving_meshes(file: Path, meshes: Sequence[SceneObject], moves: Sequence[bool]) -> list[int]:
    """Return the indices of the meshes that move; all if none moves."""
    still = [mesh.path for mesh, it_moves in zip(meshes, moves, strict=True) if not it_moves]
    if not any(moves):
        return list(range(len(meshes)))
    if still:
        warn(
            f"{file}: meshes that stand still are left out; prim='/' (--prim / on the command line) takes them, too: "
            f"{format_names(still)}"
        )
    return [number for number, it_moves in enumerate(moves) if it_moves]


def common_name(meshes: Sequence[SceneObject]) -> str:
    """Return the name of the only mesh, or of the deepest named common ancestor; "" if there is none."""
    shared = set.intersection(*({each.path for each in mesh.lineage} for mesh in meshes))
    return next((each.name for each in meshes[0].lineage if each.path in shared and each.name), "")


def format_names(names: Sequence[str], form: Callable[[str], str] = repr) -> str:
    """Return at most 20 names, quoted by default, for a message."""
    more = len(names) - _LONGEST_LIST
    return ", ".join(map(form, names[:_LONGEST_LIST])) + (f" and {more} more" if more > 0 else "")


TIME_TOLERANCE = 1e-6
"""Largest distance in seconds of keys of different channels that make one frame."""

MAX_INSERTED_FRAMES = 100_000
"""Largest number of frames added between keys; an hour has 86 400 at 24 frames per second."""

_EARLY = 2.0  # seconds; exporters compute earlier times from later ones


def merge_times(channels: Iterable[Float], tolerance: float = TIME_TOLERANCE) -> Float:
    """Return the times ``(n,)`` of all channels, increasing, merged if equal in two channels, but not within one."""
    times = np.empty(0)
    for each in channels:
        times = insert_times(times, each, tolerance)
    return times


def insert_times(times: Float, more: Float, tolerance: float | Float) -> Float:
    """Return times and `more` ``(n,)``, increasing, without those of `more` within `tolerance` of one of `times`."""
    ends = np.concatenate([[-np.inf], times, [np.inf]])
    place = np.searchsorted(times, more)
    near = np.minimum(more - ends[place], ends[place + 1] - more) <= tolerance
    return np.union1d(times, more[~near])


def snap_to_frames(times: Float, fps: float) -> Float:
    """Return times ``(T,)``, moved to ``k / fps`` if within two float32 steps of it (of 2 s, for earlier times).

    Other times stay as they are, and all do where two would become one.

    Examples
    --------
    >>> rounded = np.array([0, 1 / 24, 49 / 48, 1.05], np.float32).astype(np.float64)
    >>> on_grid(rounded, 48).tolist() == [0, 1 / 24, 49 / 48, rounded[3]]
    True
    """
    with np.errstate(all="ignore"):  # non-finite times are reported where they are used
        nearest = np.rint(times * fps) / fps
        rounding = 2 * np.spacing(np.maximum(np.abs(times), _EARLY).astype(np.float32)).astype(np.float64)
        snapped = np.where(np.abs(nearest - times) <= rounding, nearest, times)
        return snapped if (np.diff(snapped) > 0).all() else times


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

    @property
    def normal_groups(self) -> IntArray:
        """Index of the shared normal at every corner: hard edges, or the vertices without any."""
        return self.polygons.indices if self.hard_edges is None else self.hard_edges

    def with_vertex_order_of(self, original: Polygons) -> SceneMesh | None:
        """Return the mesh with the vertex order of a file (only compressed models renumber), None for another mesh."""
        found = find_numbering(self.polygons, original, [self.vertex_count])
        if found is None or found.order != "free":
            return None if found is None else self
        order = found.inverse.vertices
        return replace(
            self,
            vertices=np.r_[self.vertices][order],
            polygons=Polygons(self.polygons.counts, found.vertices[self.polygons.indices]),
        )

    def match(self, stored: Polygons, order: Index | None = None) -> tuple[SceneMesh, PolygonMatch] | None:
        """Return the mesh in the file's vertex order, and the match of their polygons; None for another mesh.

        `order` ``(C,)`` is the reversal of corners by the reader; the match is by stored corners.
        """
        read = stored if order is None else Polygons(stored.counts, stored.indices[order])
        ours = self.with_vertex_order_of(read)
        match = None if ours is None else matched(read, ours.polygons)
        if ours is None or match is None:
            return None
        # Turning corners around twice changes nothing.
        return ours, match if order is None else PolygonMatch(match.polygons, match.corners[order])


def join_meshes(meshes: Sequence[SceneMesh], origin: Origin | None) -> tuple[Polygons, Surface]:
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
        joined.append(mesh.normal_groups + count)
        count += int(mesh.normal_groups.max(initial=-1)) + 1
    return np.concatenate(joined)


def base_face_set(path: str, polygon_count: int, bound: Iterable[FaceSet]) -> tuple[FaceSet, ...]:
    """Return a mesh's material as a face set of the polygons ``(P,)`` that no bound face set contains, if any."""
    taken = [each.polygons for each in bound]
    rest = np.setdiff1d(np.arange(polygon_count), np.concatenate(taken) if taken else ())
    return (FaceSet(path.rpartition("/")[2], rest, path),) if rest.size else ()


def split_meshes(header: SequenceHeader) -> list[SceneMesh]:
    """Return the meshes that a sequence joins, in order, without defaults added by `join_meshes`."""
    surface, polygons = header.surface, header.polygons
    corners = np.concatenate([[0], np.cumsum(polygons.counts)])
    several = len(header.objects) > 1
    meshes, vertex, polygon = [], 0, 0
    for each, scheme in zip(header.objects, surface.subdivisions, strict=True):
        end = polygon + each.polygon_count
        inside = slice(int(corners[polygon]), int(corners[end]))
        own = Polygons(polygons.counts[polygon:end], polygons.indices[inside] - vertex)
        hard_edges: IntArray | None = None
        if surface.hard_edges is not None:
            hard_edges = np.unique(surface.hard_edges[inside], return_inverse=True)[1].astype(np.int32)
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
