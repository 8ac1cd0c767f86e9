r"""Limbs: a part with all that hangs on it, and what it takes to move it in its joint.

The parts of a component are a tree by their links: the root is the largest part, every other part hangs on its
*parent*, one link nearer to the root. The *stance* of a limb is what the link says of part and parent, a turn
:math:`\tau` and a gap g at the pivot (`mixseq.reconstruction.links`),

.. math:: R_i^T R_j = \bar Q \exp(\tau), \qquad R_j p_j + t_j = R_i (p_i + g) + t_i .

Another stance moves the part, from :math:`(R, t)` to :math:`(R', t')`, and the whole limb with it as one rigid body,
:math:`x \to R' R^T (x - t) + t'`. A placement states poses more than once, and between frames the statements disagree.
So all that is stated is moved, by the same motion: where this is the identity, nothing changes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph

from mixseq.errors import SettingsError
from mixseq.geometry.rotations import continuous_vectors, matrices
from mixseq.reconstruction.agreement import solve
from mixseq.reconstruction.anchored import AnchoredPlacement
from mixseq.reconstruction.links import Poses
from mixseq.signals.curve import Curve
from mixseq.signals.model import Model
from mixseq.spaces.mixed import MixedSpace

Float = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]


STRIPS = 4
"""Over so many edges the coordinates of a joint pass from one border of parts to another."""


@dataclass(frozen=True, eq=False)
class Limb:
    """A part of a body and all parts that hang on it.

    Attributes
    ----------
    space : MixedSpace
        Tells of parts and links.
    part : int
        The part.
    parts : (p,) bool
        It and what hangs on it.
    link : int
        The link that it hangs on.
    """

    space: MixedSpace
    part: int
    parts: Mask
    link: int

    def stance(self, whole: Curve, times: Float) -> Float:
        """Return turns and gaps ``(N, 6)`` of the limb in a whole placement at times ``(N,)``, turns unwrapped."""
        links, link, stated = self.space.links, self.link, self._stated(whole, times)
        rotations, places = solve(links, stated)
        i, j = links.parts[link]
        back = _transposed(rotations[:, i])
        turned = links.rests[link].T @ back @ rotations[:, j]
        turns = continuous_vectors(turned[None], stated.turns[:, link])[0]
        pivot = _applied(rotations[:, j], links.pivots[link, 1]) + places[:, j]
        gaps = _applied(back, pivot - places[:, i]) - links.pivots[link, 0]
        return np.concatenate([turns, gaps], axis=1)

    def moved(self, whole: Curve, times: Float, stance: Float) -> Float:
        """Return whole placements ``(N, P)`` at increasing times with another stance ``(N, 6)`` of the limb."""
        links, stated = self.space.links, self._stated(whole, times)
        poses = solve(links, stated)
        motion = self._motion(*poses, stance)
        limb = self.parts
        rotations, translations = stated.rotations.copy(), stated.translations.copy()
        turned, places = motion.of(matrices(rotations[:, limb]), translations[:, limb])
        rotations[:, limb] = continuous_vectors(turned, rotations[0, limb])
        translations[:, limb] = places

        inside = limb[links.parts]
        cut = np.flatnonzero(inside[:, 0] != inside[:, 1])
        turns, gaps = stated.turns.copy(), stated.gaps.copy()
        relative, gaps[:, cut] = self._moved_links(motion, poses, stated, cut)
        turns[:, cut] = continuous_vectors(_transposed(links.rests[cut]) @ relative, turns[0, cut])
        blocks = (rotations, translations, turns, gaps)
        return np.concatenate([block.reshape(len(times), -1) for block in blocks], axis=1)

    def joint(self) -> Float:
        """Return how much ``(S + O,)`` coordinates of key shapes belong to the joints between limb and body.

        1 for lengths, angles and offsets at vertices that are near the border of the limb, 0 near other borders of
        parts, and in between where a joint is that of several borders. 0 for the vertices of parts.
        """
        space, topology = self.space, self.space.topology
        sides = space.decomposition.part_of_face[topology.hinge_faces]
        ours = self.parts[sides[:, 0]] != self.parts[sides[:, 1]]
        others = (sides[:, 0] != sides[:, 1]) & ~ours
        own, other = self._away(ours), self._away(others)
        closer = np.where(np.isfinite(own), other, 0.0) - np.where(np.isfinite(own), own, np.inf)
        near = np.clip(0.5 + closer / STRIPS, 0.0, 1.0)
        along = near[topology.edges].mean(axis=1)
        edges, hinges = space.projection.edge_ids, topology.hinge_edges[space.projection.hinge_ids]
        offsets = np.zeros(0)
        if isinstance(space.projection, AnchoredPlacement):
            offsets = np.repeat(near[space.projection.rows.free], 3)
        return np.concatenate([along[edges], along[hinges], np.zeros(3 * len(space.shapes)), offsets])

    def own_shape(self) -> Float:
        """Return 1 for the coordinates ``(S + O,)`` of key shapes that are vertices of the part, 0 elsewhere."""
        space = self.space
        sizes = [len(vertices) for vertices in space.decomposition.parts]
        own = np.repeat(np.repeat(np.arange(len(sizes)) == self.part, sizes), 3).astype(np.float64)
        return np.pad(own, (sum(space.sizes[:2]), space.offset_dim))

    def _away(self, hinges: Mask) -> Float:
        """How many edges all vertices ``(V,)`` are away from hinges."""
        topology = self.space.topology
        start = np.unique(topology.edges[topology.hinge_edges[hinges]])
        if not len(start):
            return np.full(topology.vertex_count, np.inf)
        graph = topology.vertex_adjacency
        return np.asarray(csgraph.dijkstra(graph, indices=start, unweighted=True, min_only=True))

    def _stated(self, whole: Curve, times: Float) -> Poses:
        ends = np.cumsum(self.space.sizes[3:])[:-1]
        return Poses(*(block.reshape(len(times), -1, 3) for block in np.split(whole(times), ends, axis=1)))

    def _motion(self, rotations: Float, places: Float, stance: Float) -> _Motion:
        links, (i, j) = self.space.links, self.space.links.parts[self.link]
        relative = links.rests[self.link] @ matrices(stance[:, :3])
        near, far = links.pivots[self.link, 0] + stance[:, 3:], links.pivots[self.link, 1]
        if self.part == j:
            turned = rotations[:, i] @ relative
            place = _applied(rotations[:, i], near) + places[:, i] - _applied(turned, far)
        else:
            turned = rotations[:, j] @ _transposed(relative)
            place = _applied(rotations[:, j], far) + places[:, j] - _applied(turned, near)
        return _Motion(turned @ _transposed(rotations[:, self.part]), places[:, self.part], place)

    def _moved_links(
        self, motion: _Motion, poses: tuple[Float, Float], stated: Poses, cut: Index
    ) -> tuple[Float, Float]:
        """Relative rotations ``(N, c, 3, 3)`` and gaps ``(N, c, 3)`` of links between the limb and the rest.

        What the statement of a link is off by turns with the limb.
        """
        links = self.space.links
        i, j = links.parts[cut].T
        (first, second), (place, _) = ((block[:, i], block[:, j]) for block in poses)
        relative = links.rests[cut] @ matrices(stated.turns[:, cut])
        moved = motion.of(*poses)
        inside = self.parts[i]
        turn = motion.turn[:, None]
        relative = np.where(
            inside[:, None, None],
            relative @ _transposed(second) @ _transposed(turn) @ second,
            _transposed(first) @ turn @ first @ relative,
        )
        near, far = links.pivots[cut, 0], links.pivots[cut, 1]
        here = _applied(first, near + stated.gaps[:, cut]) + place
        there = _applied(second, far) + poses[1][:, j]
        goal = np.where(inside[:, None], there + _applied(turn, here - there), motion.of_points(here))
        frames = np.where(inside[:, None, None], moved[0][:, i], first)
        origins = np.where(inside[:, None], moved[1][:, i], place)
        return relative, _applied(_transposed(frames), goal - origins) - near


class _Motion(NamedTuple):
    """Rigid motions: by rotations `turn` ``(N, 3, 3)``, and from points `origin` ``(N, 3)`` to points `goal`."""

    turn: Float
    origin: Float
    goal: Float

    def of(self, rotations: Float, places: Float) -> tuple[Float, Float]:
        """Poses ``(N, g, 3, 3)``, ``(N, g, 3)`` as moved."""
        return self.turn[:, None] @ rotations, self.of_points(places)

    def of_points(self, points: Float) -> Float:
        """Points ``(N, g, 3)`` as moved."""
        return _applied(self.turn[:, None], points - self.origin[:, None]) + self.goal[:, None]


def limb_of(model: Model, part: int) -> Limb:
    """Return the limb of a part.

    Raises
    ------
    SettingsError
        If the model has no linked parts, the part is none of them, or hangs on no other.
    """
    space, count = model.space, len(model.decomposition.parts)
    if not isinstance(space, MixedSpace) or space.placement != "anchored":
        raise SettingsError(
            "parts are linked in the anchored placement only; fit a model with placement='anchored'"
        )
    if not 0 <= part < count:
        raise SettingsError(f"there is no part {part}; the model has {count}, from 0 on")
    above = parents(space)
    parent = int(above[part])
    if parent < 0:
        linked = bool((space.links.parts == part).any())
        why = "is the root, which others hang on" if linked else "has no neighbours"
        raise SettingsError(f"part {part} {why}; give a part that hangs on another one")
    parts = np.zeros(count, dtype=bool)
    parts[part] = True
    for _ in range(count):
        parts |= (above >= 0) & parts[above]
    link = np.flatnonzero((space.links.parts == sorted((part, parent))).all(axis=1))
    return Limb(space, part, parts, int(link[0]))


def parents(space: MixedSpace) -> Index:
    """Return the part ``(p,)`` that every part hangs on, -1 for the roots: the parts with most area."""
    faces, labels = space.topology.faces, space.decomposition.part_of_face
    a, b, c = np.moveaxis(space.reference[faces], 1, 0)
    count = len(space.decomposition.parts)
    areas = np.bincount(labels, np.linalg.norm(np.cross(b - a, c - a), axis=1), minlength=count)
    i, j = space.links.parts.T
    graph = sparse.coo_array((np.ones(len(i)), (i, j)), shape=(count, count)).tocsr()
    result = np.full(count, -1, dtype=np.int64)
    reached = np.zeros(count, dtype=bool)
    for root in np.argsort(-areas, kind="stable"):
        if not reached[root]:
            order, above = csgraph.breadth_first_order(graph, root, directed=False)
            result[order[1:]] = above[order[1:]]
            reached[order] = True
    return result


def _transposed(rotations: Float) -> Float:
    return np.swapaxes(rotations, -1, -2)


def _applied(rotations: Float, vectors: Float) -> Float:
    return np.asarray(np.einsum("...ij,...j->...i", rotations, vectors))
