r"""Gauss-Newton on edge lengths and dihedral angles: the discrete shell that fits them best.

Minimises, over the free vertices of a patch,

.. math::

    E(x) = \sum_e w_e^2 (l_e - l_e^*)^2 + \sum_h w_h^2\, \mathrm{wrap}(\theta_h - \theta_h^*)^2
         + \sum_v w_v^2 |x_v - x_v^*|^2

with ``w_e = 1 / mean length of e`` and one weight for all angles, so that both terms count relative changes
(Froehlich and Botsch 2011). The last term is optional: soft constraints of positions. Angle residuals are wrapped to
(-pi, pi], so that folds beyond half a turn are pulled the right way.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mixseq.arrays import Float
from mixseq.geometry.lengths_angles import dihedral_gradients, length_gradients
from mixseq.shells.block_pattern import BlockSparsePattern
from mixseq.shells.fitting_kernels import conjugate_gradients, shell_equations, shell_residuals
from mixseq.shells.gauss_newton import DampedStep, ShellReport, ShellSettings, damped, minimise
from mixseq.shells.patch import Patch

__all__ = [
    "UNCONSTRAINED",
    "DenseTerm",
    "ShellProblem",
    "ShellReport",
    "ShellSettings",
    "SoftConstraint",
    "fit_shell",
]


CLOSE = 0.03
"""Relative residual at which conjugate gradients stop; the next Gauss-Newton step corrects the rest."""

MOST = 100
"""Largest number of conjugate gradient steps; beyond it the matrix is factored."""

HOPELESS = 1e150
"""Largest dense residual whose square fits into double precision."""


class SoftConstraint(NamedTuple):
    """Soft constraints of positions of free vertices."""

    positions: Float  # (f, 3) where they are expected, in the unit of the points
    weights: Float  # (f,) weights of the distances from there, per unit; empty for no constraints at all


class DenseTerm(Protocol):
    """One more residual that depends on all vertices, such as a volume."""

    def residual(self, points: Float) -> float:
        """Return the weighted residual at points ``(n, 3)``."""

    def gradient(self, points: Float) -> Float:
        """Return its derivatives ``(n, 3)``."""


UNCONSTRAINED = SoftConstraint(np.zeros((0, 3)), np.zeros(0))


@dataclass(frozen=True, eq=False)
class ShellProblem:
    """Targets and weights of the patch's free edges and hinges.

    Optional are soft constraints, residuals ``weight * (x - position)`` of free vertices, and a last *dense* residual.
    """

    patch: Patch
    lengths: Float
    angles: Float
    length_weights: Float
    bending: float
    soft: SoftConstraint = UNCONSTRAINED
    dense: DenseTerm | None = None

    @property
    def edges(self) -> NDArray[np.int64]:
        """Edges ``(e', 2)`` with a residual."""
        return self.patch.equations.edges

    @property
    def hinges(self) -> NDArray[np.int64]:
        """Hinges ``(h', 4)`` with a residual."""
        return self.patch.equations.hinges

    def residuals(self, points: Float) -> Float:
        """Weighted residuals of points ``(n, 3)``: ``e' + h'``, ``3 free`` of soft constraints, and the dense one."""
        return self._residuals(points)[0]

    def energy(self, points: Float) -> float:
        """Sum of the squared residuals."""
        return self._residuals(points)[1]

    def _residuals(self, points: Float) -> tuple[Float, float]:
        rows = self.patch.equations
        residuals = np.empty(len(rows.edges) + len(rows.hinges) + 3 * len(self.soft.weights))
        energy = shell_residuals(
            points,
            rows.edges,
            rows.hinges,
            self.lengths,
            self.angles,
            self.length_weights,
            self.bending,
            rows.free,
            self.soft.positions,
            self.soft.weights,
            residuals,
        )
        if self.dense is not None:
            last = self.dense.residual(points)
            # Python raises where squares overflow; infinite energies are what minimise expects of a hopeless mesh.
            square = last**2 if abs(last) < HOPELESS else np.inf
            return np.append(residuals, last), float(energy) + square
        return residuals, float(energy)

    def normal_equations(self, points: Float, residuals: Float) -> tuple[Float, Float]:
        """Values ``(N,)`` of ``J^T J`` in the patch's pattern, and ``J^T r`` ``(3 free,)``, without the dense term."""
        rows = self.patch.equations
        values, gradient = np.empty(len(rows.pattern.rows)), np.empty(3 * len(rows.free))
        shell_equations(
            points,
            rows.edges,
            rows.hinges,
            self.length_weights,
            self.bending,
            self.soft.weights,
            residuals,
            rows.number,
            rows.edge_blocks,
            rows.hinge_blocks,
            rows.pattern.places,
            values,
            gradient,
        )
        return values, gradient

    def dense_row(self, points: Float) -> Float | None:
        """Derivatives ``(3 free,)`` of the dense residual, if there is one."""
        if self.dense is None:
            return None
        return self.dense.gradient(points)[self.patch.free].reshape(-1)

    def jacobian(self, points: Float) -> sparse.csr_array:
        """Derivatives of all residuals but the dense one by the free vertices, ``(residuals, 3 free)``."""
        length = length_gradients(points, self.edges) * self.length_weights[:, None]
        stretch = np.stack([-length, length], axis=1)
        bend = self.bending * dihedral_gradients(points, self.hinges)
        row = np.concatenate(
            [
                np.repeat(np.arange(len(self.edges)), 6),
                len(self.edges) + np.repeat(np.arange(len(self.hinges)), 12),
            ]
        )
        place = self.patch.free_number[np.concatenate([self.edges.reshape(-1), self.hinges.reshape(-1)])]
        column = (3 * place[:, None] + np.arange(3)).reshape(-1)
        value = np.concatenate([stretch.reshape(-1), bend.reshape(-1)])
        inside = np.repeat(place >= 0, 3)
        weights = np.repeat(self.soft.weights, 3)
        value = np.concatenate([value[inside], weights])
        first = len(self.edges) + len(self.hinges)
        row = np.concatenate([row[inside], first + np.arange(len(weights))])
        column = np.concatenate([column[inside], np.arange(len(weights))])
        size = (first + len(weights), 3 * len(self.patch.free))
        return sparse.coo_array((value, (row, column)), shape=size).tocsr()


def fit_shell(
    problem: ShellProblem, start: Float, settings: ShellSettings | None = None
) -> tuple[Float, ShellReport]:
    """Fit a patch to edge lengths and dihedral angles: start ``(n, 3)``; result ``(n, 3)``."""
    return minimise(_Fit(problem), np.array(start, dtype=np.float64), settings or ShellSettings())


class _Fit:
    """The `LeastSquares` of a problem; stores whether conjugate gradients are worth trying again."""

    def __init__(self, problem: ShellProblem) -> None:
        self._problem = problem
        self._constrained = bool(problem.soft.weights.size)

    def residual(self, points: Float) -> tuple[Float, float]:
        return self._problem._residuals(points)

    def linearize(self, points: Float, residuals: Float) -> tuple[Float, DampedStep]:
        pattern = self._problem.patch.equations.pattern
        values, gradient = self._problem.normal_equations(points, residuals)
        with_damping, row = damped(pattern, values), self._problem.dense_row(points)
        if row is not None:
            gradient += residuals[-1] * row

        def step(damping: float) -> Float:
            matrix = with_damping(damping)
            if row is not None:
                return _dense_step(pattern, matrix, gradient, row)
            result, self._constrained = _step(pattern, matrix, gradient, self._constrained)
            return result

        return gradient, step

    def retract(self, points: Float, step: Float) -> Float:
        result = points.copy()
        result[self._problem.patch.free] += step.reshape(-1, 3)
        return result


def _step(
    pattern: BlockSparsePattern, values: Float, gradient: Float, constrained: bool
) -> tuple[Float, bool]:
    """Solve for a step, by conjugate gradients if `constrained`; return whether these are worth trying again.

    With all positions constrained the matrix is well conditioned: a few conjugate gradients cost a tenth of a
    factorisation. Without constraints soft bends make it ill conditioned.
    """
    if constrained:
        step = np.empty_like(gradient)
        steps = conjugate_gradients(
            pattern.starts, pattern.rows, pattern.places, values, -gradient, CLOSE, MOST, step
        )
        if steps >= 0:
            return step, True
    return -pattern.analysis.factor(values).solve(gradient), False


def _dense_step(pattern: BlockSparsePattern, values: Float, gradient: Float, row: Float) -> Float:
    """Solve ``(A + row row^T) step = -gradient`` with the factor of A alone (Sherman and Morrison 1950)."""
    both = pattern.analysis.factor(values).solve(np.stack([-gradient, row], axis=1))
    step, along = both.T
    return np.asarray(step - along * (row @ step) / (1.0 + row @ along))
