r"""Smooth skinning decomposition: weights, rest positions and motions of bones, fitted in turn.

.. math:: \min \sum_{t, v} \Bigl| \sum_b w_{vb} \bigl( R_{tb} r_v + T_{tb} \bigr) - x_t(v) \Bigr|^2

Le and Deng (2012) alternate weights (`mixseq.rigging.weights`) and motions (`mixseq.rigging.jointed_motions`); rest
positions, which they take from a frame, are fitted here too. Bones start as near-rigid parts instead of clusters of
vertices; further bones are seeded where the error is largest. Rounds are accelerated.

Bones are free at first. Then they form a tree (`mixseq.rigging.bone_tree`), with the fewest sliding joints that keep
the error within a tenth of that of free bones: those of largest separation, weighted by their bones.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mixseq.arrays import Float, Index
from mixseq.rigging.bone_tree import bone_tree
from mixseq.rigging.bones import merged, motion_of, on_rotations, seeded
from mixseq.rigging.jointed_motions import Joints, attached, move
from mixseq.rigging.rigs import INFLUENCES
from mixseq.rigging.weights import Binding, bind

GAIN = 3e-3
"""Relative decrease of the error below which rounds end; constants here were chosen empirically."""

WORSE = 1.1
"""Largest root mean square error of bones in a tree, relative to free ones."""

_FEW = 3  # rounds over which this is averaged
_EXACT = 1e-9  # root mean square error of rounding, in diagonals
_NEARLY = 1e-6  # root mean square error below which no joint slides, in diagonals
_BETWEEN = 2  # rounds before more bones are seeded
_TRIED = 3  # a number of sliding joints gets this fraction of all rounds: 1 / _TRIED


def free_bones(
    tracks: Float, labels: Index, most: int, rounds: int, told: Callable[[int], None]
) -> tuple[Binding, Float]:
    """Fit weights, rest positions, motions ``(B, 4, 3T)`` of free bones: tracks ``(V, 3T)``; labels ``(V,)``."""
    labels = merged(tracks, labels, most)
    rest = tracks[:, :3].copy()
    motions = np.stack(
        [motion_of(tracks, rest, np.flatnonzero(labels == b)) for b in range(labels.max() + 1)]
    )
    nothing = np.zeros((len(rest), INFLUENCES))
    binding = Binding(rest, nothing.astype(np.int64), nothing, nothing[:, 0])
    exact = _EXACT**2 * tracks.size / 3
    binding = bind(tracks, motions, binding, free_rest=False)
    while len(motions) < most and binding.errors.sum() > exact:
        # Half as many again at a time, each seeded at errors of those before.
        more = min(most - len(motions), 1 + len(motions) // 2)
        new = seeded(tracks, binding, more, max(4, len(tracks) // (6 * most)))
        motions = np.concatenate([motions, new])
        for _ in range(_BETWEEN):
            binding = bind(tracks, motions, binding, free_rest=False)
            motions, _ = move(tracks, binding, motions, Joints.loose(len(motions)))
    loose = Joints.loose(len(motions))
    motions, _ = move(tracks, binding, motions, loose)
    binding, motions, _ = alternated(tracks, binding, motions, loose, exact, rounds, told)
    return _without_idle(binding, motions)


def alternated(
    tracks: Float,
    binding: Binding,
    motions: Float,
    joints: Joints,
    enough: float,
    rounds: int,
    told: Callable[[int], None],
    held: bool = False,
) -> tuple[Binding, Float, Joints]:
    """Fit weights with rest positions, and motions, in turn, until the squared error is small enough or stops falling.

    Every round extrapolates the last ones: rest positions and motions go on by a fraction j / (j + 3) of their last
    step (Nesterov 1983), j counting the rounds since the error grew; such a round is reverted. With `held`, rest
    positions and joints are fixed.
    """
    rest, before = binding.rest, motions
    past, good = [np.inf], 0
    for done in range(rounds):
        told(done)
        on = good / (good + 3.0)
        ahead = replace(binding, rest=binding.rest + on * (binding.rest - rest))
        going = attached(on_rotations(motions + on * (motions - before)), joints)
        bound = bind(tracks, going, ahead, free_rest=not held)
        if good and bound.errors.sum() > past[-1]:
            good = 0
            continue
        good += 1
        rest, before = binding.rest, motions
        binding = bound
        motions, joints = move(tracks, bound, going, joints, fit_pivots=not held)
        past.append(binding.errors.sum())
        if past[-1] <= enough or (len(past) > _FEW and past[-1] > (1 - GAIN) ** (2 * _FEW) * past[-1 - _FEW]):
            break
    return binding, motions, joints


def _without_idle(binding: Binding, motions: Float) -> tuple[Binding, Float]:
    """Remove bones without vertices."""
    used = np.unique(binding.influences[binding.weights > 0])
    return _renumbered(binding, used, len(motions)), motions[used]


def _renumbered(binding: Binding, order: Index, bones: int) -> Binding:
    """Renumber the bones of a binding by their places in an order."""
    places = np.zeros(bones, dtype=np.int64)
    places[order] = np.arange(len(order))
    return replace(binding, influences=np.where(binding.weights > 0, places[binding.influences], 0))


def hung_bones(
    tracks: Float, faces: Index, binding: Binding, motions: Float, rounds: int, told: Callable[[int], None]
) -> tuple[Binding, Float, Joints]:
    """Build a tree of free bones with the fewest sliding joints that the error allows; see `free_bones`."""
    order, joints = bone_tree(faces, binding, motions)
    binding, motions = _renumbered(binding, order, len(order)), motions[order]
    most = max(WORSE**2 * binding.errors.sum(), _NEARLY**2 * tracks.size / 3)
    apart = _coming_apart(binding, motions, joints)
    fewest, enough, tries = 0, len(apart), 0
    found = binding, motions, replace(joints, sliding=np.ones(len(order), dtype=bool))
    while fewest < enough:  # binary search: `enough` sliding joints keep the error
        told(tries := tries + 1)
        count = (fewest + enough) // 2
        sliding = joints.sliding.copy()
        sliding[apart[:count]] = True
        tried = alternated(
            tracks, binding, motions, replace(joints, sliding=sliding), most, rounds // _TRIED, _silent
        )
        if tried[0].errors.sum() <= most:
            found, enough = tried, count
        else:
            fewest = count + 1
    return alternated(tracks, *found, _EXACT**2 * tracks.size / 3, rounds // _TRIED, _silent)


def _coming_apart(binding: Binding, motions: Float, joints: Joints) -> Index:
    """Return the bones with parents, by decreasing weighted separation of their joints."""
    bones = np.flatnonzero(joints.parents >= 0)
    apart = motions[joints.parents[bones]] - motions[bones]
    gaps = np.einsum("bi,bij->bj", joints.pivots[bones], apart[:, :3]) + apart[:, 3]
    weights = np.zeros(len(motions))
    np.add.at(weights, binding.influences, np.square(binding.weights))
    costs = np.sum(np.square(gaps), axis=1) * weights[bones]
    return np.asarray(bones[np.argsort(-costs, kind="stable")])


def _silent(done: int) -> None:
    """Ignore progress."""
