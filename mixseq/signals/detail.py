"""Signals of an encoded sequence: within a tolerance, exact, or with given numbers of modes and knots.

Key shapes are the mean and modes, or frames of the sequence. Curves have few knots, or one at (almost) every frame. For
a tolerance the coarsest signals that keep it at all frames are searched for; if not even the finest do, an error is
raised.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from hashlib import blake2b
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg
from scipy.interpolate import make_lsq_spline

from mixseq.choices import PoseForm
from mixseq.errors import ReconstructionError, SettingsError
from mixseq.mesh.rotations import align_quat_signs
from mixseq.runtime.low_memory import LargeArray, new_large_array
from mixseq.runtime.parallel import Executor, serial_executor
from mixseq.runtime.progress import Progress, no_progress
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.sequence import (
    FrameStore,
    MeshSequence,
    block_size,
    bounding_diagonal,
    iterate_blocks,
    largest_coordinate,
    largest_offset,
    rounding_error,
)
from mixseq.signals.curve import Curve
from mixseq.signals.decoding import FRAMES_PER_BLOCK
from mixseq.signals.model import Model
from mixseq.signals.modes import Modes, principal_modes
from mixseq.signals.pose import PoseMap
from mixseq.spaces.base import ShapeSpace
from mixseq.spaces.temporal import FrameWeights, Poses, TemporalOperator, insert_midpoints, select_operator
from mixseq.types import Float, FloatArray, Index, evenly_spaced

DeviationNorm = Callable[[Float], Float]
"""Map of the deviations ``(T, k)`` of a curve to their sizes ``(T,)``."""


def max_norm(weights: Float) -> DeviationNorm:
    """Return the measure of the largest coordinate, with weights ``(k,)``."""
    return lambda deviations: np.asarray(np.abs(deviations * weights).max(axis=1, initial=0.0))


def rms_over_vertices(count: int) -> DeviationNorm:
    """Return the measure of scores: root mean square over a number of vertices."""
    return lambda scores: np.asarray(np.linalg.norm(scores, axis=1) / np.sqrt(count))


def fit_curve(times: Float, values: Float, tolerance: float, measure: DeviationNorm) -> Curve:
    """Fit a curve with few knots to values ``(T, k)`` at times ``(T,)``, within a tolerance."""
    candidates = np.arange(2, len(times) - 2)  # those of the not-a-knot spline through all values
    chosen = np.zeros(0, dtype=np.int64)
    while len(chosen) < len(candidates):
        curve = least_squares_curve(times, values, times[chosen])
        outside = np.flatnonzero(measure(curve(times) - values) > tolerance)
        if not len(outside):
            return curve
        ends = np.concatenate([[1], chosen, [len(times) - 2]])
        intervals = np.unique(np.clip(np.searchsorted(ends, outside) - 1, 0, len(ends) - 2))
        low, high = ends[intervals], ends[intervals + 1]
        middles = ((low + high) // 2)[high - low > 1]
        if not len(middles):  # violations are next to knots on both sides
            break
        chosen = np.union1d(chosen, middles)
    return Curve(times, values)


def least_squares_curve(times: Float, values: Float, inner: Float) -> Curve:
    """Fit a curve with inner knots ``(n,)`` to values ``(T, k)`` at times ``(T,)``, by least squares."""
    first, last = times[0], times[-1]
    if len(times) < 4 or len(inner) >= len(times) - 4:
        return Curve(times, values)
    if len(inner):
        sites = np.concatenate([[first, (first + inner[0]) / 2], inner, [(inner[-1] + last) / 2, last]])
    else:
        sites = np.linspace(first, last, 4)
    if not values.shape[1]:
        return Curve(sites, np.zeros((len(sites), 0)))
    knots = np.concatenate([[first] * 4, inner, [last] * 4])
    return Curve(sites, make_lsq_spline(times, values, knots, k=3)(sites))


def choose_key_frames(scores: Float) -> Index:
    """Choose frames ``(r + 1,)`` as key shapes for points of pose space ``(T, r)``."""
    size = np.abs(scores).max(initial=0.0) or 1.0
    corners = np.concatenate([np.full((1, len(scores)), size), scores.T])
    pivots = linalg.qr(corners, mode="r", pivoting=True)[1]
    return np.sort(pivots[: scores.shape[1] + 1]).astype(np.int64)


def key_pose_map(keys: Float) -> PoseMap:
    """Make the pose map of key shapes at points of pose space ``(K, r)``."""
    corners = np.concatenate(
        [np.ones((1, len(keys))), keys.T]
    )  # weights w of a point c: corners @ w = (1, c)
    inverse = np.linalg.pinv(corners)
    offset, matrix = inverse[:, 0], inverse[:, 1:].T
    # Rounding, and points that the keys do not span, must not make the sums drift.
    return PoseMap(offset + (1 - offset.sum()) / len(keys), matrix - matrix.mean(axis=1, keepdims=True))


OPERATOR_VERTICES = 256
"""Number of vertices from which the temporal operator is chosen."""

MIN_SCORE_SCALE = 1e-200
"""Least scale of a mode's scores, in diagonals, for rounding."""

CORRECTION_STEP = 2.0**-24
"""Rounding step of corrections of exact models, which are zero at the frames, in diagonals and radians."""


class InterpolatedPoses(NamedTuple):
    """Predictions at and between frames, interpolated by cubic splines."""

    times: Float  # (2T - 1,) frames and the middles between them, in seconds
    weights: FrameWeights  # weights of the frames there
    quarter_times: Float  # (4T - 3,) frames and the quarters between them, in seconds
    part_poses: Float  # (4T - 3, ...) poses of parts as seen from their bodies, at the quarters
    placement: Float  # (4T - 3, P) placements at the quarters


@dataclass(frozen=True, eq=False)
class EncodedSequence:
    """A sequence as vectors of a shape space."""

    header: SequenceHeader  # mesh and times
    space: ShapeSpace  # the space
    shapes: LargeArray  # (T, S) the vectors of the frames without their placement
    placement: Float  # (T, P) the placement
    # (T, C) coordinates of sampled vertices, used to select the temporal operator.
    samples: Float
    pose: PoseForm = "modes"  # form of the key shapes
    in_body_axes: bool = False  # whether poses of parts are predicted as seen from their bodies, too

    @cached_property
    def operator(self) -> TemporalOperator:
        """Temporal operator that predicts the samples best."""
        return select_operator(self.header.times, self.samples)

    @cached_property
    def poses(self) -> Float:
        """Relative poses of parts at the frames ``(T, pose_dim)``."""
        poses = np.empty((len(self.shapes), self.space.pose_dim))
        for row in range(len(poses) if self.space.pose_dim else 0):  # row by row: shapes may be on disk
            poses[row] = self.shapes[row : row + 1][0, self.pose_columns]
        return poses

    @property
    def pose_columns(self) -> slice:
        """Columns of shapes with the relative poses of parts."""
        return slice(self.space.shape_dim - self.space.pose_dim, self.space.shape_dim)

    @cached_property
    def modes(self) -> Modes:
        """All modes of the shapes."""
        return principal_modes(self.shapes, self.space.shape_weights)

    @cached_property
    def interpolated(self) -> InterpolatedPoses:
        """Predictions between the frames."""
        times = insert_midpoints(self.header.times)
        quarters = insert_midpoints(times)
        found = self.space.interpolate_poses(
            self.operator, self.poses, self.placement, quarters, self.in_body_axes
        )
        return InterpolatedPoses(times, self.operator.weights_at(times), quarters, *found)


def encode_sequence(
    sequence: FrameStore | MeshSequence,
    space: ShapeSpace,
    pose: PoseForm = "modes",
    workers: Executor = serial_executor,
    progress: Progress = no_progress,
) -> EncodedSequence:
    """Encode all frames of a sequence in a space."""
    count, size = len(sequence.points), space.shape_dim
    placed = slice(size, size + space.placement_dim)
    shapes = new_large_array((count, size))
    placement = np.empty((count, space.placement_dim))
    some = evenly_spaced(sequence.header.vertex_count, OPERATOR_VERTICES)
    samples = np.empty((count, 3 * len(some)))
    previous, done = None, 0
    for apart, sampled in workers(_encode_block, (space, some), iterate_blocks(sequence.points)):
        vectors = space.unwrap(apart, previous)
        rows = slice(done, done + len(vectors))
        shapes[rows], placement[rows], samples[rows] = vectors[:, :size], vectors[:, placed], sampled
        previous, done = vectors[-1], rows.stop
        progress(done, count, "encoding frames")
    turns, centres = space.unpack_placements(placement)
    steady = space.pack_placements(
        Poses(align_quat_signs(turns), centres)
    )  # what is interpolated in time must not jump
    held = space.to_body_axes(samples.reshape(count, -1, 3), some, steady).reshape(count, -1)
    return EncodedSequence(sequence.header, space, shapes, steady, held, pose)


def _encode_block(shared: tuple[ShapeSpace, Index], points: FloatArray) -> tuple[Float, Float]:
    """Return vectors and samples of a block of frames, each frame independent of others."""
    space, vertices = shared
    samples = points[:, vertices].astype(np.float64)
    return space.encode_independently(points), samples.reshape(len(points), -1)


@dataclass(frozen=True)
class Detail:
    """Level of detail of signals."""

    rank: int | None = None  # number of shape modes; by default all there are
    # How far, in diagonals, the signals may be from the frames (by the measures of Encoded); zero to pass through them
    # all.
    slack: float = 0.0
    knots: int | ArrayLike | None = None  # inner knots of all curves; by default chosen by slack
    # Key shapes and curves are rounded to multiples of this number, a power of two in diagonals, so that they take few
    # bytes; zero not to.
    step: float = 0.0


def build_model(encoded: EncodedSequence, detail: Detail) -> Model:
    """Make the model of an encoded sequence."""
    times = encoded.header.times
    rank = _choose_rank(encoded, detail)
    modes = encoded.modes.first(rank)
    if encoded.pose == "modes":
        pose, shapes = modes.pose_map(), modes.key_shapes()
    else:
        frames = choose_key_frames(modes.scores)
        pose = key_pose_map(modes.scores[frames])
        shapes = encoded.shapes[frames]
    if detail.step:  # weights add up to one: so errors of the first key shape are not magnified
        steps = detail.step * encoded.space.rounding_step_ratios
        shapes = _round(shapes[:1], steps) + _round(shapes - shapes[:1], steps)
    corrections = partial(_pose_corrections, encoded.space, pose, shapes[:, encoded.pose_columns])
    if detail.knots is not None:
        curves = _fit_curves_with_knots(encoded, modes.scores, corrections, _check_knots(detail.knots, times))
    else:
        curves = _fit_curves_within_slack(encoded, modes.scores, corrections, detail)
    return Model(encoded.header, encoded.space, curves[0], pose, shapes, *curves[1:])


Corrections = Callable[[Curve, Float, Float], Float]
"""Map of a time signal, times ``(N,)`` and part poses there ``(N, ...)`` to corrections ``(N, C)``."""


def _pose_corrections(
    space: ShapeSpace, pose: PoseMap, key_poses: Float, time: Curve, times: Float, targets: Float
) -> Float:
    """Return the `Corrections` of shapes blended of key shapes with part poses ``(K, pose_dim)``."""
    return space.pose_corrections(pose.weights(time(times)) @ key_poses, targets)


def _fit_curves_with_knots(
    encoded: EncodedSequence, scores: Float, corrections: Corrections, inner: Float
) -> tuple[Curve, Curve, Curve]:
    """Return curves of time, placement and correction with inner knots ``(n,)``."""
    times = encoded.header.times
    time = least_squares_curve(times, scores, inner)
    placement = least_squares_curve(times, encoded.placement, inner)
    parts, _ = encoded.space.interpolate_poses(
        encoded.operator, encoded.poses, encoded.placement, times, in_body=False
    )
    return time, placement, least_squares_curve(times, corrections(time, times, parts), inner)


def _fit_curves_within_slack(
    encoded: EncodedSequence, scores: Float, corrections: Corrections, detail: Detail
) -> tuple[Curve, Curve, Curve]:
    """Return curves of time, placement and correction within slack of frames and predictions, rounded."""
    slack, step, space = detail.slack, detail.step, encoded.space
    sites, rows, quarters, targets, placed = encoded.interpolated
    # Scores of modes that hardly count are small, but lengths and angles, which weigh little, change with them.
    sizes = 2.0 ** np.floor(np.log2(np.maximum(np.abs(scores).max(axis=0), MIN_SCORE_SCALE)))
    time = _fit_rounded_curve(
        sites, rows.interpolate(scores), slack, rms_over_vertices(encoded.header.vertex_count), step * sizes
    )
    of_placement, of_correction = np.split(space.weights[space.shape_dim :], [space.placement_dim])
    placement = _fit_rounded_curve(quarters, placed, slack, max_norm(of_placement), step)
    values = corrections(time, quarters, targets)
    if step and not slack:
        step = max(step, CORRECTION_STEP)
    return time, placement, _fit_rounded_curve(quarters, values, slack, max_norm(of_correction), step)


def _fit_rounded_curve(
    times: Float, values: Float, slack: float, measure: DeviationNorm, step: float | Float
) -> Curve:
    curve = fit_curve(times, values, slack, measure) if slack > 0 else Curve(times, values)
    return Curve(curve.times, _round(curve.values, step)) if np.any(step) else curve


def _round(values: Float, step: float | Float) -> Float:
    """Round to multiples of a step, or of one per column."""
    return np.asarray(np.round(values / step) * step)


def _choose_rank(encoded: EncodedSequence, detail: Detail) -> int:
    """Return the given number of modes, or the least one with all frames within the slack."""
    scores = encoded.modes.scores
    if detail.rank is not None:
        return min(detail.rank, len(encoded.modes.sizes))
    tails, rank = np.zeros(len(scores)), int(scores.shape[1])  # squared norms of all modes from the rank on
    while rank:
        tails += np.square(scores[:, rank - 1])
        if np.sqrt(tails.max()) / np.sqrt(encoded.header.vertex_count) > detail.slack:
            break
        rank -= 1
    return rank


def _check_knots(knots: int | ArrayLike, times: Float) -> Float:
    most = max(len(times) - 4, 0)
    if isinstance(knots, int | np.integer):
        if not 0 <= knots <= most:
            raise SettingsError(f"knots is {knots}; {len(times)} frames can have 0 to {most} inner knots")
        if knots == most:
            return times[2:-2]
        places = np.linspace(0, len(times) - 1, int(knots) + 2)[1:-1]
        return np.interp(places, np.arange(len(times)), times)
    inner = np.unique(np.asarray(knots, dtype=np.float64).reshape(-1))
    if len(inner) > most:
        raise SettingsError(f"there are {len(inner)} inner knots; {len(times)} frames can have {most}")
    if inner.size and not (inner[0] > times[0] and inner[-1] < times[-1]):
        raise SettingsError(
            f"inner knots are from {inner[0]:g} to {inner[-1]:g} s; "
            f"they must be between {times[0]:g} and {times[-1]:g} s"
        )
    ends = np.concatenate([[times[0]] * 4, inner, [times[-1]] * 4])
    for number in range(
        len(inner) + 4
    ):  # Schoenberg and Whitney: every basis function needs a frame of its own
        if not ((times > ends[number]) & (times < ends[number + 4])).any() and 0 < number < len(inner) + 3:
            where = ends[number + 2]
            raise SettingsError(f"there are no frames between the knots near {where:g} s; leave some out")
    return inner


VISUALLY_LOSSLESS_TOLERANCE = 5e-4
"""Default tolerance in diagonals: half a pixel, where a mesh fills a picture of 1000 pixels."""

EXACT_TOLERANCE = 1e-8
"""Tolerance of exact models in diagonals, for rounding; near the origin the error is some 1e-15."""

EXACT_ROUNDING_STEP = 2.0**-38
"""Rounding step of signals of exact models, in diagonals: frames are off by some 1e-11."""

TOLERANCE_TO_STEP_RATIO = 64
"""Ratio of the tolerance to the rounding step of signals; the step is refined where it is too coarse."""

SUFFICIENT_ERROR_RATIO = 0.6
"""Ratio of error to tolerance above which a model is not made coarser."""

MAX_TRIAL_MODELS = 7
"""Largest number of models that are tried before the finest one."""


def fit_within_tolerance(
    encoded: EncodedSequence,
    sequence: FrameStore | MeshSequence,
    tolerance: float,
    progress: Progress = no_progress,
    workers: Executor | None = None,
) -> Model:
    """Find signals that reproduce a sequence to a tolerance.

    Slack of the signals and error of the frames grow together, unevenly: the slack is scaled by the measured error, and
    bisected once it was both too small and too large.
    """
    low, high, slack = 0.0, np.inf, tolerance / 4
    best: Model | None = None
    step = 2.0 ** np.floor(np.log2(tolerance / TOLERANCE_TO_STEP_RATIO))
    errors: dict[bytes, float] = {}  # of tried models: short sequences have few
    for number in range(MAX_TRIAL_MODELS):
        progress(number, MAX_TRIAL_MODELS, "choosing modes and knots")
        model = build_model(encoded, Detail(slack=slack, step=step))
        signals = _digest(model)
        if signals not in errors:
            errors[signals] = largest_error(model, sequence, 2 * tolerance, workers)
        elif errors[signals] > tolerance:  # these are all modes and knots
            step /= 2
        error = errors[signals]
        if error <= tolerance:
            low, best = slack, model
            if (
                error > SUFFICIENT_ERROR_RATIO * tolerance
                or len(model.shapes) == 1
                or number > MAX_TRIAL_MODELS // 2
            ):
                break
        else:
            high = slack
        scaled = slack * float(np.clip(0.8 * tolerance / max(error, tolerance / 100), 0.1, 10.0))
        slack = scaled if low < scaled < high else float(np.sqrt(max(low, high / 100) * high))
    progress(MAX_TRIAL_MODELS, MAX_TRIAL_MODELS, "choosing modes and knots")
    if best is not None:
        return best
    finest = build_model(encoded, Detail(step=min(step, EXACT_ROUNDING_STEP)))
    return verify_tolerance(finest, sequence, tolerance, workers)


def _digest(model: Model) -> bytes:
    """Hash the curves of a model, to compare models of one sequence."""
    digest = blake2b()
    for curve in model.curves:
        digest.update(curve.times.data)
        digest.update(np.ascontiguousarray(curve.values).data)
    return digest.digest()


def verify_tolerance(
    model: Model,
    sequence: FrameStore | MeshSequence,
    promise: float,
    workers: Executor | None = None,
    progress: Progress = no_progress,
) -> Model:
    """Return a model after verifying the tolerance `promise` at all frames."""
    error = largest_error(model, sequence, workers=workers)
    progress(1, 1, "checking")
    if error <= promise:
        return model
    missed = (
        f"{sequence.header.name!r}: a vertex of the most accurate model is off by {error:.3g} diagonals, more than "
        f"{promise:g}"
    )
    unit = bounding_diagonal(sequence.points[:1][0]) or 1.0
    away, largest = largest_offset(sequence.points), largest_coordinate(sequence.points)
    if promise * unit < rounding_error(away):  # wherever the sequence is
        raise SettingsError(
            f"{missed}: vertices get up to {away / unit:.3g} diagonals of the first frame away from it, beside which "
            "double precision has no digits for that; give a larger tolerance, or fit the frames that have grown or "
            "moved so far apart from the first ones"
        )
    if promise * unit < rounding_error(largest):
        raise SettingsError(
            f"{missed}: coordinates are up to {largest / unit:.3g} diagonals, beside which double precision has no "
            "digits for that; move the sequence to the origin, or give a larger tolerance"
        )
    raise ReconstructionError(f"{missed}; give a larger tolerance, or another space or placement")


def largest_error(
    model: Model,
    sequence: FrameStore | MeshSequence,
    stop: float = np.inf,
    workers: Executor | None = None,
) -> float:
    """Return the largest distance of a vertex at the frames, in diagonals."""
    unit = bounding_diagonal(sequence.points[:1][0]) or 1.0
    # Every 4th frame first, then those between: violations occur at many frames.
    frames = np.concatenate([np.arange(first, len(sequence.points), 4) for first in (0, 2, 1, 3)])
    largest, done = 0.0, 0
    size = min(FRAMES_PER_BLOCK, block_size(sequence.header.vertex_count))
    for block in model.blocks(model.times[frames], size, workers=workers):
        apart = block - sequence.points[frames[done : done + len(block)]]
        error = float(np.sqrt(np.einsum("tvi,tvi->tv", apart, apart).max())) / unit
        if not np.isfinite(error):
            return np.inf
        largest, done = max(largest, error), done + len(block)
        if largest > stop:
            break
    return largest
