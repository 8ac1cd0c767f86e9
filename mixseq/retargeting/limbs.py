r"""The articulated body of a character (rigid parts, their pivots, limbs to its contacts), and its inverse kinematics.

In frame t part p has a rotation R and a centre c and moves a rest point y to :math:`R (y - m_p) + c`, with the rest
centre m. The parts are a tree: the parent of a part is the neighbour nearer to the root, and its *pivot* the point in
which they meet. The *limb* of a contact is the chain of parts from the child of the root to the contact. The length of
a leg is that of the path through the pivots of its limb.

*Inverse kinematics* rotates the parts of limbs about their pivots until contacts reach their targets. The end g of a
limb is the root's pivot plus a sum of *levers* :math:`u_{gk}`, one per part k: from its pivot to the next one, and from
the last pivot to the end. Part k rotates by :math:`\Omega_k`, in the world's axes, with all its levers, so that the end
moves by :math:`\sum_k (\Omega_k - 1)\, u_{gk}`. Small rotations :math:`\omega_k = w_k \sum_g u_{gk} \times \lambda_g`,
least squares by compliances w, move ends by

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
    points: Float  # (k, 3) the vertices at rest
    parts: Index  # (k,) the part of each vertex
    # (T, k, 3) the vertices frame by frame, as their parts at rest see them, if the parts do not only move rigidly.
    local: Float | None = None


@dataclass(frozen=True, eq=False)
class ArticulatedBody:
    """Rigid parts and the pivots between them."""

    centres: Float  # (p, 3) rest centres of the parts
    pairs: Index  # (n, 2) pairs of adjacent parts
    pivots: Float  # (n, 3) where they meet, at rest
    root: int  # root of the tree of parts, the body itself

    @cached_property
    def parents(self) -> dict[int, tuple[int, int]]:
        """Parent and pivot number of every part that is connected to the root, from the root on."""
        result: dict[int, tuple[int, int]] = {}
        reached = [self.root]
        for part in reached:  # breadth first: the list grows
            for pivot, (i, j) in enumerate(self.pairs.tolist()):
                other = j if i == part else i
                if part in (i, j) and other != self.root and other not in result:
                    result[other] = part, pivot
                    reached.append(other)
        return result

    def limb(self, contact: Contact) -> tuple[int, ...]:
        """Return the chain of parts from the root's child to the lowest common one of a contact's vertices."""
        name, parts = contact.name, np.unique(contact.parts).tolist()
        if not parts or contact.points.shape != (len(contact.parts), 3):
            raise SettingsError(
                f"contact '{name}' has {len(contact.points)} vertices and {len(contact.parts)} parts; "
                "give at least one vertex, and the part that carries each"
            )
        loose = [part for part in parts if part != self.root and part not in self.parents]
        if loose:
            what = "no part" if loose[0] < 0 else f"part {loose[0]}, which nothing links to the root"
            raise SettingsError(f"vertices of contact '{name}' follow {what}; name vertices of a foot")
        chains = [self._chain(part) for part in parts]
        common = 0
        while all(len(chain) > common and chain[common] == chains[0][common] for chain in chains):
            common += 1
        if not common and parts != [self.root]:
            raise SettingsError(
                f"vertices of contact '{name}' are on several limbs (parts {', '.join(map(str, parts))}); "
                "name one contact for each foot"
            )
        return chains[0][:common]

    def gaps(self, rotations: Float, centres: Float) -> Float:
        """Return the gaps ``(n, 3)`` of pairs at their pivots: rotations, centres ``(p, 3, 3), (p, 3)``."""
        first, second = (
            rotate_vectors(rotations[part], self.pivots - self.centres[part]) + centres[part]
            for part in self.pairs.T
        )
        return np.asarray(first - second)

    def pivot(self, part: int) -> Float:
        """Return the rest point ``(3,)`` of the pivot of a part."""
        return np.asarray(self.pivots[self.parents[part][1]])

    def placed(
        self, points: FloatArray, parts: Sequence[int] | Index, rotations: Float, centres: Float
    ) -> Float:
        """Return the positions ``(T, k, 3)`` of rest points ``(k, 3)`` of parts ``(k,)`` in all frames."""
        some = np.asarray(parts, dtype=np.int64)
        arms = np.asarray(points, dtype=np.float64).reshape(-1, 3) - self.centres[some]
        return rotate_vectors(rotations[:, some], arms) + centres[:, some]

    def path(
        self, contact: Contact, rotations: Float, centres: Float, frames: Index | slice = slice(None)
    ) -> Float:
        """Return the vertices ``(T, k, 3)`` of a contact in frames of given motions."""
        if contact.local is None:
            return self.placed(contact.points, contact.parts, rotations, centres)
        arms = contact.local[frames] - self.centres[contact.parts]
        return rotate_vectors(rotations[:, contact.parts], arms) + centres[:, contact.parts]

    def _chain(self, part: int) -> tuple[int, ...]:
        chain: list[int] = []
        while part != self.root:
            chain.insert(0, part)
            part = self.parents[part][0]
        return tuple(chain)


def leg_length(body: ArticulatedBody, contact: Contact) -> float:
    """Return the rest length from the root's pivot (or centre) through the limb's pivots to the middle of a contact."""
    limb = body.limb(contact)
    joints = [body.pivot(part) for part in limb] or [body.centres[body.root]]
    way = np.stack([*joints, contact.points.mean(axis=0)])
    return float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum())


def leg_ratio(
    source: ArticulatedBody,
    target: ArticulatedBody,
    source_contacts: Sequence[Contact],
    target_contacts: Sequence[Contact],
) -> float:
    """Return the ratio of the target's leg lengths to the source's, the scale of strides."""
    if not source_contacts or len(source_contacts) != len(target_contacts):
        raise SettingsError(
            f"there are {len(source_contacts)} contacts of the source and {len(target_contacts)} of the target; "
            "give as many, and at least one"
        )
    ours = sum(leg_length(target, contact) for contact in target_contacts)
    theirs = sum(leg_length(source, contact) for contact in source_contacts)
    if not theirs > 0:
        raise SettingsError(
            "the legs of the source have no length; name contacts away from the root's pivots"
        )
    return ours / theirs


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
        change += rotate_vectors(carried - identity, pivot - centres[:, above])
        change += rotate_vectors(turn - identity, centres[:, part] - pivot)
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
        turns = rotvec_to_matrix(compliance[:, None] * np.cross(lever, multipliers).sum(axis=1)) @ turns
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
