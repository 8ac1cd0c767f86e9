"""Signals of an encoded sequence, with a given detail."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mixseq.arrays import Float, FloatArray, Index, evenly
from mixseq.choices import PoseForm
from mixseq.disk_array import LargeArray, new_large_array
from mixseq.errors import SettingsError
from mixseq.frame_store import FrameStore, blocks_of
from mixseq.geometry.rotations import continued
from mixseq.mapping import Executor, serially
from mixseq.prediction.operator import Operator, Rows, chosen, with_middles
from mixseq.prediction.poses import Poses
from mixseq.progress import Progress, silent
from mixseq.sequence import MeshSequence, SequenceHeader
from mixseq.signals.curve import Curve
from mixseq.signals.curve_fitting import Measure, fit_curve, largest, least_squares_curve
from mixseq.signals.key_shapes import choose_keys, key_map
from mixseq.signals.model import Model
from mixseq.signals.modes import Modes, principal_modes
from mixseq.signals.pose import PoseMap
from mixseq.spaces.base import ShapeSpace

OPERATOR_SAMPLES = 256
"""Number of vertices from which the temporal operator is chosen."""

SMALLEST_SCORE = 1e-200
"""Least scale of a mode's scores, in diagonals, for rounding."""

CORRECTION_STEP = 2.0**-24
"""Rounding step of corrections of exact models, which are zero at the frames, in diagonals and radians."""


class Between(NamedTuple):
    """Predictions at and between frames, interpolated by cubic splines."""

    times: Float  # (2T - 1,) frames and the middles between them, in seconds
    rows: Rows  # weights of the frames there
    quarters: Float  # (4T - 3,) frames and the quarters between them, in seconds
    targets: Float  # (4T - 3, ...) poses of parts as seen from their bodies, at the quarters
    placement: Float  # (4T - 3, P) placements at the quarters


@dataclass(frozen=True, eq=False)
class Encoded:
    """A sequence as vectors of a shape space."""

    header: SequenceHeader  # mesh and times
    space: ShapeSpace  # the space
    shapes: LargeArray  # (T, S) the vectors of the frames without their placement
    placement: Float  # (T, P) the placement
    # (T, C) coordinates of sampled vertices, used to select the temporal operator.
    samples: Float
    pose: PoseForm = "modes"  # form of the key shapes
    in_body: bool = False  # whether poses of parts are predicted as seen from their bodies, too

    @cached_property
    def operator(self) -> Operator:
        """Temporal operator that predicts the samples best."""
        return chosen(self.header.times, self.samples)

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
    def between(self) -> Between:
        """Predictions between the frames."""
        times = with_middles(self.header.times)
        quarters = with_middles(times)
        found = self.space.predicted_poses(self.operator, self.poses, self.placement, quarters, self.in_body)
        return Between(times, self.operator.at(times), quarters, *found)

    @cached_property
    def shape_measure(self) -> Measure:
        """Deviation of scores: root mean square over the vertices, in diagonals."""
        root = np.sqrt(self.header.vertex_count)
        return lambda scores: np.asarray(np.linalg.norm(scores, axis=1) / root)

    @cached_property
    def placement_measure(self) -> Measure:
        """Deviation of the placement: the largest coordinate, in diagonals."""
        return largest(self.space.weights[self.space.shape_dim :][: self.space.placement_dim])

    @cached_property
    def correction_measure(self) -> Measure:
        """Deviation of corrections: the largest coordinate, in diagonals."""
        return largest(self.space.weights[self.space.shape_dim + self.space.placement_dim :])


def encode(
    sequence: FrameStore | MeshSequence,
    space: ShapeSpace,
    pose: PoseForm = "modes",
    workers: Executor = serially,
    progress: Progress = silent,
) -> Encoded:
    """Encode all frames of a sequence in a space."""
    count, size = len(sequence.points), space.shape_dim
    placed = slice(size, size + space.placement_dim)
    shapes = new_large_array((count, size))
    placement = np.empty((count, space.placement_dim))
    some = evenly(sequence.header.vertex_count, OPERATOR_SAMPLES)
    samples = np.empty((count, 3 * len(some)))
    previous, done = None, 0
    for apart, sampled in workers(_encoded, (space, some), blocks_of(sequence.points)):
        vectors = space.unwrap(apart, previous)
        rows = slice(done, done + len(vectors))
        shapes[rows], placement[rows], samples[rows] = vectors[:, :size], vectors[:, placed], sampled
        previous, done = vectors[-1], rows.stop
        progress(done, count, "encoding frames")
    turns, centres = space.poses(placement)
    steady = space.placements(Poses(continued(turns), centres))  # what is interpolated in time must not jump
    held = space.held(samples.reshape(count, -1, 3), some, steady).reshape(count, -1)
    return Encoded(sequence.header, space, shapes, steady, held, pose)


def _encoded(shared: tuple[ShapeSpace, Index], points: FloatArray) -> tuple[Float, Float]:
    """Return vectors and samples of a block of frames, each frame independent of others."""
    space, vertices = shared
    samples = points[:, vertices].astype(np.float64)
    return space.encode_apart(points), samples.reshape(len(points), -1)


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


def build(encoded: Encoded, detail: Detail) -> Model:
    """Make the model of an encoded sequence."""
    times = encoded.header.times
    rank = _rank(encoded, detail)
    modes = encoded.modes.first(rank)
    if encoded.pose == "modes":
        pose, shapes = modes.pose_map(), modes.key_shapes()
    else:
        frames = choose_keys(modes.scores)
        pose = key_map(modes.scores[frames])
        shapes = encoded.shapes[frames]
    if detail.step:  # weights add up to one: so errors of the first key shape are not magnified
        steps = detail.step * encoded.space.coarseness
        shapes = _rounded(shapes[:1], steps) + _rounded(shapes - shapes[:1], steps)
    signals = Signals(encoded, pose, shapes[:, encoded.pose_columns])
    if detail.knots is not None:
        curves = signals.with_knots(modes.scores, _inner_knots(detail.knots, times))
    else:
        curves = signals.within(modes.scores, detail.slack, detail.step)
    return Model(encoded.header, encoded.space, curves[0], pose, shapes, *curves[1:])


@dataclass(frozen=True, eq=False)
class Signals:
    """Curves of a model at a level of detail."""

    encoded: Encoded  # the sequence
    pose: PoseMap  # from pose space to weights of the key shapes
    key_poses: Float  # (K, pose_dim) relative part poses of the key shapes

    def with_knots(self, scores: Float, inner: Float) -> tuple[Curve, Curve, Curve]:
        """Return curves of time, placement and correction with inner knots ``(n,)``."""
        encoded, times = self.encoded, self.encoded.header.times
        time = least_squares_curve(times, scores, inner)
        placement = least_squares_curve(times, encoded.placement, inner)
        parts, _ = encoded.space.predicted_poses(
            encoded.operator, encoded.poses, encoded.placement, times, in_body=False
        )
        return time, placement, least_squares_curve(times, self._corrections(time, times, parts), inner)

    def within(self, scores: Float, slack: float, step: float) -> tuple[Curve, Curve, Curve]:
        """Return curves of time, placement and correction within slack of frames and predictions, rounded."""
        encoded = self.encoded
        sites, rows, quarters, targets, placed = encoded.between
        # Scores of modes that hardly count are small, but lengths and angles, which weigh little, change with them.
        sizes = 2.0 ** np.floor(np.log2(np.maximum(np.abs(scores).max(axis=0), SMALLEST_SCORE)))
        time = _curve(sites, rows.of(scores), slack, encoded.shape_measure, step * sizes)
        placement = _curve(quarters, placed, slack, encoded.placement_measure, step)
        corrections = self._corrections(time, quarters, targets)
        if step and not slack:
            step = max(step, CORRECTION_STEP)
        return time, placement, _curve(quarters, corrections, slack, encoded.correction_measure, step)

    def _corrections(self, time: Curve, times: Float, targets: Float) -> Float:
        """Return the corrections ``(N, C)`` of blended shapes at times ``(N,)`` to part poses ``(N, ...)``."""
        blended = self.pose.weights(time(times)) @ self.key_poses
        return self.encoded.space.corrections(blended, targets)


def _curve(times: Float, values: Float, slack: float, measure: Measure, step: float | Float) -> Curve:
    curve = fit_curve(times, values, slack, measure) if slack > 0 else Curve(times, values)
    return Curve(curve.times, _rounded(curve.values, step)) if np.any(step) else curve


def _rounded(values: Float, step: float | Float) -> Float:
    """Round to multiples of a step, or of one per column."""
    return np.asarray(np.round(values / step) * step)


def _rank(encoded: Encoded, detail: Detail) -> int:
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


def _inner_knots(knots: int | ArrayLike, times: Float) -> Float:
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
