"""The same problem without parts: Gauss-Newton on the lengths and angles of the whole mesh (the space S_e).

The mesh is one joint with no vertex fixed, so kernels, solver and criteria are those of the joints. Patterns are
analysed, and constant matrices factored, before anything is timed.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from importlib import import_module

import numpy as np

from mixseq.mesh.measures import dihedral_angles, edge_lengths, unwrap_angles
from mixseq.mesh.topology import Topology
from mixseq.shells.fitting import Patch, ShellProblem, fit_shell, linear_initialisation
from mixseq.shells.gauss_newton import ShellReport, ShellSettings
from mixseq.types import Float


@dataclass(frozen=True, eq=False)
class FullMesh:
    """A mesh between two of its poses ``(2, V, 3)``, in diagonals; rslab works on `threads` threads.

    The second pose has a weight.
    """

    topology: Topology
    ends: Float
    threads: int
    settings: ShellSettings
    weight: float = 0.5

    @cached_property
    def lengths(self) -> Float:
        """Mean edge lengths of the two."""
        return self._between(edge_lengths(self.ends, self.topology.edges))

    @cached_property
    def angles(self) -> Float:
        """Mean dihedral angles of the two, by the shorter way round."""
        return self._between(unwrap_angles(dihedral_angles(self.ends, self.topology.hinges)))

    def _between(self, both: Float) -> Float:
        return np.asarray((1.0 - self.weight) * both[0] + self.weight * both[1])

    @cached_property
    def problem(self) -> ShellProblem:
        t = self.topology
        nothing_fixed = np.zeros(t.vertex_count, dtype=bool)
        faces = t.faces.astype(np.int64)
        import_module("rslab")  # without it the comparison fails: with another solver it would be another one
        patch = Patch(faces, t.edges, t.face_edges, t.hinges, t.hinge_faces, nothing_fixed, self.threads)
        return ShellProblem(patch, self.lengths, self.angles, 1.0 / self.lengths, self.settings.bending)

    def prepare(self) -> None:
        """Analyse and compile whatever is kept, so that it is not timed."""
        iterate(self.problem, self.ends[0])
        self.problem.patch.precompute()

    def from_vertices(self) -> tuple[Float, ShellReport]:
        """Solve, starting from the mean of the vertices."""
        return fit_shell(self.problem, self.ends.mean(axis=0), self.settings)

    def from_frames(self) -> tuple[Float, ShellReport]:
        """Solve, starting from the linear start; only for a connected mesh."""
        patch = self.problem.patch
        start = linear_initialisation(patch, self.lengths, self.angles, np.zeros_like(self.ends[0]))
        return fit_shell(self.problem, start, self.settings)


def iterate(problem: ShellProblem, points: Float) -> Float:
    """One iteration of Gauss-Newton: residuals, assembly, factorisation, solution. Returns the step."""
    residuals = problem.residuals(points)
    values, gradient = problem.normal_equations(points, residuals)
    pattern = problem.patch.equations.pattern
    diagonal = values[pattern.diagonal]
    values[pattern.diagonal] = (1 + 1e-6) * diagonal + 1e-12 * diagonal.max()
    return -pattern.analysis.factor(values).solve(gradient)
