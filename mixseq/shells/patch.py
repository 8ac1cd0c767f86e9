"""A patch of triangles to be rebuilt from lengths and angles, and the pattern of its normal equations."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from mixseq.arrays import Index, Mask
from mixseq.pickling import PickledWithoutCaches
from mixseq.segmentation.joints import Joint
from mixseq.shells.block_pattern import BlockSparsePattern
from mixseq.shells.face_frames import Hinges
from mixseq.shells.solvers import Factor, factorise
from mixseq.topology import Topology


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Lengths and angles around the free vertices of a patch, and the pattern of their matrix."""

    edges: Index  # (e', 2) edges with a free vertex
    hinges: Index  # (h', 4) hinges with a free vertex
    free: Index  # (f,) the free vertices
    number: Index  # (n,) place of every vertex among them, -1 if fixed
    pattern: BlockSparsePattern  # pattern of the matrix, one triple of unknowns for each free vertex
    edge_blocks: Index  # (e',) block that couples the two vertices of an edge, -1 if one is fixed
    # (h', 6) blocks that couple the vertices ba, ca, cb, da, db, dc of a hinge, -1 if one is fixed.
    hinge_blocks: Index

    @classmethod
    def of(
        cls, edges: Index, hinges: Index, free: Index, number: Index, threads: int | None = None
    ) -> NormalEquations:
        """Find the blocks of edges and hinges."""
        ends, corners = number[edges], number[hinges]
        p, o = np.tril_indices(4, -1)
        first, second = corners[:, p], corners[:, o]
        pairs = np.concatenate([ends, np.stack([first, second], axis=-1).reshape(-1, 2)])
        pattern = BlockSparsePattern.of(len(free), pairs, threads)
        return cls(
            edges=np.ascontiguousarray(edges),
            hinges=np.ascontiguousarray(hinges),
            free=free,
            number=number,
            pattern=pattern,
            edge_blocks=pattern.block(*ends.T),
            hinge_blocks=np.ascontiguousarray(pattern.block(first, second)),
        )


@dataclass(frozen=True, eq=False)
class Patch(PickledWithoutCaches):
    """A hinge-connected patch of triangles in local indices, with some vertices fixed in space."""

    faces: Index  # (m, 3) triangles
    edges: Index  # (e, 2) edges, in the order of the lengths
    face_edges: Index  # (m, 3) edge of the sides 01, 12, 20 of every face
    hinges: Index  # (h, 4) hinges a, b, c, d, in the order of the angles
    hinge_faces: Index  # (h, 2) their two faces
    fixed: Mask  # (n,) vertices whose positions are given
    threads: int | None = None  # threads that factor one matrix; by default from its size

    @classmethod
    def of_joint(cls, topology: Topology, joint: Joint, fixed: Mask) -> Patch:
        """Make the patch of a joint; `fixed` ``(n,)`` marks the joint's given vertices."""
        return cls(
            faces=joint.faces,
            edges=np.searchsorted(joint.vertices, topology.edges[joint.edge_ids]),
            face_edges=np.searchsorted(joint.edge_ids, topology.face_edges[joint.face_ids]),
            hinges=np.searchsorted(joint.vertices, topology.hinges[joint.hinge_ids]),
            hinge_faces=np.searchsorted(joint.face_ids, topology.hinge_faces[joint.hinge_ids]),
            fixed=fixed,
        )

    def constants(self) -> tuple[object, ...]:
        """Implement `PickledWithoutCaches.constants` for the linear initialisation and Gauss-Newton."""
        return self.equations.pattern, self.frame_pattern, self.laplacian_factor

    @cached_property
    def free(self) -> Index:
        """Unknown vertices."""
        return np.flatnonzero(~self.fixed)

    @cached_property
    def free_number(self) -> Index:
        """Place ``(n,)`` of every vertex among the free ones, -1 if fixed."""
        number = np.full(len(self.fixed), -1, dtype=np.int64)
        number[self.free] = np.arange(len(self.free))
        return number

    @cached_property
    def free_edges(self) -> Mask:
        """Mark the edges ``(e,)`` with a free vertex."""
        return np.asarray(~self.fixed[self.edges].all(axis=1))

    @cached_property
    def free_hinges(self) -> Mask:
        """Mark the hinges ``(h,)`` with a free vertex."""
        return np.asarray(~self.fixed[self.hinges].all(axis=1))

    @cached_property
    def fixed_faces(self) -> Mask:
        """Mark the faces ``(m,)`` whose three vertices are fixed."""
        return np.asarray(self.fixed[self.faces].all(axis=1))

    @cached_property
    def hinge_frames(self) -> Hinges:
        """The hinges in the frames of their faces."""
        return Hinges(self.faces, self.hinges, self.hinge_faces)

    @cached_property
    def equations(self) -> NormalEquations:
        """The normal equations of lengths and angles around the free vertices."""
        return NormalEquations.of(
            self.edges[self.free_edges],
            self.hinges[self.free_hinges],
            self.free,
            self.free_number,
            self.threads,
        )

    @cached_property
    def frame_pattern(self) -> BlockSparsePattern:
        """Block pattern of unknown frames of faces, coupled by hinges."""
        count, pairs = int((self.face_number >= 0).sum()), self.face_number[self.hinge_faces]
        return BlockSparsePattern.of(count, pairs, self.threads)

    @cached_property
    def face_number(self) -> Index:
        """Place ``(m,)`` of every face among those with unknown frames; -1 for fixed faces, or for the first one."""
        known = self.fixed_faces.copy()
        known[0] |= not known.any()
        return np.where(known, -1, np.cumsum(~known) - 1)

    @cached_property
    def laplacian(self) -> sparse.csr_array:
        """Graph Laplacian ``(n, n)``; an edge counts once per face."""
        starts = self.faces.reshape(-1)
        ends = np.roll(self.faces, -1, axis=1).reshape(-1)
        size = (len(self.fixed), len(self.fixed))
        half = sparse.coo_array((np.ones(len(starts)), (starts, ends)), shape=size).tocsr()
        adjacency = (half + half.T).tocsr()
        return (sparse.diags_array(np.asarray(adjacency.sum(axis=1)).reshape(-1)) - adjacency).tocsr()

    @cached_property
    def laplacian_factor(self) -> Factor:
        """Factor of the Laplacian's block of integrated vertices; constant over a sequence."""
        return factorise(self.laplacian[self.integrated][:, self.integrated])

    @cached_property
    def integrated(self) -> Index:
        """Unknown vertices of the Poisson system: the free ones, but the first where nothing is fixed."""
        return self.free if self.fixed.any() else self.free[1:]
