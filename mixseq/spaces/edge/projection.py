"""Projections of the space S_e: from lengths and angles that no mesh may have to the nearest mesh.

There are two, `mixseq.spaces.edge.relaxed_shell` and `mixseq.spaces.edge.discrete_shell`.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol, Self

from mixseq.arrays import Float
from mixseq.shells.fitting import ShellReport, ShellSettings


class Wanted(NamedTuple):
    """Targets of a mesh, and their weights."""

    lengths: Float  # (E,) edge lengths
    weights: Float  # (E,) weights of the lengths: one over the typical length
    angles: Float  # (H,) dihedral angles of all hinges in radians, whole turns do not matter
    volumes: Float  # (p,) volumes of the pieces; empty without a volume term
    volume_weights: Float  # (p,) weights of the volumes, over the typical volume; 0 for sheets


class EdgeProjection(Protocol):
    """Rebuilds the hinge-connected pieces of one mesh.

    *Rows* are the vertices of all pieces, piece after piece, see `mixseq.spaces.pieces`.
    """

    def prepared(self) -> Self:
        """Compute what all frames share, as `PickledWithoutCaches.prepared`."""

    def fit(self, wanted: Wanted, settings: ShellSettings) -> tuple[Float, list[ShellReport]]:
        """Fit rows ``(N, 3)``, pieces in any pose; raises `ReconstructionError` if lengths or angles are not finite."""
