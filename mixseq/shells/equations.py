"""The normal equations of a patch: which lengths and angles have a part in which block of the matrix."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mixseq.arrays import Index
from mixseq.shells.block_pattern import BlockPattern


@dataclass(frozen=True, eq=False)
class Equations:
    """Lengths and angles around the free vertices of a patch, and the matrix they make.

    Attributes
    ----------
    edges, hinges : (e', 2), (h', 4) int64
        Those with a free vertex.
    free : (f,) int64
        The free vertices.
    number : (n,) int64
        Place of every vertex among them, -1 if fixed.
    pattern : BlockPattern
        Pattern of the matrix, one triple of unknowns for each free vertex.
    edge_blocks : (e',) int64
        Block that couples the two vertices of an edge, -1 if one is fixed.
    hinge_blocks : (h', 6) int64
        Blocks that couple the vertices ba, ca, cb, da, db, dc of a hinge, -1 if one is fixed.
    """

    edges: Index
    hinges: Index
    free: Index
    number: Index
    pattern: BlockPattern
    edge_blocks: Index
    hinge_blocks: Index

    @classmethod
    def of(cls, edges: Index, hinges: Index, free: Index, number: Index) -> Equations:
        """Find the blocks."""
        ends, corners = number[edges], number[hinges]
        p, o = np.tril_indices(4, -1)
        first, second = corners[:, p], corners[:, o]
        pairs = np.concatenate([ends, np.stack([first, second], axis=-1).reshape(-1, 2)])
        pattern = BlockPattern.of(len(free), pairs)
        return cls(
            edges=np.ascontiguousarray(edges),
            hinges=np.ascontiguousarray(hinges),
            free=free,
            number=number,
            pattern=pattern,
            edge_blocks=pattern.block(*ends.T),
            hinge_blocks=np.ascontiguousarray(pattern.block(first, second)),
        )
