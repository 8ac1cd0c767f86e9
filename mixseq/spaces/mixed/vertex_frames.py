r"""A rigid frame for every vertex, blended from the poses of the parts around it.

A vertex well inside a part moves with that part. Near other parts it has a share in each of their motions (`shares`).
Motions from the reference frame are blended as dual quaternions (Kavan and others 2008), so that the blend is a rigid
motion again and changes smoothly from vertex to vertex.

Quaternions have two signs, and blends depend on them. Along a tree of neighbouring parts each has the sign nearest to
that of the part before it: no neighbours turn against each other by half a turn, while parts that are farther apart
may.

Seen from its frame a vertex hardly moves. It is *unposed*, :math:`R_v^T (x_v - t_v)`: where it would be in the
reference frame. Whatever the shares are, posing what was unposed gives the vertex back.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph

from mixseq.arrays import Float, Index
from mixseq.geometry.rotations import inverse, normalised, product, quaternions, rotations_of, turned
from mixseq.pickling import PickledWithoutCaches
from mixseq.prediction.poses import Neighbours, Poses
from mixseq.segmentation.boundaries import Boundaries
from mixseq.segmentation.joints import Decomposition
from mixseq.spaces.mixed import vertex_frame_kernels as kernels
from mixseq.topology import Topology

BEND = 10.0
"""A face bends if the frames of its corners differ by more than so many degrees. Ours; chosen on half of the animations
of the benchmarks."""


@dataclass(frozen=True, eq=False)
class VertexFrames(PickledWithoutCaches):
    """How vertices follow p parts.

    Attributes
    ----------
    topology : Topology
        Connectivity of the mesh.
    decomposition : Decomposition
        Its parts.
    rest : Poses
        Poses of the parts in the reference frame, ``(1, p, 4)`` and ``(1, p, 3)``.
    shares : (V, p) sparse matrix
        How much vertices follow parts; rows add up to one.
    """

    topology: Topology
    decomposition: Decomposition
    rest: Poses
    shares: sparse.csr_array

    @cached_property
    def alone(self) -> Index:
        """The part ``(V,)`` that each vertex follows alone, -1 where several have a share."""
        first = self.shares.indices[self.shares.indptr[:-1]]
        return np.where(np.diff(self.shares.indptr) == 1, first, -1).astype(np.int64)

    def bent(self, motions: Float) -> NDArray[np.bool_]:
        """Mark the faces ``(F,)`` whose corners' frames differ by more than `BEND` in motions ``(V, 7)``."""
        corners = motions[self.topology.faces[self._blended], :4]
        cosines = np.abs(np.einsum("fki,fki->fk", corners, np.roll(corners, -1, axis=1)))
        bent = np.zeros(len(self.topology.faces), dtype=bool)
        bent[self._blended] = (cosines < np.cos(np.radians(BEND) / 2.0)).any(axis=1)
        return bent

    @cached_property
    def _blended(self) -> Index:
        """The faces whose corners do not all follow one and the same part alone."""
        a, b, c = self.alone[self.topology.faces].T
        return np.flatnonzero((a < 0) | (a != b) | (a != c))

    def motions(self, rotations: Float, centres: Float) -> Float:
        """Return the motions ``(V, 7)`` of all vertices from the reference frame: quaternions, then translations.

        Parameters
        ----------
        rotations, centres : (p, 4), (p, 3) float64
            Poses of the parts.
        """
        return np.asarray(kernels.blend(*self._shares, self._duals(rotations, centres)))

    def moving(
        self, rotations: Float, centres: Float, rotation_rates: Float, centre_rates: Float
    ) -> tuple[Float, Float]:
        """Return motions ``(V, 7)``, and spins and speeds of translations ``(V, 6)``, of poses that change."""
        duals = self._duals(rotations, centres)
        rates = self._dual_rates(rotations, centres, rotation_rates, centre_rates)
        motions, changes = kernels.blend_moving(*self._shares, duals, rates)
        return np.asarray(motions), np.asarray(changes)

    @cached_property
    def _shares(self) -> tuple[Index, Index, Float]:
        return self.shares.indptr.astype(np.int64), self.shares.indices.astype(np.int64), self.shares.data

    @cached_property
    def _boundaries(self) -> Boundaries:
        return Boundaries.of(self.topology, self.decomposition.part_of_face)

    @cached_property
    def _graph(self) -> sparse.csr_array:
        """Which parts are neighbours ``(p, p)``."""
        pairs = self._boundaries.parts
        count = len(self.decomposition.parts)
        return sparse.coo_array((np.ones(len(pairs)), tuple(pairs.T)), shape=(count, count)).tocsr()

    @cached_property
    def bodies(self) -> Index:
        """The connected body ``(p,)`` that every part belongs to."""
        return csgraph.connected_components(self._graph, directed=False)[1].astype(np.int64)

    @cached_property
    def _tree(self) -> list[tuple[int, int]]:
        """Parts and the neighbours they follow, from the first part of every body on."""
        pairs = []
        for root in np.unique(self.bodies, return_index=True)[1]:
            order, before = csgraph.breadth_first_order(self._graph, root, directed=False)
            pairs += [(int(part), int(before[part])) for part in order[1:]]
        return pairs

    def signed(self, rotations: Float) -> Float:
        """Return quaternions ``(p, 4)`` of a frame with signs along the tree, from the first part of a body on."""
        return rotations * self._signs(product(rotations, inverse(self.rest.rotations[0])))

    def continued(self, rotations: Float, before: Float | None) -> Float:
        """Give quaternions ``(T, p, 4)`` signs that do not jump, body by body: neighbours go the same way round.

        The first ones go on from those ``(1, p, 4)`` of the frame before, if there is one.
        """
        previous = np.concatenate([rotations[:1] if before is None else before, rotations[:-1]])
        cosines = np.einsum("tpi,tpi->tp", rotations, previous)
        bodies = np.eye(int(self.bodies.max(initial=-1)) + 1)[self.bodies]
        signs = np.cumprod(np.where(cosines @ bodies < 0, -1.0, 1.0), axis=0)
        return rotations * signs[:, self.bodies, None]

    def neighbours(self, reference: Float, radii: Float) -> Neighbours:
        """Return which parts see which, with radii ``(p,)``: pivots are the middles of their boundaries at rest."""
        pairs = np.concatenate([self._boundaries.parts, self._boundaries.parts[:, ::-1]])
        middles = np.tile(self._boundaries.middles(reference), (2, 1))
        back = np.swapaxes(rotations_of(self.rest.rotations[0]), 1, 2)[pairs[:, 1]]
        return Neighbours(pairs, turned(back, middles - self.rest.centres[0][pairs[:, 1]]), radii)

    def parents(self, reference: Float) -> Index:
        """Return the part ``(p,)`` that every part hangs on, -1 for roots: parts with most area in ``(V, 3)``."""
        a, b, c = np.moveaxis(reference[self.topology.faces], 1, 0)
        count = len(self.decomposition.parts)
        sizes = np.linalg.norm(np.cross(b - a, c - a), axis=1)
        areas = np.bincount(self.decomposition.part_of_face, sizes, minlength=count)
        i, j = np.concatenate([self._boundaries.parts, self._boundaries.parts[:, ::-1]]).T
        graph = sparse.coo_array((np.ones(len(i)), (i, j)), shape=(count, count)).tocsr()
        result = np.full(count, -1, dtype=np.int64)
        reached = np.zeros(count, dtype=bool)
        for root in np.argsort(-areas, kind="stable"):
            if not reached[root]:
                order, above = csgraph.breadth_first_order(graph, root, directed=False)
                result[order[1:]] = above[order[1:]]
                reached[order] = True
        return result

    def _signs(self, turns: Float) -> Float:
        signs = np.ones((len(turns), 1))
        cosines = turns @ turns.T
        for part, before in self._tree:
            signs[part] = signs[before] if cosines[part, before] >= 0 else -signs[before]
        return signs

    def _duals(self, rotations: Float, centres: Float) -> Float:
        """Dual quaternions ``(p, 8)`` of the parts' motions from the reference frame: real, then dual part."""
        turns, shifts = self._motions(normalised(rotations), centres)
        return np.concatenate([turns, 0.5 * product(_pure(shifts), turns)], axis=1) * self._signs(turns)

    def _motions(self, rotations: Float, centres: Float) -> tuple[Float, Float]:
        rest = self.rest.rotations[0], self.rest.centres[0]
        turns = product(rotations, inverse(rest[0]))
        return turns, centres - turned(rotations_of(turns), rest[1])

    def _dual_rates(
        self, rotations: Float, centres: Float, rotation_rates: Float, centre_rates: Float
    ) -> Float:
        """Derivatives ``(p, 8)`` of `_duals`; those of the length of quaternions do not matter."""
        norms = np.linalg.norm(rotations, axis=1, keepdims=True)
        unit = rotations / norms
        change = rotation_rates / norms
        change = change - unit * np.einsum("pi,pi->p", unit, change)[:, None]
        turns, shifts = self._motions(unit, centres)
        turn_rates = product(change, inverse(self.rest.rotations[0]))
        spins = 2.0 * product(turn_rates, inverse(turns))[:, 1:]
        carried = turned(rotations_of(turns), self.rest.centres[0])
        shift_rates = centre_rates - np.cross(spins, carried)
        dual = product(_pure(shift_rates), turns) + product(_pure(shifts), turn_rates)
        return np.concatenate([turn_rates, 0.5 * dual], axis=1) * self._signs(turns)


def rest_poses(rotations: Float, centres: Float) -> Poses:
    """Return poses of one frame, from rotation matrices ``(p, 3, 3)`` and centres ``(p, 3)``."""
    return Poses(quaternions(rotations)[None], centres[None])


def _pure(vectors: Float) -> Float:
    return np.pad(vectors, ((0, 0), (1, 0)))
