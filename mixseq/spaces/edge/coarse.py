r"""Discrete shells on a coarse mesh first, after the multi-resolution of Froehlich and Botsch (2011).

The coarse mesh is the decimated reference. Its vertices are some of the mesh's, so blends of its own lengths and angles
are as good as those of the mesh, and Gauss-Newton on them is quick. Its solution :math:`y_c` is then
carried over to the whole mesh, piece by piece:

1. The linear start x of the whole piece, as in `mixseq.shells.unfold`: it knows all detail, but what its frames
   lack to fit adds up over long ways.
2. At every coarse vertex the rotation that turns its edges in x into those in y, spread over all vertices by
   :math:`(L + h S)\, R = h S R_c` and projected to rotations; L is the graph Laplacian, S marks coarse vertices.
3. The sides of the faces in x, turned by these rotations, and coarse vertices drawn to their places:
   :math:`(L + h S)\, x' = \mathrm{div}\, (R\, u) + h S y`.
4. At most a few Gauss-Newton steps on the whole mesh.

Both systems share one matrix, which is factored once. Where lengths and angles are those of a mesh, 1 and 3 are exact.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mixseq.geometry.rigid import aligning_rotations, kabsch, nearest_rotations
from mixseq.shells.fitting import ShellReport, ShellSettings, fit_shell
from mixseq.shells.patch import Patch
from mixseq.shells.solvers import Factor, factorise
from mixseq.shells.unfold import integrate, turned_sides
from mixseq.spaces.edge.decimation import decimate
from mixseq.spaces.edge.discrete_shell import DiscreteShell, ShellPiece, Wanted
from mixseq.topology import Topology

Float = NDArray[np.float64]
Index = NDArray[np.int64]

HOLD = 1.0
"""How much the place of a coarse vertex counts against the sides around it. The number is ours."""

FEWEST = 4
"""Vertices that are left of every piece, where it has as many."""


@dataclass(frozen=True, eq=False)
class CoarseShell:
    """A mesh and its coarse mesh.

    Attributes
    ----------
    fine : DiscreteShell
        The mesh.
    coarse : DiscreteShell
        The coarse mesh; its vertices are numbered like its rows.
    kept : (C,) int64
        The vertices of the mesh that the coarse vertices are.
    kept_rows : (C,) int64
        Their rows among those of the mesh.
    """

    fine: DiscreteShell
    coarse: DiscreteShell
    kept: Index
    kept_rows: Index

    @classmethod
    def of(cls, fine: DiscreteShell, reference: Float, count: int) -> CoarseShell:
        """Decimate every piece of a mesh with vertices ``(V, 3)``, to `count` vertices in all if that is possible."""
        kept, rows, faces, piece_vertices, piece_faces = [], [], [], [], []
        start = face_start = row_start = 0
        for own, piece in zip(fine.vertices, fine.pieces, strict=True):
            left, triangles = np.arange(len(own)), np.zeros((0, 3), dtype=np.int64)
            if piece is not None:
                share = max(FEWEST, round(count * len(own) / fine.row_count))
                left, triangles = decimate(reference[own], piece.patch.faces, share)
            kept.append(own[left])
            rows.append(row_start + left)
            faces.append(triangles + start)
            piece_vertices.append(start + np.arange(len(left)))
            piece_faces.append(face_start + np.arange(len(triangles)))
            start, face_start, row_start = (
                start + len(left),
                face_start + len(triangles),
                row_start + len(own),
            )
        topology = Topology(np.concatenate(faces), start)
        coarse = DiscreteShell(topology, piece_vertices, piece_faces)
        return cls(fine, coarse, np.concatenate(kept), np.concatenate(rows))

    @cached_property
    def carriers(self) -> tuple[Carrier | None, ...]:
        """How every piece is carried over from its coarse one."""
        pairs = zip(self.fine.pieces, self.coarse.pieces, strict=True)
        return tuple(
            None if fine is None or coarse is None else self._carrier(fine, coarse) for fine, coarse in pairs
        )

    def _carrier(self, fine: ShellPiece, coarse: ShellPiece) -> Carrier:
        return Carrier(fine.patch, self.kept_rows[coarse.rows] - fine.rows.start, coarse.patch.edges)

    def prepare(self) -> None:
        """Compute what all frames share."""
        self.fine.prepare()
        self.coarse.prepare()
        for carrier in self.carriers:
            if carrier is not None:
                carrier.factor  # noqa: B018 - a cached property

    def fit(
        self, wanted: Wanted, coarsely: Wanted, settings: ShellSettings, steps: int
    ) -> tuple[Float, list[ShellReport]]:
        """Rebuild the mesh.

        Parameters
        ----------
        wanted, coarsely : Wanted
            What the mesh and the coarse mesh should have.
        settings : ShellSettings
            Settings of both fits.
        steps : int
            At most so many Gauss-Newton steps on the mesh.

        Returns
        -------
        rows : (N, 3) float64
            Vertices of all pieces, every piece anywhere.
        reports : list of ShellReport
            For every piece with faces, that of the coarse mesh and that of the mesh. The latter has converged where
            the former has: that steps are few is meant.
        """
        places, reports = self.coarse.fit(coarsely, settings)
        last = replace(settings, iterations=min(steps, settings.iterations))
        rows, all_reports = np.zeros((self.fine.row_count, 3)), []
        told = iter(reports)
        pieces = zip(self.fine.pieces, self.coarse.pieces, self.carriers, strict=True)
        for number, (fine, coarse, carrier) in enumerate(pieces):
            if fine is None or coarse is None or carrier is None:
                continue
            problem = self.fine.problem(number, fine, wanted, settings)
            start = carrier.carried(problem.lengths, problem.angles, places[coarse.rows])
            rows[fine.rows], report = fit_shell(problem, start, last)
            first = next(told)
            all_reports += [first, replace(report, converged=first.converged)]
        return rows, all_reports


@dataclass(frozen=True, eq=False)
class Carrier:
    """Carries the places of the coarse vertices of one piece over to all its vertices.

    Attributes
    ----------
    patch : Patch
        The piece.
    kept : (c,) int64
        Its coarse vertices.
    edges : (e, 2) int64
        Edges between them, by their place in `kept`.
    """

    patch: Patch
    kept: Index
    edges: Index

    @cached_property
    def factor(self) -> Factor:
        """Factor of ``L + h S`` ``(n, n)``."""
        hold = np.zeros(len(self.patch.fixed))
        hold[self.kept] = HOLD
        return factorise(sparse.csr_array(self.patch.laplacian + sparse.diags_array(hold)))

    def carried(self, lengths: Float, angles: Float, places: Float) -> Float:
        """Return the vertices ``(n, 3)`` of a piece with lengths, angles, and places ``(c, 3)`` of the coarse ones."""
        faces, nowhere = self.patch.faces, np.zeros((len(self.patch.fixed), 3))
        sides = turned_sides(self.patch, lengths, angles, nowhere)
        linear = integrate(self.patch, sides, nowhere)
        whole, _ = kabsch(linear[self.kept], places)
        turns = self._rotations(linear[self.kept] @ whole.T, places)
        spread = self.factor.solve(self._at_kept(HOLD * turns.reshape(-1, 9))).reshape(-1, 3, 3)
        rotations = nearest_rotations(spread[faces].mean(axis=1)) @ whole
        turned = np.einsum("fij,fkj->fki", rotations, sides)
        right = self._at_kept(HOLD * places)
        np.add.at(right, faces.reshape(-1), -turned.reshape(-1, 3))
        np.add.at(right, np.roll(faces, -1, axis=1).reshape(-1), turned.reshape(-1, 3))
        return self.factor.solve(right)

    def _at_kept(self, values: Float) -> Float:
        """Values ``(c, k)`` of the coarse vertices among zeros ``(n, k)``."""
        result = np.zeros((len(self.patch.fixed), values.shape[1]))
        result[self.kept] = values
        return result

    def _rotations(self, source: Float, target: Float) -> Float:
        """Rotations ``(c, 3, 3)`` that best turn the edges of every coarse vertex into those of the target."""
        i, j = self.edges.T
        products = np.einsum("ei,ej->eij", target[j] - target[i], source[j] - source[i])
        covariances = np.zeros((len(source), 3, 3))
        np.add.at(covariances, i, products)
        np.add.at(covariances, j, products)
        return aligning_rotations(covariances)
