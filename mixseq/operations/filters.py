r"""Filters: remove the fastest changes of a motion, or exaggerate or damp it.

A smoothing spline f through values y minimises

.. math:: \int (y - f)^2\, dt + \lambda \int f''^2\, dt

and answers a sine of angular frequency :math:`\omega` with the gain :math:`1 / (1 + \lambda \omega^4)`. Its power is
halved at the period P for

.. math:: \lambda = (\sqrt 2 - 1)\, (P / 2 \pi)^4 .

Lines stay unchanged. Their counterpart for rotations is a steady turn, :math:`\exp(\omega t)\, R`, with the mean
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
from mixseq.mesh.rotations import exponentials, inverse, normalised, product, rotations_of, vectors
from mixseq.operations.sections import between, sites_of
from mixseq.runtime.public import public
from mixseq.sequence.frame_rates import Seconds
from mixseq.signals.curve import Curve
from mixseq.signals.model import Model
from mixseq.spaces.base import ShapeSpace
from mixseq.spaces.temporal import Poses
from mixseq.types import Float

LARGEST_GAIN = 1000.0
"""Largest gain."""


@public
def exaggerate(model: Model, gain: float, modes: Sequence[int] | None = None) -> Model:
    """Return the model with its motion exaggerated or damped.

    The time signal is scaled about its mean over the frames. The path of the body stays; relative poses and shapes of
    its parts change. The residual layer is kept.

    Parameters
    ----------
    model : Model
        The motion.
    gain : float
        1 changes nothing, 0 freezes all at the mean, more than 1 exaggerates, less damps.
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
    wanted = range(count) if modes is None else modes
    for mode in wanted:
        if not 0 <= mode < count:
            raise SettingsError(f"there is no mode {mode}; the model has {count}, from 0 on")
    gains = np.ones(count)
    gains[list(wanted)] = gain
    scaled = replace(model, time=_scaled(model, model.time, gains))
    if modes is not None:
        return scaled
    return replace(scaled, correction=_scaled(model, model.correction, np.full(model.correction.dim, gain)))


def _scaled(model: Model, curve: Curve, gains: Float) -> Curve:
    """Return a curve with its coordinates scaled about their means over the frames of a model."""
    mean = curve(model.times).mean(axis=0)
    values = np.where(gains == 1.0, curve.values, mean + gains * (curve.values - mean))
    return Curve(curve.times, values)


def check_gain(gain: float) -> None:
    """Raise SettingsError for gains above `LARGEST_GAIN` in size, or not a number."""
    if not abs(gain) <= LARGEST_GAIN:
        raise SettingsError(f"gain is {gain}; a number is expected, at most {LARGEST_GAIN:g} in size")


FEWEST = 5
"""Smallest number of values of a smoothing spline."""

LONGEST = 1e9
"""Largest period in mean steps; beyond it only a line is left."""


@public
def smooth(model: Model, seconds: Seconds) -> Model:
    """Return the model without changes that are faster than a period: time, placement and correction.

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
        If the period is not positive, or the model has less than five frames and knots.
    """
    if not (np.isfinite(seconds) and seconds > 0):
        raise SettingsError(f"seconds is {seconds}; a positive period is expected")
    return model.with_motion(
        smoothed(model.time, model.times, seconds),
        smoothed(model.placement, model.times, seconds, SteadyTurn.of(model.space, model.placement)),
        smoothed(model.correction, model.times, seconds),
    )


@dataclass(frozen=True, eq=False)
class SteadyTurn:
    """Mean turning of the r rotations of placements."""

    space: ShapeSpace  # the space of the placements
    rates: Float  # (r, 3) mean angular velocities, in radians per second

    @classmethod
    def of(cls, space: ShapeSpace, placement: Curve) -> SteadyTurn:
        """Fit the mean angular velocity to a placement, from knot to knot."""
        turns = normalised(space.unpack_placements(placement.values).rotations)
        steps = vectors(rotations_of(product(turns[1:], inverse(turns[:-1]))))
        lasting = placement.end - placement.start
        return cls(space, steps.sum(axis=0) / (lasting if lasting > 0 else 1.0))

    def turned(self, times: Float, placements: Float, sign: float) -> Float:
        """Add the steady turn to placements ``(N, P)`` at times ``(N,)``, or remove it with the sign -1."""
        turns, centres = self.space.unpack_placements(placements)
        steady = exponentials(sign * times[:, None, None] * self.rates)
        return self.space.pack_placements(Poses(product(steady, turns), centres))


def smoothed(curve: Curve, frames: Float, seconds: float, steady: SteadyTurn | None = None) -> Curve:
    """Smooth a curve by its values at knots and frames ``(T,)``; a placement relative to a steady turn."""
    ends = np.array([curve.start, curve.end])
    inner = np.concatenate([curve.times, frames])
    times = np.union1d(ends, between(inner, *ends))
    close = 1e-6 * (ends[1] - ends[0]) / len(times)
    times = np.append(times[:-1][np.diff(times) > close], ends[1])
    if len(times) < FEWEST:
        raise SettingsError(f"{len(times)} frames and knots cannot be smoothed; {FEWEST} or more are needed")
    if not curve.dim:
        return curve
    steps = np.diff(times)
    lasting = (np.append(steps, 0.0) + np.append(0.0, steps)) / 2  # seconds that every value stands for
    # The unit of time is the mean step, for the sake of the digits.
    unit = float(steps.mean())
    strength = (np.sqrt(2.0) - 1.0) * min(seconds / unit / (2.0 * np.pi), LONGEST) ** 4
    values = curve(times) if steady is None else steady.turned(times, curve(times), -1.0)
    line = _line(times, values, lasting)
    spline = make_smoothing_spline(times / unit, values - line(times), lasting / unit, strength)
    sites = sites_of(ends, times[1:-1])
    result = line(sites) + np.asarray(spline(sites / unit)).reshape(len(sites), curve.dim)
    return Curve(sites, result if steady is None else steady.turned(sites, result, 1.0))


def _line(times: Float, values: Float, weights: Float) -> Curve:
    """Fit a line to values ``(N, k)``: it is invariant to smoothing, and strong smoothing would lose its digits."""
    middle = np.average(times, weights=weights)
    mean = np.average(values, axis=0, weights=weights)
    away = weights * (times - middle)
    slope = away @ (values - mean) / (away @ (times - middle))
    ends = times[[0, -1]]
    return Curve(ends, mean + (ends - middle)[:, None] * slope)
