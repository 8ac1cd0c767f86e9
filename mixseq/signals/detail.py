"""Compute the signals of an encoded sequence: within a tolerance, exactly, or with given numbers of modes and knots.

Key shapes are the mean and modes, or frames of the sequence. Curves have few knots, or one at (almost) every frame. A
search finds the coarsest signals within a given tolerance at all frames. If the finest signals exceed the tolerance, an
error is raised.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from hashlib import blake2b
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mixseq.errors import ReconstructionError, SettingsError
from mixseq.mesh.measures import element_blocks
from mixseq.mesh.rotations import align_quat_signs
from mixseq.mesh.topology import Topology
from mixseq.runtime.low_memory import LargeArray, new_large_array
from mixseq.runtime.parallel import Executor, serial_executor
from mixseq.runtime.progress import Progress, log_progress
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.sequence import (
    FrameStore,
    MeshSequence,
    block_size,
    iterate_blocks,
    largest_coordinate,
    largest_offset,
    rounding_error,
)
from mixseq.signals.curve import Curve
from mixseq.signals.decoding import FRAMES_PER_BLOCK
from mixseq.signals.model import Model
from mixseq.signals.pose import Modes, principal_modes
from mixseq.spaces.base import ShapeSpace
from mixseq.spaces.mixed.construction import faces_without_area
from mixseq.spaces.mixed.mixed_space import MixedSpace
from mixseq.spaces.temporal import FrameWeights, Poses, TemporalOperator, Timing, insert_midpoints
from mixseq.types import Float, FloatArray, Index, evenly_spaced

DeviationNorm = Callable[[Float], Float]
"""Function from deviations ``(T, k)`` of a curve to their norms ``(T,)``."""


def max_norm(weights: Float) -> DeviationNorm:
    """Return the maximum norm with weights ``(k,)``."""
    return lambda deviations: np.asarray(np.abs(deviations * weights).max(axis=1, initial=0.0))


def rms_over_vertices(count: int) -> DeviationNorm:
    """Return the norm of score deviations: the root mean square displacement over `count` vertices."""
    return lambda scores: np.asarray(np.linalg.norm(scores, axis=1) / np.sqrt(count))


def fit_curve(times: Float, values: Float, tolerance: float, norm: DeviationNorm) -> Curve:
    """Fit a curve with few knots to values ``(T, k)`` at times ``(T,)``, within a tolerance, with their breaks."""
    pieces = Curve(times, values).pieces
    if len(pieces) > 1:
        return Curve.from_pieces(fit_curve(piece.times, piece.values, tolerance, norm) for piece in pieces)
    candidate_count = max(len(times) - 4, 0)  # inner knots of the not-a-knot spline through all values
    knots = np.zeros(0, dtype=np.int64)
    while len(knots) < candidate_count:
        curve = least_squares_curve(times, values, times[knots])
        outside = np.flatnonzero(norm(curve(times) - values) > tolerance)
        if not len(outside):
            return curve
        ends = np.concatenate([[1], knots, [len(times) - 2]])
        intervals = np.unique(np.clip(np.searchsorted(ends, outside) - 1, 0, len(ends) - 2))
        low, high = ends[intervals], ends[intervals + 1]
        middles = ((low + high) // 2)[high - low > 1]
        if not len(middles):  # no frames between the knots around the violations
            break
        knots = np.union1d(knots, middles)
    return Curve(times, values)


def least_squares_curve(times: Float, values: Float, inner: Float) -> Curve:
    """Fit a curve with inner knots ``(n,)`` to values ``(T, k)`` at times ``(T,)`` by least squares."""
    from scipy.interpolate import make_lsq_spline  # slow import, unused by exact models

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


OPERATOR_VERTICES = 256  # number of vertices from which the temporal operator is selected
FRAMES_IN_BODY_AXES = 1024  # number of frames whose samples are brought into body axes together
MOTION_VERTICES = 64  # vertices by which breaks of speed, and slopes beside held frames, are selected
MIN_SCORE_SCALE = 1e-200  # least scale, in diagonals, of scores of a mode, to which their step is proportional
CORRECTION_STEP = 2.0**-24  # rounding step, in diagonals and radians, of corrections of exact models


class InterpolatedPoses(NamedTuple):
    """Poses interpolated in time, at the frames and between them."""

    times: Float  # (n,) frames and midpoints, in seconds, and twice the breaks
    weights: tuple[FrameWeights, ...]  # weights of the frames at these times, of every group
    quarter_times: Float  # (m,) frames and points at quarters of the intervals, in seconds, and twice the breaks
    part_poses: Poses  # (m, p) part poses in body axes, at the quarter points
    placement: Float  # (m, P) placements at the quarter points


@dataclass(frozen=True, eq=False)
class EncodedSequence:
    """A mesh sequence encoded as vectors of a shape space."""

    header: SequenceHeader  # mesh and times
    space: ShapeSpace  # shape space of the vectors
    shapes: LargeArray  # (T, S) shape part of the vectors of the frames
    placement: Float  # (T, P) placements of the frames, with continuous signs of quaternions
    # Of every group of components, the operator that interpolates sampled vertices with the least errors.
    operators: tuple[TemporalOperator, ...]
    group_of_vertex: Index  # (V,) groups of components with cuts and pops of their own

    @cached_property
    def poses(self) -> Float:
        """Part poses ``(T, pose_dim)`` of the frames."""
        poses = np.empty((len(self.shapes), self.space.pose_dim))
        for frame in range(len(poses) if self.space.pose_dim else 0):  # frame by frame, as shapes may be on disk
            poses[frame] = self.shapes[frame : frame + 1][0, self.pose_columns]
        return poses

    @property
    def pose_columns(self) -> slice:
        """Columns of the part poses in `shapes`."""
        return slice(self.space.shape_dim - self.space.pose_dim, self.space.shape_dim)

    @cached_property
    def modes(self) -> Modes:
        """All principal components of the shapes, of every group."""
        groups = self.space.group_coordinates(self.group_of_vertex) if self.group_of_vertex.any() else None
        return principal_modes(self.shapes, self.space.shape_weights, groups)

    @cached_property
    def interpolated(self) -> InterpolatedPoses:
        """Poses interpolated between the frames."""
        times = insert_midpoints(self.header.times)
        quarter_times = insert_midpoints(times)
        for operator in self.operators:
            times, quarter_times = map(operator.add_breaks, (times, quarter_times))
        weights = tuple(operator.weights_at(times) for operator in self.operators)
        return InterpolatedPoses(times, weights, quarter_times, *self.interpolate_poses(quarter_times))

    def interpolate_poses(self, times: Float) -> tuple[Poses, Float]:
        """Interpolate target part poses ``(N, p)`` and placements ``(N, P)`` at times ``(N,)``."""
        poses = [self.space.interpolate_poses(each, self.poses, self.placement, times) for each in self.operators]
        return self.space.merge_poses(poses, self.group_of_vertex) if len(poses) > 1 else poses[0]


def encode_sequence(
    sequence: FrameStore | MeshSequence,
    space: ShapeSpace,
    workers: Executor = serial_executor,
    progress: Progress = log_progress,
    timings: Sequence[Timing] = (Timing(),),
    group_of_vertex: Index | None = None,
) -> EncodedSequence:
    """Encode all frames of a sequence in a shape space; groups ``(V,)`` of components have a timing each."""
    count, size = len(sequence.points), space.shape_dim
    if group_of_vertex is None:
        group_of_vertex = np.zeros(sequence.header.vertex_count, dtype=np.int64)
    placement_columns = slice(size, size + space.placement_dim)
    shapes = new_large_array((count, size))
    raw_placement = np.empty((count, space.placement_dim))
    of_groups = (np.flatnonzero(group_of_vertex == number) for number in range(len(timings)))
    sampled = [ids[evenly_spaced(len(ids), OPERATOR_VERTICES)] for ids in of_groups]
    vertex_ids = np.concatenate(sampled)
    samples = np.empty((count, len(vertex_ids), 3))
    previous, done = None, 0
    for block, block_samples in workers(_encode_block, (space, vertex_ids), iterate_blocks(sequence.points)):
        vectors = space.unwrap(block, previous)
        rows = slice(done, done + len(vectors))
        shapes[rows], samples[rows] = vectors[:, :size], block_samples
        raw_placement[rows] = vectors[:, placement_columns]
        previous, done = vectors[-1], rows.stop
        progress(done, count, "encoding frames")
    rotations, centres = space.unpack_placements(raw_placement)
    placement = space.pack_placements(Poses(align_quat_signs(rotations), centres))  # signs continuous in time
    columns = np.split(np.arange(len(vertex_ids)), np.cumsum([len(ids) for ids in sampled])[:-1])
    motion_ids = [ids[evenly_spaced(len(ids), MOTION_VERTICES)] for ids in columns]
    motions = [samples[:, ids].reshape(count, -1) for ids in motion_ids]  # copies: samples become those of bodies
    for start in range(0, count, FRAMES_IN_BODY_AXES) if len(timings) == 1 else ():  # else bodies jump with a group
        rows = slice(start, start + FRAMES_IN_BODY_AXES)  # samples of few vertices are as large as the sequence
        samples[rows] = space.to_body_axes(samples[rows], vertex_ids, placement[rows])
    operators = tuple(
        timing.select_operator(sequence.header.times, samples[:, ids].reshape(count, -1), motion)
        for timing, ids, motion in zip(timings, columns, motions, strict=True)
    )
    return EncodedSequence(sequence.header, space, shapes, placement, operators, group_of_vertex)


def _encode_block(context: tuple[ShapeSpace, Index], points: FloatArray) -> tuple[Float, Float]:
    """Encode a block of frames independently of other frames; return vectors and coordinates of sampled vertices."""
    space, vertex_ids = context
    samples = points[:, vertex_ids].astype(np.float64)
    return space.encode_independently(points), samples


@dataclass(frozen=True)
class Detail:
    """Level of detail of the signals."""

    rank: int | None = None  # number of shape modes; by default determined by slack
    slack: float = 0.0  # largest deviation of the signals in diagonals, see `DeviationNorm`; zero for exact signals
    knots: int | ArrayLike | None = None  # inner knots of all curves; by default determined by slack
    step: float = 0.0  # rounding step of key shapes and curves, a power of two in diagonals; zero for no rounding


def build_model(encoded: EncodedSequence, detail: Detail) -> Model:
    """Make the model of an encoded sequence."""
    times = encoded.header.times
    rank = _choose_rank(encoded, detail)
    modes = encoded.modes.first(rank)
    pose, shapes = modes.pose_map(), modes.key_shapes()
    if detail.step:
        round_key_shapes(shapes, encoded.space, detail.step)
    key_poses = shapes[:, encoded.pose_columns]

    def corrections(time: Curve, times: Float, targets: Poses) -> Float:
        if len(encoded.header.times) <= 2:  # no inner frame to judge interpolation in time by: poses are blended
            return np.zeros((len(times), encoded.space.correction_dim))
        poses = np.empty((len(times), key_poses.shape[1]))
        for rows in element_blocks(len(times), len(shapes)):  # with the next time, as a break's times are together
            coordinates = time.on_both_sides(times[rows.start : rows.stop + 1])[: rows.stop - rows.start]
            poses[rows] = pose.weights(coordinates) @ key_poses
        return encoded.space.pose_corrections(poses, targets)

    if detail.knots is not None:
        curves = _fit_curves_with_knots(encoded, modes.scores, corrections, _inner_knots(detail.knots, times))
    else:
        curves = _fit_curves_within_slack(encoded, modes.scores, corrections, detail)
    return Model(encoded.header, encoded.space, curves[0], pose, shapes, *curves[1:])


def round_key_shapes(shapes: Float, space: ShapeSpace, step: float) -> None:
    """Round key shapes ``(K, S)`` in place, to a step in diagonals times the step ratios of the space.

    Weights add up to one, so that errors of the first key shape are not amplified.
    """
    steps = step * space.rounding_step_ratios
    for columns in element_blocks(len(steps), len(shapes)):
        block, ratios = shapes[:, columns], steps[columns]
        block[:] = _round(block[:1], ratios) + _round(block - block[:1], ratios)


def find_rounding_step(shapes: Float, space: ShapeSpace) -> float:
    """Return the largest power of two that key shapes ``(K, S)`` are rounded to, relative to the space's ratios."""
    mantissas, exponents = np.frexp(shapes[:, shapes.any(axis=0)] / space.rounding_step_ratios[shapes.any(axis=0)])
    digits = np.abs(mantissas * 2.0**53).astype(np.int64)
    lowest = np.log2(np.maximum(digits & -digits, 1)) - 53 + exponents
    return float(2.0 ** lowest[digits > 0].min(initial=0.0))


Corrections = Callable[[Curve, Float, Poses], Float]
"""Function from a time signal, times ``(N,)`` and target part poses ``(N, p)`` to corrections ``(N, C)``."""


def _fit_curves_with_knots(
    encoded: EncodedSequence, scores: Float, corrections: Corrections, inner: Float
) -> tuple[Curve, Curve, Curve]:
    """Fit the time, placement and correction curves with inner knots ``(n,)``."""
    times = encoded.header.times
    time = least_squares_curve(times, scores, inner)
    placement = least_squares_curve(times, encoded.placement, inner)
    part_poses, _ = encoded.interpolate_poses(times)
    return time, placement, least_squares_curve(times, corrections(time, times, part_poses), inner)


def _fit_curves_within_slack(
    encoded: EncodedSequence, scores: Float, corrections: Corrections, detail: Detail
) -> tuple[Curve, Curve, Curve]:
    """Fit rounded time, placement and correction curves that deviate from the interpolated poses within the slack."""
    slack, step, space = detail.slack, detail.step, encoded.space
    times, weights, quarter_times, part_poses, placements = encoded.interpolated
    # Scale the step by mode: faint modes also change lengths and angles, which have little weight in the metric.
    scales = 2.0 ** np.floor(np.log2(np.maximum(np.abs(scores).max(axis=0), MIN_SCORE_SCALE)))
    values = np.empty((len(times), scores.shape[1]))
    for number, of_group in enumerate(weights):
        mask = encoded.modes.groups[: scores.shape[1]] == number
        own_scores = scores if mask.all() else scores[:, mask]
        for rows in element_blocks(len(times), scores.shape[1]):  # curves of long sequences are larger than these
            values[rows][:, mask] = of_group.select(rows).interpolate(own_scores)
    score_norm = rms_over_vertices(encoded.header.vertex_count)
    time = _fit_rounded(times, values, slack, score_norm, step * scales, out=values)
    del values
    pose_weights = np.split(space.weights[space.shape_dim :], [space.placement_dim])
    placement_norm, correction_norm = map(max_norm, pose_weights)
    placement = _fit_rounded(quarter_times, placements, slack, placement_norm, step)
    rotations_and_shifts = corrections(time, quarter_times, part_poses)
    if step and not slack:
        step = max(step, CORRECTION_STEP)
    return time, placement, _fit_rounded(quarter_times, rotations_and_shifts, slack, correction_norm, step)


def _fit_rounded(
    times: Float, values: Float, slack: float, norm: DeviationNorm, step: float | Float, out: Float | None = None
) -> Curve:
    if slack > 0:
        curve = fit_curve(times, values, slack, norm)
        times, values, out = curve.times, curve.values, None
    return Curve(times, _round(values, step, out) if np.any(step) else values)


def _round(values: Float, step: float | Float, out: Float | None = None) -> Float:
    """Round values to multiples of a step, or of one step per column."""
    rounded = np.divide(values, step, out=out)
    np.round(rounded, out=rounded)
    rounded *= step
    return np.asarray(rounded)


def _choose_rank(encoded: EncodedSequence, detail: Detail) -> int:
    """Return the given number of modes, or the least number that reproduces all frames within the slack."""
    scores = encoded.modes.scores
    if detail.rank is not None:
        return min(detail.rank, len(encoded.modes.sizes))
    tails, rank = np.zeros(len(scores)), int(scores.shape[1])  # squared norms of the scores beyond the rank
    while rank:
        tails += np.square(scores[:, rank - 1])
        if np.sqrt(tails.max()) / np.sqrt(encoded.header.vertex_count) > detail.slack:
            break
        rank -= 1
    return rank


def _inner_knots(knots: int | ArrayLike, times: Float) -> Float:
    """Return inner knots ``(n,)`` from their number or times; raises `SettingsError` if they do not fit the frames."""
    max_count = max(len(times) - 4, 0)
    if isinstance(knots, int | np.integer):
        if not 0 <= knots <= max_count:
            raise SettingsError(f"knots is {knots}; {len(times)} frames allow 0 to {max_count} inner knots")
        if knots == max_count:
            return times[2:-2]
        positions = np.linspace(0, len(times) - 1, int(knots) + 2)[1:-1]
        return np.interp(positions, np.arange(len(times)), times)
    inner = np.unique(np.asarray(knots, dtype=np.float64).reshape(-1))
    if len(inner) > max_count:
        raise SettingsError(f"there are {len(inner)} inner knots; {len(times)} frames allow {max_count}")
    if inner.size and not (inner[0] > times[0] and inner[-1] < times[-1]):
        raise SettingsError(
            f"inner knots are from {inner[0]:g} to {inner[-1]:g} s; "
            f"they must be between {times[0]:g} and {times[-1]:g} s"
        )
    padded = np.concatenate([[times[0]] * 4, inner, [times[-1]] * 4])
    # Schoenberg-Whitney condition: the support of every basis function contains a frame.
    for k in range(1, len(inner) + 3):
        if not ((times > padded[k]) & (times < padded[k + 4])).any():
            time = padded[k + 2]
            raise SettingsError(f"there are no frames between the knots near {time:g} s; leave some out")
    return inner


VISUALLY_LOSSLESS_TOLERANCE = 5e-4  # in diagonals: half a pixel where the mesh fills 1000 pixels
EXACT_TOLERANCE = 1e-8  # tolerance of exact models in diagonals, which allows for rounding errors
EXACT_ROUNDING_STEP = 2.0**-38  # rounding step of exact models in diagonals; frames are off by about 1e-11
TOLERANCE_TO_STEP_RATIO = 64  # initial ratio of the tolerance to the rounding step of signals
SUFFICIENT_ERROR_RATIO = 0.6  # ratio of error to tolerance above which a model is accepted without further coarsening
MAX_TRIAL_MODELS = 7  # largest number of models in the search before the finest model is tried


def fit_within_tolerance(
    encoded: EncodedSequence,
    sequence: FrameStore | MeshSequence,
    tolerance: float,
    progress: Progress = log_progress,
    workers: Executor | None = None,
) -> Model:
    """Fit the coarsest signals that reproduce a sequence within a tolerance.

    The error of the frames increases irregularly with the slack of the signals. The slack is scaled by the measured
    error; after values both too small and too large, it is bisected.
    """
    low, high, slack = 0.0, np.inf, tolerance / 4
    best: Detail | None = None
    model: Model | None = None
    step = 2.0 ** np.floor(np.log2(tolerance / TOLERANCE_TO_STEP_RATIO))
    errors: dict[bytes, float] = {}  # by digest, because models of short sequences coincide
    tried = ""
    for trial in range(MAX_TRIAL_MODELS):
        progress(trial, MAX_TRIAL_MODELS, f"choosing modes and knots{tried}")
        model = None  # key shapes of two models may take as much memory as the frames
        detail = Detail(slack=slack, step=step)
        model = build_model(encoded, detail)
        digest = _digest(model)
        if digest not in errors:
            errors[digest] = largest_error(model, sequence, 2 * tolerance, workers)
        elif errors[digest] > tolerance:  # the model has all modes and knots already
            step /= 2
        error = errors[digest]
        tried = f", after {len(model.shapes)} key shapes at {error / tolerance:.2g} of the tolerance"
        if error <= tolerance:
            low, best = slack, detail
            is_sufficient = error > SUFFICIENT_ERROR_RATIO * tolerance
            if is_sufficient or len(model.shapes) == 1 or trial > MAX_TRIAL_MODELS // 2:
                progress(MAX_TRIAL_MODELS, MAX_TRIAL_MODELS, "choosing modes and knots")
                return model
        else:
            high = slack
        scaled = slack * float(np.clip(0.8 * tolerance / max(error, tolerance / 100), 0.1, 10.0))
        slack = scaled if low < scaled < high else float(np.sqrt(max(low, high / 100) * high))
    progress(MAX_TRIAL_MODELS, MAX_TRIAL_MODELS, "choosing modes and knots")
    model = None
    if best is not None:
        return build_model(encoded, best)
    finest = build_model(encoded, Detail(step=min(step, EXACT_ROUNDING_STEP)))
    return verify_tolerance(finest, sequence, tolerance, workers)


def _digest(model: Model) -> bytes:
    """Hash the curves of a model, to identify equal models of a sequence."""
    digest = blake2b()
    for curve in model.curves:
        digest.update(curve.times.data)
        digest.update(np.ascontiguousarray(curve.values).data)
    return digest.digest()


def verify_tolerance(
    model: Model,
    sequence: FrameStore | MeshSequence,
    tolerance: float,
    workers: Executor | None = None,
    progress: Progress = log_progress,
) -> Model:
    """Return a model if no vertex of any frame is off by more than a tolerance in diagonals; else raise an error."""
    error = largest_error(model, sequence, workers=workers)
    progress(1, 1, "checking")
    if error <= tolerance:
        return model
    message = (
        f"{sequence.header.name!r}: a vertex of the most accurate model is off by {error:.3g} diagonals, more than "
        f"{tolerance:g}"
    )
    unit = sequence.diagonal or 1.0
    offset, coordinate = largest_offset(sequence.points), largest_coordinate(sequence.points)
    if tolerance * unit < rounding_error(offset):  # offsets do not depend on the position of the sequence
        raise SettingsError(
            f"{message}: vertices move up to {offset / unit:.3g} diagonals away from the first frame, and double "
            "precision cannot resolve the tolerance at that distance; give a larger tolerance, or fit the frames that "
            "have grown or moved far away separately"
        )
    if tolerance * unit < rounding_error(coordinate):
        raise SettingsError(
            f"{message}: coordinates are up to {coordinate / unit:.3g} diagonals, and double precision cannot resolve "
            "the tolerance that far from the origin; move the sequence to the origin, or give a larger tolerance"
        )
    if isinstance(model.space, MixedSpace) and model.space.placement == "free":
        for frame, face in _collapsing_faces(model.space.topology, sequence.points):
            raise ReconstructionError(
                f"{message}: triangle {face} has no area in {sequence.header.frame_name(frame)}, where lengths and "
                "angles do not determine its vertices; give placement='anchored', or a larger tolerance"
            )
    raise ReconstructionError(f"{message}; give a larger tolerance, or another space or placement")


def _collapsing_faces(topology: Topology, points: LargeArray) -> Iterator[tuple[int, int]]:
    """Yield frames and faces that have no area in this frame of points ``(T, V, 3)``, but in others."""
    frames = [faces_without_area(topology, points[frame : frame + 1]) for frame in range(len(points))]
    for frame, is_collapsed in enumerate(frames):
        for face in np.flatnonzero(is_collapsed & ~np.all(frames, axis=0)):
            yield frame, int(face)


def largest_error(
    model: Model, sequence: FrameStore | MeshSequence, stop: float = np.inf, workers: Executor | None = None
) -> float:
    """Return the largest distance of decoded vertices from the frames, in diagonals; stop early above `stop`."""
    unit = sequence.diagonal or 1.0
    # Check every fourth frame first, then the frames between, because violations usually occur at many frames.
    frames = np.concatenate([np.arange(first, len(sequence.points), 4) for first in (0, 2, 1, 3)])
    largest, done = 0.0, 0
    size = min(FRAMES_PER_BLOCK, block_size(sequence.header.vertex_count))
    for block in model.blocks(model.times[frames], size, workers=workers):
        deviations = block - sequence.points[frames[done : done + len(block)]]
        error = float(np.sqrt(np.einsum("tvi,tvi->tv", deviations, deviations).max())) / unit
        if not np.isfinite(error):
            return np.inf
        largest, done = max(largest, error), done + len(block)
        if largest > stop:
            break
        del block, deviations  # as large as the next block
    return largest
