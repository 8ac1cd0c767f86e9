"""Access to Alembic's Python binding, and evaluation of properties and transforms at frame times.

Every property has its sample times in seconds: uniform, cyclic (several samples per shutter), or arbitrary. Between two
samples of a transform, translation, stretch and rotation angle are interpolated linearly, as in Blender. Matrices act
on row vectors: p' = p M.

In a copy of the original, new points are in mesh space, and the transforms stay: their other children do not move, and
caches of other programs can refer to the result. Points p in mesh space are in the world, with time derivatives '

    w = p M,    w' = p' M + p M',

where M' is the central difference over one frame, as during a renderer's open shutter.

Specification: https://docs.alembic.io/python/alembic.html, https://docs.alembic.io/reference/index.html
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mixseq.errors import FormatError, MissingExtraError
from mixseq.mesh.rotations import matrix_to_rotvec, rotvec_to_matrix
from mixseq.types import Float, FloatArray, Single

try:
    import imath as imath
    from alembic3d import Abc as Abc
    from alembic3d import AbcCoreAbstract as AbcCoreAbstract
    from alembic3d import AbcGeom as AbcGeom
    from alembic3d import AbcMaterial as AbcMaterial
except ImportError as error:
    raise MissingExtraError("Alembic files need the package alembic3d: pip install 'mixseq[alembic]'") from error

LIBRARY_ERRORS: tuple[type[Exception], ...] = (RuntimeError, ValueError, TypeError, LookupError, ArithmeticError)
"""Exceptions that the library or value conversions raise for damaged files."""

_COLOUR_CHANNELS = {imath.C3fArray: "rgb", imath.C4fArray: "rgba"}
"""Types of colour arrays; NumPy can access these arrays only by channel."""

_HEADER_BYTES = 16
"""Size of an Ogawa header: "Ogawa", 255 if the file is complete, version (2 bytes), offset of the root group (8)."""


def open_archive(path: Path) -> Any:
    """Open a file as an ``IArchive``."""
    with path.open("rb") as file:
        start = file.read(_HEADER_BYTES)
    if start.startswith(b"\x89HDF"):
        raise FormatError(
            f"{path} is old Alembic based on HDF5; convert it with abcconvert -toOgawa, or export it again"
        )
    if not start.startswith(b"Ogawa"):
        raise FormatError(f"{path} cannot be read as Alembic; it is damaged or of another type")
    if len(start) < _HEADER_BYTES or start[5] != 0xFF or int.from_bytes(start[8:], "little") >= path.stat().st_size:
        raise FormatError(f"{path} is not complete; it is truncated, or was not written to its end")
    return Abc.IArchive(str(path))


def sample_selector(sampled: Any, sample: int) -> Any:
    """Return the selector of a sample by its time, since Python's constructor interprets an index as a time."""
    time = sampled.getTimeSampling().getSampleTime(sample)
    return Abc.ISampleSelector(time, Abc.ISampleSelector.TimeIndexType.kNearIndex)


def sample_length(array: Any, sample: int) -> int:
    """Return the length of an array sample without reading it."""
    return int(array.getDimension(sample_selector(array, sample)).numPoints())


def read_sample(array: Any, sample: int, file_size: int) -> NDArray[Any]:
    """Return an array sample ``(n,)`` or ``(n, k)``; check its size against the file size in bytes."""
    stored = read_imath_sample(array, sample, file_size)
    channels = _COLOUR_CHANNELS.get(type(stored))
    if channels:
        return np.stack([np.asarray(getattr(stored, channel)) for channel in channels], axis=1)
    return np.array(stored)


def read_imath_sample(array: Any, sample: int, file_size: int) -> Any:
    """Return an array sample as an imath array; see `read_sample`."""
    count = sample_length(array, sample)
    if count * array.getDataType().getNumBytes() > file_size:
        raise FormatError(f"an array claims {count} values, more than the file can hold; it is damaged")
    return array.getValue(sample_selector(array, sample))


def create_array(kind: Any, rows: ArrayLike) -> Any:
    """Create an imath array of a type such as ``V3fArray`` from rows ``(n, k)``."""
    values = np.asarray(rows)
    array = kind(len(values))
    if kind in _COLOUR_CHANNELS:
        for channel, column in zip(_COLOUR_CHANNELS[kind], values.T, strict=False):
            np.asarray(getattr(array, channel))[...] = column
    elif kind is imath.UnsignedIntArray:  # NumPy cannot access this type
        for index, value in enumerate(values.tolist()):
            array[index] = value
    elif len(values):
        np.asarray(array)[...] = values
    return array


TIME_TOLERANCE = 0.999e-6
"""Distance in seconds below which times count as equal."""

_MAX_SAMPLE_COUNT = 1_000_000


def sample_times(sampled: Any) -> Float:
    """Return the sample times ``(N,)`` in seconds of a property or schema."""
    count, sampling = sampled.getNumSamples(), sampled.getTimeSampling()
    if count > _MAX_SAMPLE_COUNT:
        raise FormatError(f"a property claims {count} samples; the file is damaged")
    kind, stored = sampling.getTimeSamplingType(), np.array(list(sampling.getStoredTimes()), dtype=np.float64)
    sample = np.arange(count)
    if not kind.isAcyclic():
        per_cycle = kind.getNumSamplesPerCycle()
        cycle, sample = np.divmod(sample, max(per_cycle, 1))
    if sample.max(initial=-1) >= len(stored):
        raise FormatError(f"a property has {len(stored)} times for {count} samples; the file is damaged")
    return stored[sample] if kind.isAcyclic() else stored[sample] + cycle * kind.getTimePerCycle()


def select_samples(times: Float, window: tuple[float, float]) -> slice:
    """Return the slice of samples that determine values within a time window, or all if no sample time is inside.

    Examples
    --------
    >>> times = np.array([1.0, 2.0, 3.0, 4.0])
    >>> select_samples(times, (2.0, 3.0)), select_samples(times, (2.5, 2.6)), select_samples(times, (5.0, 6.0))
    (slice(1, 3, None), slice(1, 3, None), slice(0, 4, None))
    """
    start, end = window[0] + TIME_TOLERANCE, window[1] - TIME_TOLERANCE
    if not len(times) or window[1] < times[0] or window[0] > times[-1]:
        return slice(0, len(times))
    first, last = np.searchsorted(times, start, side="right") - 1, np.searchsorted(times, end, side="left")
    return slice(max(int(first), 0), min(int(last) + 1, len(times)))


def create_time_sampling(times: Float, step: float) -> Any:
    """Return a time sampling of times ``(N,)``: uniform (with `step` in s if it fits), or arbitrary."""
    if len(times) > 1:
        mean = float(times[-1] - times[0]) / (len(times) - 1)
        step = step if np.isclose(mean, step, rtol=1e-9, atol=0) else mean
    if np.allclose(times, times[0] + np.arange(len(times)) * step, rtol=1e-12, atol=1e-12):
        return AbcCoreAbstract.TimeSampling(step, float(times[0]))
    vector = AbcCoreAbstract.TimeVector()
    vector.extend(times.tolist())
    acyclic = AbcCoreAbstract.TimeSamplingType(AbcCoreAbstract.AcyclicFlag.kAcyclic)
    return AbcCoreAbstract.TimeSampling(acyclic, vector)


LocatedFrames = list[tuple[int, float]]
"""Index of the sample before every frame, and the weight of the next sample."""


def locate_frames(times: Float, frames: Float) -> LocatedFrames:
    """Locate frame times ``(T,)`` between sample times ``(N,)``."""
    last = len(times) - 1
    before = np.clip(np.searchsorted(times, frames + TIME_TOLERANCE, side="right") - 1, 0, last)
    step = times[np.minimum(before + 1, last)] - times[before]
    since = frames - times[before]
    weight = np.divide(since, step, out=np.zeros_like(since), where=(step > 0) & (since > TIME_TOLERANCE))
    return list(zip(before.tolist(), weight.tolist(), strict=True))


@dataclass(frozen=True, eq=False)
class Transforms:
    """Transforms from a mesh to the world, the nearest to the mesh first, with the samples located at the frames."""

    samples: tuple[tuple[Any, LocatedFrames], ...]

    @classmethod
    def from_schemas(
        cls, schemas: tuple[Any, ...], frames: Float, window: tuple[float, float] | None = None
    ) -> Transforms:
        """Locate frame times ``(T,)`` between the samples of transforms, limited to a time window if one is given."""
        samples = []
        for schema in schemas:
            times = np.zeros(1) if schema.isConstant() else sample_times(schema)
            kept = slice(0, len(times)) if window is None else select_samples(times, window)
            located = locate_frames(times[kept], frames)
            samples.append((schema, [(before + kept.start, weight) for before, weight in located]))
        return cls(tuple(samples))

    def to_world(self, frame: int) -> Float:
        """Return the mesh-to-world matrix ``(4, 4)`` of a frame."""
        world = np.eye(4)
        for schema, located in self.samples:
            matrix, inherits = _local_matrix(schema, *located[frame])
            with np.errstate(all="ignore"):
                world = world @ matrix
            if not inherits:
                break
        return world


def _local_matrix(schema: Any, before: int, weight: float) -> tuple[Float, bool]:
    """Return the parent-relative matrix ``(4, 4)`` of a transform, and whether it inherits ancestor transforms."""
    if not schema.getNumSamples():
        return np.eye(4), True
    first = schema.getValue(sample_selector(schema, before))
    matrix = np.array(first.getMatrix(), dtype=np.float64)
    if weight:
        second = schema.getValue(sample_selector(schema, before + 1))
        matrix = interpolate_matrices(matrix, np.array(second.getMatrix(), dtype=np.float64), weight)
    return matrix, bool(first.getInheritsXforms())


def determinant(matrix: Float) -> float:
    """Return the determinant of a matrix's linear part ``(3, 3)``, which is negative for mirroring."""
    with np.errstate(all="ignore"):
        return float(np.linalg.det(matrix[:3, :3]))


def interpolate_matrices(first: Float, second: Float, weight: float) -> Float:
    """Interpolate affine matrices ``(4, 4)`` by translation, stretch and rotation."""
    from mixseq.mesh.rigid import nearest_rotations

    if not (np.isfinite(first).all() and np.isfinite(second).all()):
        return np.full((4, 4), np.nan)  # the reader reports the frame and the vertex
    blend = (1 - weight) * first + weight * second
    rotations = nearest_rotations(np.stack([first[:3, :3], second[:3, :3]]))
    stretches = np.stack([first[:3, :3], second[:3, :3]]) @ rotations.swapaxes(1, 2)  # applied before the rotations
    step = rotvec_to_matrix(weight * matrix_to_rotvec(rotations[0].T @ rotations[1]))
    blend[:3, :3] = ((1 - weight) * stretches[0] + weight * stretches[1]) @ rotations[0] @ step
    return blend


def transform_points(points: FloatArray, matrix: Float) -> FloatArray:
    """Transform points ``(V, 3)`` by a matrix ``(4, 4)`` or ``(3, 3)``, in doubles unless it is the identity."""
    if np.array_equal(matrix, np.eye(len(matrix))):
        return points
    with np.errstate(all="ignore"):  # the reader reports overflow with its vertex
        world = points.astype(np.float64) @ matrix[:3, :3]
        if len(matrix) == 4:
            world += matrix[3, :3]
        return np.asarray(world)


def _as_single(values: FloatArray) -> Single:
    with np.errstate(over="ignore", under="ignore"):
        return values.astype(np.float32)


_MIN_RELATIVE_DETERMINANT = 1e-12
"""Lower bound on the determinant of an invertible matrix, relative to the cube of its largest element."""


@dataclass(frozen=True, eq=False)
class MeshTransform:
    """Matrices ``(T, 4, 4)`` from mesh space to the world, and their time derivatives `rates` per second."""

    matrices: Float
    rates: Float

    @classmethod
    def from_schemas(cls, schemas: tuple[Any, ...], frames: Float, fps: float) -> MeshTransform:
        """Evaluate transforms, the nearest to the mesh first, at frame times ``(T,)`` in seconds.

        Only samples from the frames' time window are used: a copy contains no others, and must give equal results.
        """
        window = float(frames[0]), float(frames[-1])
        now, before, after = (_evaluate_matrices(schemas, frames + shift / fps, window) for shift in (0.0, -0.5, 0.5))
        return cls(now, (after - before) * fps)

    @property
    def is_mirrored(self) -> bool:
        """Whether the mesh is mirrored in the first frame."""
        return determinant(self.matrices[0]) < 0

    def check_invertible(self) -> None:
        """Raise an error if a frame's matrix is singular."""
        with np.errstate(all="ignore"):
            determinants = np.abs(np.linalg.det(self.matrices[:, :3, :3]))
            largest = np.abs(self.matrices[:, :3, :3]).max(axis=(1, 2))
        is_singular = ~(determinants > _MIN_RELATIVE_DETERMINANT * largest**3)
        if is_singular.any():
            raise FormatError(f"the transforms above it make it flat in frame {int(is_singular.argmax())}")

    def to_mesh_points(self, world: FloatArray, frame: int) -> Single:
        """Convert a frame's world-space points ``(V, 3)`` to mesh space."""
        return _as_single(transform_points(world, np.linalg.inv(self.matrices[frame])))

    def to_mesh_velocities(self, world: FloatArray, points: FloatArray, frame: int) -> Single:
        """Convert a frame's world-space velocities ``(V, 3)`` to mesh space, given the points in mesh space."""
        inverse = np.linalg.inv(self.matrices[frame])[:3, :3]
        return _as_single(transform_points(world - self._transport(points, frame), inverse))

    def to_world_velocities(self, own: FloatArray, points: FloatArray, frame: int) -> Single:
        """Convert a frame's mesh-space velocities ``(V, 3)`` to world space, given the points in mesh space."""
        rotated = own.astype(np.float64) @ self.matrices[frame, :3, :3]
        return (rotated + self._transport(points, frame)).astype(np.float32)

    def _transport(self, points: FloatArray, frame: int) -> Float:
        """Return the world-space velocities ``(V, 3)`` of points that are static in mesh space."""
        return points.astype(np.float64) @ self.rates[frame, :3, :3] + self.rates[frame, 3, :3]


def _evaluate_matrices(schemas: tuple[Any, ...], frames: Float, window: tuple[float, float]) -> Float:
    transforms = Transforms.from_schemas(schemas, frames, window)
    if all(schema.isConstant() for schema in schemas):
        return np.broadcast_to(transforms.to_world(0), (len(frames), 4, 4))
    return np.stack([transforms.to_world(frame) for frame in range(len(frames))])
