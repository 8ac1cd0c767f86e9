r"""More or less of a motion: what parts do in their joints and how their shape changes, about the mean.

.. math::

    c(t) \to \bar c + \text{gain}\, (c(t) - \bar c), \qquad
    \tau(t) \to \bar\tau + \text{gain}\, (\tau(t) - \bar\tau)

with the time signal c and the stances :math:`\tau` of parts, how they are turned and placed against what they hang on
(`mixseq.operations.joint_tree`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mixseq.arrays import Float
from mixseq.errors import SettingsError
from mixseq.operations.joint_tree import JointTree
from mixseq.operations.splines import ACCURACY, placement_measure, sampled, sites_within
from mixseq.public import public
from mixseq.signals.curve import Curve
from mixseq.signals.model import Model

LARGEST_GAIN = 1000.0
"""Largest gain."""


@public
def exaggerate(model: Model, gain: float, modes: Sequence[int] | None = None) -> Model:
    r"""Return the model with its motion exaggerated or damped: all parts in their joints, and the change of shape.

    Everything is scaled about its mean over the frames, as `exaggerate_part` does for one part. The part as seen from
    which the others move least, such as a trunk, stays where it is, so a body goes where it went. Where parts have no
    poses of their own, in all spaces but the mixed one with anchored parts, only shape is scaled, which bends joints.
    No part is turned by more than half a turn from its mean for it: what spins, spins as before.
    The residual layer is kept.

    Parameters
    ----------
    model : Model
        The motion.
    gain : float
        1 changes nothing, 0 freezes all at the mean, more than 1 exaggerates, less damps.
    modes : sequence of int, optional
        Scale these coordinates of pose space alone, from 0 on, in a model that was fitted the modes, the largest first;
        parts stay where they are.

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
    whole = modes is None and gain != 1.0 and model.space.posed_parts
    placement = _exaggerated(model, gain) if whole else model.placement
    return replace(model, time=Curve(model.time.times, values), placement=placement)


def check_gain(gain: float) -> None:
    """Refuse what no motion survives."""
    if not abs(gain) <= LARGEST_GAIN:
        raise SettingsError(f"gain is {gain}; a number is expected, at most {LARGEST_GAIN:g} in size")


def _exaggerated(model: Model, gain: float) -> Curve:
    """Return the placement of a model whose stances are scaled about their means over the frames."""
    space = model.space.anchored()
    placement = model.placement
    tree = JointTree.of(space, space.poses(placement(model.times)))

    def stances(times: Float) -> Float:
        # Turns are unwrapped along the knots, so that whole turns count, whatever times are asked for.
        known, asked = np.unique(np.concatenate([placement.times, times]), return_inverse=True)
        return tree.stances(space.poses(placement(known)))[asked[len(placement.times) :]]

    frames = stances(model.times)
    mean = frames.mean(axis=0)
    furthest = np.linalg.norm((frames - mean)[..., :3], axis=2).max(axis=0)
    most = np.maximum(np.pi / np.maximum(furthest, np.pi / LARGEST_GAIN), 1.0)
    gains = np.clip(gain, -most, most)[:, None]

    def moved(times: Float) -> Float:
        before = stances(times)
        after = mean + gains * (before - mean)
        return space.placements(tree.moved(space.poses(placement(times)), before, after))

    sites = sites_within(model, model.start, model.end)
    return sampled(moved, sites, ACCURACY, placement_measure(model))
