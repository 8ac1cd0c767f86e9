"""More or less of a motion: coordinates of pose space scaled about their means."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mixseq.errors import SettingsError
from mixseq.signals.curve import Curve
from mixseq.signals.model import Model

LARGEST = 1000.0
"""Largest gain."""


def exaggerate(model: Model, gain: float, modes: Sequence[int] | None = None) -> Model:
    r"""Return the model with its change of shape exaggerated or damped.

    .. math:: c_i(t) \to \bar c_i + \text{gain}\, (c_i(t) - \bar c_i)

    with the mean over the frames. Where parts are does not change; `exaggerate_part` does that.
    The residual layer is kept.

    Parameters
    ----------
    model : Model
        The motion.
    gain : float
        1 changes nothing, 0 freezes the modes at their means, more than 1 exaggerates, less damps.
    modes : sequence of int, optional
        Coordinates of pose space, from 0 on: in a model that was fitted the modes, the largest first. All of them by
        default.

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
    mean = model.time(model.times).mean(axis=0)
    values = np.where(gains == 1.0, model.time.values, mean + gains * (model.time.values - mean))
    return replace(model, time=Curve(model.time.times, values))


def check_gain(gain: float) -> None:
    """Refuse what no motion survives."""
    if not abs(gain) <= LARGEST:
        raise SettingsError(f"gain is {gain}; a number is expected, at most {LARGEST:g} in size")
