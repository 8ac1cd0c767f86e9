"""A model as Blender shows it: in its axes and units, at any time, the first and the last pose held beyond the ends."""

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
    """Return the time of a model that a frame of a scene shows, as caches in Blender are timed.

    A frame's number is its time times the rate; sub-frames are fractions.

    Examples
    --------
    >>> seconds(1013.5, 1001, 25)
    0.5
    """
    return (frame - frame_offset) / fps


@dataclass(frozen=True)
class Placing:
    """How a model stands in a scene."""

    up_axis: str
    scale: float

    @classmethod
    def as_told(cls, header: SequenceHeader) -> Placing:
        """Return how a model says that it stands, in metres."""
        return cls(header.up_axis, header.metres_per_unit)

    def conversion(self, header: SequenceHeader) -> UnitConversion:
        """Return how points are turned and scaled."""
        placed = replace(header, up_axis=self.up_axis, metres_per_unit=self.scale)
        return UnitConversion.of(placed, BLENDERS_UP, 1.0)


@dataclass(frozen=True)
class Motion:
    """A model that stands in a scene. Two of the same model that stand alike are equal."""

    model: Model
    placing: Placing

    @cached_property
    def _conversion(self) -> UnitConversion:
        return self.placing.conversion(self.model.header)

    def held(self, time: float) -> float:
        """Return the time in seconds that is shown at a time: that of an end beyond it."""
        return float(np.clip(time, self.model.start, self.model.end))

    def points(self, time: float) -> Single:
        """Return the vertices ``(V, 3)``, in Blender's axes and units, at a time in seconds."""
        points: Single = np.ascontiguousarray(
            self._conversion.values(self.model(self.held(time))), np.float32
        )
        return points


def part_of(header: SequenceHeader, name: str) -> tuple[slice, slice]:
    """Return the vertices and the polygons of one of the meshes that a model joins."""
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
    """Return what the meshes that a model joins are called, [""] if it is one."""
    return [each.path or each.name for each in header.objects] if len(header.objects) > 1 else [""]


def fitting(model: Model, points: Float, frames: int = 9) -> tuple[str, Placing]:
    """Return which mesh of a model a mesh in Blender is, and how the model has to stand to lie on it.

    Importers turn and scale points, or leave that to the object: the placing is that with which some frame is nearest.

    Shapes: points ``(V, 3)``.
    """
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
