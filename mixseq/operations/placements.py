r"""Placements of two motions: one that goes on from another, and what is between two.

A rotation goes from :math:`R_a` to :math:`R_b` along the turn between them,

.. math:: R_a \exp(w\, \tau), \qquad \exp(\tau) = R_a^T R_b,

which is unwrapped over time: one motion may turn more than the other, by whole turns. Parts that meet stay together: a
part that hangs on another (`ShapeSpace.parents`) goes so as this one sees it, and so does the middle of their
boundary. Only roots go as the world sees them, with their centres along straight lines.
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
    turned,
)
from mixseq.prediction.poses import Poses
from mixseq.signals.curve import Curve
from mixseq.spaces.base import ShapeSpace


def centre_columns(space: ShapeSpace) -> Index:
    """Return which numbers ``(g, 3)`` of a placement are centres."""
    return np.arange(4 * space.rotation_count, space.placement_dim).reshape(-1, 3)


def continued(space: ShapeSpace, curve: Curve, start: float, reference: Float) -> Curve:
    """Return a placement whose quaternions begin with the signs nearest to given ones: the same motion.

    Parts of a body get one sign, so that they all go the same way round from one motion into the other, but for parts
    that would go by more than two thirds of a turn.

    Parameters
    ----------
    space : ShapeSpace
        The space.
    curve : Curve
        A placement.
    start : float
        When it begins, in seconds.
    reference : (P,) float64
        Where the placement is before that.
    """
    here, before = (space.poses(each).rotations[0] for each in (curve([start]), reference[None]))
    cosines = np.einsum("gi,gi->g", normalised(here), normalised(before))
    together = np.bincount(space.bodies, cosines)[space.bodies]
    signs = np.where(np.where(np.abs(cosines) > 0.5, cosines, together) < 0, -1.0, 1.0)
    if (signs > 0).all():
        return curve
    turns, centres = space.poses(curve.values)
    return Curve(curve.times, space.placements(Poses(turns * signs[:, None], centres)))


def mean(one: Float, other: Float, share: Float) -> Float:
    """Return means ``(N, ...)`` of numbers with shares ``(N, ...)`` of the other ones."""
    return np.asarray((1.0 - share) * one + share * other)


def mean_placements(space: ShapeSpace, one: Float, other: Float, share: Float) -> Float:
    """Return means ``(N, P)`` of placements.

    Parameters
    ----------
    space : ShapeSpace
        Their space.
    one, other : (N, P) float64
        Placements at increasing times, with signs of quaternions that do not jump.
    share : (N, 1) float64
        Shares of the other ones.
    """
    first, second = space.poses(one), space.poses(other)
    length, longer = (np.linalg.norm(poses.rotations, axis=2, keepdims=True) for poses in (first, second))
    a, b = (Poses(normalised(poses.rotations), poses.centres) for poses in (first, second))
    share = share[:, :, None]
    result = Poses(_turned(a.rotations, b.rotations, share), mean(a.centres, b.centres, share))
    _hang(space, result, a, b, share)
    return space.placements(Poses(result.rotations * mean(length, longer, share), result.centres))


def _turned(one: Float, other: Float, share: Float) -> Float:
    """Unit quaternions ``(N, r, 4)`` on the way, which is the shorter one at first."""
    ways = continuous_vectors(rotations_of(product(inverse(one), other)))
    return product(one, exponentials(share * ways))


def _hang(space: ShapeSpace, result: Poses, a: Poses, b: Poses, share: Float) -> None:
    """Put the parts that hang on others where these have them, in between `a` and `b`."""
    above, pairs = space.parents, space.neighbours.parts
    for part in _downwards(above):
        parent = above[part]
        link = np.flatnonzero((pairs == (parent, part)).all(axis=1))[0]
        pivot = space.neighbours.pivots[link]
        seen = [_seen(poses, parent, part, pivot) for poses in (a, b)]
        turn = _turned(seen[0].rotations, seen[1].rotations, share)[:, 0]
        middle = mean(seen[0].centres, seen[1].centres, share)[:, 0]
        base = result.rotations[:, parent]
        result.rotations[:, part] = product(base, turn)
        away = turned(rotations_of(base), middle) - turned(rotations_of(result.rotations[:, part]), pivot)
        result.centres[:, part] = result.centres[:, parent] + away


def _seen(poses: Poses, parent: int, part: int, pivot: Float) -> Poses:
    """How a parent sees a part, ``(N, 1, 4)``, and a point of it ``(N, 1, 3)``."""
    back = inverse(poses.rotations[:, [parent]])
    point = turned(rotations_of(poses.rotations[:, [part]]), pivot) + poses.centres[:, [part]]
    return Poses(
        product(back, poses.rotations[:, [part]]),
        turned(rotations_of(back), point - poses.centres[:, [parent]]),
    )


def _downwards(above: Index) -> list[int]:
    """All parts that hang on others, after what they hang on."""
    order: list[int] = []
    level = np.flatnonzero(above < 0)
    while len(level):
        level = np.flatnonzero(np.isin(above, level))
        order += level.tolist()
    return order
