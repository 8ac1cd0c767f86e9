r"""Filters: remove the fastest changes of a motion, or exaggerate or damp it.

A smoothing spline f through values y minimises

.. math:: \int (y - f)^2\, dt + \lambda \int f''^2\, dt

and has the gain :math:`1 / (1 + \lambda \omega^4)` for a sine of angular frequency :math:`\omega`. A sine of period P
loses half its power for

.. math:: \lambda = (\sqrt 2 - 1)\, (P / 2 \pi)^4 .

Straight lines stay unchanged. Quaternions are smoothed relative to a steady rotation :math:`\exp(\omega t)\, R`, with
the mean angular velocity :math:`\omega`, so steady rotations stay unchanged, too.

Exaggeration scales the time signal c about its mean :math:`\bar c` over the frames,

.. math:: c(t) \to \bar c + \text{gain}\, (c(t) - \bar c)

and the correction in the same way. This changes relative poses and shapes of parts. In the mixed shape space, a point
of pose space is a pose of the whole character, independent of its position.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_smoothing_spline

from mixseq.errors import SettingsError
from mixseq.mesh.rotations import (
    matrix_to_rotvec,
    normalise_quat,
    quat_conjugate,
    quat_multiply,
    quat_to_matrix,
    rotvec_to_quat,
)
from mixseq.operations.sections import merge_sites, strictly_between
from mixseq.runtime.public import public
from mixseq.sequence.frame_rates import Seconds
from mixseq.signals.curve import Curve
from mixseq.signals.model import Model
from mixseq.spaces.base import ShapeSpace
from mixseq.spaces.temporal import Poses
from mixseq.types import Float

MAX_GAIN = 1000.0  # largest magnitude of a gain


@public
def exaggerate(model: Model, gain: float, modes: Sequence[int] | None = None) -> Model:
    """Exaggerate or damp the motion of a model.

    The time signal is scaled about its mean over the frames. Relative poses and shapes of parts change; the path of the
    body does not.

    Parameters
    ----------
    model : Model
        The motion.
    gain : float
        Factor: 1 keeps the motion, 0 freezes it at the mean, larger values exaggerate, values in between damp.
    modes : sequence of int, optional
        Coordinates of pose space to scale, counted from 0; by default all, and the correction. In a fitted model the
        coordinates are the modes, largest first.

    Raises
    ------
    SettingsError
        If the gain is out of range, or a mode does not exist.
    """
    check_gain(gain)
    count = model.time.dim
    scaled_modes = range(count) if modes is None else modes
    for mode in scaled_modes:
        if not 0 <= mode < count:
            raise SettingsError(f"there is no mode {mode}; the model has {count}, from 0 on")
    gains = np.ones(count)
    gains[list(scaled_modes)] = gain
    scaled = model.edited(time=_scale_about_mean(model, model.time, gains))
    if modes is not None:
        return scaled
    gains = np.full(model.correction.dim, gain)
    return scaled.edited(correction=_scale_about_mean(model, model.correction, gains))


def _scale_about_mean(model: Model, curve: Curve, gains: Float) -> Curve:
    """Scale the coordinates of a curve about their means over the frames of a model."""
    mean = curve(model.times).mean(axis=0)
    values = np.where(gains == 1.0, curve.values, mean + gains * (curve.values - mean))
    return Curve(curve.times, values)


def check_gain(gain: float) -> None:
    """Raise SettingsError if a gain is NaN or exceeds `MAX_GAIN` in magnitude."""
    if not abs(gain) <= MAX_GAIN:
        raise SettingsError(f"gain is {gain}; a number from -{MAX_GAIN:g} to {MAX_GAIN:g} is expected")


MIN_SMOOTHED_VALUES = 5  # smallest number of values that a smoothing spline can be fitted to
MAX_PERIOD_STEPS = 1e9  # upper limit of the period / 2 pi, in mean time steps; the result is a straight line there


@public
def smooth(model: Model, seconds: Seconds) -> Model:
    """Remove changes of time signal, placement and correction that are faster than a period.

    A sine of this period loses half its power. The gain is 0.13 at half the period and 0.97 at twice the period.
    Smoothing is weaker within about one period of the ends.

    Parameters
    ----------
    model : Model
        The motion.
    seconds : float
        The period in seconds.

    Raises
    ------
    SettingsError
        If the period is not positive, or the model has fewer than five frames and knots.
    """
    if not (np.isfinite(seconds) and seconds > 0):
        raise SettingsError(f"seconds is {seconds}; a positive period is expected")
    steady = SteadyRotation.fit(model.space, model.placement)
    return model.edited(
        time=smooth_curve(model.time, model.times, seconds),
        placement=smooth_curve(model.placement, model.times, seconds, steady),
        correction=smooth_curve(model.correction, model.times, seconds),
    )


@dataclass(frozen=True, eq=False)
class SteadyRotation:
    """Mean angular velocity of the r rotations of placements."""

    space: ShapeSpace  # the space of the placements
    rates: Float  # (r, 3) in radians per second

    @classmethod
    def fit(cls, space: ShapeSpace, placement: Curve) -> SteadyRotation:
        """Compute the mean angular velocity of a placement from the rotations between knots."""
        rotations = normalise_quat(space.unpack_placements(placement.values).rotations)
        turns = matrix_to_rotvec(quat_to_matrix(quat_multiply(rotations[1:], quat_conjugate(rotations[:-1]))))
        duration = placement.end - placement.start
        return cls(space, turns.sum(axis=0) / (duration if duration > 0 else 1.0))

    def apply(self, times: Float, placements: Float, sign: float) -> Float:
        """Add (sign 1) or remove (sign -1) the steady rotation in placements ``(N, P)`` at times ``(N,)``."""
        rotations, centres = self.space.unpack_placements(placements)
        steady = rotvec_to_quat(sign * times[:, None, None] * self.rates)
        return self.space.pack_placements(Poses(quat_multiply(steady, rotations), centres))


def smooth_curve(curve: Curve, frames: Float, seconds: float, steady: SteadyRotation | None = None) -> Curve:
    """Smooth the values of a curve at its knots and frames ``(T,)``, relative to a steady rotation if given."""
    ends = np.array([curve.start, curve.end])
    times = np.union1d(ends, strictly_between(np.concatenate([curve.times, frames]), *ends))
    min_step = 1e-6 * (ends[1] - ends[0]) / len(times)
    times = np.append(times[:-1][np.diff(times) > min_step], ends[1])
    if len(times) < MIN_SMOOTHED_VALUES:
        raise SettingsError(f"{len(times)} frames and knots; smoothing needs {MIN_SMOOTHED_VALUES} or more")
    if not curve.dim:
        return curve
    steps = np.diff(times)
    durations = (np.append(steps, 0.0) + np.append(0.0, steps)) / 2  # integration weight of each value, in seconds
    unit = float(steps.mean())  # unit of time, to keep digits
    strength = (np.sqrt(2.0) - 1.0) * min(seconds / unit / (2.0 * np.pi), MAX_PERIOD_STEPS) ** 4
    values = curve(times) if steady is None else steady.apply(times, curve(times), -1.0)
    line = _fit_line(times, values, durations)
    spline = make_smoothing_spline(times / unit, values - line(times), durations / unit, strength)
    sites = merge_sites(ends, times[1:-1])
    result = line(sites) + np.asarray(spline(sites / unit)).reshape(len(sites), curve.dim)
    return Curve(sites, result if steady is None else steady.apply(sites, result, 1.0))


def _fit_line(times: Float, values: Float, weights: Float) -> Curve:
    """Fit a line to values ``(N, k)``, the limit of strong smoothing, where solving for a spline would lose digits."""
    middle = np.average(times, weights=weights)
    mean = np.average(values, axis=0, weights=weights)
    moments = weights * (times - middle)
    slope = moments @ (values - mean) / (moments @ (times - middle))
    ends = times[[0, -1]]
    return Curve(ends, mean + (ends - middle)[:, None] * slope)
