"""Mesh sequences: one fixed mesh, with new vertex positions in every frame.

`MeshSequence` adds points to a `SequenceHeader`. Readers stream ``(header, blocks of points)``; `Frames` is their
common interface with `MeshSequence`. Points and headers are validated on construction, so that every `MeshSequence` is
valid.

Files are read sequentially and often slowly, but fitting needs several passes and single frames. So a stream is copied
once to a `FrameStore` with random access, in memory or in a temporary file.

As products of squared lengths must fit into double precision, lengths must be from `MIN_LENGTH` to `MAX_LENGTH`. Errors
below `rounding_error` of the largest coordinate cannot be computed.

`convert_units` rotates the up axis by 90 degrees about the axis perpendicular to the old and new up axes. From Y to Z,
the point (x, y, z) becomes (x, -z, y), by the usual convention. The rotation only permutes and negates coordinates, so
only a change of unit rounds.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Protocol, TypeGuard, cast, overload

import numpy as np
from numpy.typing import ArrayLike

from mixseq.choices import UNITS, OrderName
from mixseq.errors import InvalidSequenceError, MixseqWarning, SettingsError
from mixseq.mesh.measures import Diagonal
from mixseq.mesh.polygons import Polygons, read_only
from mixseq.runtime.low_memory import LargeArray, new_large_array
from mixseq.runtime.progress import Progress, log_progress
from mixseq.runtime.public import FileOr, HasFrames, public
from mixseq.sequence.frame_rates import snap_to_ntsc
from mixseq.sequence.header import DEFAULT_FPS, UP_AXES, SequenceHeader, header_fields
from mixseq.sequence.provenance import Provenance, as_edited, frames_checksum
from mixseq.types import Float, FloatArray, IntArray

if TYPE_CHECKING:
    from trimesh import Trimesh


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class MeshSequence(SequenceHeader):
    """A deforming mesh: fixed polygons with points ``(T, V, 3)``.

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
        If the header is invalid, or points or velocities have a wrong shape or are not finite.
    """

    points: FloatArray
    velocities: FloatArray | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "points", read_only(_as_points(self.points)))
        check_block(self, self.points, first_frame=0)
        if len(self.points) != self.frame_count:
            raise InvalidSequenceError(
                f"{len(self.points)} frames of points but {self.frame_count} times; give one time per frame"
            )
        if self.velocities is not None:
            object.__setattr__(self, "velocities", read_only(_as_points(self.velocities)))
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
        """Make a sequence from arrays.

        Parameters
        ----------
        points : (T, V, 3) array_like
            Vertex positions of every frame.
        faces : (F, 3) array_like or Polygons
            Triangles, or `Polygons` for quads and n-gons.
        times : (T,) array_like, optional
            Times of the frames in seconds; by default, frames are spaced at `fps` from 0.
        fps : float, optional
            Frames per second, by default 24; 23.976 is read as 24000/1001, see `mixseq.sequence.frame_rates`.
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
        rate = snap_to_ntsc(rate) if times is None else _rate_of_times(times, rate)
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
        """Return the same mesh and times with other points and without velocities."""
        return replace(self, points=points, velocities=None, provenance=as_edited(self.provenance))

    def blocks(self, size: int = 16) -> Iterator[FloatArray]:
        """Iterate over the points in blocks ``(B, V, 3)`` of at most `size` frames."""
        for start in range(0, self.frame_count, size):
            yield self.points[start : start + size]

    @cached_property
    def diagonal(self) -> float:
        """Unit of errors, the diagonal of the first frame's bounding box; see `reference_diagonal`."""
        return reference_diagonal(self.blocks()).length

    def __len__(self) -> int:
        return self.frame_count

    def __iter__(self) -> Iterator[FloatArray]:
        return iter(self.points)

    @overload
    def __getitem__(self, frame: int) -> FloatArray: ...

    @overload
    def __getitem__(self, frame: slice) -> MeshSequence: ...

    def __getitem__(self, frame: int | slice) -> FloatArray | MeshSequence:
        """Return the points ``(V, 3)`` of a frame by its index from 0, or a sequence of several frames."""
        if not isinstance(frame, slice):
            points: FloatArray = self.points[frame]
            return points
        velocities = None if self.velocities is None else self.velocities[frame]
        return replace(self, points=self.points[frame], velocities=velocities, times=self.times[frame], keys=None)

    def to_trimesh(self, frame: int = 0) -> Trimesh:
        """Return a frame by its index from 0 as a `trimesh.Trimesh`, with the same vertices and triangulated faces."""
        from trimesh import Trimesh

        return Trimesh(self.points[frame], self.faces, process=False, metadata={"name": self.name})


class Frames(Protocol):
    """A sequence that streams: a `MeshSequence`, or an open reader (`mixseq.open_sequence`)."""

    @property
    def header(self) -> SequenceHeader:
        """Header of the sequence, without points."""

    def blocks(self, size: int = ...) -> Iterator[FloatArray]:
        """Iterate over the points in blocks ``(B, V, 3)`` of at most `size` frames, starting at the first frame."""


class Rig(Frames, Protocol):
    """An open animation of joints, morph weights or transforms: a reader whose `can_evaluate` is true."""

    def blocks_at(self, times: ArrayLike, size: int = ...) -> Iterator[FloatArray]:
        """Iterate over the points at times ``(N,)`` in seconds, in blocks ``(B, V, 3)`` of at most `size` frames."""

    def velocity_blocks_at(self, times: ArrayLike, size: int = ...) -> Iterator[FloatArray]:
        """Iterate over the velocities at times ``(N,)``, in units per second, in the same blocks as `blocks_at`."""


def is_rig(frames: Frames) -> TypeGuard[Rig]:
    """Return whether frames are an open rig, which can be evaluated at any time."""
    return bool(getattr(frames, "can_evaluate", False))


@dataclass(frozen=True, eq=False)
class LazyFrames:
    """`Frames` computed on demand: `make` takes the largest number of frames per block, and yields blocks of points."""

    header: SequenceHeader
    make: Callable[[int], Iterator[FloatArray]]
    parts: IntArray | None = None

    def blocks(self, size: int = 16) -> Iterator[FloatArray]:
        """Yield the points in blocks ``(B, V, 3)`` of at most `size` frames."""
        return self.make(size)


def own_parts(frames: Frames) -> IntArray | None:
    """Return the part ``(F,)`` of every triangle that frames of a model come with; None if there are none."""
    return getattr(frames, "parts", None)


def without_velocities(frames: Frames) -> Frames:
    """Return the same frames without their velocities."""
    check_frames(frames)
    return LazyFrames(frames.header, frames.blocks, own_parts(frames))


def bounding_diagonal(points: FloatArray) -> float:
    """Return the length of the diagonal of the bounding box of points ``(V, 3)``."""
    return Diagonal.from_points(points).length


_POINT_RATIO = 2.0**-20  # ratio of the diagonal to the largest coordinate, or diagonal, up to which a frame is a point


def reference_diagonal(blocks: Iterable[FloatArray]) -> Diagonal:
    """Return the unit of errors of frames in blocks ``(B, V, 3)``: the diagonal of the bounding box of the first frame.

    If the first frame is a point, from which a mesh grows, this is the largest diagonal of all frames; only then are
    blocks after the first one read. The diagonal is 0 if all frames are points.
    """
    first = largest = Diagonal(0.0, 0)
    for number, block in enumerate(blocks):
        if number == 0:
            first = largest = Diagonal.from_points(block[0])
            if first.length > _POINT_RATIO * float(np.abs(block[0]).max()):
                return first
        largest = max(largest, *map(Diagonal.from_points, block), key=lambda diagonal: diagonal.length)
    return first if first.length > _POINT_RATIO * largest.length else largest


def join_blocks(header: SequenceHeader, blocks: Iterable[FloatArray]) -> MeshSequence:
    """Join blocks ``(B, V, 3)`` of points to one sequence."""
    parts = [_as_points(block) for block in blocks]
    points = np.concatenate(parts) if parts else np.zeros((0, header.vertex_count, 3), dtype=np.float32)
    return MeshSequence.from_header(header, points)


def check_frames(frames: object) -> None:
    """Raise InvalidSequenceError if the argument is not a sequence."""
    if not isinstance(getattr(frames, "header", None), SequenceHeader):
        raise InvalidSequenceError(
            f"a MeshSequence or an open sequence is expected, not {type(frames).__name__}; read files "
            "with mixseq.read, make sequences of arrays with MeshSequence.from_arrays"
        )


def check_motion(frames: Frames) -> None:
    """Check that frames are a sequence whose motion is computed from its points, and warn of its own velocities."""
    check_frames(frames)
    if getattr(frames, "has_velocities", getattr(frames, "velocities", None) is not None):
        warn_of_loss(frames.header, "velocities are left out", "models compute them: velocities=True, --velocities")


def warn_of_loss(header: SequenceHeader, loss: str, cure: str) -> None:
    """Warn of what an operation leaves out of a sequence or model."""
    warnings.warn(f"{header.name!r}: {loss}; {cure}", MixseqWarning, stacklevel=5)


def check_block(header: SequenceHeader, points: FloatArray, first_frame: int) -> None:
    """Raise InvalidSequenceError if a block of points ``(B, V, 3)`` does not fit its header."""
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
            f"{header.frame_name(first_frame + frame)}: {header.vertex_name(vertex)} is "
            f"{points[frame, vertex].tolist()}; coordinates must be finite"
        )


def _check_velocities(header: SequenceHeader, points: FloatArray, velocities: FloatArray) -> None:
    if velocities.shape != points.shape:
        raise InvalidSequenceError(
            f"velocities have shape {velocities.shape}, points {points.shape}; give one velocity per point"
        )
    if not np.isfinite(velocities).all():
        frame, vertex = (int(i) for i in np.argwhere(~np.isfinite(velocities))[0][:2])
        raise InvalidSequenceError(f"{header.frame_name(frame)}: the velocity of vertex {vertex} is not finite")


def _rate_of_times(times: ArrayLike, fps: float) -> float:
    """Return the given rate if frame times are multiples of its period; otherwise, return the exact NTSC rate.

    Examples
    --------
    >>> _rate_of_times(np.arange(1001, 1097) / 23.976, 23.976)
    23.976
    >>> _rate_of_times(np.arange(1001, 1097) * 1001 / 24000, 23.976) == 24000 / 1001
    True
    """
    seconds, exact = np.asarray(times, dtype=np.float64), snap_to_ntsc(fps)
    given_miss, exact_miss = (
        float(np.abs(seconds * rate - np.rint(seconds * rate)).max(initial=0)) for rate in (fps, exact)
    )
    return fps if given_miss < min(exact_miss, 1e-6) else exact


def _as_points(points: ArrayLike) -> FloatArray:
    """Return points as a C-ordered array ``(T, V, 3)``; types other than float32 and float64 become float64."""
    array = np.asarray(points)
    if array.dtype not in (np.float32, np.float64):
        try:
            array = array.astype(np.float64)
        except (TypeError, ValueError) as error:
            raise InvalidSequenceError(f"points are not numbers: {error}") from None
    if array.ndim != 3 or array.shape[2] != 3:
        raise InvalidSequenceError(f"points have shape {array.shape}; (frames, vertices, 3) is expected")
    return np.ascontiguousarray(array)


MAX_BLOCK_FRAMES = 8
MAX_BLOCK_VERTICES = 1 << 20  # vertices in all frames of a block with several frames: 24 MB of float64
MIN_LENGTH, MAX_LENGTH = 1e-60, 1e60  # limits of the diagonal and of coordinates, in any unit
_RELATIVE_ROUNDING_ERROR = 2.0**-40  # rounding error of a coordinate, without cancellation


@dataclass(frozen=True, eq=False)
class FrameStore:
    """A sequence with random access to its points."""

    header: SequenceHeader
    points: LargeArray  # (T, V, 3)

    @cached_property
    def diagonal(self) -> float:
        """Unit of errors, see `reference_diagonal`."""
        return reference_diagonal(iterate_blocks(self.points)).length

    def about(self, origin: Float) -> FrameStore:
        """Return the sequence relative to an origin ``(3,)``, in double precision unless the origin is zero."""
        if not origin.any():
            return self
        points, done = new_large_array(self.points.shape), 0
        for block in iterate_blocks(self.points):
            points[done : done + len(block)] = block - origin
            done += len(block)
        return FrameStore(self.header, points)

    def trace(self, max_error: float, promised: bool, order: OrderName = "keep") -> SequenceHeader:
        """Return the header of frames that are within `max_error` diagonals of this sequence, with their provenance."""
        name, checksum = self.header.name, frames_checksum(iterate_blocks(self.points))
        source = replace(self.header.provenance or Provenance(name), checksum=checksum)
        unit = self.diagonal or 1.0
        return replace(self.header, provenance=Provenance(name, source, max_error, unit, promised, order=order))


def load_frames(frames: Frames, progress: Progress = log_progress) -> FrameStore:
    """Return a sequence with random access to its points; copy the points unless they are in memory."""
    store = FrameStore(frames.header, frames.points) if isinstance(frames, MeshSequence) else _copy(frames, progress)
    _check_lengths(store)
    return store


def _copy(frames: Frames, progress: Progress) -> FrameStore:
    header = frames.header
    count, done = header.frame_count, 0
    points: LargeArray | None = None
    for block in frames.blocks(block_size(header.vertex_count)):
        check_block(header, block, done)
        if points is None:
            points = new_large_array((count, header.vertex_count, 3), block.dtype)
        if done + len(block) > count:
            raise InvalidSequenceError(f"there are more frames than the {count} times; give one time per frame")
        points[done : done + len(block)] = block
        done += len(block)
        progress(done, count, "reading frames")
    if points is None or done < count:
        raise InvalidSequenceError(f"{done} frames of points but {count} times; give one time per frame")
    return FrameStore(header, points)


def _check_lengths(store: FrameStore) -> None:
    name, points = store.header.name, store.points
    diagonal = store.diagonal
    cure = f"from {MIN_LENGTH:g} to {MAX_LENGTH:g} is expected; scale it, in the program it comes from"
    if diagonal and not MIN_LENGTH <= diagonal <= MAX_LENGTH:
        raise InvalidSequenceError(
            f"{name!r}: the mesh is {diagonal:.3g} units across, and squares of such lengths do "
            f"not fit into double precision; {cure}"
        )
    largest = largest_coordinate(points)
    if largest > MAX_LENGTH:
        raise InvalidSequenceError(
            f"{name!r}: coordinates are up to {largest:.3g} units, and their squares do not fit into double "
            f"precision; {cure}"
        )


def largest_coordinate(points: LargeArray) -> float:
    """Return the largest absolute value of a coordinate of points ``(T, V, 3)``."""
    return max(float(np.abs(block).max(initial=0.0)) for block in iterate_blocks(points))


def largest_offset(points: LargeArray) -> float:
    """Return the largest distance along an axis of points ``(T, V, 3)`` from the centre of the first frame."""
    first = points[:1][0].astype(np.float64)
    centre = (first.min(axis=0) + first.max(axis=0)) / 2
    return max(float(np.abs(block - centre).max(initial=0.0)) for block in iterate_blocks(points))


def rounding_error(coordinate: float) -> float:
    """Return the smallest error that can be computed for a coordinate, in its units."""
    return coordinate * _RELATIVE_ROUNDING_ERROR


_SINGLE_ROUNDING = 2 * 3**0.5 * 2.0**-24  # largest relative shift of a point that is rounded to float32 twice


def rounding_margin(bound: float, *coordinates: float) -> float:
    """Return the part of a bound that is left to rounding to single precision, in the bound's unit; at most a half.

    It suffices for the first of the largest `coordinates` that it can suffice for: those relative to zero, and those
    relative to the origin of `choose_origin`. It is 0 if there is none.
    """
    margins = [_SINGLE_ROUNDING * max(coordinate, 2.0**-126) for coordinate in coordinates]  # above subnormal numbers
    return next((margin for margin in margins if margin <= bound / 2), 0.0)


def block_size(vertex_count: int) -> int:
    """Return the number of frames per block, which depends only on the mesh, so that results are reproducible."""
    return max(1, min(MAX_BLOCK_FRAMES, MAX_BLOCK_VERTICES // vertex_count))


def iterate_blocks(points: LargeArray) -> Iterator[FloatArray]:
    """Yield points ``(T, V, 3)`` in blocks of `block_size` frames."""
    size = block_size(points.shape[1])
    for start in range(0, len(points), size):
        yield points[start : start + size]


_UNITLESS_FORMATS = ("Alembic",)  # file formats without units: a writer cannot detect that the unit has changed


@dataclass(frozen=True, eq=False)
class UnitConversion:
    """A rotation to another up axis and a scale to another unit."""

    up_axis: str
    metres_per_unit: float
    rotation: Float  # (3, 3)
    scale: float

    @classmethod
    def from_header(
        cls, header: SequenceHeader, up_axis: str | None = None, units: str | float | None = None
    ) -> UnitConversion:
        """Make the conversion of a sequence; parameters and errors are those of `convert_units`."""
        up = header.up_axis if up_axis is None else up_axis
        if up not in UP_AXES:
            raise SettingsError(f"up_axis is {up!r}; one of {', '.join(UP_AXES)} is expected")
        metres = header.metres_per_unit if units is None else parse_unit(units)
        return cls(up, metres, _quarter_turn(header.up_axis, up), header.metres_per_unit / metres)

    @property
    def changes(self) -> bool:
        """Whether the conversion is not the identity."""
        return self.scale != 1.0 or not np.array_equal(self.rotation, np.eye(3))

    def convert_header(self, header: SequenceHeader) -> SequenceHeader:
        """Return a header with the new up axis and unit."""
        surface, origin = header.surface, header.surface.origin
        if self.changes and origin is not None and origin.format in _UNITLESS_FORMATS:
            surface = replace(surface, origin=None)
        provenance = as_edited(header.provenance) if self.changes else header.provenance
        up_axis, metres_per_unit = self.up_axis, self.metres_per_unit
        return replace(header, up_axis=up_axis, metres_per_unit=metres_per_unit, surface=surface, provenance=provenance)

    def convert(self, values: FloatArray) -> FloatArray:
        """Rotate and scale points or velocities ``(..., 3)``; keep their precision."""
        if not self.changes:
            return values
        axes = np.abs(self.rotation).argmax(axis=1)
        signs = self.rotation.sum(axis=1).astype(values.dtype)
        rotated: FloatArray = values[..., axes] * signs + values.dtype.type(0)  # no negative zeros
        if self.scale == 1.0:
            return rotated
        with np.errstate(over="ignore", under="ignore"):  # overflow is an error of `MeshSequence`
            scaled: FloatArray = (rotated.astype(np.float64) * self.scale).astype(values.dtype)
        return scaled


@public
def convert_units(
    sequence: FileOr[MeshSequence | HasFrames], up_axis: str | None = None, units: str | float | None = None
) -> MeshSequence:
    """Return a sequence rotated so that an axis points up, and scaled to a unit of length.

    Points and velocities are converted, so that size and orientation in the world are kept. To set metadata missing in
    a file, give `up_axis` and `metres_per_unit` to `mixseq.read` instead.

    Parameters
    ----------
    sequence : MeshSequence
        The sequence.
    up_axis : {"X", "Y", "Z"}, optional
        New up axis, by default the up axis of the sequence.
    units : str or float, optional
        New unit of length: a name in `UNITS`, such as "cm", or metres; by default, the unit is kept.

    Returns
    -------
    MeshSequence
        The same frames in the new coordinates, in the same precision. A source file in Alembic is dropped from
        `Surface.origin`, as the format has no units.

    Raises
    ------
    SettingsError
        If the axis or unit does not exist.

    Examples
    --------
    >>> one = MeshSequence.from_arrays([[[0.0, 0, 0], [1, 2, 3], [1, 0, 0]]], [[0, 1, 2]], metres_per_unit=0.01)
    >>> convert_units(one, up_axis="Z", units="mm").points[0, 1].tolist()
    [10.0, -30.0, 20.0]
    """
    sequence = cast("MeshSequence", sequence)
    conversion = UnitConversion.from_header(sequence.header, up_axis, units)
    velocities = sequence.velocities
    return MeshSequence.from_header(
        conversion.convert_header(sequence.header),
        conversion.convert(sequence.points),
        None if velocities is None else conversion.convert(velocities),
    )


def parse_unit(units: str | float) -> float:
    """Return the metres of a unit, given as a name, positive number or text; raise SettingsError for other values."""
    if units in UNITS:
        return UNITS[str(units)]
    try:
        metres = float(units)
    except (TypeError, ValueError):
        metres = np.nan
    if not (np.isfinite(metres) and metres > 0):
        raise SettingsError(f"the unit is {units!r}; one of {', '.join(UNITS)} is expected, or its length in metres")
    return metres


def _quarter_turn(old: str, new: str) -> Float:
    """Return the rotation ``(3, 3)`` by 90 degrees from one up axis to another; the identity if they are equal."""
    rotation = np.eye(3)
    if old != new:
        first, second = UP_AXES.index(old), UP_AXES.index(new)
        rotation[:, [first, second]] = rotation[:, [second, first]] * [1.0, -1.0]
    return rotation
