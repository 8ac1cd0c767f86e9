"""Select meshes in a scene, and convert them to and from one mesh sequence.

Readers make a `SceneObject` of every mesh and its ancestors, select meshes below `prim` or moving meshes, and join the
selected meshes as `SceneMesh` objects. Writers split a header into its meshes again, and match them with the original,
of which a copy with new points is written: by path, or by faces if exactly one mesh of the file has the same faces.
Key times of several channels are merged if they differ only by rounding.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from mixseq.errors import AmbiguousError, FormatError, InvalidSequenceError, MixseqError, OutputError, SettingsError
from mixseq.mesh.polygons import (
    PolygonMatch,
    Polygons,
    count_common_polygons,
    describe_difference,
    match_polygons,
    reversed_winding,
)
from mixseq.mesh.surface import DEFAULT_COLOUR, DEFAULT_UV, CornerValues, FaceSet, MeshObject, Origin, Surface
from mixseq.sequence.frame_rates import FRAME_TOLERANCE
from mixseq.sequence.header import FileKeys, SequenceHeader
from mixseq.types import Float, FloatArray, Index, IntArray
from mixseq_io.files import LimitError
from mixseq_io.reader import warn

_MAX_LISTED_NAMES = 20


@dataclass(frozen=True, eq=False)
class SceneObject:
    """Object of a scene, with or without a mesh; empty names are ignored."""

    path: str
    names: tuple[str, ...]
    parent: SceneObject | None = None

    @property
    def name(self) -> str:
        """First non-empty name, or "" if there is none."""
        return next(filter(None, self.names), "")

    @property
    def lineage(self) -> list[SceneObject]:
        """The object and its ancestors, in order from the object to the root."""
        chain = [self]
        while (parent := chain[-1].parent) is not None:
            chain.append(parent)
        return chain


def select_meshes(
    file: Path, meshes: Sequence[SceneObject], prim: str, among: Sequence[SceneObject] | None = None
) -> list[int]:
    """Return the indices of meshes (or of objects in `among`) at or below the object with a path or name `prim`."""
    among = meshes if among is None else among
    if not prim.strip("/"):
        return list(range(len(among)))
    root = _find_path(file, meshes, prim)
    return [index for index, candidate in enumerate(among) if root in (own.path for own in candidate.lineage)]


def _find_path(file: Path, meshes: Sequence[SceneObject], prim: str) -> str:
    """Return the path of the object with a given path, name, or path without outer slashes."""
    paths = {own.path.strip("/"): own.path for mesh in meshes for own in mesh.lineage}
    path = paths.get(prim.strip("/"))
    if path == prim:
        return path
    # For nested objects with the same name, use the outermost object.
    named = {own.path for mesh in meshes for own in [own for own in mesh.lineage if prim in own.names][-1:]}
    if len(named) > 1:
        raise AmbiguousError(f"{file}: {prim!r} is in several places, {format_names(sorted(named))}; give its path")
    found = next(iter(named), path)
    if found is None:
        raise FormatError(
            f"{file} has no mesh at or below {prim!r}; its meshes are {format_names([mesh.path for mesh in meshes])}"
        )
    return found


_READ_ERRORS = (MixseqError, RuntimeError, ValueError, TypeError, LookupError, ArithmeticError)
"""Errors of readers and libraries about damaged meshes."""

Read = TypeVar("Read")


def read_valid_meshes(
    file: Path,
    meshes: Sequence[SceneObject],
    is_moving: Sequence[bool],
    prepare: Callable[[list[int]], Callable[[int], Read]],
) -> list[Read]:
    """Read the moving meshes, or all if none moves; name those that cannot be read in a warning, and leave them out.

    `prepare` takes the indices of the meshes that are read, and returns the function that reads one of them. If no mesh
    can be read, the error of the first is raised.
    """
    errors: dict[int, Exception] = {}
    while True:
        candidates = [index for index in range(len(meshes)) if index not in errors]
        chosen = [index for index in candidates if is_moving[index]] or candidates
        if not chosen:
            index, error = next(iter(errors.items()))
            if isinstance(error, MixseqError):
                raise error
            raise FormatError(f"{file}: {_describe_damage(file, meshes[index].path, error)}") from error
        read = prepare(chosen)
        results, error_count = [], len(errors)
        for index in chosen:
            try:
                results.append(read(index))
            except LimitError:
                raise
            except _READ_ERRORS as error:
                errors[index] = error
        if len(errors) == error_count:
            break
    if errors:
        reasons = [_describe_damage(file, meshes[index].path, error) for index, error in errors.items()]
        warn(f"{file}: meshes that cannot be read are left out: {format_names(reasons, str)}")
    static = [meshes[index].path for index in sorted({*candidates} - {*chosen})]
    if static:
        warn(
            f"{file}: meshes that stand still are left out; prim='/' (--prim / on the command line) takes them, too: "
            f"{format_names(static)}"
        )
    return results


def _describe_damage(file: Path, mesh: str, error: Exception) -> str:
    """Describe why a mesh cannot be read, in mixseq's words, without those of libraries."""
    if not isinstance(error, MixseqError):
        return f"{mesh} has values that are damaged or of another type"
    reason = str(error).removeprefix(f"{file}: ")
    return reason if mesh in reason else f"{mesh}: {reason}"


def check_finite(points: FloatArray, frame_name: str) -> None:
    """Raise an error if a coordinate of a mesh's points ``(V, 3)`` is not finite."""
    finite = np.isfinite(points).all(axis=1)
    if not finite.all():
        vertex = int(finite.argmin())
        raise InvalidSequenceError(
            f"{frame_name}: vertex {vertex} is {points[vertex].tolist()}; coordinates must be finite"
        )


def common_name(meshes: Sequence[SceneObject]) -> str:
    """Return the name of the only mesh, or of the deepest common ancestor with a name; "" if there is none."""
    shared = set.intersection(*({own.path for own in mesh.lineage} for mesh in meshes))
    return next((own.name for own in meshes[0].lineage if own.path in shared and own.name), "")


def format_names(names: Sequence[str], format_name: Callable[[str], str] = repr) -> str:
    """Format at most 20 names for a message; by default names are quoted."""
    omitted = len(names) - _MAX_LISTED_NAMES
    listing = ", ".join(map(format_name, names[:_MAX_LISTED_NAMES]))
    return f"{listing} and {omitted} more" if omitted > 0 else listing


TIME_TOLERANCE = 1e-6
"""Largest distance in seconds at which keys of two channels are merged into one frame."""

MAX_INSERTED_FRAMES = 100_000
"""Largest number of frames added between keys; an hour has 86 400 at 24 frames per second."""

_MIN_ROUNDING_TIME = 2.0
"""Time in seconds; earlier times have the same rounding error, since exporters compute them from later times."""


def merge_times(channels: Iterable[Float], tolerance: float = TIME_TOLERANCE) -> Float:
    """Merge the increasing times of channels into ``(n,)``, without times within `tolerance` in different channels."""
    times = np.empty(0)
    for channel in channels:
        times = insert_times(times, channel, tolerance)
    return times


def insert_times(times: Float, more: Float, tolerance: float | Float) -> Float:
    """Insert the times `more` into increasing `times`, except those within `tolerance` of a time in `times`."""
    padded = np.concatenate([[-np.inf], times, [np.inf]])
    after = np.searchsorted(times, more)
    is_close = np.minimum(more - padded[after], padded[after + 1] - more) <= tolerance
    return np.union1d(times, more[~is_close])


MIN_KEY_SPACING_FRAMES = 1.5
"""Least mean distance of linear keys in frames; a key at every frame was baked, and says nothing about the motion."""


def find_keys(keys: Float, times: Float, fps: float, is_held: bool) -> FileKeys | None:
    """Return the frames at times ``(T,)`` at which linear or held motion has keys ``(n,)``; None if others have."""
    if len(keys) < 2:
        return None
    slack = TIME_TOLERANCE + FRAME_TOLERANCE / fps
    ids = np.minimum(np.searchsorted(times, keys - slack), len(times) - 1)
    is_dense = (keys[-1] - keys[0]) * fps < MIN_KEY_SPACING_FRAMES * (len(keys) - 1)
    if not is_held and (is_dense or (np.abs(times[ids] - keys) > slack).any()):
        return None
    return FileKeys(tuple(np.unique(ids).tolist()), is_held)


def snap_to_frames(times: Float, fps: float) -> Float:
    """Snap times ``(T,)`` to ``k / fps`` if at most two float32 steps away; times below 2 s use the step at 2 s.

    Other times are unchanged. If two times would become equal, all times are unchanged.

    Examples
    --------
    >>> rounded = np.array([0, 1 / 24, 49 / 48, 1.05], np.float32).astype(np.float64)
    >>> snap_to_frames(rounded, 48).tolist() == [0, 1 / 24, 49 / 48, rounded[3]]
    True
    """
    with np.errstate(all="ignore"):  # the user of the times reports non-finite values
        nearest = np.rint(times * fps) / fps
        late = np.maximum(np.abs(times), _MIN_ROUNDING_TIME).astype(np.float32)
        rounding = 2 * np.spacing(late).astype(np.float64)
        snapped = np.where(np.abs(nearest - times) <= rounding, nearest, times)
        return snapped if (np.diff(snapped) > 0).all() else times


@dataclass(frozen=True, eq=False, kw_only=True)
class SceneMesh:
    """Mesh of a scene, whose polygons index the mesh's vertices; fields are those of `Surface` and `MeshObject`."""

    name: str
    path: str
    vertices: slice | Index  # V, in the sequence
    polygons: Polygons
    uvs: CornerValues | None = None
    colours: CornerValues | None = None
    hard_edges: IntArray | None = None
    face_sets: tuple[FaceSet, ...] = ()  # one of all polygons is the mesh's material
    subdivision: str = "none"

    @property
    def vertex_count(self) -> int:
        """Number of vertices V."""
        if isinstance(self.vertices, slice):
            return int(self.vertices.stop - self.vertices.start)
        return len(self.vertices)

    @property
    def normal_groups(self) -> IntArray:
        """Normal's index at every corner: from `hard_edges`, or the vertex index without hard edges."""
        return self.polygons.indices if self.hard_edges is None else self.hard_edges

    def with_vertex_order_of(self, original: Polygons) -> SceneMesh | None:
        """Undo the renumbering of vertices by compressed models; return None if `original` is another mesh."""
        from mixseq.compression.numbering import find_numbering

        numbering = find_numbering(self.polygons, original, [self.vertex_count])
        if numbering is None or numbering.order != "free":
            return None if numbering is None else self
        return replace(
            self,
            vertices=np.r_[self.vertices][numbering.inverse.vertices],
            polygons=Polygons(self.polygons.counts, numbering.vertices[self.polygons.indices]),
        )

    def match(self, stored: Polygons, order: Index | None = None) -> tuple[SceneMesh, PolygonMatch] | None:
        """Return the mesh in a file's vertex order and the match of its polygons, or None if the file has another mesh.

        `order` ``(C,)`` is the permutation by which the reader reversed corners; it is its own inverse.
        """
        read = stored if order is None else Polygons(stored.counts, stored.indices[order])
        renumbered = self.with_vertex_order_of(read)
        match = None if renumbered is None else match_polygons(read, renumbered.polygons)
        if renumbered is None or match is None:
            return None
        return renumbered, match if order is None else PolygonMatch(match.polygons, match.corners[order])


def join_meshes(meshes: Sequence[SceneMesh], origin: Origin | None) -> tuple[Polygons, Surface]:
    """Join meshes into one mesh by concatenating their vertices and polygons."""
    vertex_starts = np.cumsum([0, *(mesh.vertex_count for mesh in meshes)])
    indices = [mesh.polygons.indices + start for mesh, start in zip(meshes, vertex_starts, strict=False)]
    counts = [mesh.polygons.counts for mesh in meshes]
    polygons = Polygons(np.concatenate(counts), np.concatenate(indices))
    polygon_starts = np.cumsum([0, *(len(mesh.polygons.counts) for mesh in meshes)])
    subdivision = Counter(mesh.subdivision for mesh in meshes).most_common(1)[0][0]
    surface = Surface(
        uvs=_join_values(meshes, [mesh.uvs for mesh in meshes], DEFAULT_UV),
        colours=_join_values(meshes, [mesh.colours for mesh in meshes], DEFAULT_COLOUR),
        hard_edges=_join_hard_edges(meshes),
        face_sets=tuple(
            FaceSet(face_set.name, face_set.polygons + start, face_set.material)
            for mesh, start in zip(meshes, polygon_starts, strict=False)
            for face_set in mesh.face_sets
        ),
        objects=tuple(
            MeshObject(
                mesh.name,
                mesh.path,
                mesh.vertex_count,
                len(mesh.polygons.counts),
                subdivision=None if mesh.subdivision == subdivision else mesh.subdivision,
            )
            for mesh in meshes
        ),
        subdivision=subdivision,
        origin=origin,
    )
    return polygons, surface


def _join_values(
    meshes: Sequence[SceneMesh], of_meshes: Sequence[CornerValues | None], default: Sequence[float]
) -> CornerValues | None:
    """Concatenate the corner values of all meshes, with a default for meshes without values; None if none has any."""
    if all(own is None for own in of_meshes):
        return None
    values, indices, count = [], [], 0
    for mesh, own in zip(meshes, of_meshes, strict=True):
        if own is None:
            own = CornerValues(np.array([default]), np.zeros(mesh.polygons.indices.size, dtype=np.int32))
        welded = own.weld(mesh.polygons.indices)
        values.append(welded.values)
        indices.append(welded.indices + count)
        count += len(welded.values)
    return CornerValues(np.concatenate(values), np.concatenate(indices))


def _join_hard_edges(meshes: Sequence[SceneMesh]) -> IntArray | None:
    """Concatenate normal indices ``(C,)``; meshes without hard edges get one per vertex. None if none has any."""
    if all(mesh.hard_edges is None for mesh in meshes):
        return None
    joined, count = [], 0
    for mesh in meshes:
        joined.append(mesh.normal_groups + count)
        count += int(mesh.normal_groups.max(initial=-1)) + 1
    return np.concatenate(joined)


def base_face_set(material: str, polygon_count: int, bound: Iterable[FaceSet]) -> tuple[FaceSet, ...]:
    """Return the face set, if any, of polygons with the mesh's `material`, which are in no `bound` face set."""
    other = [face_set.polygons for face_set in bound]
    polygons = np.setdiff1d(np.arange(polygon_count), np.concatenate(other) if other else ())
    return (FaceSet(material.rpartition("/")[2], polygons, material),) if polygons.size else ()


def split_meshes(header: SequenceHeader) -> list[SceneMesh]:
    """Split a sequence into its joined meshes, and remove defaults that `join_meshes` added."""
    surface, polygons = header.surface, header.polygons
    corner_starts = np.concatenate([[0], np.cumsum(polygons.counts)])
    is_joined = len(header.objects) > 1
    meshes, vertex, polygon = [], 0, 0
    for each, scheme in zip(header.objects, surface.subdivisions, strict=True):
        end = polygon + each.polygon_count
        corners = slice(int(corner_starts[polygon]), int(corner_starts[end]))
        own = Polygons(polygons.counts[polygon:end], polygons.indices[corners] - vertex)
        hard_edges: IntArray | None = None
        if surface.hard_edges is not None:
            hard_edges = np.unique(surface.hard_edges[corners], return_inverse=True)[1].astype(np.int32)
        if is_joined and hard_edges is not None and _is_smooth(own, hard_edges):
            hard_edges = None
        meshes.append(
            SceneMesh(
                name=each.name,
                path=each.path,
                vertices=slice(vertex, vertex + each.vertex_count),
                polygons=own,
                uvs=_restrict_values(surface.uvs, corners, DEFAULT_UV if is_joined else ()),
                colours=_restrict_values(surface.colours, corners, DEFAULT_COLOUR if is_joined else ()),
                hard_edges=hard_edges,
                face_sets=tuple(_restrict_face_sets(surface.face_sets, polygon, end)),
                subdivision=scheme,
            )
        )
        vertex, polygon = vertex + each.vertex_count, end
    return meshes


def _restrict_values(joined: CornerValues | None, corners: slice, default: Sequence[float]) -> CornerValues | None:
    """Return the values of a range of corners, without unused values; None if all values are the default."""
    if joined is None:
        return None
    value_ids, indices = np.unique(joined.indices[corners], return_inverse=True)
    own = CornerValues(joined.values[value_ids], indices)
    return None if default and (own.values == default).all() else own


def _is_smooth(polygons: Polygons, hard_edges: IntArray) -> bool:
    """Whether corners share a normal if and only if they share a vertex."""
    pairs = np.unique(np.column_stack([polygons.indices, hard_edges]), axis=0)
    return all(len(np.unique(column)) == len(pairs) for column in pairs.T)


def _restrict_face_sets(face_sets: Sequence[FaceSet], first: int, end: int) -> list[FaceSet]:
    """Restrict face sets to the polygons ``first .. end - 1``, renumbered from 0."""
    restricted = []
    for each in face_sets:
        polygons = each.polygons[(each.polygons >= first) & (each.polygons < end)] - first
        if polygons.size:
            restricted.append(FaceSet(each.name, polygons, each.material))
    return restricted


Loaded = TypeVar("Loaded")
Mesh = TypeVar("Mesh")
Match = TypeVar("Match")


def open_original_file(
    path: Path,
    header: SequenceHeader,
    flatten: bool,
    onto: str | os.PathLike[str] | None,
    format_name: str,
    load: Callable[[Path], Loaded],
) -> Loaded | None:
    """Load the file to copy, or return None without one or with `flatten`; warn if a recorded origin is unreadable."""
    if flatten and onto is not None:
        raise SettingsError("flatten writes a stand-alone file, onto a copy of another; give one of them")
    origin = header.surface.origin
    if onto is not None:
        file = Path(onto)
    elif origin is not None and origin.format == format_name and not flatten:
        file = Path(origin.path)
    else:
        return None
    if path.exists() and file.exists() and path.samefile(file):
        raise OutputError(f"{path} is the original and would be lost; write to another name")
    try:
        return load(file)
    except (FormatError, InvalidSequenceError) as error:
        if onto is not None:
            raise OutputError(f"cannot write {path} onto another file: {error}") from error
        warn(f"{error}; the result is a stand-alone file, without its other contents (onto=FILE names another)")
        return None


def match_meshes(
    path: Path,
    header: SequenceHeader,
    meshes: Mapping[str, Mesh],
    match: Callable[[SceneMesh, Mesh], Match | None],
    describe_difference: Callable[[SceneMesh, Mesh], str],
) -> list[Match]:
    """Match every mesh of a sequence with one of the file's `meshes`, whose keys are paths."""
    unmatched, matches = dict(meshes), []
    for scene_mesh in split_meshes(header):
        own_path = scene_mesh.path
        label = own_path or scene_mesh.name
        candidates = {own_path: unmatched[own_path]} if own_path in unmatched else unmatched
        results = {name: match(scene_mesh, mesh) for name, mesh in candidates.items()}
        matching = {name: result for name, result in results.items() if result is not None}
        if len(matching) > 1:
            raise FormatError(
                f"{path} has {len(matching)} meshes with the faces of {label!r}, {format_names(list(matching))}"
            )
        if not matching:
            reason = describe_difference(scene_mesh, *candidates.values()) if len(candidates) == 1 else ""
            problem = f"{path} has no mesh with the faces of {label!r}"
            raise FormatError(f"{problem}: {reason}" if reason else problem)
        ((name, result),) = matching.items()
        del unmatched[name]
        matches.append(result)
    return matches


def describe_difference_up_to_winding(polygons: Polygons, stored: Polygons, name: str) -> str:
    """Describe the first difference of polygons from those of a mesh, in the winding with more equal polygons."""
    reversed_polygons = Polygons(stored.counts, stored.indices[reversed_winding(stored.counts, keep_first=True)])
    closest = max((stored, reversed_polygons), key=partial(count_common_polygons, polygons))
    return describe_difference(polygons, closest, ("the sequence", name))


def is_retimed(header: SequenceHeader, sources: ArrayLike | None) -> bool:
    """Whether `sources`, times of the original in seconds, are given and differ from the times of the frames."""
    return sources is not None and not np.allclose(sources, header.times, rtol=0, atol=FRAME_TOLERANCE / header.fps)


def warn_of_unretimed_motion(
    path: Path, header: SequenceHeader, spans: Mapping[str, tuple[float, float]], sources: ArrayLike | None
) -> None:
    """Warn of objects whose animation does not follow the sequence; `spans` are their first and last times in seconds.

    If `sources` ``(T,)`` retime the sequence, all objects count; else objects it outlasts by more than a frame.
    """
    first, last = (float(time) for time in header.times[[0, -1]])
    frame, retimed = 1 / header.fps, is_retimed(header, sources)
    unretimed = [name for name, (start, end) in spans.items() if retimed or first < start - frame or last > end + frame]
    if unretimed:
        start, end = min(spans[name][0] for name in unretimed), max(spans[name][1] for name in unretimed)
        warn(
            f"{path}: other animation keeps its own times, {start:g} to {end:g} s, and is not retimed: "
            f"{format_names(unretimed)}"
        )
