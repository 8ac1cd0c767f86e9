r"""What a motion is without its fastest changes.

A smoothing spline f through values y minimises

.. math:: \int (y - f)^2\, dt + \lambda \int f''^2\, dt

and answers a sine of angular frequency :math:`\omega` with the gain :math:`1 / (1 + \lambda \omega^4)`. Its power is
halved at the period P for

.. math:: \lambda = (\sqrt 2 - 1)\, (P / 2 \pi)^4 .
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_smoothing_spline

from mixseq.errors import SettingsError
from mixseq.operations.pieces import between, sites_of
from mixseq.signals.curve import Curve
from mixseq.signals.model import Model

Float = NDArray[np.float64]

FEWEST = 5
"""Values that a smoothing spline needs."""

LONGEST = 1e9
"""Periods of more steps all leave a line."""


def smooth(model: Model, seconds: float) -> Model:
    """Return the model without changes that are faster than a period: all its signals, shape and placement.

    A sine of this period loses half its power. Of the amplitude, 0.13 are left at half the period, 0.97 at twice
    the period. Near the ends, over about a period, less is certain and less is smoothed.

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
    return replace(
        model,
        time=smoothed(model.time, model.times, seconds),
        placement=smoothed(model.placement, model.times, seconds),
        corrections=None,  # they would bring back some of what is smoothed
    )


def smoothed(curve: Curve, frames: Float, seconds: float) -> Curve:
    """Smooth a curve by what it is at its knots and at the frames ``(T,)``."""
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
    line, values = _line(times, curve(times), lasting), curve(times)
    spline = make_smoothing_spline(times / unit, values - line(times), lasting / unit, strength)
    sites = sites_of(ends, times[1:-1])
    return Curve(sites, line(sites) + np.asarray(spline(sites / unit)).reshape(len(sites), curve.dim))


def _line(times: Float, values: Float, weights: Float) -> Curve:
    """Return the line next to values: what smoothing leaves alone, and would lose digits of if it were strong."""
    middle = np.average(times, weights=weights)
    mean = np.average(values, axis=0, weights=weights)
    away = weights * (times - middle)
    slope = away @ (values - mean) / (away @ (times - middle))
    ends = times[[0, -1]]
    return Curve(ends, mean + (ends - middle)[:, None] * slope)
