r"""Articulated body of a character (rigid parts, their pivots, limbs to its contacts), and its inverse kinematics.

In every frame, part p has a rotation R and a centre c; it moves a rest point y to :math:`R (y - m_p) + c`, with its
rest centre m. The parts are a tree. The parent of a part is its neighbour nearer to the root, and the two meet at the
*pivot* of the part. The *limb* of a contact is the chain of parts from a child of the root to the contact. The length
of a leg is the length of the path through the pivots of its limb.

*Inverse kinematics* rotates the parts of limbs about their pivots until contacts reach their targets. The end g of a
limb is its first pivot plus a sum of *levers* :math:`u_{gk}`. The lever of part k points from its pivot to the next
pivot, or from the last pivot to the end. Part k rotates by :math:`\Omega_k` in world axes with all its levers, so that
the end moves by :math:`\sum_k (\Omega_k - 1)\, u_{gk}`. The least-squares solution with compliances w has small
rotations :math:`\omega_k = w_k \sum_g u_{gk} \times \lambda_g`, which move the ends by

.. math:: \sum_h A_{gh} \lambda_h, \qquad A_{gh} = \sum_k w_k \big[ (u_{gk} \cdot u_{hk})\, 1 - u_{hk} u_{gk}^T \big] .

Rotations hardly change the length of a nearly straight limb, and its knee would pop. So only the part e of the moves m
is made by rotations,

.. math:: e = l\, f(l^{-1} A\, l^{-1})\, l^{-1} m, \qquad f(x) = 3 x^2 - 2 x^3 \le 1, \qquad
          l_g^2 = (\delta L_g + |m_g|)\, L_g ,

where L are the lengths of limbs, and the smooth matrix function f is 1 for x > 1. (Kovar, Schreiner and Gleicher 2002
lengthen legs for the same reason.) Steps of damped least squares (Wampler 1986, Nakamura and Hanafusa 1986) solve for
the remaining part of e,

.. math:: \sum_h A_{gh} \lambda_h + \big( \mu L_g^2 + |e_g| L_g \big) \lambda_g = e_g .

The second term of the damping bounds the second derivative of :math:`\tfrac12 |e|^2`, which Gauss-Newton omits. This
term vanishes with e. The number of steps is fixed, so that rotations depend smoothly on moves. With the chosen
:math:`\delta`, :math:`\mu`, f and l, joints of a leg have at most four times the acceleration of its end.

Residual moves, again called :math:`e_g`, stretch the limbs. The joint above part k opens by :math:`\tau_k`. These gaps
are the smallest with :math:`\sum_{k \in g} \tau_k = e_g`, which distributes the stretch of one limb evenly. With pivots
q, a child k of part j moves from c to

.. math:: c_k' = c_j' + \Omega_j (q_k - c_j) + \Omega_k (c_k - q_k) + \tau_k .

A part in n limbs is :math:`n^2` times as stiff, so that legs move rather than the body. In limbs of at least three
parts the part on the ground, and thus the sole, keeps its rotation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import SettingsError
from mixseq.mesh.rotations import rotate_vectors, rotvec_to_matrix
from mixseq.types import Float, FloatArray, Index


@dataclass(frozen=True, eq=False)
class Contact:
    """A named group of vertices that touch the ground together."""

    name: str  # name in messages and reports
    points: Float  # (k, 3) positions of the vertices at rest
    parts: Index  # (k,) part of each vertex
    # (T, k, 3) rest-space positions of the vertices in every frame; None for rigid parts.
    local_points: Float | None = None


@dataclass(frozen=True, eq=False)
class ArticulatedBody:
    """Rigid parts and the pivots between them."""

    centres: Float  # (p, 3) rest centres of the parts
    pairs: Index  # (n, 2) pairs of adjacent parts
    pivots: Float  # (n, 3) pivots of the pairs at rest
    root: int  # root of the tree of parts, such as the trunk

    @cached_property
    def parents(self) -> dict[int, tuple[int, int]]:
        """Parent and pivot of every part connected to the root, parents first."""
        parents: dict[int, tuple[int, int]] = {}
        queue = [self.root]
        for part in queue:  # breadth first: the list grows
            for pivot, (i, j) in enumerate(self.pairs.tolist()):
                neighbour = j if i == part else i
                if part in (i, j) and neighbour != self.root and neighbour not in parents:
                    parents[neighbour] = part, pivot
                    queue.append(neighbour)
        return parents

    def limb(self, contact: Contact) -> tuple[int, ...]:
        """Return the parts of a limb, from a child of the root to the lowest part common to all contact vertices."""
        name, parts = contact.name, np.unique(contact.parts).tolist()
        disconnected = [part for part in parts if part != self.root and part not in self.parents]
        if disconnected:
            raise SettingsError(
                f"vertices of contact '{name}' follow part {disconnected[0]}, which is not connected to the root; "
                "choose vertices of a foot"
            )
        chains = [self._chain(part) for part in parts]
        common = 0
        while all(len(chain) > common and chain[common] == chains[0][common] for chain in chains):
            common += 1
        if not common and parts != [self.root]:
            raise SettingsError(
                f"vertices of contact '{name}' are on several limbs (parts {', '.join(map(str, parts))}); "
                "give one contact for each foot"
            )
        return chains[0][:common]

    def gaps(self, rotations: Float, centres: Float) -> Float:
        """Return the gaps ``(n, 3)`` between paired parts at pivots: rotations ``(p, 3, 3)``; centres ``(p, 3)``."""
        first, second = (
            rotate_vectors(rotations[part], self.pivots - self.centres[part]) + centres[part] for part in self.pairs.T
        )
        return np.asarray(first - second)

    def pivot(self, part: int) -> Float:
        """Return the rest position ``(3,)`` of the pivot of a part."""
        return np.asarray(self.pivots[self.parents[part][1]])

    def pose_points(self, points: FloatArray, parts: Sequence[int] | Index, rotations: Float, centres: Float) -> Float:
        """Return the positions ``(T, k, 3)`` of rest points ``(k, 3)`` that follow parts ``(k,)``."""
        part_ids = np.asarray(parts, dtype=np.int64)
        arms = np.asarray(points, dtype=np.float64).reshape(-1, 3) - self.centres[part_ids]
        return rotate_vectors(rotations[:, part_ids], arms) + centres[:, part_ids]

    def contact_path(
        self, contact: Contact, rotations: Float, centres: Float, frames: Index | slice = slice(None)
    ) -> Float:
        """Return the vertices ``(T, k, 3)`` of a contact in given frames."""
        if contact.local_points is None:
            return self.pose_points(contact.points, contact.parts, rotations, centres)
        arms = contact.local_points[frames] - self.centres[contact.parts]
        return rotate_vectors(rotations[:, contact.parts], arms) + centres[:, contact.parts]

    def _chain(self, part: int) -> tuple[int, ...]:
        chain: list[int] = []
        while part != self.root:
            chain.insert(0, part)
            part = self.parents[part][0]
        return tuple(chain)


def leg_length(body: ArticulatedBody, contacts: Sequence[Contact]) -> float:
    """Return the total rest length of limbs, from their first pivot (or the root's centre) to the contacts' middles."""
    length = 0.0
    for contact in contacts:
        joints = [body.pivot(part) for part in body.limb(contact)] or [body.centres[body.root]]
        path = np.stack([*joints, contact.points.mean(axis=0)])
        length += float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
    return length


STRAIGHT_LIMB_TOLERANCE = 0.02  # delta: a limb of two equal bones bent by 23 degrees needs no stretch to shorten
DAMPING_RATIO = 0.01  # mu: damping, relative to the squared length of a limb
SOLVER_STEPS = 20  # number of damped least-squares steps


@dataclass(frozen=True, eq=False)
class LimbMotion:
    """Motions of all parts after inverse kinematics."""

    rotations: Float  # (T, p, 3, 3) rotations of all parts
    centres: Float  # (T, p, 3) centres of all parts
    limb_rotations: Float  # (T, k, 3, 3) rotations added to the limbs' parts, in world axes
    residual_moves: Float  # (T, g, 3) moves that rotations do not reach, made by stretching the limbs


def solve_limbs(
    body: ArticulatedBody, rotations: Float, centres: Float, contacts: Sequence[Contact], moves: Float
) -> LimbMotion:
    """Move contacts by inverse kinematics: rotations ``(T, p, 3, 3)``; centres ``(T, p, 3)``; moves ``(T, g, 3)``."""
    limbs = [body.limb(contact) for contact in contacts]
    parts = sorted({part for limb in limbs for part in limb})
    part_columns = [[parts.index(part) for part in limb] for limb in limbs]
    membership = np.zeros((len(limbs), len(parts)))
    for index, columns in enumerate(part_columns):
        membership[index, columns] = 1.0
    stretch_compliance = 1.0 / membership.sum(axis=0) ** 2
    compliance = stretch_compliance.copy()
    for columns in part_columns:
        if len(columns) > 2 and membership[:, columns[-1]].sum() == 1:
            compliance[columns[-1]] = 0.0

    limb_rotations = np.tile(np.eye(3), (len(moves), len(parts), 1, 1))
    residual_moves = np.zeros_like(moves)
    frames = np.flatnonzero(moves.any(axis=(1, 2)))
    levers = np.zeros((len(frames), *membership.shape, 3))
    poses = rotations[frames], centres[frames]
    for index, (limb, contact) in enumerate(zip(limbs, contacts, strict=True)):
        levers[:, index, part_columns[index]] = _levers(body, limb, contact, *poses, frames)
    limb_rotations[frames], residual_moves[frames] = rotate_limbs(levers, moves[frames], compliance)
    gram = membership * stretch_compliance @ membership.T
    distribution = stretch_compliance[:, None] * membership.T @ np.linalg.pinv(gram)
    stretches = np.einsum("kg,tgi->tki", distribution, residual_moves)
    limb_motions = {part: (limb_rotations[:, index], stretches[:, index]) for index, part in enumerate(parts)}
    moved = _forward_kinematics(body, rotations, centres, limb_motions)
    return LimbMotion(*moved, limb_rotations, residual_moves)


def _levers(
    body: ArticulatedBody,
    limb: tuple[int, ...],
    contact: Contact,
    rotations: Float,
    centres: Float,
    frames: NDArray[np.int64],
) -> Float:
    """Return the levers ``(N, k, 3)`` of a limb, from pivot to pivot and from the last pivot to the contact."""
    pivots = np.array([body.pivot(part) for part in limb]).reshape(-1, 3)
    joints = body.pose_points(pivots, limb, rotations, centres)
    contact_centre = body.contact_path(contact, rotations, centres, frames).mean(axis=1, keepdims=True)
    return np.diff(np.concatenate([joints, contact_centre], axis=1), axis=1)


def _forward_kinematics(
    body: ArticulatedBody, rotations: Float, centres: Float, limb_motions: dict[int, tuple[Float, Float]]
) -> tuple[Float, Float]:
    """Apply the world rotations and stretches of limb parts to a motion, from parents to children."""
    result_rotations, result_centres = rotations.copy(), centres.copy()
    identity, zero = np.eye(3), np.zeros(3)
    world_rotations: dict[int, Float] = {body.root: identity}
    for part, (parent, _) in body.parents.items():
        parent_rotation = world_rotations[parent]
        rotation, stretch = limb_motions.get(part, (parent_rotation, zero))
        world_rotations[part] = rotation
        pivot = body.pose_points(body.pivot(part), [part], rotations, centres)[:, 0]
        # Adding differences reproduces frames without rotations exactly.
        change = result_centres[:, parent] - centres[:, parent] + stretch
        change += rotate_vectors(parent_rotation - identity, pivot - centres[:, parent])
        change += rotate_vectors(rotation - identity, centres[:, part] - pivot)
        result_centres[:, part] += change
        result_rotations[:, part] = rotation @ rotations[:, part]
    return result_rotations, result_centres


def rotate_limbs(levers: Float, moves: Float, compliance: Float) -> tuple[Float, Float]:
    """Return the rotations ``(N, k, 3, 3)`` of limb parts that make given moves, and residual moves ``(N, g, 3)``.

    Shapes: levers ``(N, g, k, 3)``; moves ``(N, g, 3)``; compliance ``(k,)``.
    """
    count, limbs, parts, _ = levers.shape
    lengths = np.linalg.norm(levers, axis=3).sum(axis=2)
    lengths = np.where(lengths > 0, lengths, 1.0)  # a contact on the root has no limb
    rotations, rotated = np.tile(np.eye(3), (count, parts, 1, 1)), levers
    goals = _reachable_moves(_mobility(levers, compliance), moves, lengths)
    achieved, diagonal = np.zeros_like(moves), np.arange(3 * limbs)
    for _ in range(SOLVER_STEPS):
        residuals = goals - achieved
        damping = DAMPING_RATIO * lengths**2 + np.linalg.norm(residuals, axis=2) * lengths
        system = _mobility(rotated, compliance)
        system[:, diagonal, diagonal] += np.repeat(damping, 3, axis=1)
        multipliers = np.linalg.solve(system, residuals.reshape(count, -1, 1)).reshape(count, limbs, 1, 3)
        steps = rotvec_to_matrix(compliance[:, None] * np.cross(rotated, multipliers).sum(axis=1))
        rotations = steps @ rotations
        rotated = np.einsum("nkij,ngkj->ngki", rotations, levers)
        achieved = (rotated - levers).sum(axis=2)
    return rotations, moves - achieved


def _mobility(levers: Float, compliance: Float) -> Float:
    """Return the matrices A ``(N, 3g, 3g)`` of the module's formulas."""
    count, limbs, *_ = levers.shape
    dots = np.einsum("k,ngki,nhki->ngh", compliance, levers, levers)
    products = np.einsum("k,nhki,ngkj->ngihj", compliance, levers, levers)
    return np.asarray(np.einsum("ngh,ij->ngihj", dots, np.eye(3)) - products).reshape(count, 3 * limbs, -1)


def _reachable_moves(mobility: Float, moves: Float, lengths: Float) -> Float:
    """Return the parts e ``(N, g, 3)`` of moves that rotations can make without popping."""
    scale = np.sqrt((STRAIGHT_LIMB_TOLERANCE * lengths + np.linalg.norm(moves, axis=2)) * lengths)
    scale = np.repeat(scale, 3, axis=1)
    values, axes = np.linalg.eigh(mobility / (scale[:, :, None] * scale[:, None]))
    x = np.clip(values, 0.0, 1.0)
    components = np.einsum("nji,nj->ni", axes, moves.reshape(len(moves), -1) / scale)
    reachable = np.einsum("nij,nj->ni", axes, x * x * (3.0 - 2.0 * x) * components)
    return np.asarray(reachable * scale).reshape(moves.shape)
