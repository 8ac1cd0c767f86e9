r"""Interpolate in time by weights of the frames, selected by cross-validation, by pieces, and blend poses by them.

A quantity y with values :math:`y_k` at the frames is :math:`y(t) = \sum_k w_k(t)\, y_k` with :math:`\sum_k w_k = 1`.
The weights result from kriging with a linear trend and the covariance (Matern, smoothness 3/2)

.. math:: k(d) = (1 + \sqrt 3\, d / \ell)\, e^{-\sqrt 3\, d / \ell}

of frames at a distance d, in mean steps between frames. Kriging interpolates the frames; for large length scales
:math:`\ell` it tends to the natural cubic spline. Short scales prevent overshooting between sparse frames. The scale
minimises the squared errors of leave-one-out cross-validation. Only the nearest `WINDOW_FRAMES` frames have weights.

Natural ends suit a continuing motion, but not one that starts from rest. In the first and the last interval, the
not-a-knot spline has the share :math:`e^4 / (e^4 + e_\text{cubic}^4)`. The errors e of both splines are leave-one-out
errors at the frame next to that end.

*Splines.* With second derivatives :math:`m_i` at knots that are :math:`h_i` apart, the spline through :math:`y_i` has

.. math:: h_{i-1} m_{i-1} + 2 (h_{i-1} + h_i) m_i + h_i m_{i+1} = 6\, (s_i - s_{i-1}), \qquad
   s_i = (y_{i+1} - y_i) / h_i

at inner knots, and between two knots, with :math:`b = (t - t_i) / h_i` and :math:`a = 1 - b`, the value
:math:`a y_i + b y_{i+1} + h_i^2 / 6\, ((a^3 - a) m_i + (b^3 - b) m_{i+1})`, linear in the values.

*Pieces.* Between cuts, holds, repeated poses and keys, every piece has an operator of its own. Neighbouring pieces
either share a frame or meet between two frames, where the motion jumps. At a cut, the motion goes on straight for half
an interval on both sides; elsewhere it waits.

A piece y may have a given slope :math:`s` at an end, which again is a weighted sum of frames. The natural spline z is
then corrected by the spline g that is zero at all frames, and has the slope 1 at this end and 0 at the other:

.. math:: y(t) = z(t) + (s - z') \, g(t)

- Beside held frames, s is a share :math:`a^4 / (a^4 + b^4)` of the natural slope. The errors a and b are those with
  which pieces of slope zero and of natural slope predict the frame next to the end from the others.
- Where velocities u and v of neighbouring intervals differ by `SPEED_RATIO`, and the acceleration is not that of a
  smooth turn, :math:`s = (u |v| + v |u|) / (|u| + |v|)`, which is bounded by twice the slower velocity.

*Poses.* Centres are weighted sums. Rotations are chained: with :math:`c_k = \sum_{j \ge k} w_j`,

.. math:: R(t) = R_0 \prod_{k \ge 1} \bigl(R_{k-1}^T R_k\bigr)^{c_k(t)},

which interpolates the frames without a chart, so that bodies may spin.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from mixseq.choices import BetweenName
from mixseq.mesh.rotations import align_quat_signs, normalise_quat
from mixseq.sequence.events import Events
from mixseq.types import Float, Index, Mask, evenly_spaced

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

EndCondition = Literal["natural", "not-a-knot"]
"""End conditions: zero second derivatives, or one cubic through the first two intervals and the last two."""


def spline_weights(knots: Float, times: Float, ends: EndCondition) -> Float:
    """Return the weights ``(N, m)`` of values at two or more knots ``(m,)`` in the cubic spline at times ``(N,)``."""
    steps = np.diff(knots)
    system, right = np.diag(np.ones(len(knots))), np.zeros((len(knots), len(knots)))
    inner = np.arange(1, len(knots) - 1)
    for offset, entries in ((-1, steps[:-1]), (0, 2 * (steps[:-1] + steps[1:])), (1, steps[1:])):
        system[inner, inner + offset] = entries
    right[inner] = 6 * np.diff(np.diff(np.eye(len(knots)), axis=0) / steps[:, None], axis=0)
    if ends == "not-a-knot" and len(knots) > 3:
        system[0, :3] = steps[1], -steps[0] - steps[1], steps[0]
        system[-1, -3:] = steps[-1], -steps[-1] - steps[-2], steps[-2]
    elif ends == "not-a-knot" and len(knots) == 3:  # the spline is a parabola
        system[0, 1] = system[-1, -2] = -1.0
    m = np.linalg.solve(system, right)

    interval = np.clip(np.searchsorted(knots, times, side="right") - 1, 0, len(steps) - 1)
    h, b = steps[interval], (times - knots[interval]) / steps[interval]
    a = 1 - b
    weights = (a**3 - a)[:, None] * m[interval] + (b**3 - b)[:, None] * m[interval + 1]
    weights *= h[:, None] ** 2 / 6
    rows = np.arange(len(times))
    weights[rows, interval] += a
    weights[rows, interval + 1] += b
    return np.asarray(weights)


CANDIDATE_LENGTH_SCALES = (np.inf, 8.0, 5.6, 4.0, 2.8, 2.0, 1.4, 1.0)
"""Candidates for the length scale of the covariance, in mean steps between frames."""

WINDOW_FRAMES = 48  # number of nearest frames with weights
MAX_LEFT_OUT_FRAMES = 96  # largest number of evenly spread frames in cross-validation
REGULAR_SPACING_TOLERANCE = 2.0**-30  # deviation from whole steps, in steps, below which frames are regularly spaced


@dataclass(frozen=True, eq=False)
class FrameWeights:
    """Weights of frames at N times."""

    frame_ids: Index  # (N, m) frames with a weight, ascending
    weights: Float  # (N, m) their weights; rows add up to one
    frame_count: int  # number T of all frames

    def select(self, ids: Index | slice) -> FrameWeights:
        """Return the weights at selected times."""
        return FrameWeights(self.frame_ids[ids], self.weights[ids], self.frame_count)

    def interpolate(self, values: Float) -> Float:
        """Return weighted sums ``(N, ...)`` of values ``(T, ...)`` at the frames."""
        flat = values.reshape(self.frame_count, -1)
        result = np.empty((len(self.frame_ids), flat.shape[1]))
        for row, weights, frame_ids in zip(result, self.weights, self.frame_ids, strict=True):
            np.einsum("m,mc->c", weights, flat[frame_ids], out=row)  # the order of the sum is independent of threads
        return result.reshape(len(self.frame_ids), *values.shape[1:])


@dataclass(frozen=True, eq=False)
class TemporalOperator:
    """Temporal interpolation of a sequence with increasing times ``(T,)``; made by `select_operator`."""

    times: Float
    length_scale: float = np.inf  # length scale in mean steps; infinite for the natural cubic spline
    cubic_shares: tuple[float, float] = (0.5, 0.5)  # shares of the not-a-knot spline in the first and last interval

    def weights_at(self, times: Float) -> FrameWeights:
        """Return the weights of the frames at times ``(N,)``; a frame has the weight one at its own time."""
        size = min(WINDOW_FRAMES, len(self.times))
        starts = np.clip(np.searchsorted(self.times, times) - size // 2, 0, len(self.times) - size)
        frame_ids = starts[:, None] + np.arange(size)
        weights = self._solve(times, frame_ids, cubic=False)
        inner = self.times[1:-1]
        if len(inner):
            for share, outer in zip(self.cubic_shares, (times < inner[0], times > inner[-1]), strict=True):
                if share and outer.any():
                    cubic = self._solve(times[outer], frame_ids[outer], cubic=True)
                    weights[outer] = (1.0 - share) * weights[outer] + share * cubic
        at_frame = self.times[frame_ids] == times[:, None]
        is_frame = at_frame.any(axis=1)
        weights[is_frame] = at_frame[is_frame]
        return FrameWeights(frame_ids, weights, len(self.times))

    def add_breaks(self, times: Float) -> Float:
        """Return times ``(N,)`` with those at which the motion breaks, twice; this operator has none."""
        return times

    def leave_one_out(self, cubic: bool = False) -> tuple[Index, FrameWeights]:
        """Return evenly spread inner frames ``(n,)``, and the weights of the other frames at their times."""
        inner = np.arange(1, len(self.times) - 1)
        left_out = inner[evenly_spaced(len(inner), MAX_LEFT_OUT_FRAMES)]
        size = min(WINDOW_FRAMES, len(self.times) - 1)
        starts = np.clip(left_out - size // 2, 0, len(self.times) - 1 - size)
        frame_ids = starts[:, None] + np.arange(size)
        frame_ids += frame_ids >= left_out[:, None]
        weights = self._solve(self.times[left_out], frame_ids, cubic)
        return left_out, FrameWeights(frame_ids, weights, len(self.times))

    def _solve(self, times: Float, frame_ids: Index, cubic: bool) -> Float:
        """Weights ``(N, m)`` of frames ``(N, m)`` at times ``(N,)``, by kriging or by the not-a-knot spline."""
        step = (self.times[-1] - self.times[0]) / max(len(self.times) - 1, 1) or 1.0
        weights = np.ones(frame_ids.shape)
        if frame_ids.shape[1] == 1:
            return weights
        firsts = self.times[frame_ids[:, :1]]
        knots = _snap_regular_knots((self.times[frame_ids] - firsts) / step)
        windows, window_ids = np.unique(knots, axis=0, return_inverse=True)
        offsets = (times - firsts[:, 0]) / step
        # Windows with the same knots share a linear system; if frames are evenly spaced, nearly all windows do.
        for number, window in enumerate(windows):
            mask = window_ids.reshape(-1) == number
            if cubic or np.isinf(self.length_scale):
                weights[mask] = spline_weights(window, offsets[mask], "not-a-knot" if cubic else "natural")
            else:
                weights[mask] = _kriging_weights(window, offsets[mask], self.length_scale)
        return weights


def select_operator(times: Float, samples: Float) -> TemporalOperator:
    """Select the operator with the least leave-one-out errors: times ``(T,)``; samples ``(T, C)``."""
    if len(times) < 4:
        return TemporalOperator(times)

    def squared_errors(length_scale: float, cubic: bool = False) -> Float:
        left_out, weights = TemporalOperator(times, length_scale).leave_one_out(cubic)
        return np.asarray(np.square(weights.interpolate(samples) - samples[left_out]).sum(axis=1))

    kriging = [squared_errors(length_scale) for length_scale in CANDIDATE_LENGTH_SCALES]
    best = int(np.argmin([errors.sum() for errors in kriging]))
    cubic = squared_errors(np.inf, cubic=True)
    shares = []
    for end in (0, -1):
        e4, e4_cubic = kriging[best][end] ** 2, cubic[end] ** 2
        shares.append(float(e4 / (e4 + e4_cubic)) if e4 + e4_cubic > 0 else 0.5)
    return TemporalOperator(times, CANDIDATE_LENGTH_SCALES[best], (shares[0], shares[1]))


def insert_midpoints(times: Float) -> Float:
    """Return times ``(2T - 1,)`` with the midpoints between neighbours."""
    result = np.empty(2 * len(times) - 1)
    result[::2], result[1::2] = times, (times[:-1] + times[1:]) / 2
    return result


def _snap_regular_knots(knots: Float) -> Float:
    """Return knots ``(N, m)``, in steps from the first, with rows of nearly whole numbers rounded."""
    whole = np.rint(knots)
    is_regular = (np.abs(knots - whole) <= REGULAR_SPACING_TOLERANCE).all(axis=1, keepdims=True)
    is_increasing = (np.diff(whole, axis=1) > 0).all(axis=1, keepdims=True)
    return np.where(is_regular & is_increasing, whole, knots)


def _kriging_weights(knots: Float, times: Float, length_scale: float) -> Float:
    def covariance(distances: Float) -> Float:
        scaled = np.sqrt(3.0) * np.abs(distances) / length_scale
        return np.asarray((1.0 + scaled) * np.exp(-scaled))

    def trend(at: Float) -> Float:
        return np.stack([np.ones(len(at)), (at - knots.mean()) / len(knots)], axis=1)

    count = len(knots)
    system = np.zeros((count + 2, count + 2))
    system[:count, :count] = covariance(knots[:, None] - knots)
    system[:count, count:] = trend(knots)
    system[count:, :count] = system[:count, count:].T
    right = np.concatenate([covariance(times[:, None] - knots), trend(times)], axis=1)
    return np.asarray(np.linalg.solve(system, right.T).T[:, :count])


SPEED_RATIO = 6.0  # ratio of velocities, or durations, beside a frame above which motion is not smooth across it
SHARED_ACCELERATION = 0.25  # similarity of accelerations at a frame and beside it of a smooth turn
SLOPE_FRAMES = 12  # number of frames by which the slope beside held frames is selected
HOLD_FRACTION = 0.999  # fraction of an interval after which `hold` shows the next frame, early enough for rounding


class Slope(NamedTuple):
    """A slope as a weighted sum of frames."""

    frame_ids: Index  # (m,) consecutive frames
    weights: Float  # (m,) per second


@dataclass(frozen=True, eq=False)
class TemporalPiece:
    """Consecutive frames that are interpolated by themselves."""

    operator: TemporalOperator  # of the frames of the piece
    first: int  # first frame of the piece
    slopes: tuple[Slope | None, Slope | None]  # slopes at both ends; None if free
    is_straight: tuple[bool, bool]  # whether the motion goes on straight beyond both ends

    def weights_at(self, times: Float, width: int, frame_count: int) -> tuple[Index, Float]:
        """Return the first of `width` consecutive frames ``(N,)`` at times ``(N,)``, and their weights."""
        knots = self.operator.times
        own = self.operator.weights_at(np.clip(times, knots[0], knots[-1]))
        starts, weights = self._embed(own, width, frame_count)
        for end, slope in enumerate(self.slopes):
            if slope is not None:
                rows = np.flatnonzero(own.frame_ids[:, -end] == (len(knots) - 1) * end)
                bump = self._bump(end)(np.clip(times[rows], knots[0], knots[-1]))
                natural = natural_slope(self.operator, end)
                for ids, change in (slope, Slope(natural.frame_ids + self.first, -natural.weights)):
                    columns = ids - starts[rows, None]
                    np.add.at(weights, (rows[:, None], columns), bump[:, None] * change)
        for end, sign in ((0, 1), (-1, -1)):
            if self.is_straight[end] and len(knots) > 1:
                rows = np.flatnonzero(sign * (times - knots[end]) < 0)
                step = sign * (times[rows] - knots[end]) / abs(knots[end + sign] - knots[end])
                frame = self.first + (len(knots) - 1) * -end
                weights[rows, frame - starts[rows]] -= step
                weights[rows, frame + sign - starts[rows]] += step
        return starts, weights

    def leave_one_out(self, width: int, frame_count: int) -> tuple[Index, Index, Float]:
        """Return left-out frames, and the `weights_at` their times without them; slopes are free."""
        frame_ids, own = self.operator.leave_one_out()
        return frame_ids + self.first, *self._embed(own, width, frame_count)

    def _embed(self, own: FrameWeights, width: int, frame_count: int) -> tuple[Index, Float]:
        frame_ids = own.frame_ids + self.first
        starts = np.clip(frame_ids[:, 0] - 1, 0, frame_count - width)  # slopes may involve the frame before
        weights = np.zeros((len(starts), width))
        np.put_along_axis(weights, frame_ids - starts[:, None], own.weights, axis=1)
        return starts, weights

    def _bump(self, end: int) -> CubicSpline:
        """Return the spline g of an end, 0 or 1."""
        from scipy.interpolate import CubicSpline

        conditions: Any = [(2, 0.0) if slope is None else (1, 0.0) for slope in self.slopes]
        conditions[end] = (1, 1.0)
        return CubicSpline(self.operator.times, np.zeros(len(self.operator.times)), bc_type=tuple(conditions))


@dataclass(frozen=True, eq=False)
class PiecewiseOperator(TemporalOperator):
    """Temporal interpolation by two or more pieces; made by `Timing.select_operator`."""

    pieces: tuple[TemporalPiece, ...] = ()
    edges: tuple[float, ...] = ()  # times, one less than pieces, at which the next piece begins

    @cached_property
    def _width(self) -> int:
        longest = max(len(piece.operator.times) for piece in self.pieces)
        return min(min(WINDOW_FRAMES, longest) + 2, len(self.times))

    def add_breaks(self, times: Float) -> Float:
        """Return increasing times with every edge twice: the end of a piece and the start of the next."""
        edges = np.array(self.edges)
        return np.sort(np.concatenate([times[~np.isin(times, edges)], edges, edges]))

    def weights_at(self, times: Float) -> FrameWeights:
        """Return the weights of the frames at times ``(N,)``; of an edge given twice, first of the piece before it."""
        piece_ids = np.searchsorted(self.edges, times, side="right")
        is_first = np.append(times[:-1] == times[1:], False)
        piece_ids[is_first] = np.searchsorted(self.edges, times[is_first], side="left")
        starts = np.zeros(len(times), dtype=np.int64)
        weights = np.zeros((len(times), self._width))
        for number in np.unique(piece_ids):
            mask = piece_ids == number
            starts[mask], weights[mask] = self.pieces[number].weights_at(times[mask], self._width, len(self.times))
        return FrameWeights(starts[:, None] + np.arange(self._width), weights, len(self.times))

    def leave_one_out(self, cubic: bool = False) -> tuple[Index, FrameWeights]:
        """Return evenly spread frames ``(n,)`` inside pieces, and the weights of the others at their times."""
        found = [p.leave_one_out(self._width, len(self.times)) for p in self.pieces if len(p.operator.times) > 2]
        if not found:
            return super().leave_one_out(cubic)
        left_out, starts, weights = map(np.concatenate, zip(*found, strict=True))
        ids = evenly_spaced(len(left_out), MAX_LEFT_OUT_FRAMES)
        frame_ids = starts[ids, None] + np.arange(self._width)
        return left_out[ids], FrameWeights(frame_ids, weights[ids], len(self.times))


def natural_slope(operator: TemporalOperator, end: int) -> Slope:
    """Return the slope of a natural spline at its first (0) or last (1) frame."""
    knots = operator.times[:2] if end == 0 else operator.times[:-3:-1]
    own = operator.weights_at(np.array([knots[0], knots[0] + (knots[1] - knots[0]) / 2, knots[1]]))
    size = own.frame_ids.shape[1]
    start = (len(operator.times) - size) * end  # there, all three times have this window
    at_end, middle, beside = (_window(own, row, start, size) for row in range(3))
    # The curvature is zero at the end: y = y_end + s x + c x^3.
    weights = (8 * (middle - at_end) - (beside - at_end)) / (3 * (knots[1] - knots[0]))
    return Slope(np.arange(start, start + size), weights)


def _window(own: FrameWeights, row: int, start: int, size: int) -> Float:
    """Return the weights ``(size,)`` of a row for the frames from `start` on."""
    weights = np.zeros(size)
    weights[own.frame_ids[row] - start] = own.weights[row]
    return weights


@dataclass(frozen=True)
class Timing:
    """Events of a sequence, or of a group of components, and the motion between its frames."""

    events: Events = Events()  # noqa: RUF009 - frozen
    between: BetweenName = "auto"

    def select_operator(self, times: Float, samples: Float, motion: Float) -> TemporalOperator:
        """Select the operator of frames at times ``(T,)``; without events, it is that of `select_operator`.

        Length scales are selected by samples ``(T, C)`` in body axes, slopes by motion ``(T, C')`` in world axes.
        """
        count, events, between = len(times), self.events, self.between
        repeats = [pose - 1 for pose in events.poses if pose] if between == "auto" else []
        waits = set(range(count - 1)) if between == "hold" else {*events.pops, *repeats}
        jumps = sorted(waits | set(events.cuts))
        corners = {*events.keys} if between == "auto" else set(range(count)) if between == "linear" else set()
        fraction = HOLD_FRACTION if between == "hold" else 0.5
        is_flat = np.zeros(count - 1, dtype=bool)
        for first, last in events.holds:
            is_flat[first:last] = True
        pieces: list[TemporalPiece] = []
        edges: list[float] = []
        for before, after in zip([-1, *jumps], [*jumps, count - 1], strict=True):
            first, last = before + 1, after
            own = slice(first, last + 1)
            if first:
                edges.append(float(times[before] + fraction * (times[first] - times[before])))
            is_straight = before >= 0 and before not in waits, after < count - 1 and after not in waits
            inner = {corner - first for corner in corners if first < corner < last}
            section = _split(times[own], samples[own], motion[own], is_flat[first:last], inner, first, is_straight)
            edges += [float(piece.operator.times[0]) for piece in section[1:]]
            pieces += section
        if len(pieces) == 1:
            return select_operator(times, samples)
        return PiecewiseOperator(times, pieces=tuple(pieces), edges=tuple(edges))


def _split(
    times: Float,
    samples: Float,
    motion: Float,
    is_flat: Mask,
    corners: set[int],
    first: int,
    is_straight: tuple[bool, bool],
) -> list[TemporalPiece]:
    """Split the frames between two jumps into pieces that share their frames at corners, holds and breaks of speed."""
    count, operator = len(times), select_operator(times, samples)
    durations = np.diff(times)[:, None]
    velocities = np.diff(motion, axis=0) / durations
    speeds = np.linalg.norm(velocities, axis=1)
    slopes: dict[int, Slope | None] = dict.fromkeys(corners)
    for k in range(1, count - 1):
        is_jerk = max(speeds[k - 1 : k + 1]) > SPEED_RATIO * min(speeds[k - 1 : k + 1])
        if is_flat[k - 1] != is_flat[k]:
            slopes[k] = None
        elif not is_flat[k] and k not in corners and is_jerk and not _is_turn(k, velocities, durations[:, 0]):
            slopes[k] = _bounded_slope(k, speeds, durations[:, 0], first)
    bounds = [0, *sorted(slopes), count - 1] if count > 1 else [0, 0]
    pieces = []
    for a, b in pairwise(bounds):
        ends: list[Slope | None] = [slopes.get(a), slopes.get(b)]
        own = slice(a, b + 1)
        if b > a and not is_flat[a]:
            if a and is_flat[a - 1]:
                weights = _slope_at_rest(times[own], motion[own])
                ends[0] = Slope(np.arange(first + a, first + a + len(weights)), weights)
            if b < count - 1 and is_flat[b]:
                weights = -_slope_at_rest(-times[own][::-1], motion[own][::-1])[::-1]
                ends[1] = Slope(np.arange(first + b + 1 - len(weights), first + b + 1), weights)
        shares = (operator.cubic_shares[0] * (a == 0), operator.cubic_shares[1] * (b == count - 1))
        piece = replace(operator, times=times[own], cubic_shares=shares)
        if any(end is not None for end in ends):
            piece = replace(piece, length_scale=np.inf)
        straight = is_straight[0] and a == 0, is_straight[1] and b == count - 1
        pieces.append(TemporalPiece(piece, first + a, (ends[0], ends[1]), straight))
    return pieces


def _bounded_slope(k: int, speeds: Float, durations: Float, first: int) -> Slope:
    """Return the slope at frame k, which is bounded by the velocities beside it."""
    before, after = speeds[[k, k - 1]] / max(speeds[k - 1] + speeds[k], np.finfo(float).tiny) / durations[[k - 1, k]]
    return Slope(np.arange(first + k - 1, first + k + 2), np.array([-before, before - after, after]))


def _is_turn(k: int, velocities: Float, durations: Float) -> bool:
    """Whether the acceleration at frame k is shared by the frames beside it, or is the only one."""
    if max(durations[k - 1 : k + 1]) > SPEED_RATIO * min(durations[k - 1 : k + 1]):
        return False

    def acceleration(j: int) -> Float:
        return np.asarray((velocities[j] - velocities[j - 1]) / (durations[j - 1] + durations[j]))

    own = acceleration(k)
    beside = [acceleration(j) for j in (k - 1, k + 1) if 1 <= j < len(velocities)]
    size = float(np.linalg.norm(own))
    similarities = [own @ each / (size * max(size, float(np.linalg.norm(each)))) for each in beside]
    return not similarities or float(np.mean(similarities)) >= SHARED_ACCELERATION


def _slope_at_rest(times: Float, motion: Float) -> Float:
    """Return weights ``(m,)`` of the slope at the first of frames ``(n, C)``, before which the motion is held."""
    if len(times) < 4:
        return np.zeros(1)
    times, motion = times[:SLOPE_FRAMES], motion[:SLOPE_FRAMES]
    others = np.delete(np.arange(len(times)), 1)
    operator, free = TemporalOperator(times[others], cubic_shares=(0.0, 0.0)), (None, None)
    errors = []
    for slopes in ((Slope(others[:1], np.zeros(1)), None), free):
        piece = TemporalPiece(operator, 0, slopes, (False, False))
        weights = piece.weights_at(times[1:2], len(others), len(others))[1]
        errors.append(float(np.linalg.norm(weights[0] @ motion[others] - motion[1])))
    e4, e4_free = errors[0] ** 4, errors[1] ** 4
    share = e4 / (e4 + e4_free) if e4 + e4_free > 0 else 0.0
    return share * natural_slope(TemporalOperator(times, cubic_shares=(0.0, 0.0)), 0).weights


class Poses(NamedTuple):
    """Poses of p parts in T frames."""

    rotations: Float  # (T, p, 4) unit quaternions with continuous signs
    centres: Float  # (T, p, 3) centres of the parts


def interpolate_poses(weights: FrameWeights, poses: Poses) -> Poses:
    """Interpolate each pose independently, by chained rotations and weighted sums of centres."""
    return Poses(chain_rotations(weights, poses.rotations), weights.interpolate(poses.centres))


def chain_rotations(weights: FrameWeights, rotations: Float) -> Float:
    """Return the rotations ``(N, p, 4)`` chained from the rotations at the frames ``(T, p, 4)``."""
    from mixseq.spaces.mixed.posing_kernels import multiply_powers

    exponents = np.ascontiguousarray(np.cumsum(weights.weights[:, ::-1], axis=1)[:, ::-1])
    result = np.empty((len(exponents), *rotations.shape[1:]))
    multiply_powers(np.require(rotations, np.float64, ["C", "W"]), weights.frame_ids, exponents, result)
    return align_quat_signs(normalise_quat(result))
