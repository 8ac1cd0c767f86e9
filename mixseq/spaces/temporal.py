r"""Interpolate in time by weights of the frames, selected by cross-validation, and blend poses by these weights.

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

*Poses.* Centres are weighted sums. Rotations are chained: with :math:`c_k = \sum_{j \ge k} w_j`,

.. math:: R(t) = R_0 \prod_{k \ge 1} \bigl(R_{k-1}^T R_k\bigr)^{c_k(t)},

which interpolates the frames without a chart, so that bodies may spin.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from mixseq.mesh.rotations import align_quat_signs, normalise_quat
from mixseq.types import Float, Index, evenly_spaced

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
