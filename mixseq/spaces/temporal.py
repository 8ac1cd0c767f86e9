r"""Interpolation in time: weights of the frames at any time, chosen by leaving frames out, and poses by them.

A quantity y at a time t is predicted from the frames, :math:`y(t) = \sum_k w_k(t)\, y_k` with
:math:`\sum_k w_k = 1`: kriging with a linear trend and the covariance (Matern, smoothness 3/2)

.. math:: k(d) = (1 + \sqrt 3\, d / \ell)\, e^{-\sqrt 3\, d / \ell}

of frames at a distance d, in mean steps between frames. It interpolates the frames, and is the cubic spline with
natural ends in the limit of large lengths :math:`\ell`. Shorter ones keep it from overshooting where frames are sparse.
Every inner frame is predicted from the others; the length with the smallest sum of squared errors is taken. Distant
frames have negligible weights: only the nearest `WINDOW` frames are used.

Natural ends are straight, which suits a motion that goes on, but not one that starts from rest. So in the first and the
last interval the usual cubic spline, which is one cubic there, has the share :math:`e^4 / (e^4 + e_\text{cubic}^4)`, by
the errors e with which kriging, and it, predict the frame next to that end when that is left out.

*Splines.* With second derivatives :math:`m_i` at knots that are :math:`h_i` apart, the spline through :math:`y_i` has

.. math:: h_{i-1} m_{i-1} + 2 (h_{i-1} + h_i) m_i + h_i m_{i+1} = 6\, (s_i - s_{i-1}), \qquad
   s_i = (y_{i+1} - y_i) / h_i

at inner knots, and between two of them, with :math:`b = (t - t_i) / h_i` and :math:`a = 1 - b`, the value
:math:`a y_i + b y_{i+1} + h_i^2 / 6\, ((a^3 - a) m_i + (b^3 - b) m_{i+1})`, linear in the values. Numpy suffices for
few knots: importing scipy's splines takes longer than decoding a frame.

*Poses.* Centres are weighted sums. Rotations are chained: with :math:`c_k = \sum_{j \ge k} w_j`,

.. math:: R(t) = R_0 \prod_{k \ge 1} \bigl(R_{k-1}^T R_k\bigr)^{c_k(t)},

which interpolates the frames without a chart: a body may spin.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from mixseq.mesh.rotations import align_quat_signs, normalise_quat, quat_conjugate, quat_multiply, quat_power
from mixseq.types import Float, Index, evenly_spaced

EndCondition = Literal["natural", "not-a-knot"]
"""End conditions: zero second derivatives, or one cubic through the first two intervals and the last two."""


def spline_weights(knots: Float, times: Float, ends: EndCondition) -> Float:
    """Return the weights ``(N, m)`` of values at two or more knots ``(m,)`` in the spline at times ``(N,)``."""
    steps = np.diff(knots)
    system, right = np.diag(np.ones(len(knots))), np.zeros((len(knots), len(knots)))
    inner = np.arange(1, len(knots) - 1)
    for offset, entries in ((-1, steps[:-1]), (0, 2 * (steps[:-1] + steps[1:])), (1, steps[1:])):
        system[inner, inner + offset] = entries
    right[inner] = 6 * np.diff(np.diff(np.eye(len(knots)), axis=0) / steps[:, None], axis=0)
    if ends == "not-a-knot" and len(knots) > 3:
        system[0, :3] = steps[1], -steps[0] - steps[1], steps[0]
        system[-1, -3:] = steps[-1], -steps[-1] - steps[-2], steps[-2]
    elif ends == "not-a-knot" and len(knots) == 3:  # both conditions are the same: it is a parabola
        system[0, 1] = system[-1, -2] = -1.0
    bends = np.linalg.solve(system, right)

    left = np.clip(np.searchsorted(knots, times, side="right") - 1, 0, len(steps) - 1)
    width, after = steps[left], (times - knots[left]) / steps[left]
    before = 1 - after
    weights = (before**3 - before)[:, None] * bends[left] + (after**3 - after)[:, None] * bends[left + 1]
    weights *= width[:, None] ** 2 / 6
    rows = np.arange(len(times))
    weights[rows, left] += before
    weights[rows, left + 1] += after
    return np.asarray(weights)


CANDIDATE_LENGTH_SCALES = (np.inf, 8.0, 5.6, 4.0, 2.8, 2.0, 1.4, 1.0)
"""Candidate lengths, in mean steps between frames."""

WINDOW_FRAMES = 48
"""Number of nearest frames with weights."""

MAX_LEFT_OUT_FRAMES = 96
"""Largest number of evenly spread frames that are left out."""

REGULAR_SPACING_TOLERANCE = 2.0**-30
"""Deviation from whole steps, in steps, below which frames are regularly spaced."""


@dataclass(frozen=True, eq=False)
class FrameWeights:
    """Weights of frames at N times."""

    frame_ids: Index  # (N, m) frames with a weight, in the order of time
    weights: Float  # (N, m) their weights; rows add up to one
    frame_count: int  # number T of all frames

    def select(self, some: Index | slice) -> FrameWeights:
        """Return the weights at some of the times."""
        return FrameWeights(self.frame_ids[some], self.weights[some], self.frame_count)

    def interpolate(self, values: Float) -> Float:
        """Return values ``(N, ...)`` of a quantity with values ``(T, ...)`` at the frames."""
        flat = values.reshape(self.frame_count, -1)
        found = np.empty((len(self.frame_ids), flat.shape[1]))
        for row, weights, frames in zip(found, self.weights, self.frame_ids, strict=True):
            np.einsum("m,mc->c", weights, flat[frames], out=row)  # in order, for any number of threads
        return found.reshape(len(self.frame_ids), *values.shape[1:])


@dataclass(frozen=True, eq=False)
class TemporalOperator:
    """The temporal operator of a sequence with increasing times ``(T,)``; made by `chosen`."""

    times: Float
    length_scale: float = (
        np.inf
    )  # length of the covariance in mean steps, infinite for the natural cubic spline
    cubic_shares: tuple[float, float] = (
        0.5,
        0.5,
    )  # shares of the usual cubic spline in the first and last interval

    def weights_at(self, times: Float) -> FrameWeights:
        """Return the weights of the frames at times ``(N,)``; at a frame its weight is one."""
        size = min(WINDOW_FRAMES, len(self.times))
        nearest = np.searchsorted(self.times, times) - size // 2
        starts = np.clip(nearest, 0, len(self.times) - size)
        frames = starts[:, None] + np.arange(size)
        return FrameWeights(frames, self._weights(times, frames), len(self.times))

    def leave_one_out(self, cubic: bool = False) -> tuple[Index, FrameWeights]:
        """Return evenly spread inner frames ``(n,)``, and their weights of others, by kriging or the cubic spline."""
        inner = np.arange(1, len(self.times) - 1)
        left = inner[evenly_spaced(len(inner), MAX_LEFT_OUT_FRAMES)]
        size = min(WINDOW_FRAMES, len(self.times) - 1)
        starts = np.clip(left - size // 2, 0, len(self.times) - 1 - size)
        frames = starts[:, None] + np.arange(size)
        frames += frames >= left[:, None]
        return left, FrameWeights(frames, self._solve(self.times[left], frames, cubic), len(self.times))

    def _weights(self, times: Float, frames: Index) -> Float:
        """Weights ``(N, m)`` of frames ``(N, m)`` at times ``(N,)``."""
        weights = self._solve(times, frames, cubic=False)
        inner = self.times[1:-1]
        if len(inner):
            for share, rows in zip(self.cubic_shares, (times < inner[0], times > inner[-1]), strict=True):
                if share and rows.any():
                    usual = self._solve(times[rows], frames[rows], cubic=True)
                    weights[rows] = (1.0 - share) * weights[rows] + share * usual
        hit = self.times[frames] == times[:, None]
        known = hit.any(axis=1)
        weights[known] = hit[known]
        return weights

    def _solve(self, times: Float, frames: Index, cubic: bool) -> Float:
        """Weights ``(N, m)`` of frames ``(N, m)`` at times ``(N,)``, by kriging or by the usual cubic spline."""
        step = (self.times[-1] - self.times[0]) / max(len(self.times) - 1, 1) or 1.0
        weights = np.ones(frames.shape)
        if frames.shape[1] == 1:
            return weights
        firsts = self.times[frames[:, :1]]
        windows, systems = np.unique(
            _snap_regular_knots((self.times[frames] - firsts) / step), axis=0, return_inverse=True
        )
        wanted = (times - firsts[:, 0]) / step
        # Times that see frames at the same distances share a system: nearly all, if frames are evenly spaced.
        for system, knots in enumerate(windows):
            some = systems.reshape(-1) == system
            if cubic or np.isinf(self.length_scale):
                weights[some] = spline_weights(knots, wanted[some], "not-a-knot" if cubic else "natural")
            else:
                weights[some] = _kriging_weights(knots, wanted[some], self.length_scale)
        return weights


def select_operator(times: Float, samples: Float) -> TemporalOperator:
    """Choose the operator of a sequence: times ``(T,)``; samples ``(T, C)``."""
    if len(times) < 4:
        return TemporalOperator(times)

    def errors(length: float, cubic: bool = False) -> Float:
        left, rows = TemporalOperator(times, length).leave_one_out(cubic)
        return np.asarray(np.square(rows.interpolate(samples) - samples[left]).sum(axis=1))

    kriging = [errors(length) for length in CANDIDATE_LENGTH_SCALES]
    best = int(np.argmin([each.sum() for each in kriging]))
    usual = errors(np.inf, cubic=True)
    shares = []
    for end in (0, -1):
        ours, others = kriging[best][end] ** 2, usual[end] ** 2
        shares.append(float(ours / (ours + others)) if ours + others > 0 else 0.5)
    return TemporalOperator(times, CANDIDATE_LENGTH_SCALES[best], (shares[0], shares[1]))


def insert_midpoints(times: Float) -> Float:
    """Return times ``(2T - 1,)`` with midpoints in between."""
    both = np.empty(2 * len(times) - 1)
    both[::2], both[1::2] = times, (times[:-1] + times[1:]) / 2
    return both


def _snap_regular_knots(knots: Float) -> Float:
    """Return knots ``(N, m)``, in steps from the first, with rows of nearly whole numbers rounded."""
    whole = np.rint(knots)
    nearly = (np.abs(knots - whole) <= REGULAR_SPACING_TOLERANCE).all(axis=1, keepdims=True)
    apart = (np.diff(whole, axis=1) > 0).all(axis=1, keepdims=True)
    return np.where(nearly & apart, whole, knots)


def _kriging_weights(knots: Float, times: Float, length: float) -> Float:
    def covariance(distances: Float) -> Float:
        scaled = np.sqrt(3.0) * np.abs(distances) / length
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


EXPONENT_TOLERANCE = 1e-12
"""Distance to 0 or 1 below which exponents of rotations are rounded."""


class Poses(NamedTuple):
    """Poses of p parts in T frames."""

    rotations: Float  # (T, p, 4) unit quaternions with continuous signs
    centres: Float  # (T, p, 3) where the parts' centres are


def interpolate_poses(rows: FrameWeights, poses: Poses) -> Poses:
    """Predict each pose independently: rotations chained, centres as weighted sums."""
    return Poses(chain_rotations(rows, poses.rotations), rows.interpolate(poses.centres))


def chain_rotations(rows: FrameWeights, rotations: Float) -> Float:
    """Return the rotations ``(N, p, 4)`` chained from those at the frames ``(T, p, 4)`` by weights."""
    exponents = np.cumsum(rows.weights[:, ::-1], axis=1)[:, ::-1]
    result = rotations[rows.frame_ids[:, 0]]
    for place in range(1, rows.frame_ids.shape[1]):
        exponent = exponents[:, place]
        before, here = rotations[rows.frame_ids[:, place - 1]], rotations[rows.frame_ids[:, place]]
        whole = np.abs(exponent - 1.0) < EXPONENT_TOLERANCE
        result[whole] = here[whole]  # all that came before is whole, too
        some = ~whole & (np.abs(exponent) >= EXPONENT_TOLERANCE)
        if some.any():
            step = quat_multiply(quat_conjugate(before[some]), here[some])
            result[some] = quat_multiply(result[some], quat_power(step, exponent[some, None]))
    return align_quat_signs(normalise_quat(result))
