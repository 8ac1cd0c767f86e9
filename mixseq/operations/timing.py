"""Earlier or later, faster or slower, backwards: affine maps of time. Frames move with the motion."""

from __future__ import annotations

import numpy as np

from mixseq.errors import SettingsError
from mixseq.operations.passes import affine, shifted
from mixseq.signals.model import Model


def shift(model: Model, seconds: float) -> Model:
    """Return the model with everything later by so many seconds, or earlier where they are negative.

    The residual layer is left out.

    Raises
    ------
    SettingsError
        If that is not finite.
    """
    if not np.isfinite(seconds):
        raise SettingsError(f"seconds is {seconds}; a number is expected")
    return shifted(model, float(seconds))


def speed(model: Model, factor: float) -> Model:
    """Return the model so many times faster, from its start on.

    The frames are the same ones; `Model.sample` and `mixseq.operations.resampling` make others.
    The residual layer is left out.

    Raises
    ------
    SettingsError
        If the factor is not positive.
    """
    if not (np.isfinite(factor) and factor > 0):
        raise SettingsError(f"factor is {factor}; a positive number is expected (reverse runs backwards)")
    return affine(model, 1.0 / factor, model.start * (1.0 - 1.0 / factor))


def reverse(model: Model) -> Model:
    """Return the model backwards, from the same start to the same end.

    The residual layer is left out.
    """
    return affine(model, -1.0, model.start + model.end)
