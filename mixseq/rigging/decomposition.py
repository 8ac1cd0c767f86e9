r"""Smooth skinning decomposition: weights, rest positions and motions of bones, fitted in turn.

.. math:: \min \sum_{t, v} \Bigl| \sum_b w_{vb} \bigl( R_{tb} r_v + T_{tb} \bigr) - x_t(v) \Bigr|^2

Le and Deng (2012) alternate weights (`mixseq.rigging.weights`) and motions (`mixseq.rigging.bones`); rest positions,
which they take from a frame, are fitted here too. Bones start as near-rigid parts instead of clusters of vertices;
where more are asked for they are seeded where the error is largest. Rounds are accelerated.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mixseq.arrays import Float, Index
from mixseq.progress import Progress
from mixseq.rigging.bones import merged, motion_of, move, on_rotations, seeded
from mixseq.rigging.rigs import INFLUENCES
from mixseq.rigging.weights import Binding, bind

GAIN = 3e-3
"""Rounds end when the error falls by less than this fraction of itself a round; values here are ours."""

_FEW = 3  # rounds that this is averaged over
_EXACT = 1e-9  # root mean square error, in diagonals, that is rounding
_BETWEEN = 2  # rounds before more bones are seeded


def decompose(
    tracks: Float, labels: Index, most: int, rounds: int, progress: Progress
) -> tuple[Binding, Float]:
    """Find weights, rest positions and motions of bones.

    Parameters
    ----------
    tracks : (V, 3T) float64
        Positions of every vertex, frame by frame; centred, in diagonals.
    labels : (V,) int64
        The bone that every vertex starts with.
    most : int
        Number of bones: those of the labels are merged if they are more, and others seeded if they are fewer.
    rounds : int
        At most so many rounds of weights and motions.
    progress : callable
        Told how far the work is.

    Returns
    -------
    binding : Binding
    motions : (B, 4, 3T) float64
        Transposed motions of the bones.
    """
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
        # Half as many again at a time, so that each is seeded where those before do not reach.
        more = min(most - len(motions), 1 + len(motions) // 2)
        new = seeded(tracks, binding, more, max(4, len(tracks) // (6 * most)))
        motions = np.concatenate([motions, new])
        for _ in range(_BETWEEN):
            binding = bind(tracks, motions, binding, free_rest=False)
            motions = move(tracks, binding, motions)
    return _alternated(tracks, binding, move(tracks, binding, motions), exact, rounds, progress)


def _alternated(
    tracks: Float, binding: Binding, motions: Float, exact: float, rounds: int, progress: Progress
) -> tuple[Binding, Float]:
    """Fit weights with rest positions, and motions, in turn.

    Every round starts from where the last ones lead: rest positions and motions go on by a fraction j / (j + 3) of
    their last step (Nesterov 1983), j counting the rounds since the error grew; such a round is taken back.
    """
    rest, before = binding.rest, motions
    past, good = [binding.errors.sum()], 0
    for done in range(rounds):
        progress(done, rounds + 1, "fitting weights and bones")
        on = good / (good + 3.0)
        ahead = replace(binding, rest=binding.rest + on * (binding.rest - rest))
        going = on_rotations(motions + on * (motions - before))
        bound = bind(tracks, going, ahead)
        if good and bound.errors.sum() > past[-1]:
            good = 0
            continue
        good += 1
        rest, before = binding.rest, motions
        binding, motions = bound, move(tracks, bound, going)
        past.append(binding.errors.sum())
        if past[-1] <= exact or (len(past) > _FEW and past[-1] > (1 - GAIN) ** (2 * _FEW) * past[-1 - _FEW]):
            break
    return binding, motions
