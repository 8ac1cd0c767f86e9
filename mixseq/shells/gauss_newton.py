r"""Damped Gauss-Newton (Levenberg-Marquardt): minimise the sum of squared residuals r.

A step s solves :math:`(J^T J + \lambda \, \mathrm{diag}\, J^T J)\, s = -J^T r`. If it does not lower the energy, it is
tried again with ten times the damping :math:`\lambda`; if it lowers it as the linear model predicts, damping falls.

Sparsity pattern of symmetric matrices of 3 x 3 blocks.

Unknowns come in threes: the coordinates of a vertex, or the columns of a face's frame. Coupled pairs follow from
connectivity, so the places of all values are found once. A matrix is its values alone, the lower triangle column by
column (compressed sparse columns).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from mixseq.errors import ReconstructionError, SettingsError
from mixseq.runtime.lazy import PickledWithoutCaches
from mixseq.shells.solvers import Analysis, analyse
from mixseq.types import Float, Index


@dataclass(frozen=True, eq=False)
class BlockSparsePattern(PickledWithoutCaches):
    """The lower triangle of a symmetric matrix of n x n blocks, with all diagonal blocks."""

    starts: Index  # (3n + 1,) where the values of every column start
    rows: Index  # (N,) row of every value, ascending in each column; the first is that of the diagonal
    # (n + m, 3) for each of the n blocks of the diagonal and the m blocks below it, and for each of the block's
    # columns, where the value of the block's row 0 is; rows 1 and 2 follow. The diagonal's blocks have only the rows on
    # and below the diagonal.
    places: Index
    keys: Index  # (m,) n * column + row of the blocks below the diagonal, ascending
    threads: int | None = None  # threads that factor one matrix; by default from its size

    @classmethod
    def of(cls, count: int, pairs: Index, threads: int | None = None) -> BlockSparsePattern:
        """Make the pattern of `count` triples of unknowns, coupled in pairs ``(k, 2)``; negative ones are ignored."""
        low, high = pairs.min(axis=1, initial=count), pairs.max(axis=1, initial=-1)
        coupled = (low >= 0) & (low < high)
        keys = np.unique(count * low[coupled] + high[coupled])
        column, row = np.divmod(keys, max(count, 1))
        below = np.bincount(column, minlength=count)
        heights = (3 * below[:, None] + np.array([3, 2, 1])).reshape(-1)
        starts = np.concatenate([[0], np.cumsum(heights)]).astype(np.int64)
        tops = starts[:-1].reshape(-1, 3)
        rank = np.arange(len(keys)) - np.searchsorted(column, np.arange(count))[column]
        places = np.concatenate([tops - np.arange(3), tops[column] + np.array([3, 2, 1]) + 3 * rank[:, None]])
        rows = np.empty(starts[-1], dtype=np.int64)
        for j in range(3):
            for i in range(j, 3):
                rows[places[:count, j] + i] = 3 * np.arange(count) + i
            for i in range(3):
                rows[places[count:, j] + i] = 3 * row + i
        return cls(starts, rows, places.astype(np.int64), keys, threads)

    @property
    def count(self) -> int:
        """Number n of triples of unknowns."""
        return (len(self.starts) - 1) // 3

    def block(self, i: Index, j: Index) -> Index:
        """Return the block of `places` that couples i and j, -1 where one is negative."""
        low, high = np.minimum(i, j), np.maximum(i, j)
        below = self.count + np.searchsorted(self.keys, self.count * low + high)
        return np.where(low < 0, -1, np.where(low == high, low, below)).astype(np.int64)

    def constants(self) -> tuple[object, ...]:
        """Implement `PickledWithoutCaches.constants`."""
        return (self.analysis,)

    @cached_property
    def diagonal(self) -> Index:
        """Places ``(3n,)`` of the values of the diagonal."""
        return self.starts[:-1]

    @cached_property
    def analysis(self) -> Analysis:
        """Ordering and symbolic factorisation, shared by all matrices of the pattern."""
        return analyse(self.starts, self.rows, self.threads)


DampedStep = Callable[[float], Float]

STUCK = 1e12
"""Damping at which the fit stops: the energy is not smooth here, or not finite."""

HELD = 1e-2
"""Damping above which short steps do not indicate convergence."""

LEVEL = 0.1
"""Ratio of energies below which a step is not the last: a mesh fits exactly."""


@dataclass(frozen=True)
class ShellSettings:
    """Settings of fits to lengths and angles.

    Attributes
    ----------
    bending : float
        Weight of an angle in radians against a relative length.
    iterations : int
        Largest number of steps.
    tolerance : float
        Converged when the model promises to lower the energy by less than this fraction of it ...
    exact : float
        ... or when no weighted residual is above this, ...
    accuracy : float
        ... or when a step moves no coordinate by more than this, in the unit of the points (diagonals), and the
        energy has levelled off. Steps shrink by a factor of about ten, so the remaining error is much less.

    Raises
    ------
    SettingsError
        If one of them is not a number, or below zero.
    """

    bending: float = 0.3
    iterations: int = 100
    tolerance: float = 1e-3
    exact: float = 1e-10
    accuracy: float = 5e-5

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            kind = int | np.integer if field.name == "iterations" else int | float | np.number
            if not (isinstance(value, kind) and np.isfinite(value) and value >= 0):
                whole = "whole number" if field.name == "iterations" else "number"
                raise SettingsError(f"{field.name} is {value!r}; a {whole} of 0 or more is expected")

    def for_differences(self) -> ShellSettings:
        """Return settings accurate enough to subtract results for nearly equal targets."""
        return replace(self, tolerance=min(self.tolerance, 1e-10), accuracy=min(self.accuracy, 1e-9))


@dataclass(frozen=True)
class ShellReport:
    """Result of a fit: final energy, number of steps, convergence."""

    energy: float
    iterations: int
    converged: bool


class LeastSquares(Protocol):
    """A nonlinear least-squares problem."""

    def residual(self, points: Float) -> tuple[Float, float]:
        """Return the residuals ``(r,)`` at points ``(n, 3)``, and the sum of their squares."""

    def linearize(self, points: Float, residuals: Float) -> tuple[Float, DampedStep]:
        """Return the gradient ``J^T r`` ``(u,)``, and a solver for the step ``(u,)`` with a damping."""

    def retract(self, points: Float, step: Float) -> Float:
        """Return new points after a step."""


def minimise(problem: LeastSquares, start: Float, settings: ShellSettings) -> tuple[Float, ShellReport]:
    """Find the points ``(n, 3)`` of least energy near a start ``(n, 3)``."""
    points = start
    residuals, energy = problem.residual(points)
    if not np.isfinite(energy):
        raise ReconstructionError(
            "lengths, angles, volumes or fixed vertices of a joint are not finite, or too large to be squared"
        )
    damping = 1e-6
    for iteration in range(settings.iterations):
        if np.abs(residuals).max(initial=0.0) <= settings.exact:
            return points, ShellReport(energy, iteration, True)
        gradient, damped_step = problem.linearize(points, residuals)
        while True:
            step = damped_step(damping)
            promised = -float(gradient @ step)  # what the linear model gains, for small damping
            if promised <= settings.tolerance * energy:
                return points, ShellReport(energy, iteration, damping <= HELD)
            candidate = problem.retract(points, step)
            new_residuals, new_energy = problem.residual(candidate)
            if new_energy < energy:
                break
            if not damping < STUCK:
                return points, ShellReport(energy, iteration, False)
            damping *= 10.0
        gain = (energy - new_energy) / promised
        level = new_energy > LEVEL * energy
        points, residuals, energy = candidate, new_residuals, new_energy
        if level and damping <= HELD and np.abs(step).max() <= settings.accuracy:
            return points, ShellReport(energy, iteration + 1, True)
        damping = max(damping * (0.2 if gain > 0.75 else 1.0 if gain > 0.25 else 4.0), 1e-10)
    return points, ShellReport(energy, settings.iterations, False)


def damped(pattern: BlockSparsePattern, values: Float) -> Callable[[float], Float]:
    """Return a function that adds a damping to the diagonal of a matrix with values ``(N,)``, into one buffer."""
    diagonal = values[pattern.diagonal]

    def with_damping(damping: float) -> Float:
        values[pattern.diagonal] = diagonal + damping * diagonal + 1e-12 * diagonal.max(initial=0.0)
        return values

    return with_damping
