"""What turns lengths and angles that no mesh may have into a mesh: the projections of the space S_e.

Blends of the lengths and angles of meshes are those of no mesh. A projection finds one that has nearly these; there are
two, `mixseq.spaces.edge.relaxed_shell` and `mixseq.spaces.edge.discrete_shell`.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol, Self

from mixseq.arrays import Float
from mixseq.shells.fitting import ShellReport, ShellSettings


class Wanted(NamedTuple):
    """What a mesh should have, and how much of it counts."""

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
        """Find the mesh with nearly these lengths and angles.

        Parameters
        ----------
        wanted : Wanted
            What the mesh should have.
        settings : ShellSettings
            Weight of the angles, and when to stop.

        Returns
        -------
        rows : (N, 3) float64
            Vertices of all pieces, every piece anywhere.
        reports : list of ShellReport
            How the fits went.

        Raises
        ------
        ReconstructionError
            If lengths or angles are not finite.
        """
