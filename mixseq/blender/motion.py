"""A model in Blender's axes and units, at any time; the first and the last pose are held beyond the ends."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np

from mixseq.arrays import Float, Single
from mixseq.errors import SettingsError
from mixseq.sequence_header import SequenceHeader
from mixseq.signals.model import Model
from mixseq.unit_conversion import UnitConversion

BLENDERS_UP = "Z"


def seconds(frame: float, frame_offset: float, fps: float) -> float:
    """Return the time of a model at a frame (or sub-frame) of a scene, ``(frame - frame_offset) / fps``."""
    return (frame - frame_offset) / fps


@dataclass(frozen=True)
class Placing:
    """The placing of a model in a scene."""

    up_axis: str
    scale: float

    @classmethod
    def as_told(cls, header: SequenceHeader) -> Placing:
        """Return the placing given by a model's header, in metres."""
        return cls(header.up_axis, header.metres_per_unit)

    def conversion(self, header: SequenceHeader) -> UnitConversion:
        """Return the rotation and scale of points."""
        placed = replace(header, up_axis=self.up_axis, metres_per_unit=self.scale)
        return UnitConversion.of(placed, BLENDERS_UP, 1.0)


@dataclass(frozen=True)
class Motion:
    """A placed model. Two are equal if model and placing are."""

    model: Model
    placing: Placing

    @cached_property
    def _conversion(self) -> UnitConversion:
        return self.placing.conversion(self.model.header)

    def held(self, time: float) -> float:
        """Return a time in seconds, clamped to the ends of the model."""
        return float(np.clip(time, self.model.start, self.model.end))

    def points(self, time: float) -> Single:
        """Return the vertices ``(V, 3)``, in Blender's axes and units, at a time in seconds."""
        points: Single = np.ascontiguousarray(
            self._conversion.values(self.model(self.held(time))), np.float32
        )
        return points


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


def fitting(model: Model, points: Float, frames: int = 9) -> tuple[str, Placing]:
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
    told = Placing.as_told(header)
    ups, scales = dict.fromkeys((told.up_axis, BLENDERS_UP)), dict.fromkeys((told.scale, 1.0))
    placings = [Placing(up, scale) for up, scale in product(ups, scales)]
    chosen = np.unique(np.linspace(0, len(model.times) - 1, frames).astype(int))
    poses = [model(time) for time in model.times[chosen]]

    def distance(candidate: tuple[str, Placing]) -> float:
        name, placing = candidate
        turned = placing.conversion(header).values
        return min(float(np.abs(turned(pose[vertices[name]]) - points).max()) for pose in poses)

    return min(product(names, placings), key=distance)
