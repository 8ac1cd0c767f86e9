"""The articulated body of a character: rigid parts, their pivots, and the limbs to its contacts.

In frame t part p has a rotation R and a centre c and moves a rest point y to :math:`R (y - m_p) + c`, with the rest
centre m. The parts are a tree: the parent of a part is the neighbour nearer to the root, and its *pivot* the point in
which they meet. The *limb* of a contact is the chain of parts from the child of the root to the contact. The length of
a leg is that of the path through the pivots of its limb.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mixseq.arrays import Float, FloatArray, Index
from mixseq.errors import SettingsError
from mixseq.geometry.rotations import turned


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
            turned(rotations[part], self.pivots - self.centres[part]) + centres[part] for part in self.pairs.T
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
        return turned(rotations[:, some], arms) + centres[:, some]

    def path(
        self, contact: Contact, rotations: Float, centres: Float, frames: Index | slice = slice(None)
    ) -> Float:
        """Return the vertices ``(T, k, 3)`` of a contact in frames of given motions."""
        if contact.local is None:
            return self.placed(contact.points, contact.parts, rotations, centres)
        arms = contact.local[frames] - self.centres[contact.parts]
        return turned(rotations[:, contact.parts], arms) + centres[:, contact.parts]

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
