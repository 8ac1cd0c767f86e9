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

Ends = Literal["natural", "not-a-knot"]
"""End conditions: zero second derivatives, or one cubic through the first two intervals and the last two."""


def spline_weights(knots: Float, times: Float, ends: Ends) -> Float:
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


LENGTHS = (np.inf, 8.0, 5.6, 4.0, 2.8, 2.0, 1.4, 1.0)
"""Candidate lengths, in mean steps between frames."""

WINDOW = 48
"""Number of nearest frames with weights."""

LEFT_OUT = 96
"""Largest number of evenly spread frames that are left out."""

ROUNDING = 2.0**-30
"""Deviation from whole steps, in steps, below which frames are regularly spaced."""


@dataclass(frozen=True, eq=False)
class Rows:
    """Weights of frames at N times."""

    frames: Index  # (N, m) frames with a weight, in the order of time
    weights: Float  # (N, m) their weights; rows add up to one
    count: int  # number T of all frames

    def at(self, some: Index | slice) -> Rows:
        """Return the weights at some of the times."""
        return Rows(self.frames[some], self.weights[some], self.count)

    def of(self, values: Float) -> Float:
        """Return values ``(N, ...)`` of a quantity with values ``(T, ...)`` at the frames."""
        flat = values.reshape(self.count, -1)
        found = np.empty((len(self.frames), flat.shape[1]))
        for row, weights, frames in zip(found, self.weights, self.frames, strict=True):
            np.einsum("m,mc->c", weights, flat[frames], out=row)  # in order, for any number of threads
        return found.reshape(len(self.frames), *values.shape[1:])


@dataclass(frozen=True, eq=False)
class Operator:
    """The temporal operator of a sequence with increasing times ``(T,)``; made by `chosen`."""

    times: Float
    length: float = np.inf  # length of the covariance in mean steps, infinite for the natural cubic spline
    cubic: tuple[float, float] = (0.5, 0.5)  # shares of the usual cubic spline in the first and last interval

    def at(self, times: Float) -> Rows:
        """Return the weights of the frames at times ``(N,)``; at a frame its weight is one."""
        size = min(WINDOW, len(self.times))
        nearest = np.searchsorted(self.times, times) - size // 2
        starts = np.clip(nearest, 0, len(self.times) - size)
        frames = starts[:, None] + np.arange(size)
        return Rows(frames, self._weights(times, frames), len(self.times))

    def left_out(self, cubic: bool = False) -> tuple[Index, Rows]:
        """Return evenly spread inner frames ``(n,)``, and their weights of others, by kriging or the cubic spline."""
        inner = np.arange(1, len(self.times) - 1)
        left = inner[evenly_spaced(len(inner), LEFT_OUT)]
        size = min(WINDOW, len(self.times) - 1)
        starts = np.clip(left - size // 2, 0, len(self.times) - 1 - size)
        frames = starts[:, None] + np.arange(size)
        frames += frames >= left[:, None]
        return left, Rows(frames, self._solved(self.times[left], frames, cubic), len(self.times))

    def _weights(self, times: Float, frames: Index) -> Float:
        """Weights ``(N, m)`` of frames ``(N, m)`` at times ``(N,)``."""
        weights = self._solved(times, frames, cubic=False)
        inner = self.times[1:-1]
        if len(inner):
            for share, rows in zip(self.cubic, (times < inner[0], times > inner[-1]), strict=True):
                if share and rows.any():
                    usual = self._solved(times[rows], frames[rows], cubic=True)
                    weights[rows] = (1.0 - share) * weights[rows] + share * usual
        hit = self.times[frames] == times[:, None]
        known = hit.any(axis=1)
        weights[known] = hit[known]
        return weights

    def _solved(self, times: Float, frames: Index, cubic: bool) -> Float:
        """Weights ``(N, m)`` of frames ``(N, m)`` at times ``(N,)``, by kriging or by the usual cubic spline."""
        step = (self.times[-1] - self.times[0]) / max(len(self.times) - 1, 1) or 1.0
        weights = np.ones(frames.shape)
        if frames.shape[1] == 1:
            return weights
        firsts = self.times[frames[:, :1]]
        windows, systems = np.unique(
            _whole_where_nearly((self.times[frames] - firsts) / step), axis=0, return_inverse=True
        )
        wanted = (times - firsts[:, 0]) / step
        # Times that see frames at the same distances share a system: nearly all, if frames are evenly spaced.
        for system, knots in enumerate(windows):
            some = systems.reshape(-1) == system
            if cubic or np.isinf(self.length):
                weights[some] = spline_weights(knots, wanted[some], "not-a-knot" if cubic else "natural")
            else:
                weights[some] = _kriging(knots, wanted[some], self.length)
        return weights


def chosen(times: Float, samples: Float) -> Operator:
    """Choose the operator of a sequence: times ``(T,)``; samples ``(T, C)``."""
    if len(times) < 4:
        return Operator(times)

    def errors(length: float, cubic: bool = False) -> Float:
        left, rows = Operator(times, length).left_out(cubic)
        return np.asarray(np.square(rows.of(samples) - samples[left]).sum(axis=1))

    kriging = [errors(length) for length in LENGTHS]
    best = int(np.argmin([each.sum() for each in kriging]))
    usual = errors(np.inf, cubic=True)
    shares = []
    for end in (0, -1):
        ours, others = kriging[best][end] ** 2, usual[end] ** 2
        shares.append(float(ours / (ours + others)) if ours + others > 0 else 0.5)
    return Operator(times, LENGTHS[best], (shares[0], shares[1]))


def with_middles(times: Float) -> Float:
    """Return times ``(2T - 1,)`` with midpoints in between."""
    both = np.empty(2 * len(times) - 1)
    both[::2], both[1::2] = times, (times[:-1] + times[1:]) / 2
    return both


def _whole_where_nearly(knots: Float) -> Float:
    """Return knots ``(N, m)``, in steps from the first, with rows of nearly whole numbers rounded."""
    whole = np.rint(knots)
    nearly = (np.abs(knots - whole) <= ROUNDING).all(axis=1, keepdims=True)
    apart = (np.diff(whole, axis=1) > 0).all(axis=1, keepdims=True)
    return np.where(nearly & apart, whole, knots)


def _kriging(knots: Float, times: Float, length: float) -> Float:
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


NOTHING = 1e-12
"""Distance to 0 or 1 below which exponents of rotations are rounded."""


class Poses(NamedTuple):
    """Poses of p parts in T frames."""

    rotations: Float  # (T, p, 4) unit quaternions with continuous signs
    centres: Float  # (T, p, 3) where the parts' centres are


def predicted_alone(rows: Rows, poses: Poses) -> Poses:
    """Predict each pose independently: rotations chained, centres as weighted sums."""
    return Poses(chained(rows, poses.rotations), rows.of(poses.centres))


def chained(rows: Rows, rotations: Float) -> Float:
    """Return the rotations ``(N, p, 4)`` chained from those at the frames ``(T, p, 4)`` by weights."""
    exponents = np.cumsum(rows.weights[:, ::-1], axis=1)[:, ::-1]
    result = rotations[rows.frames[:, 0]]
    for place in range(1, rows.frames.shape[1]):
        exponent = exponents[:, place]
        before, here = rotations[rows.frames[:, place - 1]], rotations[rows.frames[:, place]]
        whole = np.abs(exponent - 1.0) < NOTHING
        result[whole] = here[whole]  # all that came before is whole, too
        some = ~whole & (np.abs(exponent) >= NOTHING)
        if some.any():
            step = quat_multiply(quat_conjugate(before[some]), here[some])
            result[some] = quat_multiply(result[some], quat_power(step, exponent[some, None]))
    return align_quat_signs(normalise_quat(result))
