r"""Exaggerate or damp a motion: scale relative poses and shapes of parts about their mean.

.. math:: c(t) \to \bar c + \text{gain}\, (c(t) - \bar c)

with the time signal c and its mean over the frames. In the mixed shape space a point of pose space is a pose of the
whole character, independent of its place. The correction is scaled in the same way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mixseq.arrays import Float
from mixseq.errors import SettingsError
from mixseq.public import public
from mixseq.signals.curve import Curve
from mixseq.signals.model import Model

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
