"""Where the parts of a target meet: at the boundaries between them, and where its pieces are held."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mixseq.arrays import Float, Index
from mixseq.retargeting.bridges import Bridges
from mixseq.retargeting.carried import vertex_parts
from mixseq.retargeting.gradients import GradientTransfer
from mixseq.segmentation.boundaries import Boundaries
from mixseq.segmentation.joints import Decomposition


@dataclass(frozen=True, eq=False)
class Meetings:
    """Pairs of parts that meet: those of boundaries first, then those of bridges.

    Attributes
    ----------
    parts : (n, 2) int64
        The pairs. They connect all parts.
    boundaries : Boundaries
        Edges between parts.
    bridges : Bridges
        What holds pieces that no edge connects.
    """

    parts: Index
    boundaries: Boundaries
    bridges: Bridges

    @classmethod
    def of(cls, gradients: GradientTransfer, decomposition: Decomposition) -> Meetings:
        """Find where the parts of a target meet."""
        held = gradients.bridges
        boundaries = Boundaries.of(gradients.target.topology, decomposition.part_of_face)
        ends = ((held.pieces, held.own), (held.holders, held.other))
        bridged = np.stack([_parts_at(gradients, decomposition, *end) for end in ends], axis=1)
        return cls(np.concatenate([boundaries.parts, bridged]), boundaries, held)

    def points(self, x: Float) -> Float:
        """Where parts meet ``(n, 3)``: in the middle of boundaries, at vertices that are held; x is ``(V', 3)``."""
        return np.concatenate([self.boundaries.middles(x), x[self.bridges.own]])

    def sizes(self, x: Float) -> tuple[Float, Float]:
        """Lengths ``(n,)`` of boundaries, and root mean square distances ``(n,)`` from their middles; 0 of bridges."""
        ends, link, middles = x[self.boundaries.edges], self.boundaries.pair, self.points(x)
        lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        away = np.square(ends.mean(axis=1) - middles[link]).sum(axis=1)
        whole, squares = (np.bincount(link, each, len(middles)) for each in (lengths, lengths * away))
        squared = np.divide(squares, whole, out=np.zeros(len(middles)), where=whole > 0)
        return whole.astype(np.float64), np.sqrt(squared)


def _parts_at(
    gradients: GradientTransfer, decomposition: Decomposition, pieces: Index, vertices: Index
) -> Index:
    """A part ``(n,)`` at each vertex, of the piece that is meant: several may share the vertex."""
    topology = gradients.target.topology
    result = vertex_parts(decomposition, topology)[vertices]
    for row, (piece, vertex) in enumerate(zip(pieces.tolist(), vertices.tolist(), strict=True)):
        faces = gradients.target.pieces.faces[piece]
        here = faces[(topology.faces[faces] == vertex).any(axis=1)]
        if here.size:  # vertices of no face have none
            result[row] = decomposition.part_of_face[here].min()
    return result
