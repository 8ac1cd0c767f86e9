"""Convert models to Blender's axes and units: vertices at any time, polygons and their attributes.

Caches of models and of decoded frames make scrubbing fast. The caches use locks, because Blender draws the viewport
and renders on different threads.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from pathlib import Path
from threading import Lock

import numpy as np

from mixseq.errors import FormatError, MixseqError, SettingsError
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.sequence import UnitConversion
from mixseq.signals.model import Model
from mixseq.types import Float, FloatArray, Index, IntArray, Mask, Single

DEFAULT_CACHE_BYTES = 512 << 20


class FrameCache:
    """Cache of arrays with a memory limit, which drops the least recently used arrays."""

    def __init__(self, max_bytes: int = DEFAULT_CACHE_BYTES) -> None:
        self.max_bytes = max_bytes
        self._arrays: OrderedDict[Hashable, Single] = OrderedDict()
        self._size = 0
        self._lock = Lock()

    @property
    def size(self) -> int:
        """Bytes of all cached arrays."""
        return self._size

    def get(self, key: Hashable, compute: Callable[[], Single]) -> Single:
        """Return the cached array of a key; compute and cache the array if it is missing."""
        with self._lock:
            if key in self._arrays:
                self._arrays.move_to_end(key)
                return self._arrays[key]
        array = compute()  # computed without the lock, so that cached arrays stay available
        array.setflags(write=False)
        with self._lock:
            if key not in self._arrays:
                self._arrays[key] = array
                self._size += array.nbytes
            while self._size > self.max_bytes and len(self._arrays) > 1:
                self._size -= self._arrays.popitem(last=False)[1].nbytes
        return array

    def clear(self) -> None:
        """Empty the cache."""
        with self._lock:
            self._arrays.clear()
            self._size = 0


class ModelCache:
    """Cache of models by file path; a model is loaded again if its file has changed."""

    def __init__(self, load: Callable[[Path], Model]) -> None:
        self._load = load
        self._entries: dict[Path, tuple[tuple[int, int], Model | MixseqError]] = {}
        self._lock = Lock()

    def get(self, path: Path) -> Model:
        """Return the model in a file; this is the same object until the file changes."""
        try:
            status = path.stat()
        except OSError as error:
            raise FormatError(f"{path}: {error.strerror or error}; choose the file again") from None
        version = status.st_mtime_ns, status.st_size
        with self._lock:
            cached_version, result = self._entries.get(path, (None, None))
            if result is None or cached_version != version:
                try:
                    result = self._load(path)
                except MixseqError as error:
                    result = error
                self._entries[path] = version, result
        if isinstance(result, MixseqError):
            raise result
        return result

    def clear(self) -> None:
        """Empty the cache."""
        with self._lock:
            self._entries.clear()


BLENDER_UP_AXIS = "Z"


@dataclass(frozen=True)
class Placement:
    """Up axis and scale with which a model is imported."""

    up_axis: str
    scale: float

    @classmethod
    def from_header(cls, header: SequenceHeader) -> Placement:
        """Return the up axis of a header and the scale from its units to metres."""
        return cls(header.up_axis, header.metres_per_unit)

    def conversion(self, header: SequenceHeader) -> UnitConversion:
        """Return the rotation and scale from the model's coordinates to Blender's."""
        placed = replace(header, up_axis=self.up_axis, metres_per_unit=self.scale)
        return UnitConversion.from_header(placed, BLENDER_UP_AXIS, 1.0)


@dataclass(frozen=True)
class Motion:
    """Model with a placement in Blender; two motions are equal if their models and placements are equal."""

    model: Model
    placement: Placement

    @cached_property
    def _conversion(self) -> UnitConversion:
        return self.placement.conversion(self.model.header)

    def clamp_time(self, time: float) -> float:
        """Clamp a time in seconds to the time range of the model."""
        return float(np.clip(time, self.model.start, self.model.end))

    def points(self, time: float) -> Single:
        """Return the vertices ``(V, 3)``, in Blender's axes and units, at a time in seconds."""
        points = self._conversion.convert(self.model(self.clamp_time(time)))
        return np.ascontiguousarray(points, np.float32)


def part_slices(header: SequenceHeader, name: str) -> tuple[slice, slice]:
    """Return the slices of vertices and of polygons of a model's mesh; the name "" selects all meshes."""
    if not name:
        return slice(0, header.vertex_count), slice(0, len(header.polygons.counts))
    vertex = polygon = 0
    for part in header.objects:
        if name in (part.path, part.name):
            return slice(vertex, vertex + part.vertex_count), slice(polygon, polygon + part.polygon_count)
        vertex, polygon = vertex + part.vertex_count, polygon + part.polygon_count
    names = ", ".join(part_names(header))
    raise SettingsError(f"{header.name} has no mesh {name!r}; choose one of its meshes: {names}")


def part_names(header: SequenceHeader) -> list[str]:
    """Return the names of a model's meshes, or [""] if the model has only one mesh."""
    return [part.path or part.name for part in header.objects] if len(header.objects) > 1 else [""]


def find_placement(model: Model, points: Float, frame_count: int = 9) -> tuple[str, Placement]:
    """Find the part and placement of a model that fit a mesh ``(V, 3)`` best in any of `frame_count` sampled frames."""
    header = model.header
    names = ["", *part_names(header)]
    vertices = {name: part_slices(header, name)[0] for name in names}
    names = [name for name in names if vertices[name].stop - vertices[name].start == len(points)]
    if not names:
        counts = ", ".join(f"{part.stop - part.start:,}" for part in vertices.values())
        raise SettingsError(
            f"the mesh has {len(points):,} vertices, the model {counts}; import the model as a new object"
        )
    default = Placement.from_header(header)
    choices = dict.fromkeys((default.up_axis, BLENDER_UP_AXIS)), dict.fromkeys((default.scale, 1.0))
    placements = [Placement(up_axis, scale) for up_axis, scale in product(*choices)]
    frames = np.unique(np.linspace(0, len(model.times) - 1, frame_count).astype(int))
    poses = [model(time) for time in model.times[frames]]

    def distance(candidate: tuple[str, Placement]) -> float:
        name, placement = candidate
        convert = placement.conversion(header).convert
        return min(float(np.abs(convert(pose[vertices[name]]) - points).max()) for pose in poses)

    return min(product(names, placements), key=distance)


@dataclass(frozen=True, eq=False)
class MeshParts:
    """One of the meshes of a model.

    Polygons: `counts` (P,) int32, the numbers of corners; `corners` (C,) int32, vertices counted from the mesh's first.
    Corners, or None: `uvs` (C, 2) and linear RGBA `colours` (C, 4), float32; `normal_ids` (C,) int32, equal at corners
    of a vertex that share a normal. `materials` are names; `material_of_polygon` (P,) int32 are their indices.
    """

    counts: IntArray
    corners: IntArray
    uvs: FloatArray | None
    colours: FloatArray | None
    normal_ids: IntArray | None
    materials: tuple[str, ...]
    material_of_polygon: IntArray

    @classmethod
    def from_header(cls, header: SequenceHeader, name: str) -> MeshParts:
        """Return the mesh with a name; errors are those of `part_slices`."""
        vertices, polygons = part_slices(header, name)
        ends = np.concatenate([[0], np.cumsum(header.polygons.counts)])
        corners = slice(ends[polygons.start], ends[polygons.stop])
        surface = header.surface
        materials, material_of_polygon = _materials(header)
        used, slots = np.unique(material_of_polygon[polygons], return_inverse=True)
        return cls(
            header.polygons.counts[polygons],
            header.polygons.indices[corners] - vertices.start,
            None if surface.uvs is None else surface.uvs.at_corners[corners],
            None if surface.colours is None else surface.colours.at_corners[corners],
            None if surface.hard_edges is None else surface.hard_edges[corners],
            tuple(materials[number] for number in used),
            slots.astype(np.int32).reshape(-1),
        )

    @property
    def starts(self) -> Index:
        """First corner ``(P,)`` of every polygon."""
        return np.cumsum(self.counts) - self.counts

    def sharp_edges(self, edge_of_corner: IntArray) -> Mask:
        """Return the mask ``(E,)`` of sharp edges, at which adjacent polygons have different normals at an end.

        `edge_of_corner` ``(C,)`` is the edge from each corner to the next corner of the polygon.
        """
        is_sharp = np.zeros(int(edge_of_corner.max(initial=-1)) + 1, dtype=bool)
        if self.normal_ids is None:
            return is_sharp
        next_corner = np.arange(1, len(edge_of_corner) + 1)
        next_corner[self.starts + self.counts - 1] = self.starts
        # Each row has an edge, an end vertex and a normal, for both ends of every edge of every polygon.
        ends = np.concatenate([np.arange(len(edge_of_corner)), next_corner])
        rows = np.column_stack([np.tile(edge_of_corner, 2), self.corners[ends], self.normal_ids[ends]])
        rows = rows[np.lexsort(rows.T[::-1])]
        same_end = (rows[1:, :2] == rows[:-1, :2]).all(axis=1)
        is_sharp[rows[1:][same_end & (rows[1:, 2] != rows[:-1, 2]), 0]] = True
        return is_sharp


def _materials(header: SequenceHeader) -> tuple[list[str], IntArray]:
    """Return the names of materials, and the material index ``(P,)`` of every polygon; "" is outside all face sets."""
    names = [""]
    material_of_polygon = np.zeros(len(header.polygons.counts), dtype=np.int32)
    for face_set in header.surface.face_sets:
        name = face_set.material.rpartition("/")[2] or face_set.name
        if name not in names:
            names.append(name)
        material_of_polygon[face_set.polygons] = names.index(name)
    return names, material_of_polygon
