"""A model in Blender's axes and units: vertices at any time, held at the ends; polygons and their attributes; caches.

Caches of models and of decoded frames, up to a limit, make scrubbing fast. Blender draws on one thread and renders on
another, so both are behind a lock.
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

MEMORY = 512 << 20
"""Bytes of cached frames by default."""


class Frames:
    """A cache of arrays, limited by memory; the least recently used are dropped."""

    def __init__(self, memory: int = MEMORY) -> None:
        self.memory = memory
        self._kept: OrderedDict[Hashable, Single] = OrderedDict()
        self._size = 0
        self._lock = Lock()

    @property
    def size(self) -> int:
        """Bytes in use."""
        return self._size

    def get(self, key: Hashable, make: Callable[[], Single]) -> Single:
        """Return the cached array of a key, or else the result of `make`."""
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
        made = make()  # without the lock, so that cached frames stay available
        made.setflags(write=False)
        with self._lock:
            if key not in self._kept:
                self._kept[key] = made
                self._size += made.nbytes
            while self._size > self.memory and len(self._kept) > 1:
                self._size -= self._kept.popitem(last=False)[1].nbytes
        return made

    def clear(self) -> None:
        """Empty the cache."""
        with self._lock:
            self._kept.clear()
            self._size = 0


class Models:
    """A cache of models by their files, read again when these change."""

    def __init__(self, load: Callable[[Path], Model]) -> None:
        self._load = load
        self._read: dict[Path, tuple[tuple[int, int], Model | MixseqError]] = {}
        self._lock = Lock()

    def get(self, path: Path) -> Model:
        """Return the model in a file, the same object until the file changes."""
        try:
            told = path.stat()
        except OSError as error:
            raise FormatError(f"{path}: {error.strerror or error}; choose the file again") from None
        state = told.st_mtime_ns, told.st_size
        with self._lock:
            known, found = self._read.get(path, (None, None))
            if found is None or known != state:
                try:
                    found = self._load(path)
                except MixseqError as error:
                    found = error
                self._read[path] = state, found
        if isinstance(found, MixseqError):
            raise found
        return found

    def clear(self) -> None:
        """Empty the cache."""
        with self._lock:
            self._read.clear()


BLENDERS_UP = "Z"


def seconds(frame: float, frame_offset: float, fps: float) -> float:
    """Return the time of a model at a frame (or sub-frame) of a scene, ``(frame - frame_offset) / fps``."""
    return (frame - frame_offset) / fps


@dataclass(frozen=True)
class Placement:
    """The placing of a model in a scene."""

    up_axis: str
    scale: float

    @classmethod
    def from_header(cls, header: SequenceHeader) -> Placement:
        """Return the placing given by a model's header, in metres."""
        return cls(header.up_axis, header.metres_per_unit)

    def conversion(self, header: SequenceHeader) -> UnitConversion:
        """Return the rotation and scale of points."""
        placed = replace(header, up_axis=self.up_axis, metres_per_unit=self.scale)
        return UnitConversion.from_header(placed, BLENDERS_UP, 1.0)


@dataclass(frozen=True)
class Motion:
    """A placed model. Two are equal if model and placing are."""

    model: Model
    placing: Placement

    @cached_property
    def _conversion(self) -> UnitConversion:
        return self.placing.conversion(self.model.header)

    def held(self, time: float) -> float:
        """Return a time in seconds, clamped to the ends of the model."""
        return float(np.clip(time, self.model.start, self.model.end))

    def points(self, time: float) -> Single:
        """Return the vertices ``(V, 3)``, in Blender's axes and units, at a time in seconds."""
        points = self._conversion.convert(self.model(self.held(time)))
        return np.ascontiguousarray(points, np.float32)


def part_of(header: SequenceHeader, name: str) -> tuple[slice, slice]:
    """Return the vertices and the polygons of a part of a model."""
    if not name:
        return slice(0, header.vertex_count), slice(0, len(header.polygons.counts))
    vertex = polygon = 0
    for each in header.objects:
        if name in (each.path, each.name):
            return slice(vertex, vertex + each.vertex_count), slice(polygon, polygon + each.polygon_count)
        vertex, polygon = vertex + each.vertex_count, polygon + each.polygon_count
    names = ", ".join(part_names(header))
    raise SettingsError(f"{header.name} has no mesh {name!r}; its meshes are {names}")


def part_names(header: SequenceHeader) -> list[str]:
    """Return the names of a model's parts, [""] if it has one."""
    return [each.path or each.name for each in header.objects] if len(header.objects) > 1 else [""]


def fitting(model: Model, points: Float, frames: int = 9) -> tuple[str, Placement]:
    """Return the part of a model with a mesh's points ``(V, 3)``, and the placing that moves some frame onto them."""
    header = model.header
    names = ["", *part_names(header)]
    vertices = {name: part_of(header, name)[0] for name in names}
    names = [name for name in names if vertices[name].stop - vertices[name].start == len(points)]
    if not names:
        counts = ", ".join(f"{rows.stop - rows.start:,}" for rows in vertices.values())
        raise SettingsError(
            f"the mesh has {len(points):,} vertices, the model {counts}; import it as a new object"
        )
    told = Placement.from_header(header)
    ups, scales = dict.fromkeys((told.up_axis, BLENDERS_UP)), dict.fromkeys((told.scale, 1.0))
    placings = [Placement(up, scale) for up, scale in product(ups, scales)]
    chosen = np.unique(np.linspace(0, len(model.times) - 1, frames).astype(int))
    poses = [model(time) for time in model.times[chosen]]

    def distance(candidate: tuple[str, Placement]) -> float:
        name, placing = candidate
        turned = placing.conversion(header).values
        return min(float(np.abs(turned(pose[vertices[name]]) - points).max()) for pose in poses)

    return min(product(names, placings), key=distance)


@dataclass(frozen=True, eq=False)
class MeshParts:
    """One of the meshes of a model.

    Of P polygons: `counts` (P,) int32 of corners; `corners` (C,) int32, vertices numbered from the mesh's first. Per
    corner, or None: `uvs` (C, 2) and linear `colours` (C, 4) RGBA float32; `groups` (C,) int32, equal for corners of a
    vertex with one normal. Names of `materials`, and `material_of_polygon` (P,) int32.
    """

    counts: IntArray
    corners: IntArray
    uvs: FloatArray | None
    colours: FloatArray | None
    groups: IntArray | None
    materials: tuple[str, ...]
    material_of_polygon: IntArray

    @classmethod
    def of(cls, header: SequenceHeader, name: str) -> MeshParts:
        """Return the mesh of a name, with the errors of `part_of`."""
        vertices, polygons = part_of(header, name)
        ends = np.concatenate([[0], np.cumsum(header.polygons.counts)])
        corners = slice(ends[polygons.start], ends[polygons.stop])
        surface = header.surface
        materials, of_polygon = _materials(header)
        used, slots = np.unique(of_polygon[polygons], return_inverse=True)
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

    def sharp(self, edges: IntArray) -> Mask:
        """Return which edges are hard: adjacent corners at an end have separate normals; edges ``(sum of counts,)``."""
        hard = np.zeros(int(edges.max(initial=-1)) + 1, dtype=bool)
        if self.groups is None:
            return hard
        after = np.arange(1, len(edges) + 1)
        after[self.starts + self.counts - 1] = self.starts
        # The two corners of a polygon at every edge of it.
        ends = np.concatenate([np.arange(len(edges)), after])
        rows = np.column_stack([np.tile(edges, 2), self.corners[ends], self.groups[ends]])
        rows = rows[np.lexsort(rows.T[::-1])]
        beside = (rows[1:, :2] == rows[:-1, :2]).all(axis=1)
        hard[rows[1:][beside & (rows[1:, 2] != rows[:-1, 2]), 0]] = True
        return hard


def _materials(header: SequenceHeader) -> tuple[list[str], IntArray]:
    """Return names of materials, and the material of every polygon; of polygons in no face set that of none."""
    names = [""]
    of_polygon = np.zeros(len(header.polygons.counts), dtype=np.int32)
    for face_set in header.surface.face_sets:
        name = face_set.material.rpartition("/")[2] or face_set.name
        if name not in names:
            names.append(name)
        of_polygon[face_set.polygons] = names.index(name)
    return names, of_polygon
