"""What turns lengths and angles that no mesh may have into a mesh: the projections of the space S_e.

Blends of the lengths and angles of meshes are those of no mesh. A projection finds one that has nearly these; two are
known, `mixseq.spaces.edge.discrete_shell` and `mixseq.spaces.edge.multiscale`.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mixseq.shells.fitting import ShellReport, ShellSettings

Float = NDArray[np.float64]


class EdgeProjection(Protocol):
    """Rebuilds the hinge-connected pieces of one mesh.

    It is made of the `Topology` and of the pieces' vertices, ``(n_k,)`` each, ascending, and faces, ``(m_k,)`` each,
    ascending: ``Projection(topology, vertices, faces)``. A piece without faces is one vertex that none uses. *Rows*
    are the vertices of all pieces, piece after piece.
    """

    def prepare(self) -> None:
        """Compute what all frames share."""

    def rebuild(
        self, lengths: Float, angles: Float, weights: Float, settings: ShellSettings
    ) -> tuple[Float, list[ShellReport]]:
        """Find the mesh with nearly these lengths and angles.

        Parameters
        ----------
        lengths : (E,) float64
            Lengths of all edges.
        angles : (H,) float64
            Dihedral angles of all hinges in radians, whole turns do not matter.
        weights : (E,) float64
            Weights of the lengths: one over the typical length of every edge.
        settings : ShellSettings
            Weight of the angles, and when to stop.

        Returns
        -------
        rows : (N, 3) float64
            Vertices of all pieces, every piece anywhere.
        reports : list of ShellReport
            How the fits went, at least one for every piece with faces.

        Raises
        ------
        ReconstructionError
            If lengths or angles are not finite.
        """
