"""The solved joints: places of their numbers in a frame, and skinning of their free vertices.

Linear blend skinning from a reference frame: every free vertex moves with all parts that hold fixed vertices of its
joint, with harmonic weights (1 at the vertices of a part, 0 at those of the others, smooth in between). Close to the
reference this is a start without folds, where blended lengths and angles are inconsistent.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mixseq.arrays import Float, Index
from mixseq.segmentation.joints import Decomposition, Joint
from mixseq.shells.patch import Patch
from mixseq.topology import Topology


@dataclass(frozen=True, eq=False)
class SolvedJoints:
    """The joints of a mesh with free vertices; data of frames is stored joint by joint."""

    joints: tuple[Joint, ...]  # the joints
    patches: tuple[Patch, ...]  # each as a patch, in which the vertices of parts are fixed

    @classmethod
    def of(cls, topology: Topology, decomposition: Decomposition) -> SolvedJoints:
        """Select the joints of a decomposition with free vertices."""
        joints = tuple(joint for joint in decomposition.joints if joint.free.any())
        return cls(joints, tuple(Patch.of_joint(topology, joint, ~joint.free) for joint in joints))

    @cached_property
    def edge_ids(self) -> Index:
        """Global numbers ``(E',)`` of the edges at free vertices."""
        return _joined([j.edge_ids[p.free_edges] for j, p in zip(self.joints, self.patches, strict=True)])

    @cached_property
    def hinge_ids(self) -> Index:
        """Global numbers ``(H',)`` of the hinges with a free vertex."""
        return _joined([j.hinge_ids[p.free_hinges] for j, p in zip(self.joints, self.patches, strict=True)])

    @cached_property
    def vertices(self) -> Index:
        """Global numbers ``(F,)`` of the free vertices."""
        return _joined([j.vertices[p.free] for j, p in zip(self.joints, self.patches, strict=True)])

    @cached_property
    def edge_slices(self) -> list[slice]:
        """Slices of the edges of every joint."""
        return _slices([int(np.count_nonzero(patch.free_edges)) for patch in self.patches])

    @cached_property
    def hinge_slices(self) -> list[slice]:
        """Slices of the hinges of every joint."""
        return _slices([int(np.count_nonzero(patch.free_hinges)) for patch in self.patches])

    @cached_property
    def vertex_slices(self) -> list[slice]:
        """Slices of the free vertices of every joint."""
        return _slices([len(patch.free) for patch in self.patches])

    def spacing(self, lengths: Float) -> Float:
        """Return the mean length ``(F,)`` of the edges at every free vertex, from lengths ``(E',)``."""
        sums, counts = np.zeros((2, len(self.vertices)))
        for patch, edges, free in zip(self.patches, self.edge_slices, self.vertex_slices, strict=True):
            ends = patch.free_number[patch.edges[patch.free_edges]]
            for end in ends.T:
                inside = end >= 0
                np.add.at(sums[free], end[inside], lengths[edges][inside])
                np.add.at(counts[free], end[inside], 1.0)
        return np.asarray(sums / counts)


@dataclass(frozen=True, eq=False)
class HarmonicSkin:
    """Harmonic skinning weights of the free vertices of a joint."""

    parts: Index  # (k,) parts that hold fixed vertices of the joint
    weights: Float  # (f, k) weights of the free vertices; rows add up to one
    rest: Float  # (f, 3) the free vertices in the reference frame

    @classmethod
    def of(cls, patch: Patch, owner: Index, rest: Float) -> HarmonicSkin:
        """Find the weights of a patch: owner ``(n,)``; rest ``(n, 3)``."""
        parts, number = np.unique(owner[patch.fixed], return_inverse=True)
        boundary = np.eye(len(parts))[number.reshape(-1)]
        coupling = patch.laplacian[patch.free][:, patch.fixed]
        return cls(parts, -patch.laplacian_factor.solve(coupling @ boundary), rest[patch.free])

    def place(self, rotations: Float, translations: Float) -> Float:
        """Move the free vertices ``(f, 3)`` with motions ``x -> R x + t`` of all parts from the reference frame."""
        moved = np.einsum("kij,fj->fki", rotations[self.parts], self.rest) + translations[self.parts]
        return np.asarray(np.einsum("fk,fki->fi", self.weights, moved))

    @cached_property
    def nearest(self) -> Index:
        """Main part ``(f,)`` of every free vertex."""
        return np.asarray(self.parts[self.weights.argmax(axis=1)])


def _joined(ids: list[Index]) -> Index:
    """Concatenate index arrays; return an empty one for none."""
    return np.concatenate(ids) if ids else np.zeros(0, dtype=np.int64)


def _slices(sizes: list[int]) -> list[slice]:
    ends = np.cumsum(sizes)
    return [slice(int(end) - size, int(end)) for end, size in zip(ends, sizes, strict=True)]
