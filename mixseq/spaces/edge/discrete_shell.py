"""Discrete shells (DSO, Froehlich and Botsch 2011): every piece of a mesh as a whole, nothing of it held.

`mixseq.shells.linear_initialisation`, then Gauss-Newton on all lengths and angles, and on the volume if that is told.
The start matters more than the steps: from a pose that is far away they get trapped (the paper's
Figure 17), the linear start looks at no pose and is exact where there is a mesh with these lengths and angles.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from mixseq.arrays import Float, FloatArray, Index
from mixseq.pickling import PickledWithoutCaches
from mixseq.segmentation.joints import make_joint
from mixseq.shells.fitting import ShellProblem, ShellReport, ShellSettings, fit_shell
from mixseq.shells.joint import sound_lengths
from mixseq.shells.linear_initialisation import linear_initialisation
from mixseq.shells.patch import Patch
from mixseq.spaces.edge.projection import Wanted
from mixseq.spaces.edge.volume import VolumeTerm, is_sheet, surface_area, volume
from mixseq.spaces.pieces import Pieces
from mixseq.topology import Topology


class ShellPiece(NamedTuple):
    """A hinge-connected piece: its rows, its patch, and which of the mesh's edges and hinges the patch has."""

    rows: slice
    patch: Patch
    edge_ids: Index
    hinge_ids: Index


@dataclass(frozen=True, eq=False)
class DiscreteShell(PickledWithoutCaches):
    """An `EdgeProjection`: one Gauss-Newton over each piece of a mesh.

    Attributes
    ----------
    topology : Topology
        Connectivity of the mesh.
    pieces : Pieces
        Its hinge-connected pieces.
    """

    topology: Topology
    pieces: Pieces

    @cached_property
    def shells(self) -> tuple[ShellPiece | None, ...]:
        """All pieces; None for a vertex that no face uses."""
        nowhere = np.zeros(self.topology.vertex_count, dtype=bool)
        shells: list[ShellPiece | None] = []
        for rows, faces in zip(self.pieces.slices, self.pieces.faces, strict=True):
            if not len(faces):
                shells.append(None)
                continue
            mask = np.zeros(len(self.topology.faces), dtype=bool)
            mask[faces] = True
            whole = make_joint(self.topology, mask, nowhere)
            patch = Patch.of_joint(self.topology, whole, np.zeros(len(whole.vertices), dtype=bool))
            shells.append(ShellPiece(rows, patch, whole.edge_ids, whole.hinge_ids))
        return tuple(shells)

    def constants(self) -> list[object]:
        """Implement `PickledWithoutCaches.constants`."""
        return [piece.patch for piece in self.shells if piece is not None]

    def volumes(self, x: FloatArray) -> Float:
        """Return the volumes ``(p,)`` of the pieces of a frame ``(V, 3)``, 0 of a vertex; see `volume`."""
        pairs = zip(self.pieces.vertices, self.shells, strict=True)
        return np.array([0.0 if piece is None else volume(x[own], piece.patch.faces) for own, piece in pairs])

    def volume_weights(self, x: FloatArray) -> Float:
        """Return one over the volumes ``(p,)`` of the pieces of a typical frame ``(V, 3)``, 0 where `is_sheet`."""
        weights = np.zeros(len(self.shells))
        for number, (own, piece) in enumerate(zip(self.pieces.vertices, self.shells, strict=True)):
            if piece is not None and not is_sheet(x[own], piece.patch.faces):
                weights[number] = 1.0 / abs(volume(x[own], piece.patch.faces))
        return weights

    def areas(self, x: FloatArray) -> Float:
        """Return the areas ``(p,)`` of the pieces of a frame ``(V, 3)``."""
        pairs = zip(self.pieces.vertices, self.shells, strict=True)
        return np.array(
            [0.0 if piece is None else surface_area(x[own], piece.patch.faces) for own, piece in pairs]
        )

    def fit(self, wanted: Wanted, settings: ShellSettings) -> tuple[Float, list[ShellReport]]:
        """Implement `EdgeProjection.fit`."""
        rows, reports = np.zeros_like(self.pieces.shapes), []
        for number, piece in enumerate(self.shells):
            if piece is None:
                continue
            problem = self.problem(number, piece, wanted, settings)
            start = linear_initialisation(piece.patch, problem.lengths, problem.angles, rows[piece.rows])
            rows[piece.rows], report = fit_shell(problem, start, settings)
            reports.append(report)
        return rows, reports

    def problem(
        self, number: int, piece: ShellPiece, wanted: Wanted, settings: ShellSettings
    ) -> ShellProblem:
        """Return what to fit one of the pieces to."""
        weights = wanted.weights[piece.edge_ids]
        term = None
        if wanted.volumes.size and wanted.volume_weights[number]:
            target, weight = wanted.volumes[number], wanted.volume_weights[number]
            term = VolumeTerm(piece.patch.faces, float(target), float(weight))
        return ShellProblem(
            patch=piece.patch,
            lengths=sound_lengths(wanted.lengths[piece.edge_ids], weights),
            angles=wanted.angles[piece.hinge_ids],
            length_weights=weights,
            bending=settings.bending,
            dense=term,
        )
