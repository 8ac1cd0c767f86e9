r"""Damped Gauss-Newton (Levenberg-Marquardt): the points whose residuals r have the least sum of squares.

A step s solves :math:`(J^T J + \lambda \, \mathrm{diag}\, J^T J)\, s = -J^T r`. One that does not lower the energy is
tried again with ten times the damping :math:`\lambda`; one that does what the linear model promised lowers it.
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
"""With this damping no step is worth taking: the energy is not smooth here, or not finite."""

HELD = 1e-2
"""Above this damping steps are short because of the damping, which says nothing about convergence."""

LEVEL = 0.1
"""A step that lowers the energy by more than to this fraction is not the last: there is a mesh that fits exactly."""


@dataclass(frozen=True)
class ShellSettings:
    """Settings of fits to lengths and angles.

    Attributes
    ----------
    bending : float
        Weight of an angle in radians against a relative length.
    iterations : int
        At most this many steps.
    tolerance : float
        Converged when the model promises to lower the energy by less than this fraction of it ...
    exact : float
        ... or when no weighted residual is above this, ...
    accuracy : float
        ... or when a step moves no coordinate by more than this, in the unit of the points (diagonals), and the
        energy has levelled off: it is the last one. Steps get shorter by a factor of about ten, so what is left is
        much less.

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
        """Return settings so accurate that results for nearly the same targets can be subtracted; ours."""
        return replace(self, tolerance=min(self.tolerance, 1e-10), accuracy=min(self.accuracy, 1e-9))


@dataclass(frozen=True)
class ShellReport:
    """How a fit went: energy at the end, steps taken, whether it converged."""

    energy: float
    iterations: int
    converged: bool


class LeastSquares(Protocol):
    """What is fitted to."""

    def residual(self, points: Float) -> tuple[Float, float]:
        """Return the residuals ``(r,)`` at points ``(n, 3)``, and the sum of their squares."""

    def linearize(self, points: Float, residuals: Float) -> tuple[Float, DampedStep]:
        """Return the gradient ``J^T r`` ``(u,)``, and what solves for the step ``(u,)`` with a damping."""

    def retract(self, points: Float, step: Float) -> Float:
        """Return the points after a step; those given stay what they are."""


def minimise(problem: LeastSquares, start: Float, settings: ShellSettings) -> tuple[Float, ShellReport]:
    """Find the points with the least energy near a start: start ``(n, 3)``; result ``(n, 3)``."""
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
    """Return what adds a damping to the diagonal of a matrix with values ``(N,)`` in a pattern, which it reuses."""
    diagonal = values[pattern.diagonal]

    def with_damping(damping: float) -> Float:
        values[pattern.diagonal] = diagonal + damping * diagonal + 1e-12 * diagonal.max(initial=0.0)
        return values

    return with_damping
