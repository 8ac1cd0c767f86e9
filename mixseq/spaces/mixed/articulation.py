r"""Part poses relative to their bodies, and relations of neighbouring parts.

Adjacent parts form a *body*. Parts are adjacent if they share a boundary, or if their components touch in the reference
frame, as eyes and shoes do. The pose of a body is the rigid motion from the reference frame that fits its parts best,

.. math:: \min_{Q, C} \sum_i m_i s_i\, |Q\, (\bar c_i - \bar C) + C - c_i|^2 + m_i r_i^2 s'_i\, |Q - T_i|^2 ,

with the rotations :math:`T_i` of parts since the reference frame, their centres :math:`c_i`, numbers of vertices
:math:`m_i`, radii of gyration :math:`r_i`, and their `Steadiness`, without which a body jumps where heavy limbs turn
past a quarter turn. Relative to their body, parts have rotations :math:`t_i = Q^T T_i` and
centres :math:`Q^T (c_i - C)`. The *relation* of a part j to its neighbour i is the rotation :math:`t_i^T t_j` and the
position of the pivot of j, the middle of their boundary, in the axes of i. Relations are invariant under rigid motions.

Blended poses and blended relations are inconsistent. They are reconciled like the faces of joints
(`mixseq.spaces.mixed.joint_projection`). Rotations are averaged with weights :math:`m_i r_i^2`; centres then follow
from the pivots with weights :math:`m_i`. The matrices are constant.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from mixseq.mesh.measures import triangle_areas
from mixseq.mesh.nearest import attach_pieces
from mixseq.mesh.rigid import nearest_rotations
from mixseq.mesh.rotations import (
    continuous_rotvec,
    matrix_to_quat,
    normalise_quat,
    quat_conjugate,
    quat_multiply,
    quat_to_matrix,
    rotate_vectors,
)
from mixseq.mesh.topology import Topology, connected_components
from mixseq.runtime.lazy import cached_property
from mixseq.segmentation.elements import Boundaries
from mixseq.segmentation.joints import Decomposition
from mixseq.spaces.base import flatten_blocks
from mixseq.spaces.mixed import posing_kernels as kernels
from mixseq.spaces.mixed.joint_projection import RealOrComplex
from mixseq.spaces.temporal import Poses
from mixseq.types import Float, Index

CONTACT_DISTANCE = 0.1  # largest distance between touching components in the reference frame, in diagonals
MOTION_FLOOR = 1e-2  # root mean square motion added to all variances, in diagonals
STEADINESS_RANGE = (1e-8, MOTION_FLOOR**-2)  # range of inverse variances, in 1 / squared diagonals


class PartPoses(NamedTuple):
    """Part poses and relations in T frames: p parts and n relations of neighbours."""

    rotations: RealOrComplex  # (T, p, 4) quaternions of parts since the reference frame, in body axes
    centres: RealOrComplex  # (T, p, 3) centres of parts, in body axes
    relation_rotations: RealOrComplex  # (T, n, 4) quaternions of part j in the axes of part i
    relation_points: RealOrComplex  # (T, n, 3) pivots of part j in the axes of part i


class Steadiness(NamedTuple):
    """Inverse variances of part poses and relations over the frames, in 1 / squared diagonals."""

    turns: Float  # (p,) for rotations of parts in body axes, times their radii of gyration
    centres: Float  # (p,) for centres of parts in body axes
    relation_turns: Float  # (n,) for rotations between neighbours, times the smaller radius of gyration
    relation_points: Float  # (n,) for pivots in the axes of neighbours


@dataclass(frozen=True, eq=False)
class Articulation:
    """Bodies and neighbouring parts; made by `find_articulation`."""

    rest_centres: Float  # (p, 3) centres of the parts in the reference frame, in diagonals
    radii: Float  # (p,) radii of gyration of the parts, in diagonals
    masses: Float  # (p,) numbers of vertices of the parts
    areas: Float  # (p,) areas of the parts in the reference frame, in squared diagonals
    body_of_part: Index  # (p,) body of every part
    pairs: Index  # (n, 2) neighbouring parts i and j, every pair in both orders
    pivots: Float  # (n, 3) middles of the pairs' boundaries in the reference frame, relative to the centre of j
    steadiness: Steadiness  # inverse variances of poses and relations
    relation_weight: float = 1.0  # weight of a relation relative to its lighter part's pose

    @cached_property
    def body_count(self) -> int:
        """Number B of bodies."""
        return int(self.body_of_part.max(initial=-1)) + 1

    @cached_property
    def body_radii(self) -> Float:
        """Radii of gyration ``(B,)`` of the bodies in the reference frame, in diagonals."""
        offsets = self.rest_centres - self._body_means(self.rest_centres[None], self.masses)[0][self.body_of_part]
        squares = self.masses * (np.square(self.radii) + np.square(offsets).sum(axis=1))
        return np.sqrt(np.bincount(self.body_of_part, squares) / np.bincount(self.body_of_part, self.masses))

    @cached_property
    def _graph(self) -> sparse.csr_array:
        shape = len(self.radii), len(self.radii)
        return sparse.coo_array((np.ones(len(self.pairs)), tuple(self.pairs.T)), shape=shape).tocsr()

    @cached_property
    def parents(self) -> Index:
        """Parents ``(p,)`` in the tree of parts, -1 for roots; the root of a body is its part with the largest area."""
        result = np.full(len(self.radii), -1, dtype=np.int64)
        reached = np.zeros(len(self.radii), dtype=bool)
        for root in np.argsort(-self.areas, kind="stable"):
            if not reached[root]:
                order, predecessors = csgraph.breadth_first_order(self._graph, root, directed=False)
                result[order[1:]] = predecessors[order[1:]]
                reached[order] = True
        return result

    @cached_property
    def links(self) -> tuple[Index, Index]:
        """Parts ``(m,)`` with a parent, parents first, and their parents ``(m,)``."""
        order: list[int] = []
        level = np.flatnonzero(self.parents < 0)
        while len(level):
            level = np.flatnonzero(np.isin(self.parents, level))
            order += level.tolist()
        parts = np.array(order, dtype=np.int64)
        return parts, self.parents[parts]

    @cached_property
    def link_relations(self) -> Index:
        """Relation ``(m,)`` of each part of the tree to its parent."""
        parts, parents = self.links
        number = {(i, j): k for k, (i, j) in enumerate(self.pairs.tolist())}
        pairs = zip(parents.tolist(), parts.tolist(), strict=True)
        return np.array([number[pair] for pair in pairs], dtype=np.int64)

    @cached_property
    def _systems(self) -> tuple[Float, ...]:
        """Weights ``(p,)``, ``(n,)`` and inverse ``(p, p)`` for rotations; weights ``(n,)`` and inverse for centres."""
        steady, inertia = self.steadiness, self.masses * np.square(self.radii)
        _, *centres = self._weights_and_inverse(self.masses, steady.centres, steady.relation_points)
        return *self._weights_and_inverse(inertia, steady.turns, steady.relation_turns), *centres

    def _weights_and_inverse(self, sizes: Float, poses: Float, relations: Float) -> tuple[Float, ...]:
        """Weights of parts ``(p,)`` and relations ``(n,)``, and the inverse ``(p, p)`` of the weighted matrix."""
        i, j = self.pairs.T
        part_weights = sizes * poses
        relation_weights = self.relation_weight * np.minimum(sizes[i], sizes[j]) * relations
        matrix = np.diag(part_weights)
        np.add.at(matrix, (i, i), relation_weights)
        np.add.at(matrix, (j, j), relation_weights)
        np.add.at(matrix, (i, j), -relation_weights)
        np.add.at(matrix, (j, i), -relation_weights)
        return part_weights, relation_weights, np.asarray(np.linalg.inv(matrix))

    def fit_bodies(self, poses: Poses) -> Poses:
        """Fit poses ``(T, B)`` of bodies, with rotations since the reference, to part poses ``(T, p)``."""
        weights = self.masses * self.steadiness.centres
        centres, rest_centres = (self._body_means(each, weights) for each in (poses.centres, self.rest_centres[None]))
        offsets = poses.centres - centres[:, self.body_of_part]
        rest_offsets = self.rest_centres - rest_centres[0][self.body_of_part]
        moments = np.einsum("p,tpa,pb->tpab", weights, offsets, rest_offsets)
        turn_weights = self.masses * np.square(self.radii) * self.steadiness.turns
        moments += turn_weights[:, None, None] * quat_to_matrix(poses.rotations)
        return Poses(matrix_to_quat(nearest_rotations(self.body_sums(moments))), centres)

    def _body_means(self, centres: Float, weights: Float) -> Float:
        """Weighted means ``(T, B, 3)`` of the centres ``(T, p, 3)`` of parts."""
        return self.body_sums(weights[:, None] * centres) / np.bincount(self.body_of_part, weights)[:, None]

    def body_sums(self, values: Float) -> Float:
        """Sums ``(T, B, ...)`` of values ``(T, p, ...)`` of parts."""
        sums = np.zeros((len(values), self.body_count, *values.shape[2:]))
        for part, body in enumerate(self.body_of_part):
            sums[:, body] += values[:, part]
        return sums

    def to_body_axes(self, poses: Poses, bodies: Poses) -> Poses:
        """Return poses of parts ``(T, p)`` in the axes of their bodies ``(T, B)``."""
        back = quat_conjugate(normalise_quat(bodies.rotations))[:, self.body_of_part]
        offsets = poses.centres - bodies.centres[:, self.body_of_part]
        return Poses(quat_multiply(back, poses.rotations), rotate_vectors(quat_to_matrix(back), offsets))

    def to_world_axes(self, poses: Poses, bodies: Poses) -> Poses:
        """Return poses of parts in world axes; the inverse of `to_body_axes`."""
        rotations = normalise_quat(bodies.rotations)[:, self.body_of_part]
        centres = rotate_vectors(quat_to_matrix(rotations), poses.centres)
        centres += bodies.centres[:, self.body_of_part]
        return Poses(quat_multiply(rotations, poses.rotations), centres)

    def add_relations(self, poses: Poses) -> PartPoses:
        """Return poses ``(T, p)``, in any common axes, together with their relations."""
        i, j = self.pairs.T
        back = quat_conjugate(poses.rotations[:, i])
        pivots = rotate_vectors(quat_to_matrix(poses.rotations[:, j]), self.pivots) + poses.centres[:, j]
        points = rotate_vectors(quat_to_matrix(back), pivots - poses.centres[:, i])
        return PartPoses(*poses, quat_multiply(back, poses.rotations[:, j]), points)

    def reconcile(self, poses: PartPoses) -> Poses:
        """Return the part poses ``(T, p)`` that fit poses and relations ``(T, ...)`` best."""
        frames = [self._reconcile_frame(PartPoses(*frame)) for frame in zip(*poses, strict=True)]
        rotations, centres = (np.stack(arrays) for arrays in zip(*frames, strict=True))
        return Poses(rotations, centres)

    def _reconcile_frame(self, poses: PartPoses) -> tuple[RealOrComplex, RealOrComplex]:
        """Return the part poses ``(p, 4)``, ``(p, 3)`` that best fit the poses and relations of one frame."""
        graph = self.pairs, self.pivots, *self.links, self.link_relations
        arrays = *map(np.ascontiguousarray, poses), *graph, *self._systems
        return kernels.reconcile_poses(*arrays)

    def measure_steadiness(self, poses: PartPoses) -> Steadiness:
        """Return the inverse variances of part poses and relations over frames ``(T, ...)``."""
        i, j = self.pairs.T
        radii = self.radii, np.minimum(self.radii[i], self.radii[j])
        result = []
        for rotations, points, radius in zip(poses[::2], poses[1::2], radii, strict=True):
            mean = normalise_quat(rotations.mean(axis=0))
            cosines = np.minimum(np.abs(np.einsum("tpi,pi->tp", rotations, mean)), 1.0)
            arcs = 2.0 * np.arccos(cosines) * radius
            distances = np.linalg.norm(points - points.mean(axis=0), axis=2)
            variances = (np.square(sizes).mean(axis=0) + MOTION_FLOOR**2 for sizes in (arcs, distances))
            result += [np.clip(1.0 / variance, *STEADINESS_RANGE) for variance in variances]
        return Steadiness(*result)

    def pose_corrections(self, poses: Poses, targets: Poses) -> Float:
        """Return rotation vectors and shifts ``(T, 6 p)`` that move poses to targets, continuous in time."""
        changes = quat_multiply(quat_conjugate(poses.rotations), targets.rotations)
        rotation_vectors = continuous_rotvec(quat_to_matrix(changes))
        shifts = targets.centres - poses.centres
        return flatten_blocks((rotation_vectors, shifts))

    def part_motions(
        self, poses: PartPoses, bodies: tuple[RealOrComplex, RealOrComplex], correction: RealOrComplex
    ) -> RealOrComplex:
        """Return the motions of parts in one frame as unit dual quaternions ``(p, 8)``.

        Shapes: bodies ``(B, 4), (B, 3)``; correction ``(6 p,)``.
        """
        rotations, centres = self._reconcile_frame(poses)
        rotation_vectors, shifts = correction.reshape(2, -1, 3)
        rotations, centres = kernels.correct_poses(rotations, centres, rotation_vectors, shifts)
        rest = self.body_of_part, self.rest_centres
        return kernels.part_motions(rotations, centres, *bodies, *rest, *self.links)


def find_articulation(
    topology: Topology,
    decomposition: Decomposition,
    reference: Float,
    rest_centres: Float,
    radii: Float,
    steadiness: Steadiness | None = None,
    relation_weight: float = 1.0,
) -> Articulation:
    """Find bodies and neighbouring parts: reference ``(V, 3)``, rest centres and radii ``(p, 3), (p,)``, in diagonals.

    Without steadiness, all poses and relations have unit weights; `relation_weight` multiplies relation weights.
    """
    labels, count = decomposition.part_of_face, len(decomposition.parts)
    boundaries = Boundaries.from_labels(topology, labels)
    pairs, pivots = boundaries.parts, boundaries.middles(reference)
    areas = np.bincount(labels, triangle_areas(reference, topology.faces), minlength=count).astype(np.float64)
    component = connected_components(count, pairs)
    part_of_vertex = np.full(topology.vertex_count, -1, dtype=np.int64)
    for number, part in enumerate(decomposition.parts):
        part_of_vertex[part] = number
    part_of_vertex[topology.faces] = labels[:, None]
    pieces = [
        np.flatnonzero((part_of_vertex >= 0) & (component[part_of_vertex] == piece))
        for piece in range(component.max(initial=-1) + 1)
    ]
    contacts = attach_pieces(pieces, reference, np.arange(len(reference)))
    contact_vertices = np.stack([contacts.vertices, contacts.holder_vertices], axis=1)
    touching = np.linalg.norm(np.diff(reference[contact_vertices], axis=1)[:, 0], axis=1) <= CONTACT_DISTANCE
    pairs = np.concatenate([pairs, part_of_vertex[contact_vertices[touching]]])
    pivots = np.concatenate([pivots, reference[contact_vertices[touching]].mean(axis=1)])
    pairs, pivots = np.concatenate([pairs, pairs[:, ::-1]]), np.tile(pivots, (2, 1))
    return Articulation(
        rest_centres=rest_centres,
        radii=radii,
        masses=np.array([len(part) for part in decomposition.parts], dtype=np.float64),
        areas=areas,
        body_of_part=connected_components(count, pairs),
        pairs=pairs,
        pivots=pivots - rest_centres[pairs[:, 1]],
        steadiness=steadiness or Steadiness(*np.ones((2, count)), *np.ones((2, len(pairs)))),
        relation_weight=relation_weight,
    )
