r"""Inverse kinematics: rotate the parts of limbs about their pivots until contacts reach their targets.

The end g of a limb is the root's pivot plus a sum of *levers* :math:`u_{gk}`, one per part k: from its pivot to the
next one, and from the last pivot to the end. Part k rotates by :math:`\Omega_k`, in the world's axes, with all its
levers, so that the end moves by :math:`\sum_k (\Omega_k - 1)\, u_{gk}`. Small rotations
:math:`\omega_k = w_k \sum_g u_{gk} \times \lambda_g`, least squares by compliances w, move ends by

.. math:: \sum_h A_{gh} \lambda_h, \qquad A_{gh} = \sum_k w_k \big[ (u_{gk} \cdot u_{hk})\, 1 - u_{hk} u_{gk}^T \big] .

A nearly straight limb can hardly change its length by rotations: its knee would pop. So only a part of the moves m is
made,

.. math:: e = l\, f(l^{-1} A\, l^{-1})\, l^{-1} m, \qquad f(x) = 3 x^2 - 2 x^3 \le 1, \qquad
          l_g^2 = (\delta L_g + |m_g|)\, L_g ,

with a smooth function f of a symmetric matrix, 1 from x = 1 on, and the lengths L of limbs. (Kovar, Schreiner and
Gleicher 2002 let legs get longer for the same reason.) Steps of damped least squares (Wampler 1986, Nakamura and
Hanafusa 1986) solve, with the remaining e,

.. math:: \sum_h A_{gh} \lambda_h + \big( \mu L_g^2 + |e_g| L_g \big) \lambda_g = e_g .

The second term of the damping bounds the second derivative of :math:`\tfrac12 |e|^2`, which Gauss-Newton omits, and
vanishes with e. The number of steps is fixed, so that rotations depend smoothly on moves. With the chosen
:math:`\delta`, :math:`\mu`, f and l joints of a leg accelerate by at most four times as much as its end.

The moves that rotations leave, again :math:`e_g`, lengthen the limbs: the joint above part k opens by :math:`\tau_k`,
the smallest with :math:`\sum_{k \in g} \tau_k = e_g`, which distributes the stretch of one limb evenly. With pivots q,
a part k that hangs on part j moves from c to

.. math:: c_k' = c_j' + \Omega_j (q_k - c_j) + \Omega_k (c_k - q_k) + \tau_k .

A part that carries n contacts is :math:`n^2` times as stiff, so that legs move rather than the body. The part on the
ground keeps its rotation, and with it the sole, where two other parts suffice.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Float
from mixseq.geometry.rotations import matrices, turned
from mixseq.retargeting.articulated_body import ArticulatedBody, Contact

STRAIGHT = 0.02
r"""The number :math:`\delta`: a leg of two equal bones, bent by 23 degrees, shortens by rotation alone."""

DAMPING = 0.01
STEPS = 20


@dataclass(frozen=True, eq=False)
class MovedContacts:
    """Motions of parts whose contacts have moved."""

    rotations: Float  # (T, p, 3, 3) rotations of all parts
    centres: Float  # (T, p, 3) centres of all parts
    turns: Float  # (T, k, 3, 3) rotations of the parts of limbs, in the world's axes
    # (T, g, 3) moves that turning did not reach: by that limbs got longer. A contact on the root has no limb; it stays
    # so far from where it should be.
    left: Float


def move_contacts(
    body: ArticulatedBody, rotations: Float, centres: Float, contacts: Sequence[Contact], moves: Float
) -> MovedContacts:
    """Move contacts by their limbs: rotations, centres ``(T, p, 3, 3), (T, p, 3)``; moves ``(T, g, 3)``."""
    limbs = [body.limb(contact) for contact in contacts]
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
        levers[:, number, columns[number]] = _levers(body, limb, contact, *poses, frames)
    turns[frames], left[frames] = turn_limbs(levers, moves[frames], compliance)
    share = easy[:, None] * member.T @ np.linalg.pinv(member * easy @ member.T)
    stretches = np.einsum("kg,tgi->tki", share, left)
    whole = {part: (turns[:, number], stretches[:, number]) for number, part in enumerate(parts)}
    return MovedContacts(*_forward(body, rotations, centres, whole), turns, left)


def _levers(
    body: ArticulatedBody,
    limb: tuple[int, ...],
    contact: Contact,
    rotations: Float,
    centres: Float,
    frames: NDArray[np.int64],
) -> Float:
    """Return vectors ``(N, len(limb), 3)`` from pivot to pivot of a limb, and on to the middle of its contact."""
    pivots = np.array([body.pivot(part) for part in limb]).reshape(-1, 3)
    joints = body.placed(pivots, limb, rotations, centres)
    end = body.path(contact, rotations, centres, frames).mean(axis=1, keepdims=True)
    return np.diff(np.concatenate([joints, end], axis=1), axis=1)


def _forward(
    body: ArticulatedBody, rotations: Float, centres: Float, own: dict[int, tuple[Float, Float]]
) -> tuple[Float, Float]:
    """Forward kinematics: return the motions of all parts from `own` rotations and stretches of limbs."""
    facing, placed = rotations.copy(), centres.copy()
    identity, none = np.eye(3), np.zeros(3)
    turns: dict[int, Float] = {body.root: identity}
    for part, (above, _) in body.parents.items():
        carried = turns[above]
        turn, stretch = own.get(part, (carried, none))
        turns[part] = turn
        pivot = body.placed(body.pivot(part), [part], rotations, centres)[:, 0]
        # Differences to the motion, so that frames without rotations keep every bit.
        change = placed[:, above] - centres[:, above] + stretch
        change += turned(carried - identity, pivot - centres[:, above])
        change += turned(turn - identity, centres[:, part] - pivot)
        placed[:, part] += change
        facing[:, part] = turn @ rotations[:, part]
    return facing, placed


def turn_limbs(levers: Float, moves: Float, compliance: Float) -> tuple[Float, Float]:
    """Find rotations ``(N, k, 3, 3)`` and remaining moves ``(N, g, 3)`` of limbs from levers ``(N, g, k, 3)``.

    Shapes: moves ``(N, g, 3)``; compliance ``(k,)``.
    """
    count, ends, parts, _ = levers.shape
    lengths = np.linalg.norm(levers, axis=3).sum(axis=2)
    lengths = np.where(lengths > 0, lengths, 1.0)  # a contact on the root has no limb
    turns, lever = np.tile(np.eye(3), (count, parts, 1, 1)), levers
    goals = _within_reach(_mobility(levers, compliance), moves, lengths)
    moved, diagonal = np.zeros_like(moves), np.arange(3 * ends)
    for _ in range(STEPS):
        left = goals - moved
        damping = DAMPING * lengths**2 + np.linalg.norm(left, axis=2) * lengths
        system = _mobility(lever, compliance)
        system[:, diagonal, diagonal] += np.repeat(damping, 3, axis=1)
        multipliers = np.linalg.solve(system, left.reshape(count, -1, 1)).reshape(count, ends, 1, 3)
        turns = matrices(compliance[:, None] * np.cross(lever, multipliers).sum(axis=1)) @ turns
        lever = np.einsum("nkij,ngkj->ngki", turns, levers)
        moved = (lever - levers).sum(axis=2)
    return turns, moves - moved


def _mobility(levers: Float, compliance: Float) -> Float:
    """The matrices A ``(N, 3g, 3g)``."""
    count, ends, *_ = levers.shape
    dots = np.einsum("k,ngki,nhki->ngh", compliance, levers, levers)
    products = np.einsum("k,nhki,ngkj->ngihj", compliance, levers, levers)
    return np.asarray(np.einsum("ngh,ij->ngihj", dots, np.eye(3)) - products).reshape(count, 3 * ends, -1)


def _within_reach(mobility: Float, moves: Float, lengths: Float) -> Float:
    """Return the moves e ``(N, g, 3)`` that rotations can make without popping."""
    scale = np.sqrt((STRAIGHT * lengths + np.linalg.norm(moves, axis=2)) * lengths)
    scale = np.repeat(scale, 3, axis=1)
    values, axes = np.linalg.eigh(mobility / (scale[:, :, None] * scale[:, None]))
    x = np.clip(values, 0.0, 1.0)
    along = np.einsum("nji,nj->ni", axes, moves.reshape(len(moves), -1) / scale)
    kept = np.einsum("nij,nj->ni", axes, x * x * (3.0 - 2.0 * x) * along)
    return np.asarray(kept * scale).reshape(moves.shape)
