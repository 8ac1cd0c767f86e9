r"""Placements of two motions: continuation and interpolation.

A rotation is interpolated from :math:`R_a` to :math:`R_b` along the turn between them,

.. math:: R_a \exp(w\, \tau), \qquad \exp(\tau) = R_a^T R_b,

which is unwrapped over time, as one motion may turn more than the other by whole turns. Centres are interpolated
linearly.
"""

from __future__ import annotations

import numpy as np

from mixseq.arrays import Float, Index
from mixseq.geometry.rotations import (
    continuous_vectors,
    exponentials,
    inverse,
    normalised,
    product,
    rotations_of,
)
from mixseq.prediction.poses import Poses
from mixseq.signals.curve import Curve
from mixseq.spaces.base import ShapeSpace


def centre_columns(space: ShapeSpace) -> Index:
    """Return the indices ``(g, 3)`` of part centres in a placement."""
    return np.arange(4 * space.rotation_count, space.placement_dim).reshape(-1, 3)


def continued(space: ShapeSpace, curve: Curve, start: float, reference: Float) -> Curve:
    """Return the placement with quaternion signs that continue a reference ``(P,)`` at `start`: the same motion."""
    here, before = (space.poses(each).rotations[0] for each in (curve([start]), reference[None]))
    signs = np.where(np.einsum("gi,gi->g", here, before) < 0, -1.0, 1.0)
    if (signs > 0).all():
        return curve
    turns, centres = space.poses(curve.values)
    return Curve(curve.times, space.placements(Poses(turns * signs[:, None], centres)))


def mean(one: Float, other: Float, share: Float) -> Float:
    """Return weighted means ``(N, ...)`` with the weight `share` ``(N, ...)`` of `other`."""
    return np.asarray((1.0 - share) * one + share * other)


def mean_placements(space: ShapeSpace, one: Float, other: Float, share: Float) -> Float:
    """Return means ``(N, P)`` of placements with the weight `share` ``(N, 1)`` of `other`."""
    first, second = space.poses(one), space.poses(other)
    length, longer = (np.linalg.norm(poses.rotations, axis=2, keepdims=True) for poses in (first, second))
    a, b = (Poses(normalised(poses.rotations), poses.centres) for poses in (first, second))
    share = share[:, :, None]
    turns = _turned(a.rotations, b.rotations, share) * mean(length, longer, share)
    return space.placements(Poses(turns, mean(a.centres, b.centres, share)))


def _turned(one: Float, other: Float, share: Float) -> Float:
    """Interpolate unit quaternions ``(N, r, 4)``, by the shorter way at first."""
    ways = continuous_vectors(rotations_of(product(inverse(one), other)))
    return product(one, exponentials(share * ways))
