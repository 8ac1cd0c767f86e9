r"""Damped Gauss-Newton (Levenberg-Marquardt): minimise the sum of squared residuals r.

A step s solves :math:`(J^T J + \lambda \, \mathrm{diag}\, J^T J)\, s = -J^T r`. If it does not lower the energy, it is
tried again with ten times the damping :math:`\lambda`; if it lowers it as the linear model predicts, damping falls.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Protocol

import numpy as np

from mixseq.arrays import Float
from mixseq.errors import ReconstructionError, SettingsError
from mixseq.shells.block_pattern import BlockSparsePattern

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
