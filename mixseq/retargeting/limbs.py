r"""Limbs: parts turn about their pivots until contacts are where they shall be, and what hangs on them goes along.

Turns :math:`\Omega` are those of `mixseq.retargeting.reach`. The moves :math:`e_g` that they leave lengthen the limbs:
the joint above part k opens by :math:`\tau_k`, the smallest with :math:`\sum_{k \in g} \tau_k = e_g`, which shares the
stretch of one limb out evenly. With pivots q, a part k that hangs on part j moves from c to

.. math:: c_k' = c_j' + \Omega_j (q_k - c_j) + \Omega_k (c_k - q_k) + \tau_k .

A part that carries n contacts is :math:`n^2` times as stiff, so that legs move rather than the body (ours). The part
on the ground keeps its turn, and with it the sole, where two others can do without it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Float
from mixseq.geometry.rigid import turned
from mixseq.retargeting.linkage import Contact, Linkage
from mixseq.retargeting.reach import reach


@dataclass(frozen=True, eq=False)
class Reached:
    """Motions of parts whose contacts have moved.

    Attributes
    ----------
    rotations, centres : (T, p, 3, 3), (T, p, 3) float64
        Of all parts.
    turns : (T, k, 3, 3) float64
        By how much the parts of limbs turned, in the world's axes.
    left : (T, g, 3) float64
        Moves that turning did not reach: by that limbs got longer. A contact on the root has no limb; it stays so far
        from where it should be.
    """

    rotations: Float
    centres: Float
    turns: Float
    left: Float


def reached(
    linkage: Linkage, rotations: Float, centres: Float, contacts: Sequence[Contact], moves: Float
) -> Reached:
    """Move contacts by their limbs.

    Parameters
    ----------
    linkage : Linkage
        The parts.
    rotations, centres : (T, p, 3, 3), (T, p, 3) float64
        Their motions.
    contacts : sequence of Contact
        What shall move.
    moves : (T, g, 3) float64
        How far. Frames in which all are zero stay exactly as they are.

    Returns
    -------
    Reached
        The corrected motions, and what turning did not do.

    Raises
    ------
    SettingsError
        If a contact is on no limb.
    """
    limbs = [linkage.limb(contact) for contact in contacts]
    parts = sorted({part for limb in limbs for part in limb})
    columns = [[parts.index(part) for part in limb] for limb in limbs]
    member = np.zeros((len(limbs), len(parts)))
    for number, some in enumerate(columns):
        member[number, some] = 1.0
    easy = 1.0 / member.sum(axis=0) ** 2
    compliance = easy.copy()
    for some in columns:
        if len(some) > 2 and member[:, some[-1]].sum() == 1:
            compliance[some[-1]] = 0.0

    turns, left = np.tile(np.eye(3), (len(moves), len(parts), 1, 1)), np.zeros_like(moves)
    frames = np.flatnonzero(moves.any(axis=(1, 2)))
    levers = np.zeros((len(frames), *member.shape, 3))
    poses = rotations[frames], centres[frames]
    for number, (limb, contact) in enumerate(zip(limbs, contacts, strict=True)):
        levers[:, number, columns[number]] = _levers(linkage, limb, contact, *poses, frames)
    turns[frames], left[frames] = reach(levers, moves[frames], compliance)
    share = easy[:, None] * member.T @ np.linalg.pinv(member * easy @ member.T)
    stretches = np.einsum("kg,tgi->tki", share, left)
    whole = {part: (turns[:, number], stretches[:, number]) for number, part in enumerate(parts)}
    return Reached(*_carried(linkage, rotations, centres, whole), turns, left)


def _levers(
    linkage: Linkage,
    limb: tuple[int, ...],
    contact: Contact,
    rotations: Float,
    centres: Float,
    frames: NDArray[np.int64],
) -> Float:
    """From pivot to pivot of a limb, and on to the middle of its contact, ``(N, len(limb), 3)``."""
    pivots = np.array([linkage.pivot(part) for part in limb]).reshape(-1, 3)
    joints = linkage.placed(pivots, limb, rotations, centres)
    end = linkage.path(contact, rotations, centres, frames).mean(axis=1, keepdims=True)
    return np.diff(np.concatenate([joints, end], axis=1), axis=1)


def _carried(
    linkage: Linkage, rotations: Float, centres: Float, own: dict[int, tuple[Float, Float]]
) -> tuple[Float, Float]:
    """Motions of all parts when those of limbs turn and move off by `own` turns and stretches."""
    facing, placed = rotations.copy(), centres.copy()
    identity, none = np.eye(3), np.zeros(3)
    turns: dict[int, Float] = {linkage.root: identity}
    for part, (above, _) in linkage.hung.items():
        carried = turns[above]
        turn, stretch = own.get(part, (carried, none))
        turns[part] = turn
        pivot = linkage.placed(linkage.pivot(part), [part], rotations, centres)[:, 0]
        # Differences to what was, so that frames in which nothing turns stay as they are to the last bit.
        change = placed[:, above] - centres[:, above] + stretch
        change += turned(carried - identity, pivot - centres[:, above])
        change += turned(turn - identity, centres[:, part] - pivot)
        placed[:, part] += change
        facing[:, part] = turn @ rotations[:, part]
    return facing, placed
