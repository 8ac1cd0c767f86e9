r"""Links between neighbouring parts: what keeps parts together between frames.

Every part has a pose :math:`(R_i, t_i)` of its own. Between frames, poses that are interpolated each on its own drift
apart. So a link between two parts that share a boundary states over again, frame by frame, how they stand to each
other: the *turn*, a rotation vector, and the *gap* at a pivot with coordinates :math:`p_i, p_j` in the parts,

.. math::

    R_i^T R_j = \bar Q\, \exp(\mathrm{turn}), \qquad \mathrm{gap} = R_i^T (R_j p_j + t_j - R_i p_i - t_i) .

A rigid motion of both parts changes neither. The pivot is where the gap moves least over the sequence, near the middle
of the boundary where the sequence leaves it free (:math:`c_i, c_j`, by a term of weight `PRIOR`):

.. math:: \sum_f |p_i - R_i^T R_j\, p_j - R_i^T (t_j - t_i)|^2 + \mathrm{PRIOR}\, (|p_i - c_i|^2 + |p_j - c_j|^2)

Interpolated own poses, turns and gaps disagree; `agreement` finds the poses that agree with all of them best. How much
each counts is measured on the sequence, see `weigh`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixseq.geometry.rigid import nearest_rotations
from mixseq.geometry.rotations import continuous_vectors, matrices
from mixseq.reconstruction.prediction import mean_squared_errors
from mixseq.sequence import FloatArray
from mixseq.topology import Topology

Float = NDArray[np.float64]
Index = NDArray[np.int64]

PRIOR = 0.01
"""Weight of the middle of the boundary against the motion, in a pivot's fit: they are equal for turns of 6 degrees."""

LINKED = 0.1
"""Weight of links against own poses of equal error. Errors of neighbours go together, so a link knows less."""

FLOOR = 1e-3
"""Errors below this, in diagonals, are all the same."""


class Poses(NamedTuple):
    """Poses of p parts and n links in N frames, or their derivatives by time.

    Attributes
    ----------
    rotations, translations : (N, p, 3)
        Own rotation vectors and centres.
    turns, gaps : (N, n, 3)
        Turns and gaps of the links.
    """

    rotations: Float
    translations: Float
    turns: Float
    gaps: Float


@dataclass(frozen=True, eq=False)
class Links:
    r"""Pairs of neighbouring parts, and how well each is held.

    Attributes
    ----------
    parts : (n, 2) int64
        The parts i < j of every link.
    pivots : (n, 2, 3) float64
        The pivot in the coordinates of part i and of part j, in diagonals.
    rests : (n, 3, 3) float64
        Mean relative rotation, :math:`\bar Q`.
    own_weights : (p, 2) float64
        Weights u, v of the own rotation (per squared radian) and centre (per squared diagonal) of every part.
    weights : (n, 2) float64
        Weights :math:`\rho, \tau` of turn and gap of every link, in the same units.
    """

    parts: Index
    pivots: Float
    rests: Float
    own_weights: Float
    weights: Float

    def __len__(self) -> int:
        """Return the number n of links."""
        return len(self.parts)

    @classmethod
    def none(cls, parts: int) -> Links:
        """Return no links at all between p parts."""
        return cls(
            np.zeros((0, 2), dtype=np.int64),
            np.zeros((0, 2, 3)),
            np.zeros((0, 3, 3)),
            np.ones((parts, 2)),
            np.zeros((0, 2)),
        )


@dataclass(frozen=True, eq=False)
class Boundaries:
    """Where neighbouring parts meet: a link is made for each pair.

    Attributes
    ----------
    parts : (n, 2) int64
        The parts i < j.
    edges : (k, 2) int64
        Vertices of the edges between faces of two parts.
    link : (k,) int64
        The pair of parts that each edge is between.
    """

    parts: Index
    edges: Index
    link: Index

    @classmethod
    def of(cls, topology: Topology, part_of_face: Index) -> Boundaries:
        """Find the boundaries between the parts ``(F,)`` of all faces: where faces of two parts meet in a hinge."""
        sides = np.sort(part_of_face[topology.hinge_faces], axis=1)
        across = sides[:, 0] != sides[:, 1]
        parts, link = np.unique(sides[across], axis=0, return_inverse=True)
        edges = topology.edges[topology.hinge_edges[across]]
        return cls(parts.astype(np.int64).reshape(-1, 2), edges, link.reshape(-1))

    def middles(self, frame: FloatArray) -> Float:
        """Return the middles ``(n, 3)`` of the boundaries in a frame ``(V, 3)``: means of the middles of edges."""
        middles = frame[self.edges].mean(axis=1)
        sums = [np.bincount(self.link, column, minlength=len(self.parts)) for column in middles.T]
        return np.stack(sums, axis=1) / np.bincount(self.link, minlength=len(self.parts))[:, None]


def make_links(parts: Index, middles: Float, rotations: Float, translations: Float, radii: Float) -> Links:
    """Find the links of a sequence.

    Parameters
    ----------
    parts : (n, 2) int64
        Pairs of parts that are neighbours, as `Boundaries` has them.
    middles : (T, n, 3)
        The middles of their boundaries, in diagonals.
    rotations : (T, p, 3)
        Rotation vectors of the parts, unwrapped.
    translations : (T, p, 3)
        Centres of the parts.
    radii : (p,)
        Their radii of gyration.
    """
    if not len(parts):
        return Links.none(rotations.shape[1])
    turned = matrices(rotations)
    relative, shift = _relative(parts, turned, translations)
    i, j = parts.T
    near = np.einsum("tnji,tnj->tni", turned[:, i], middles - translations[:, i]).mean(axis=0)
    far = np.einsum("tnji,tnj->tni", turned[:, j], middles - translations[:, j]).mean(axis=0)
    mean = relative.mean(axis=0)
    system = (1.0 + PRIOR) * np.tile(np.eye(6), (len(parts), 1, 1))
    system[:, :3, 3:], system[:, 3:, :3] = -mean, -np.swapaxes(mean, 1, 2)
    back = np.einsum("tnji,tnj->tni", relative, shift).mean(axis=0)
    right = np.concatenate([shift.mean(axis=0) + PRIOR * near, PRIOR * far - back], axis=1)
    pivots = np.linalg.solve(system, right[:, :, None]).reshape(-1, 2, 3)

    equal = np.ones((rotations.shape[1], 2)), np.ones((len(parts), 2))
    links = Links(parts, pivots, nearest_rotations(mean), *equal)
    own_weights, weights = weigh(links, complete(links, rotations, translations), radii)
    return Links(links.parts, pivots, links.rests, own_weights, weights)


def weigh(links: Links, poses: Poses, radii: Float) -> tuple[Float, Float]:
    """Return own weights ``(p, 2)`` and weights of the links ``(n, 2)``: one over the squared errors of prediction.

    The same curve through the frames before and after predicts every frame. How far it is off tells how well the
    curve is known between frames. Links count by the factor `LINKED` less.
    """
    smallest = np.minimum(*radii[links.parts.T]) if len(links) else np.zeros(0)
    own = [
        mean_squared_errors(poses.rotations) + (FLOOR / radii) ** 2,
        mean_squared_errors(poses.translations) + FLOOR**2,
    ]
    linked = [
        mean_squared_errors(poses.turns) + (FLOOR / smallest) ** 2,
        mean_squared_errors(poses.gaps) + FLOOR**2,
    ]
    return 1.0 / np.stack(own, axis=1), LINKED / np.stack(linked, axis=1)


def complete(links: Links, rotations: Float, translations: Float, previous: Float | None = None) -> Poses:
    """State the poses of parts over again by links.

    Parameters
    ----------
    links : Links
        The links.
    rotations, translations : (N, p, 3)
        Own rotation vectors and centres in consecutive frames.
    previous : (n, 3), optional
        Turns of the frame before the first one, which the turns go on from; the shortest without it.
    """
    turned = matrices(rotations)
    relative, shift = _relative(links.parts, turned, translations)
    turns = continuous_vectors(np.swapaxes(links.rests, 1, 2) @ relative, previous)
    p, q = links.pivots[:, 0], links.pivots[:, 1]
    return Poses(rotations, translations, turns, np.einsum("tnij,nj->tni", relative, q) + shift - p)


def _relative(parts: Index, rotations: Float, translations: Float) -> tuple[Float, Float]:
    """Rotations ``(N, n, 3, 3)`` and centres ``(N, n, 3)`` of the parts j in the coordinates of the parts i."""
    i, j = parts.T
    back = np.swapaxes(rotations[:, i], -1, -2)
    return back @ rotations[:, j], np.einsum("tnij,tnj->tni", back, translations[:, j] - translations[:, i])
