"""Mesh sequences: one fixed mesh, with new vertex positions in every frame.

`SequenceHeader` is a sequence without its points; `MeshSequence` adds them. Readers stream
``(header, blocks of points)``; `Frames` is their common interface with `MeshSequence`. Sequences are validated here and
in their headers only: every `MeshSequence` is valid.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from mixseq.arrays import FloatArray
from mixseq.diagonal import Diagonal
from mixseq.errors import InvalidSequenceError
from mixseq.frame_rates import exact_rate
from mixseq.polygons import Polygons, frozen
from mixseq.sequence_header import DEFAULT_FPS, UP_AXES, SequenceHeader, header_fields

__all__ = [
    "DEFAULT_FPS",
    "UP_AXES",
    "Frames",
    "MeshSequence",
    "Polygons",
    "SequenceHeader",
    "bounding_diagonal",
    "check_block",
    "check_frames",
    "collect",
    "header_fields",
]


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class MeshSequence(SequenceHeader):
    """A deforming mesh: fixed polygons, ``(T, V, 3)`` points.

    Make one with `MeshSequence.from_arrays`, or read it from a file with `mixseq.read`.

    Parameters
    ----------
    points : (T, V, 3) float32 or float64
        Vertex positions in the file's units.
    velocities : (T, V, 3) float32 or float64, optional
        Velocities of the vertices in the file's units per second, for motion blur.
    **header
        The fields of `SequenceHeader`.

    Raises
    ------
    InvalidSequenceError
        If the header is unsound, or points or velocities have another shape or are not finite.
    """

    points: FloatArray
    velocities: FloatArray | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "points", frozen(_as_points(self.points)))
        check_block(self, self.points, first_frame=0)
        if len(self.points) != self.frame_count:
            raise InvalidSequenceError(
                f"{len(self.points)} frames of points but {self.frame_count} times; give one time per frame"
            )
        if self.velocities is not None:
            object.__setattr__(self, "velocities", frozen(_as_points(self.velocities)))
            _check_velocities(self, self.points, self.velocities)

    @classmethod
    def from_arrays(
        cls,
        points: ArrayLike,
        faces: ArrayLike | Polygons,
        times: ArrayLike | None = None,
        fps: float | None = None,
        up_axis: str = "Y",
        metres_per_unit: float = 1.0,
        name: str = "mesh",
    ) -> MeshSequence:
        """Make a sequence of arrays.

        Parameters
        ----------
        points : (T, V, 3) array_like
            Vertex positions of every frame.
        faces : (F, 3) array_like or Polygons
            Triangles, or polygons where there are quads or n-gons.
        times : (T,) array_like, optional
            Seconds; by default frames follow each other at `fps`.
        fps : float, optional
            Frames per second, by default 24; 23.976 means 24000/1001, see `mixseq.frame_rates`.
        up_axis, metres_per_unit, name
            See `SequenceHeader`.

        Examples
        --------
        >>> points = np.zeros((2, 3, 3))
        >>> points[:, 1, 0] = points[:, 2, 1] = 1
        >>> MeshSequence.from_arrays(points, [[0, 1, 2]], fps=10).times.tolist()
        [0.0, 0.1]
        """
        array = _as_points(points)
        rate = DEFAULT_FPS if fps is None else float(fps)
        if not (np.isfinite(rate) and rate > 0):
            raise InvalidSequenceError(f"fps is {fps}; a positive number is expected")
        rate = exact_rate(rate) if times is None else _rate_beside(times, rate)
        return cls(
            points=array,
            polygons=faces if isinstance(faces, Polygons) else Polygons.from_triangles(faces),
            vertex_count=array.shape[1],
            times=np.arange(len(array)) / rate if times is None else np.asarray(times, dtype=np.float64),
            fps=rate,
            up_axis=up_axis,
            metres_per_unit=metres_per_unit,
            name=name,
        )

    @classmethod
    def from_header(
        cls, header: SequenceHeader, points: FloatArray, velocities: FloatArray | None = None
    ) -> MeshSequence:
        """Make a sequence from a header and points ``(T, V, 3)``."""
        return cls(points=points, velocities=velocities, **header_fields(header))

    @property
    def header(self) -> SequenceHeader:
        """Header of the sequence, without points."""
        return SequenceHeader(**header_fields(self))

    def with_points(self, points: FloatArray) -> MeshSequence:
        """Return the same mesh and times with other points, and no velocities."""
        return replace(self, points=points, velocities=None)

    def blocks(self, size: int = 16) -> Iterator[FloatArray]:
        """Iterate over the points in blocks ``(B, V, 3)`` of at most `size` frames."""
        for start in range(0, self.frame_count, size):
            yield self.points[start : start + size]

    @cached_property
    def diagonal(self) -> float:
        """Diagonal of the bounding box of the first frame, the unit of errors."""
        return bounding_diagonal(self.points[0])

    def __len__(self) -> int:
        return self.frame_count


class Frames(Protocol):
    """A sequence that streams: a `MeshSequence`, or an open reader (`mixseq.open_sequence`)."""

    @property
    def header(self) -> SequenceHeader:
        """Header of the sequence, without points."""

    def blocks(self, size: int = ...) -> Iterator[FloatArray]:
        """Iterate over the points in blocks ``(B, V, 3)`` of at most `size` frames, from the first one on."""


def bounding_diagonal(points: FloatArray) -> float:
    """Length of the diagonal of the bounding box of ``(V, 3)`` points."""
    return Diagonal.of(points).length


def collect(header: SequenceHeader, blocks: Iterable[FloatArray]) -> MeshSequence:
    """Join blocks ``(B, V, 3)`` of points to one sequence."""
    parts = [_as_points(block) for block in blocks]
    points = np.concatenate(parts) if parts else np.zeros((0, header.vertex_count, 3), dtype=np.float32)
    return MeshSequence.from_header(header, points)


def check_frames(frames: object) -> None:
    """Raise InvalidSequenceError if the argument is no sequence."""
    if not isinstance(getattr(frames, "header", None), SequenceHeader):
        raise InvalidSequenceError(
            f"a MeshSequence or an open sequence is expected, not {type(frames).__name__}; read files "
            "with mixseq.read, make sequences of arrays with MeshSequence.from_arrays"
        )


def check_block(header: SequenceHeader, points: FloatArray, first_frame: int) -> None:
    """Validate a block of points ``(B, V, 3)`` against its header."""
    if points.ndim != 3 or points.shape[2] != 3:
        raise InvalidSequenceError(f"points have shape {points.shape}; (frames, vertices, 3) is expected")
    if points.shape[1] != header.vertex_count:
        raise InvalidSequenceError(
            f"{header.frame_name(first_frame)} has {points.shape[1]} vertices, the mesh has {header.vertex_count}; "
            "every frame needs the same vertices in the same order"
        )
    if not np.isfinite(points).all():
        frame, vertex = (int(i) for i in np.argwhere(~np.isfinite(points))[0][:2])
        raise InvalidSequenceError(
            f"{header.frame_name(first_frame + frame)}: vertex {vertex} is {points[frame, vertex].tolist()}; "
            "coordinates must be finite"
        )


def _check_velocities(header: SequenceHeader, points: FloatArray, velocities: FloatArray) -> None:
    if velocities.shape != points.shape:
        raise InvalidSequenceError(
            f"velocities have shape {velocities.shape}, points {points.shape}; give one velocity per point"
        )
    if not np.isfinite(velocities).all():
        frame, vertex = (int(i) for i in np.argwhere(~np.isfinite(velocities))[0][:2])
        raise InvalidSequenceError(
            f"{header.frame_name(frame)}: the velocity of vertex {vertex} is not finite"
        )


def _rate_beside(times: ArrayLike, fps: float) -> float:
    """Return the typed rate if frame times are multiples of its period, else the exact rate.

    Examples
    --------
    >>> _rate_beside(np.arange(1001, 1097) / 23.976, 23.976)
    23.976
    >>> _rate_beside(np.arange(1001, 1097) * 1001 / 24000, 23.976) == 24000 / 1001
    True
    """
    frames, exact = np.asarray(times, dtype=np.float64), exact_rate(fps)
    typed, meant = (
        float(np.abs(frames * rate - np.rint(frames * rate)).max(initial=0)) for rate in (fps, exact)
    )
    return fps if typed < min(meant, 1e-6) else exact


def _as_points(points: ArrayLike) -> FloatArray:
    """Return C-ordered float32 or float64 points of three dimensions; other types become float64."""
    array = np.asarray(points)
    if array.dtype not in (np.float32, np.float64):
        try:
            array = array.astype(np.float64)
        except (TypeError, ValueError) as error:
            raise InvalidSequenceError(f"points are not numbers: {error}") from None
    if array.ndim != 3 or array.shape[2] != 3:
        raise InvalidSequenceError(f"points have shape {array.shape}; (frames, vertices, 3) is expected")
    return np.ascontiguousarray(array)
