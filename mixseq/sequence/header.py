"""The header of a mesh sequence: the mesh, and the times of its frames."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mixseq.errors import InvalidSequenceError, SettingsError
from mixseq.mesh.polygons import Polygons, read_only
from mixseq.mesh.surface import MeshObject, Surface
from mixseq.sequence.frame_rates import FRAME_TOLERANCE, format_frame, format_number
from mixseq.sequence.provenance import Provenance

UP_AXES = ("X", "Y", "Z")
DEFAULT_FPS = 24.0

MAX_FRAME_COUNT = 10_000_000  # largest number of frames, to detect wrong rates and speeds


class FileKeys(NamedTuple):
    """Frames that are keys in a file, between which its motion is linear or held."""

    frames: tuple[int, ...]  # counted from 0
    is_held: bool


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class SequenceHeader:
    """All data of a mesh sequence except its points.

    Parameters
    ----------
    polygons : Polygons
        The faces as authored. `faces` is their triangulation.
    vertex_count : int
        Number of vertices V.
    times : (T,) float64
        Time of every frame in seconds, strictly increasing.
    fps : float
        Frames per second of the time line (USD: ``timeCodesPerSecond``), not necessarily the spacing of times.
    up_axis : {"X", "Y", "Z"}
        Axis that points up.
    metres_per_unit : float
        Length of one unit of `points` in metres.
    name : str
        Name of the mesh.
    surface : Surface
        Texture coordinates, hard edges, face sets, objects, and the source file.
    provenance : Provenance, optional
        The file, and what its frames were compressed from or fitted to, with the bound of the error.
    keys : FileKeys, optional
        Frames that are keys of a rig, if the file says that all of its motion is linear or held between them.

    Raises
    ------
    InvalidSequenceError
        If face indices exceed the vertices, times do not increase, or a value is out of range.
    """

    polygons: Polygons
    vertex_count: int
    times: NDArray[np.float64]
    fps: float = DEFAULT_FPS
    up_axis: str = "Y"
    metres_per_unit: float = 1.0
    name: str = "mesh"
    surface: Surface = Surface()  # noqa: RUF009 - frozen all the way down
    provenance: Provenance | None = None
    keys: FileKeys | None = None

    def __post_init__(self) -> None:
        times = np.asarray(self.times, dtype=np.float64).reshape(-1)
        object.__setattr__(self, "times", read_only(times))
        object.__setattr__(self, "vertex_count", int(self.vertex_count))
        object.__setattr__(self, "fps", float(self.fps))
        object.__setattr__(self, "metres_per_unit", float(self.metres_per_unit))
        _check_header(self)

    def __repr__(self) -> str:
        return (
            f"{type(self).__name__}({self.name!r}: {self.frame_count} frames, {self.vertex_count} vertices, "
            f"{len(self.polygons.counts)} faces, {self.fps:g} fps)"
        )

    def _repr_html_(self) -> str:
        """Return a table for notebooks."""
        from html import escape

        rows = {
            "frames": f"{self.frame_count} at {self.fps:g} fps, {self.times[0]:g} to {self.times[-1]:g} s",
            "vertices": f"{self.vertex_count}",
            "faces": f"{len(self.polygons.counts)}",
            "units": f"{self.metres_per_unit:g} m, {self.up_axis} up",
        }
        cells = "".join(f"<tr><th>{name}</th><td>{text}</td></tr>" for name, text in rows.items())
        return f"<table><caption>{escape(self.name)}</caption>{cells}</table>"

    @property
    def faces(self) -> NDArray[np.int32]:
        """Triangles ``(F, 3)`` of the polygons."""
        return self.polygons.triangles

    @property
    def file_name(self) -> str:
        """Name of the file, or of the mesh if there is no file."""
        return self.provenance.name if self.provenance else self.name

    @property
    def frame_count(self) -> int:
        """Number of frames T."""
        return int(self.times.size)

    @property
    def objects(self) -> tuple[MeshObject, ...]:
        """The joined meshes; without joined meshes, one object for the whole sequence."""
        whole = MeshObject(self.name, "", self.vertex_count, len(self.polygons.counts))
        return self.surface.objects or (whole,)

    def frame_number(self, index: int) -> str:
        """Return the frame number of a frame index as text."""
        return format_frame(self.times[index], self.fps)

    def frame_name(self, index: int) -> str:
        """Return "frame" and the frame number of a frame index, with the index if the two differ."""
        if not 0 <= index < self.frame_count:
            return f"frame {index}"
        number = self.frame_number(index)
        return f"frame {number}" if number == f"{index}" else f"frame {number} (index {index})"

    def vertex_name(self, vertex: int) -> str:
        """Return "vertex" and a number, with the object and the vertex's number in it if there are several objects."""
        ends = np.cumsum([each.vertex_count for each in self.objects])
        if len(ends) < 2:
            return f"vertex {vertex}"
        index = int(np.searchsorted(ends, vertex, side="right"))
        own, each = vertex - int(ends[index]) + self.objects[index].vertex_count, self.objects[index]
        return f"vertex {vertex} (vertex {own} of {each.path or each.name})"

    def index_of(self, number: float) -> int:
        """Return the index of the frame with a frame number; raise SettingsError if no frame has the number."""
        distances = np.abs(self.times * self.fps - number)
        index = int(distances.argmin())
        if distances[index] > FRAME_TOLERANCE:
            raise SettingsError(f"there is no frame {format_number(number)}; frames are {self.frame_numbers}")
        return index

    @property
    def frame_numbers(self) -> str:
        """First and last frame number as text, "1001 to 1096"."""
        return " to ".join(dict.fromkeys(format_frame(time, self.fps) for time in self.times[[0, -1]]))

    def numbered_from(self, first: float) -> SequenceHeader:
        """Return the header with times shifted to give the first frame a number; SettingsError if it is not finite."""
        if not np.isfinite(first):
            raise SettingsError(f"start_frame is {first}; a number is expected")
        numbers = (self.times - self.times[0]) * self.fps
        whole = np.rint(numbers)
        return self.with_times((np.where(np.abs(numbers - whole) < 1e-6, whole, numbers) + first) / self.fps)

    def with_times(self, times: ArrayLike, fps: float | None = None) -> SequenceHeader:
        """Return the header of the same mesh with other frame times."""
        changes = {"times": times, "fps": self.fps if fps is None else fps, "keys": None}
        return SequenceHeader(**header_fields(self) | changes)


def header_fields(header: SequenceHeader) -> dict[str, Any]:
    """Return the fields of the header by name, for another header or a sequence."""
    return {field: getattr(header, field) for field in SequenceHeader.__dataclass_fields__}


def frame_times(start: float, end: float, fps: float, tolerance: float = 1e-6) -> NDArray[np.float64]:
    """Return frame times ``(T,)`` from `start` to at most `end` at a rate; SettingsError for too many frames."""
    if (end - start) * fps >= MAX_FRAME_COUNT:
        raise SettingsError(
            f"{end - start:g} s at {fps:g} frames per second are more than {MAX_FRAME_COUNT:,} frames; "
            "give a shorter time or a lower rate"
        )
    count = int(np.floor((end - start) * fps + tolerance)) + 1
    return np.asarray(np.minimum(start + np.arange(count) / fps, end))


def _check_header(header: SequenceHeader) -> None:
    if header.vertex_count < 3:
        raise InvalidSequenceError(f"the mesh has {header.vertex_count} vertices; at least 3 are needed")
    indices = header.polygons.indices
    if indices.size == 0:
        raise InvalidSequenceError("the mesh has no faces; give a mesh with faces, not points or curves")
    is_invalid = (indices < 0) | (indices >= header.vertex_count)
    if is_invalid.any():
        corner = int(np.argmax(is_invalid))
        polygon = int(np.searchsorted(np.cumsum(header.polygons.counts), corner, side="right"))
        raise InvalidSequenceError(
            f"face {polygon} uses vertex {indices[corner]}, but vertices are 0 to {header.vertex_count - 1}"
        )
    if header.times.size == 0:
        raise InvalidSequenceError("the sequence has no frames")
    if not np.isfinite(header.times).all():
        raise InvalidSequenceError(f"frame {int(np.argmin(np.isfinite(header.times)))}: its time is not finite")
    steps = np.diff(header.times)
    if (steps <= 0).any():
        frame = int(np.argmax(steps <= 0)) + 1
        raise InvalidSequenceError(
            f"frame {frame} is at {header.times[frame]:g} s, not after frame {frame - 1} at "
            f"{header.times[frame - 1]:g} s; times must increase"
        )
    for label, value in (("fps", header.fps), ("metres_per_unit", header.metres_per_unit)):
        if not (np.isfinite(value) and value > 0):
            raise InvalidSequenceError(f"{label} is {value}; a positive number is expected")
    if "\0" in header.name or any("\ud800" <= letter <= "\udfff" for letter in header.name):
        raise InvalidSequenceError(f"the name {header.name!r} has characters that no file can hold")
    header.surface.check(header.polygons, header.vertex_count)
    if header.up_axis not in UP_AXES:
        raise InvalidSequenceError(f"up axis is {header.up_axis!r}; one of {', '.join(UP_AXES)} is expected")
