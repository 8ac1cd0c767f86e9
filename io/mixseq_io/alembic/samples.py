"""Samples of properties and transforms at the times of frames, and paths of meshes in a stand-alone archive.

Alembic properties have their own samples, at times in seconds: uniform, cyclic (several per shutter), or arbitrary.
Between two samples of a transform, translation, stretch and rotation angle are interpolated linearly, as in Blender.
Matrices act on row vectors: p' = p M.

New points over an archive stay in mesh space, so that other children of its transforms keep their place, and caches of
other programs can refer to the result. With p the own points and M the matrix of a frame, world points and velocities
are

    w = p M,    w' = p' M + p M'.

M' is the central difference over one frame, as renderers see a transform while the shutter is open.

Stand-alone archives keep original paths, so that references such as cache modifiers of other programs find the meshes.
Other meshes are below a transform of their name, because tools name imports by transforms.

Specification: https://docs.alembic.io/reference/index.html (``TimeSampling``, ``IXformSchema``)
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import takewhile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import FormatError
from mixseq.mesh.rigid import nearest_rotations
from mixseq.mesh.rotations import matrices, vectors
from mixseq.sequence.frame_rates import NTSC_RATES
from mixseq.sequence.header import DEFAULT_FPS, SequenceHeader
from mixseq.types import Float, FloatArray
from mixseq_io.alembic.library import AbcCoreAbstract, selector
from mixseq_io.scene_meshes import SceneMesh

Place = tuple[str, ...]
"""Names from the root to a mesh; all but the last are transforms."""


def object_places(header: SequenceHeader, scene_meshes: Sequence[SceneMesh]) -> list[Place]:
    """Return the places of all meshes: ``/<name>/<object>/<object>``, or their own paths.

    Those are kept if all meshes have one with a transform, and their common ancestor is named as the sequence.
    """
    kept = [tuple(each.path.split("/")[1:]) for each in scene_meshes if each.path.startswith("/")]
    if len(kept) == len(scene_meshes) and _can_be(kept) and _common_name(kept) in ("", header.name):
        return kept
    root = valid_name(header.name)
    if len(scene_meshes) == 1:
        return [(root, root)]
    return [(root, name, name) for name in unique_names(each.name for each in scene_meshes)]


def _can_be(places: Sequence[Place]) -> bool:
    """Whether meshes can be at places: each with a transform above it, and nothing below another mesh."""
    meshes = set(places)
    above = {place[:end] for place in meshes for end in range(1, len(place))}
    named = all(len(place) > 1 and all(place) for place in meshes)
    return named and len(meshes) == len(places) and not meshes & above


def _common_name(places: Sequence[Place]) -> str:
    """Return the sequence's name for a reader: that of its only mesh, or of the common ancestor."""
    shared = list(takewhile(lambda names: len(set(names)) == 1, zip(*places, strict=False)))
    return shared[-1][0] if shared else ""


def valid_name(name: str) -> str:
    """Return a valid object name: without slashes and not empty."""
    return name.replace("/", "_") or "mesh"


def unique_names(names: Iterable[str]) -> list[str]:
    """Return valid names, repeated ones with a number: "a", "a_2"."""
    taken: dict[str, None] = {}
    numbers: dict[str, int] = {}
    for name in map(valid_name, names):
        number, free = numbers.get(name, 1), name
        while free in taken:
            number += 1
            free = f"{name}_{number}"
        numbers[name] = number
        taken[free] = None
    return list(taken)


TIME_TOLERANCE = 0.999e-6
"""Distance in seconds below which times are equal."""

_MOST_SAMPLES = 1_000_000
_USUAL_RATES = (24, 25, 30, 48, 50, 60, *NTSC_RATES, 100, 120, 240)


def sample_times(sampled: Any) -> Float:
    """Return the sample times ``(N,)`` in seconds of a property or schema."""
    count, sampling = sampled.getNumSamples(), sampled.getTimeSampling()
    if count > _MOST_SAMPLES:
        raise FormatError(f"a property claims {count} samples; the file is damaged")
    kind, stored = sampling.getTimeSamplingType(), np.array(list(sampling.getStoredTimes()), dtype=np.float64)
    sample = np.arange(count)
    if not kind.isAcyclic():
        per_cycle = kind.getNumSamplesPerCycle()
        cycle, sample = np.divmod(sample, max(per_cycle, 1))
    if sample.max(initial=-1) >= len(stored):
        raise FormatError(f"a property has {len(stored)} times for {count} samples; the file is damaged")
    return stored[sample] if kind.isAcyclic() else stored[sample] + cycle * kind.getTimePerCycle()


def samples_within(times: Float, window: tuple[float, float]) -> slice:
    """Return the slice of samples that determine values within a window of time; all, if all are before or after.

    Examples
    --------
    >>> times = np.array([1.0, 2.0, 3.0, 4.0])
    >>> samples_within(times, (2.0, 3.0)), samples_within(times, (2.5, 2.6)), samples_within(times, (5.0, 6.0))
    (slice(1, 3, None), slice(1, 3, None), slice(0, 4, None))
    """
    start, end = window[0] + TIME_TOLERANCE, window[1] - TIME_TOLERANCE
    if not len(times) or window[1] < times[0] or window[0] > times[-1]:
        return slice(0, len(times))
    first, last = np.searchsorted(times, start, side="right") - 1, np.searchsorted(times, end, side="left")
    return slice(max(int(first), 0), min(int(last) + 1, len(times)))


def time_sampling(times: Float, step: float) -> Any:
    """Return a uniform sampling for even times ``(N,)``, with `step` if it fits, else one of all times."""
    if len(times) > 1:
        mean = float(times[-1] - times[0]) / (len(times) - 1)
        step = step if np.isclose(mean, step, rtol=1e-9, atol=0) else mean
    if np.allclose(times, times[0] + np.arange(len(times)) * step, rtol=1e-12, atol=1e-12):
        return AbcCoreAbstract.TimeSampling(step, float(times[0]))
    listed = AbcCoreAbstract.TimeVector()
    listed.extend(times.tolist())
    one_by_one = AbcCoreAbstract.TimeSamplingType(AbcCoreAbstract.AcyclicFlag.kAcyclic)
    return AbcCoreAbstract.TimeSampling(one_by_one, listed)


@dataclass(frozen=True, eq=False)
class SampleWeights:
    """Pair of samples around every frame, and the weight of the second."""

    before: NDArray[np.int64]
    weight: Float

    def at(self, frame: int) -> tuple[int, float]:
        """Return the sample before a frame, and the weight of the one after."""
        return int(self.before[frame]), float(self.weight[frame])


def locate(own: Float, frames: Float) -> SampleWeights:
    """Return the samples, at the times `own` ``(N,)``, around frames ``(T,)``."""
    before = np.clip(np.searchsorted(own, frames + TIME_TOLERANCE, side="right") - 1, 0, len(own) - 1)
    after = np.minimum(before + 1, len(own) - 1)
    since, step = frames - own[before], own[after] - own[before]
    weight = np.divide(since, step, out=np.zeros_like(since), where=(step > 0) & (since > TIME_TOLERANCE))
    return SampleWeights(before, weight)


def frame_rate(times: Float, declared: str) -> float:
    """Return the frame rate of times ``(T,)``: as declared, of even steps, or a usual rate whose grid they lie on.

    Examples
    --------
    >>> frame_rate(np.array([0.0, 1 / 29.97, 2 / 29.97]), ""), frame_rate(np.array([0.0, 1 / 24, 4 / 24]), "")
    (29.97, 24.0)
    """
    step = (times[-1] - times[0]) / max(len(times) - 1, 1)
    even = len(times) > 1 and np.allclose(np.diff(times), step, rtol=0, atol=1e-6 * step + 1e-9)
    rounding = float(np.spacing(np.abs(times).max())) / max(step, 1e-9)  # late times are less precise
    rate = _plain(1 / step, 1e-12 + rounding) if even else 0.0
    try:
        said = float(declared or 0)
    except ValueError:
        said = 0.0
    if (
        np.isfinite(said) and said > 0 and not np.isclose(said, rate, rtol=1e-6)
    ):  # else the step is more precise
        return _plain(said, 1e-8)
    for usual in () if even else _USUAL_RATES:
        if len(times) > 1 and np.allclose(times * usual, np.rint(times * usual), rtol=0, atol=1e-3):
            return float(usual)
    return rate or DEFAULT_FPS


def _plain(rate: float, tolerance: float) -> float:
    """Return the rate before rounding by a reciprocal or a text: 29.97 or 30000/1001."""
    simple = float(Fraction(rate).limit_denominator(1001))
    return simple if np.isclose(simple, rate, rtol=tolerance, atol=0) else float(f"{rate:.12g}")


@dataclass(frozen=True, eq=False)
class Transforms:
    """Transforms from a mesh to the world in every frame."""

    above: tuple[tuple[Any, SampleWeights], ...]

    @classmethod
    def at(
        cls, above: tuple[Any, ...], frames: Float, window: tuple[float, float] | None = None
    ) -> Transforms:
        """Return the samples of transforms around frames ``(T,)``, of all samples or those within a window of time."""
        found = []
        for schema in above:
            times = _times(schema)
            kept = slice(0, len(times)) if window is None else samples_within(times, window)
            between = locate(times[kept], frames)
            found.append((schema, SampleWeights(between.before + kept.start, between.weight)))
        return cls(tuple(found))

    def to_world(self, frame: int) -> Float:
        """Return the matrix ``(4, 4)`` of a frame."""
        world = np.eye(4)
        for schema, between in self.above:
            matrix, inherits = _local(schema, *between.at(frame))
            with np.errstate(all="ignore"):
                world = world @ matrix
            if not inherits:
                break
        return world


def _times(schema: Any) -> Float:
    return np.zeros(1) if schema.isConstant() else sample_times(schema)


def _local(schema: Any, before: int, weight: float) -> tuple[Float, bool]:
    if not schema.getNumSamples():
        return np.eye(4), True
    first = schema.getValue(selector(schema, before))
    matrix = np.array(first.getMatrix(), dtype=np.float64)
    if weight:
        second = schema.getValue(selector(schema, before + 1))
        matrix = mixed(matrix, np.array(second.getMatrix(), dtype=np.float64), weight)
    return matrix, bool(first.getInheritsXforms())


def determinant(matrix: Float) -> float:
    """Return the determinant of a matrix's ``(3, 3)`` part, negative for mirroring."""
    with np.errstate(all="ignore"):
        return float(np.linalg.det(matrix[:3, :3]))


def mixed(first: Float, second: Float, weight: float) -> Float:
    """Interpolate affine matrices ``(4, 4)`` by translation, stretch and rotation; rotations do not shrink halfway."""
    if not (np.isfinite(first).all() and np.isfinite(second).all()):
        return np.full((4, 4), np.nan)  # the reader names the frame and the vertex
    blend = (1 - weight) * first + weight * second
    turns = nearest_rotations(np.stack([first[:3, :3], second[:3, :3]]))
    stretches = np.stack([first[:3, :3], second[:3, :3]]) @ turns.swapaxes(1, 2)  # rows: stretch, then turn
    step = matrices(weight * vectors(turns[0].T @ turns[1]))
    blend[:3, :3] = ((1 - weight) * stretches[0] + weight * stretches[1]) @ turns[0] @ step
    return blend


def moved(points: FloatArray, matrix: Float) -> NDArray[np.float32]:
    """Transform points ``(V, 3)`` by a matrix ``(4, 4)``, or vectors by its part ``(3, 3)``."""
    if np.array_equal(matrix, np.eye(len(matrix))):
        return np.asarray(points, dtype=np.float32)
    with np.errstate(all="ignore"):  # overflow is reported by the reader, with its vertex
        world = points.astype(np.float64) @ matrix[:3, :3]
        if len(matrix) == 4:
            world += matrix[3, :3]
        return world.astype(np.float32)


_FLAT = 1e-12
"""Smallest determinant of an inverted matrix, relative to the cube of the largest scale."""


@dataclass(frozen=True, eq=False)
class Placing:
    """Transforms above a mesh in every frame, and their rates."""

    matrices: Float
    rates: Float

    @classmethod
    def at(cls, above: tuple[Any, ...], frames: Float, fps: float) -> Placing:
        """Evaluate transforms, the nearest to the mesh first, at times of frames ``(T,)`` in seconds.

        Only samples that frames need are used, so that a copy without the others gives the same result.
        """
        window = float(frames[0]), float(frames[-1])
        now, before, after = (_matrices(above, frames + shift / fps, window) for shift in (0.0, -0.5, 0.5))
        return cls(now, (after - before) * fps)

    def check(self) -> None:
        """Raise an error if a frame's matrix is singular."""
        with np.errstate(all="ignore"):
            sizes = np.abs(np.linalg.det(self.matrices[:, :3, :3]))
            largest = np.abs(self.matrices[:, :3, :3]).max(axis=(1, 2))
        flat = ~(sizes > _FLAT * largest**3)
        if flat.any():
            raise FormatError(f"the transforms above it make it flat in frame {int(flat.argmax())}")

    def own_points(self, world: FloatArray, frame: int) -> NDArray[np.float32]:
        """Return a frame's points ``(V, 3)`` in mesh space."""
        return moved(world, np.linalg.inv(self.matrices[frame]))

    def own_velocities(self, world: FloatArray, own_points: FloatArray, frame: int) -> NDArray[np.float32]:
        """Return a frame's velocities ``(V, 3)`` in mesh space, given its points `own_points` there."""
        inverse = np.linalg.inv(self.matrices[frame])[:3, :3]
        return moved(world - self._carried(own_points, frame), inverse)

    def world_velocities(self, own: FloatArray, own_points: FloatArray, frame: int) -> NDArray[np.float32]:
        """Return the world velocities ``(V, 3)``, the inverse of `own_velocities`."""
        turned = own.astype(np.float64) @ self.matrices[frame, :3, :3]
        return (turned + self._carried(own_points, frame)).astype(np.float32)

    def _carried(self, own_points: FloatArray, frame: int) -> Float:
        """Return the world velocities ``(V, 3)`` of points at rest in mesh space."""
        return own_points.astype(np.float64) @ self.rates[frame, :3, :3] + self.rates[frame, 3, :3]


def _matrices(above: tuple[Any, ...], frames: Float, window: tuple[float, float]) -> Float:
    transforms = Transforms.at(above, frames, window)
    if all(schema.isConstant() for schema in above):
        return np.broadcast_to(transforms.to_world(0), (len(frames), 4, 4))
    return np.stack([transforms.to_world(frame) for frame in range(len(frames))])
