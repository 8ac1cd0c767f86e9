r"""Discrete shells (DSO, Froehlich and Botsch 2011): every piece of a mesh as a whole, without fixed vertices.

Linear initialisation (`mixseq.shells.reconstruction`) is followed by Gauss-Newton on all lengths and angles, and on the
volume if that is a target. Gauss-Newton gets trapped from distant poses (the paper's Figure 17); the linear start uses
no pose, and is exact where a mesh has these lengths and angles.

With :math:`c` the mean of a piece's vertices its signed volume is

.. math:: V(x) = \tfrac16 \sum_{ijk} \det(x_i - c,\; x_j - c,\; x_k - c) .

For a closed surface this is independent of c; for an open one it is the volume of the cone from its centre, invariant
under rigid motions. The volume term is one residual :math:`w\,(V - V^*) / \bar V`, with :math:`\bar V` the volume of
the reference. Sheets, with :math:`|\bar V|` below `FLAT` times area to the 3/2, have no volume term.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Float, FloatArray, Index, IntArray
from mixseq.geometry.lengths_angles import sound_lengths
from mixseq.pickling import PickledWithoutCaches
from mixseq.segmentation.joints import make_joint
from mixseq.shells.fitting import ShellProblem, ShellReport, ShellSettings, fit_shell
from mixseq.shells.patch import Patch
from mixseq.shells.reconstruction import linear_initialisation
from mixseq.spaces.edge.projection import Wanted
from mixseq.spaces.pieces import Pieces
from mixseq.topology import Topology

FLAT = 1e-3
"""Least ratio of volume to area to the 3/2 of a surface with a volume term; that of a sphere is 0.094."""


def volume(points: FloatArray, faces: IntArray) -> float:
    """Return the signed volume of points ``(n, 3)`` about their mean, over faces ``(m, 3)``."""
    x = points - points.mean(axis=0)
    a, b, c = (x[corner] for corner in faces.T)
    return float(np.einsum("fi,fi->", a, np.cross(b, c))) / 6.0


def volume_gradient(points: FloatArray, faces: IntArray) -> Float:
    """Return the derivatives ``(n, 3)`` of `volume`; they add up to zero."""
    x = points - points.mean(axis=0)
    a, b, c = (x[corner] for corner in faces.T)
    pulls = np.concatenate([np.cross(b, c), np.cross(c, a), np.cross(a, b)]) / 6.0
    corners = faces.T.reshape(-1)
    gradient = np.stack([np.bincount(corners, pull, minlength=len(x)) for pull in pulls.T], axis=1)
    return np.asarray(gradient - gradient.mean(axis=0))


def surface_area(points: FloatArray, faces: IntArray) -> float:
    """Return the area of points ``(n, 3)`` over faces ``(m, 3)``."""
    a, b, c = (points[corner] for corner in faces.T)
    return float(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())


def is_sheet(points: FloatArray, faces: IntArray) -> bool:
    """Return whether a surface has too little volume for a volume term; see the module."""
    return bool(abs(volume(points, faces)) <= FLAT * surface_area(points, faces) ** 1.5)


@dataclass(frozen=True, eq=False)
class VolumeTerm:
    """The residual of the volume, a `DenseTerm` of `mixseq.shells.fitting`."""

    faces: NDArray[np.int64]  # (m, 3) triangles of the surface
    target: float  # target volume
    # Weight of the term over the volume of the reference, so that the residual counts relative changes.
    weight: float

    def residual(self, points: Float) -> float:
        """Implement `DenseTerm.residual`."""
        return self.weight * (volume(points, self.faces) - self.target)

    def gradient(self, points: Float) -> Float:
        """Implement `DenseTerm.gradient`."""
        return self.weight * volume_gradient(points, self.faces)


class ShellPiece(NamedTuple):
    """A hinge-connected piece: its rows, its patch, and the mesh's edges and hinges in the patch."""

    rows: slice
    patch: Patch
    edge_ids: Index
    hinge_ids: Index


@dataclass(frozen=True, eq=False)
class DiscreteShell(PickledWithoutCaches):
    """An `EdgeProjection` by Gauss-Newton over each piece of a mesh."""

    topology: Topology  # connectivity of the mesh
    pieces: Pieces  # its hinge-connected pieces

    @cached_property
    def shells(self) -> tuple[ShellPiece | None, ...]:
        """All pieces; None for vertices without faces."""
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
        """Return the volumes ``(p,)`` of the pieces of a frame ``(V, 3)``, 0 of single vertices; see `volume`."""
        pairs = zip(self.pieces.vertices, self.shells, strict=True)
        return np.array([0.0 if piece is None else volume(x[own], piece.patch.faces) for own, piece in pairs])

    def volume_weights(self, x: FloatArray) -> Float:
        """Return inverse volumes ``(p,)`` of the pieces of a typical frame ``(V, 3)``, 0 where `is_sheet`."""
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
        """Return the fitting problem of one piece."""
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
