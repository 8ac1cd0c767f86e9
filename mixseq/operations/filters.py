r"""Filters: remove the fastest changes of a motion, or exaggerate or damp it.

A smoothing spline f through values y minimises

.. math:: \int (y - f)^2\, dt + \lambda \int f''^2\, dt

and has the gain :math:`1 / (1 + \lambda \omega^4)` for a sine of angular frequency :math:`\omega`. Its power is halved
at the period P for

.. math:: \lambda = (\sqrt 2 - 1)\, (P / 2 \pi)^4 .

Lines stay unchanged. Their counterpart for rotations is a steady rotation, :math:`\exp(\omega t)\, R`, with the mean
:math:`\omega` of angular velocities: quaternions are smoothed relative to it.

Relative poses and shapes of parts are exaggerated about their mean,

.. math:: c(t) \to \bar c + \text{gain}\, (c(t) - \bar c)

with the time signal c and its mean over the frames. In the mixed shape space a point of pose space is a pose of the
whole character, independent of its place. The correction is scaled in the same way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

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

MAX_GAIN = 1000.0
"""Largest magnitude of a gain."""


@public
def exaggerate(model: Model, gain: float, modes: Sequence[int] | None = None) -> Model:
    """Exaggerate or damp the motion of a model.

    The time signal is scaled about its mean over the frames. The path of the body stays; relative poses and shapes of
    its parts change. The residual layer is kept.

    Parameters
    ----------
    model : Model
        The motion.
    gain : float
        1 keeps the motion, 0 freezes it at the mean, more than 1 exaggerates, less damps.
    modes : sequence of int, optional
        Scale only these coordinates of pose space, from 0 on, and no correction. In a fitted model they are the modes,
        largest first.

    Raises
    ------
    SettingsError
        If the gain is not finite, or there is no such mode.
    """
    check_gain(gain)
    count = model.time.dim
    scaled_modes = range(count) if modes is None else modes
    for mode in scaled_modes:
        if not 0 <= mode < count:
            raise SettingsError(f"there is no mode {mode}; the model has {count}, from 0 on")
    gains = np.ones(count)
    gains[list(scaled_modes)] = gain
    scaled = replace(model, time=_scale_about_mean(model, model.time, gains))
    if modes is not None:
        return scaled
    gains = np.full(model.correction.dim, gain)
    return replace(scaled, correction=_scale_about_mean(model, model.correction, gains))


def _scale_about_mean(model: Model, curve: Curve, gains: Float) -> Curve:
    """Scale the coordinates of a curve about their means over the frames of a model."""
    mean = curve(model.times).mean(axis=0)
    values = np.where(gains == 1.0, curve.values, mean + gains * (curve.values - mean))
    return Curve(curve.times, values)


def check_gain(gain: float) -> None:
    """Raise SettingsError for gains above `MAX_GAIN` in magnitude, or NaN."""
    if not abs(gain) <= MAX_GAIN:
        raise SettingsError(f"gain is {gain}; a number from -{MAX_GAIN:g} to {MAX_GAIN:g} is expected")


MIN_SMOOTHED_VALUES = 5
"""Smallest number of values of a smoothing spline."""

MAX_PERIOD_STEPS = 1e9
"""Period, in mean steps of time, beyond which the result is a line."""


@public
def smooth(model: Model, seconds: Seconds) -> Model:
    """Remove changes of time signal, placement and correction that are faster than a period.

    A sine of this period loses half its power. At half the period 0.13 of the amplitude are left, at twice the period
    0.97. Within about a period of the ends smoothing is weaker. The residual layer is left out.

    Parameters
    ----------
    model : Model
        The motion.
    seconds : float
        The period.

    Raises
    ------
    SettingsError
        If the period is not positive, or the model has fewer than five frames and knots.
    """
    if not (np.isfinite(seconds) and seconds > 0):
        raise SettingsError(f"seconds is {seconds}; a positive period is expected")
    return model.with_motion(
        smooth_curve(model.time, model.times, seconds),
        smooth_curve(model.placement, model.times, seconds, SteadyRotation.fit(model.space, model.placement)),
        smooth_curve(model.correction, model.times, seconds),
    )


@dataclass(frozen=True, eq=False)
class SteadyRotation:
    """Mean angular velocity of the r rotations of placements."""

    space: ShapeSpace  # the space of the placements
    rates: Float  # (r, 3) in radians per second

    @classmethod
    def fit(cls, space: ShapeSpace, placement: Curve) -> SteadyRotation:
        """Fit the mean angular velocity to a placement, from knot to knot."""
        rotations = normalise_quat(space.unpack_placements(placement.values).rotations)
        turns = matrix_to_rotvec(quat_to_matrix(quat_multiply(rotations[1:], quat_conjugate(rotations[:-1]))))
        duration = placement.end - placement.start
        return cls(space, turns.sum(axis=0) / (duration if duration > 0 else 1.0))

    def apply(self, times: Float, placements: Float, sign: float) -> Float:
        """Add the steady rotation to placements ``(N, P)`` at times ``(N,)``, or remove it with the sign -1."""
        rotations, centres = self.space.unpack_placements(placements)
        steady = rotvec_to_quat(sign * times[:, None, None] * self.rates)
        return self.space.pack_placements(Poses(quat_multiply(steady, rotations), centres))


def smooth_curve(curve: Curve, frames: Float, seconds: float, steady: SteadyRotation | None = None) -> Curve:
    """Smooth a curve by its values at knots and frames ``(T,)``; a placement relative to a steady rotation."""
    ends = np.array([curve.start, curve.end])
    times = np.union1d(ends, strictly_between(np.concatenate([curve.times, frames]), *ends))
    min_step = 1e-6 * (ends[1] - ends[0]) / len(times)
    times = np.append(times[:-1][np.diff(times) > min_step], ends[1])
    if len(times) < MIN_SMOOTHED_VALUES:
        raise SettingsError(f"{len(times)} frames and knots; smoothing needs {MIN_SMOOTHED_VALUES} or more")
    if not curve.dim:
        return curve
    steps = np.diff(times)
    durations = (np.append(steps, 0.0) + np.append(0.0, steps)) / 2  # seconds of each value in the integral
    unit = float(steps.mean())  # of time, to keep digits
    strength = (np.sqrt(2.0) - 1.0) * min(seconds / unit / (2.0 * np.pi), MAX_PERIOD_STEPS) ** 4
    values = curve(times) if steady is None else steady.apply(times, curve(times), -1.0)
    line = _fit_line(times, values, durations)
    spline = make_smoothing_spline(times / unit, values - line(times), durations / unit, strength)
    sites = merge_sites(ends, times[1:-1])
    result = line(sites) + np.asarray(spline(sites / unit)).reshape(len(sites), curve.dim)
    return Curve(sites, result if steady is None else steady.apply(sites, result, 1.0))


def _fit_line(times: Float, values: Float, weights: Float) -> Curve:
    """Fit a line to values ``(N, k)``: it is invariant to smoothing, and strong smoothing would lose its digits."""
    middle = np.average(times, weights=weights)
    mean = np.average(values, axis=0, weights=weights)
    moments = weights * (times - middle)
    slope = moments @ (values - mean) / (moments @ (times - middle))
    ends = times[[0, -1]]
    return Curve(ends, mean + (ends - middle)[:, None] * slope)
