r"""Edits of one limb: exaggerate or damp the motion of a part in its joint, or hold it.

The stance of a part relative to its parent (`mixseq.operations.limb_joints`) is a vector of six numbers over time,
:math:`\tau(t)`, with turns as unwrapped rotation vectors. Edits change it,

.. math::

    \tau' = \bar\tau + \text{gain}\, (\tau - \bar\tau), \qquad
    \tau' = \tau + w(t)\, (\tau(t_0) - \tau),

and the part moves rigidly with its whole limb. Between limb and body the skin follows the poses of both; the remaining
shape change in the joint follows the same formula. As the results are no cubic splines, signals are adaptively sampled.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mixseq.arrays import Float
from mixseq.errors import SettingsError
from mixseq.frame_numbers import Seconds
from mixseq.operations.exaggeration import check_gain
from mixseq.operations.joining import CurveSection, Seam, join, snapped
from mixseq.operations.limb_joints import Limb, limb_of
from mixseq.operations.sculpt import smoothstep
from mixseq.operations.splines import (
    ACCURACY,
    correction_measure,
    refined,
    sampled,
    shape_measure,
    sites_within,
)
from mixseq.public import public
from mixseq.signals.curve import Curve
from mixseq.signals.model import Model
from mixseq.signals.pose import PoseMap

Change = Callable[[Float, Float], Float]
"""From times ``(N,)`` and stances ``(N, 6)`` to changed stances ``(N, 6)``."""

NEGLIGIBLE = 1e-3
"""Size of modes of a held part and its joints below which they are left out, as a fraction of the largest."""

STEP = 1.0
"""Largest turn added to a part between sites, in radians, so that whole turns are resolved."""

FADE = 0.2
"""Default duration over which a part comes to rest, in seconds."""


@public
def exaggerate_part(model: Model, part: int, gain: float) -> Model:
    """Return the model with the motion of a part in its joint scaled about its mean.

    The residual layer is kept.

    Parameters
    ----------
    model : Model
        A model in the mixed space, parts anchored.
    part : int
        Number of the part. Its limb moves with it as one body.
    gain : float
        1 changes nothing, 2 doubles the motion, 0 stops it, a negative number reverses it.

    Raises
    ------
    SettingsError
        If the parts of the model have no poses of their own, the part does not exist or has no parent, or the gain is
        not finite.
    """
    limb = limb_of(model, part)
    check_gain(gain)
    mean = limb.stance(model, model.times).mean(axis=0)
    sites = sites_within(model, model.start, model.end)
    correction = _moved(model, limb, sites, lambda _, stance: mean + gain * (stance - mean))
    return replace(model, correction=correction, shapes=_scaled_joint(model, limb, gain))


@public
def hold(model: Model, part: int, time: Seconds, start: Seconds, end: Seconds, fade: Seconds = FADE) -> Model:
    """Return the model with a part at rest against its parent, as it is at a time.

    The residual layer is kept.

    Parameters
    ----------
    model : Model
        A model in the mixed space, parts anchored.
    part : int
        Number of the part. Its limb moves with it as one body.
    time : float
        Time of the stance that is held, in seconds.
    start, end : float
        First and last time of rest, in seconds.
    fade : float
        Seconds before the start over which the part comes to rest, and after the end over which it moves off again.

    Raises
    ------
    SettingsError
        If the parts of the model have no poses of their own, the part does not exist or has no parent, or a time is out
        of range.
    """
    limb = limb_of(model, part)
    time, start, end = snapped(model, time), snapped(model, start, "start"), snapped(model, end, "end")
    if start > end:
        raise SettingsError(f"the start, {start:g} s, is after the end, {end:g} s")
    if not (np.isfinite(fade) and fade > 0):
        raise SettingsError(f"fade is {fade}; a positive number of seconds is expected")

    def rest(times: Float) -> Float:
        weight = np.ones(len(times))
        if start > model.start:
            weight = weight * smoothstep(times, start - fade, start)
        if end < model.end:
            weight = weight * (1.0 - smoothstep(times, end, end + fade))
        return np.asarray(weight[:, None])

    first, last = max(start - fade, model.start), min(end + fade, model.end)
    knots = np.concatenate([np.linspace(start - fade, start, 4), np.linspace(end, end + fade, 4)])
    sites = sites_within(model, first, last, knots)
    still = limb.stance(model, np.array([time]))
    correction = _moved(model, limb, sites, lambda times, stance: stance + rest(times) * (still - stance))
    wider, resting = _with_rest(model, limb)
    here = model.time([time])

    def held(times: Float) -> Float:
        points = model.time(times)
        added = rest(times) * resting(here - points)
        return np.concatenate([points, added], axis=1)

    signal = sampled(held, sites, ACCURACY, shape_measure(wider))
    return replace(
        wider,
        time=_spliced(wider, wider.time, signal),
        correction=_spliced(wider, model.correction, correction),
    )


def _moved(model: Model, limb: Limb, sites: Float, change: Change) -> Curve:
    """Return the whole correction with a changed stance of a limb, from the first to the last site."""

    def moved(times: Float) -> Float:
        return limb.corrections(model, times, change(times, limb.stance(model, times)))

    stance = limb.stance(model, sites)
    more = np.diff(change(sites, stance)[:, :3] - stance[:, :3], axis=0)
    parts = 1 + int(np.abs(more).max(initial=0.0) / STEP)
    return sampled(moved, refined(sites, parts), ACCURACY, correction_measure(model))


def _spliced(model: Model, curve: Curve, inside: Curve) -> Curve:
    """Return a signal of the model over its duration, replaced by another curve while that lasts.

    Interpolation errors at the ends are absorbed by the first and last interval of `inside`.
    """
    first, last = inside.start, inside.end
    if first == last:
        return inside
    sections, seams = [CurveSection(inside, first, last)], []
    if model.start < first:
        sections.insert(0, CurveSection(curve, model.start, first))
        seams.append(Seam(inside.times[2] - first, share=0.0))
    if last < model.end:
        sections.append(CurveSection(curve, last, model.end))
        seams.append(Seam(last - inside.times[-3], share=1.0))
    return join(sections, seams)


# Joints ---------------------------------------------------------------------------------------------------


def _scaled_joint(model: Model, limb: Limb, gain: float) -> Float:
    """Return the key shapes ``(K, S)`` with the joint coordinates of the limb scaled about their mean."""
    share = limb.joint()
    joint = np.flatnonzero(share)
    shapes = model.shapes.copy()
    mean = (model.pose.weights(model.time(model.times)) @ shapes[:, joint]).mean(axis=0)
    shapes[:, joint] += (gain - 1.0) * share[joint] * (shapes[:, joint] - mean)
    return shapes


def _with_rest(model: Model, limb: Limb) -> tuple[Model, Callable[[Float], Float]]:
    """Return the model with pose coordinates for a part and its joints alone, and the map from time-signal steps."""
    share, metric = limb.joint() + limb.own_shape(), model.space.shape_weights
    some = np.flatnonzero(share * metric)
    dim, keys = model.pose.matrix.shape
    steps = model.pose.matrix @ (model.shapes[:, some] - model.shapes[0, some]) * (share * metric)[some]
    frames = model.time(model.times)
    _, sizes, directions = np.linalg.svd((frames - frames.mean(axis=0)) @ steps, full_matrices=False)
    directions = directions[sizes > NEGLIGIBLE * sizes.max(initial=0.0)]
    rank = len(directions)
    shapes = np.repeat(model.shapes[:1], rank, axis=0)
    shapes[:, some] += directions / metric[some]
    matrix = np.zeros((dim + rank, keys + rank))
    matrix[:dim, :keys] = model.pose.matrix
    matrix[dim:, 0], matrix[dim:, keys:] = -1.0, np.eye(rank)
    wider = replace(
        model,
        time=Curve(model.time.times, np.pad(model.time.values, ((0, 0), (0, rank)))),
        pose=PoseMap(np.pad(model.pose.offset, (0, rank)), matrix),
        shapes=np.concatenate([model.shapes, shapes]),
    )
    into = steps @ directions.T
    return wider, lambda changes: np.asarray(changes @ into)
