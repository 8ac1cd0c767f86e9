r"""Reaching: turn the parts of limbs as little as possible so that their ends move by given amounts.

The end g of a limb is the root's pivot plus a sum of *levers* :math:`u_{gk}`, one for each part k: from the pivot it
hangs by to the next one, and from the last pivot to the end. Part k turns by :math:`\Omega_k`, in the world's axes, and
all its levers with it, so that the end moves by :math:`\sum_k (\Omega_k - 1)\, u_{gk}`. Small turns
:math:`\omega_k = w_k \sum_g u_{gk} \times \lambda_g`, the least ones by compliances w that move ends at all, move them
by

.. math:: \sum_h A_{gh} \lambda_h, \qquad A_{gh} = \sum_k w_k \big[ (u_{gk} \cdot u_{hk})\, 1 - u_{hk} u_{gk}^T \big] .

A limb that is nearly straight can hardly get shorter or longer by that: its knee would pop out. So only a part of the
wanted moves m is made,

.. math:: e = l\, f(l^{-1} A\, l^{-1})\, l^{-1} m, \qquad f(x) = 3 x^2 - 2 x^3 \le 1, \qquad
          l_g^2 = (\delta L_g + |m_g|)\, L_g ,

with a smooth function f of a symmetric matrix, 1 from x = 1 on, and the lengths L of limbs. (Kovar, Schreiner and
Gleicher 2002 let legs get longer for the same reason.) Steps of damped least squares (Wampler 1986, Nakamura and
Hanafusa 1986) do that,

.. math:: \sum_h A_{gh} \lambda_h + \big( \mu L_g^2 + |e_g| L_g \big) \lambda_g = e_g ,

with what is left of e. The second term of the damping bounds the second derivative of :math:`\tfrac12 |e|^2`, which
Gauss-Newton leaves out, and vanishes with e. The number of steps is fixed, so that turns depend smoothly on moves.
:math:`\delta`, :math:`\mu`, f and l are ours: joints of a leg, straight or bent, accelerate by at most four times as
much as its end.
"""

from __future__ import annotations

import numpy as np

from mixseq.arrays import Float
from mixseq.geometry.rotations import matrices

STRAIGHT = 0.02
r"""The number :math:`\delta`: a leg of two equal bones, bent by 23 degrees, gets wholly shorter by turning."""

DAMPING = 0.01
STEPS = 20


def reach(levers: Float, moves: Float, compliance: Float) -> tuple[Float, Float]:
    """Find the turns that move the ends of limbs.

    Parameters
    ----------
    levers : (N, g, k, 3) float64
        In every frame what part k adds to limb g; zero where it is not of the limb.
    moves : (N, g, 3) float64
        Moves wanted of the ends.
    compliance : (k,) float64
        How easily parts turn; those of 0 do not.

    Returns
    -------
    turns : (N, k, 3, 3) float64
        Rotations of the parts in the world's axes; their levers turn by them.
    left : (N, g, 3) float64
        What is left of the moves.
    """
    count, ends, parts, _ = levers.shape
    lengths = np.linalg.norm(levers, axis=3).sum(axis=2)
    lengths = np.where(lengths > 0, lengths, 1.0)  # a contact on the root: nothing turns
    turns, turned = np.tile(np.eye(3), (count, parts, 1, 1)), levers
    goals = _within_reach(_mobility(levers, compliance), moves, lengths)
    moved, diagonal = np.zeros_like(moves), np.arange(3 * ends)
    for _ in range(STEPS):
        left = goals - moved
        damping = DAMPING * lengths**2 + np.linalg.norm(left, axis=2) * lengths
        system = _mobility(turned, compliance)
        system[:, diagonal, diagonal] += np.repeat(damping, 3, axis=1)
        pull = np.linalg.solve(system, left.reshape(count, -1, 1)).reshape(count, ends, 1, 3)
        turns = matrices(compliance[:, None] * np.cross(turned, pull).sum(axis=1)) @ turns
        turned = np.einsum("nkij,ngkj->ngki", turns, levers)
        moved = (turned - levers).sum(axis=2)
    return turns, moves - moved


def _mobility(levers: Float, compliance: Float) -> Float:
    """The matrices A ``(N, 3g, 3g)``."""
    count, ends, *_ = levers.shape
    dots = np.einsum("k,ngki,nhki->ngh", compliance, levers, levers)
    products = np.einsum("k,nhki,ngkj->ngihj", compliance, levers, levers)
    return np.asarray(np.einsum("ngh,ij->ngihj", dots, np.eye(3)) - products).reshape(count, 3 * ends, -1)


def _within_reach(mobility: Float, moves: Float, lengths: Float) -> Float:
    """Moves e ``(N, g, 3)`` that turning can make without popping."""
    scale = np.sqrt((STRAIGHT * lengths + np.linalg.norm(moves, axis=2)) * lengths)
    scale = np.repeat(scale, 3, axis=1)
    values, axes = np.linalg.eigh(mobility / (scale[:, :, None] * scale[:, None]))
    x = np.clip(values, 0.0, 1.0)
    along = np.einsum("nji,nj->ni", axes, moves.reshape(len(moves), -1) / scale)
    kept = np.einsum("nij,nj->ni", axes, x * x * (3.0 - 2.0 * x) * along)
    return np.asarray(kept * scale).reshape(moves.shape)
