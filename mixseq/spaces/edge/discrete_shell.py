"""Discrete shells (DSO, Froehlich and Botsch 2011): every piece of a mesh as a whole, nothing of it held.

The linear start of `mixseq.shells.unfold`, then Gauss-Newton on all lengths and angles, and on the volume if
that is told. The start matters more than the steps: from a pose that is far away they get trapped (the paper's
Figure 17), the linear start looks at no pose and is exact where there is a mesh with these lengths and angles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixseq.segmentation.joints import make_joint
from mixseq.sequence import FloatArray
from mixseq.shells.fitting import ShellProblem, ShellReport, ShellSettings, fit_shell
from mixseq.shells.joint import sound_lengths
from mixseq.shells.patch import Patch
from mixseq.shells.unfold import unfold
from mixseq.spaces.edge.volume import VolumeTerm, is_sheet, surface_area, volume
from mixseq.topology import Topology

Float = NDArray[np.float64]
Index = NDArray[np.int64]


class Wanted(NamedTuple):
    """What a mesh should have, and how much of it counts.

    Attributes
    ----------
    lengths, weights : (E,) float64
        Lengths of all edges, and their weights: one over the typical length.
    angles : (H,) float64
        Dihedral angles of all hinges, radians.
    volumes, volume_weights : (p,) float64
        Volumes of all pieces, and their weights: over the typical volume, 0 where it does not count. Empty for no
        volume term at all.
    """

    lengths: Float
    angles: Float
    weights: Float
    volumes: Float
    volume_weights: Float


class ShellPiece(NamedTuple):
    """A hinge-connected piece: its rows, its patch, and which of the mesh's edges and hinges the patch has."""

    rows: slice
    patch: Patch
    edge_ids: Index
    hinge_ids: Index


@dataclass(frozen=True, eq=False)
class DiscreteShell:
    """An `EdgeProjection`: one Gauss-Newton over each piece of a mesh.

    Attributes
    ----------
    topology : Topology
        Connectivity of the mesh.
    vertices, faces : sequences of (n_k,) and (m_k,) int64
        Vertices and faces of the pieces, ascending.
    """

    topology: Topology
    vertices: Sequence[Index]
    faces: Sequence[Index]

    @cached_property
    def row_count(self) -> int:
        """Number of rows N, the vertices of all pieces."""
        return sum(len(each) for each in self.vertices)

    @cached_property
    def pieces(self) -> tuple[ShellPiece | None, ...]:
        """All pieces; None for a vertex that no face uses."""
        ends = np.cumsum([len(each) for each in self.vertices])
        nowhere = np.zeros(self.topology.vertex_count, dtype=bool)
        pieces: list[ShellPiece | None] = []
        for end, vertices, faces in zip(ends.tolist(), self.vertices, self.faces, strict=True):
            if not len(faces):
                pieces.append(None)
                continue
            mask = np.zeros(len(self.topology.faces), dtype=bool)
            mask[faces] = True
            whole = make_joint(self.topology, mask, nowhere)
            patch = Patch.of_joint(self.topology, whole, np.zeros(len(vertices), dtype=bool))
            pieces.append(ShellPiece(slice(end - len(vertices), end), patch, whole.edge_ids, whole.hinge_ids))
        return tuple(pieces)

    def prepare(self) -> None:
        """Implement `EdgeProjection.prepare`."""
        for piece in self.pieces:
            if piece is not None:
                patch = piece.patch
                patch.equations.pattern.analysis, patch.frame_pattern.analysis  # noqa: B018 - cached properties
                patch.laplacian_factor  # noqa: B018

    def volumes(self, x: FloatArray) -> Float:
        """Return the volumes ``(p,)`` of the pieces of a frame ``(V, 3)``, 0 of a vertex; see `volume`."""
        pairs = zip(self.vertices, self.pieces, strict=True)
        return np.array([0.0 if piece is None else volume(x[own], piece.patch.faces) for own, piece in pairs])

    def volume_weights(self, x: FloatArray) -> Float:
        """Return one over the volumes ``(p,)`` of the pieces of a typical frame ``(V, 3)``, 0 where `is_sheet`."""
        weights = np.zeros(len(self.pieces))
        for number, (own, piece) in enumerate(zip(self.vertices, self.pieces, strict=True)):
            if piece is not None and not is_sheet(x[own], piece.patch.faces):
                weights[number] = 1.0 / abs(volume(x[own], piece.patch.faces))
        return weights

    def areas(self, x: FloatArray) -> Float:
        """Return the areas ``(p,)`` of the pieces of a frame ``(V, 3)``."""
        pairs = zip(self.vertices, self.pieces, strict=True)
        return np.array(
            [0.0 if piece is None else surface_area(x[own], piece.patch.faces) for own, piece in pairs]
        )

    def rebuild(
        self, lengths: Float, angles: Float, weights: Float, settings: ShellSettings
    ) -> tuple[Float, list[ShellReport]]:
        """Implement `EdgeProjection.rebuild`."""
        return self.fit(Wanted(lengths, angles, weights, np.zeros(0), np.zeros(0)), settings)

    def fit(self, wanted: Wanted, settings: ShellSettings) -> tuple[Float, list[ShellReport]]:
        """Do what `rebuild` does, also for volumes."""
        rows, reports = np.zeros((self.row_count, 3)), []
        for number, piece in enumerate(self.pieces):
            if piece is None:
                continue
            problem = self.problem(number, piece, wanted, settings)
            start = unfold(piece.patch, problem.lengths, problem.angles, rows[piece.rows])
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
