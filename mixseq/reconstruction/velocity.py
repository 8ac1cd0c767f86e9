r"""How fast the free vertices of a joint move: the analytic derivative of `rebuild` in time.

The free vertices x minimise ``E(x, y, p) = |r|^2`` (see `shells`), given the fixed vertices y and the targets p,
so half the gradient, ``J' r`` with the derivatives ``J`` of the weighted residuals by the free vertices, stays zero
while y and p move. Its derivative in time is zero as well (implicit function theorem). With velocities u of all
vertices, free and fixed,

.. math:: J^T (\bar J u - W \dot p) + (S u)_{free} = 0, \qquad
          S = \sum_e w_e\, r_e \nabla^2 l_e + \sum_h w_h\, r_h \nabla^2 \theta_h

where :math:`\bar J` has the columns of the fixed vertices too. Without S this is the Gauss-Newton velocity: one linear
system with the matrix of a step of `fit_shell`. It is exact where the residuals are zero, at the frames of the
sequence. Elsewhere it is where conjugate gradients start, which solve for S too: its products with vectors are
derivatives of the closed gradients along a direction, and the Gauss-Newton matrix is the preconditioner.
At a minimum the Hessian ``J' J + S`` has no negative directions. Where one is met all the same the points are no
minimum, or the minimum is about to end in a fold, and the Gauss-Newton velocity is the answer.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mixseq.geometry.lengths_angles import dihedral_gradients, edge_lengths, length_gradients
from mixseq.reconstruction.joint import SHORTEST
from mixseq.reconstruction.patch import Patch
from mixseq.reconstruction.shells import NO_PULL, Pull, ShellProblem, ShellSettings

Float = NDArray[np.float64]
Index = NDArray[np.int64]

DAMPING = 1e-12
"""Added to the Gauss-Newton matrix, relative to its diagonal: makes motions that nothing hinders unique."""

FLAT = 1e-9
"""A face lower than this, relative to the hinge's edge, has no second derivatives of its angle."""


@dataclass(frozen=True, eq=False)
class JointRates:
    """Velocities of what a joint is made from, per second or whatever the unit of time is.

    Attributes
    ----------
    lengths : (e',) float64
        Of the lengths of `Patch.free_edges`.
    angles : (h',) float64
        Of the angles of `Patch.free_hinges`, radians.
    positions : (n, 3) float64
        Of the fixed vertices; the others are not looked at.
    places : (f, 3) float64
        Of the places of the pull; empty if there is none.
    """

    lengths: Float
    angles: Float
    positions: Float
    places: Float = field(default_factory=lambda: np.zeros((0, 3)))


@dataclass(frozen=True)
class VelocityReport:
    """How a velocity was found.

    Attributes
    ----------
    iterations : int
        Steps of conjugate gradients after the Gauss-Newton velocity.
    converged : bool
        Whether they arrived. If not the result is their last one.
    definite : bool
        Whether no negative direction was met. If one was the result is the Gauss-Newton velocity.
    """

    iterations: int
    converged: bool
    definite: bool


def joint_velocity(
    patch: Patch,
    lengths: Float,
    angles: Float,
    weights: Float,
    points: Float,
    rates: JointRates,
    settings: ShellSettings,
    iterations: int = 50,
    tolerance: float = 1e-8,
    pull: Pull = NO_PULL,
) -> tuple[Float, VelocityReport]:
    """Return the velocities of a rebuilt joint's vertices.

    Parameters
    ----------
    patch, lengths, angles, weights, settings, pull
        As `rebuild` was given them.
    points : (n, 3) float64
        What it returned, stationary up to its tolerance.
    rates : JointRates
        Velocities of lengths, angles and fixed vertices.
    iterations : int
        At most this many steps of conjugate gradients; 0 for the Gauss-Newton velocity.
    tolerance : float
        They have arrived when what is left of the right-hand side is less than this fraction of it, in the norm
        of the inverse Gauss-Newton matrix.

    Returns
    -------
    velocities : (n, 3) float64
        Those of the fixed vertices are the given ones.
    report : VelocityReport

    Notes
    -----
    A length that `rebuild` raises to its lower bound stands still. Where a joint's fixed vertices leave it a free
    motion, as where there are none, the result is one of the possible velocities.
    """
    bound = SHORTEST / weights
    problem = ShellProblem(patch, np.maximum(lengths, bound), angles, weights, settings.bending, pull)
    free = patch.free
    velocities = np.where(patch.fixed[:, None], rates.positions, 0.0)
    if not len(free):
        return velocities, VelocityReport(0, True, True)
    residuals = problem.residuals(points)
    jacobian = problem.jacobian(points)
    wanted = np.concatenate(
        [
            weights * np.where(lengths > bound, rates.lengths, 0.0),
            settings.bending * rates.angles,
            (pull.weights[:, None] * rates.places).reshape(-1),
        ]
    )
    pattern = patch.equations.pattern
    values, _ = problem.normal_equations(points, residuals)
    # Relative to each row: one triangle as good as without area has gradients without bound, and must not hold
    # all the others.
    diagonal = values[pattern.diagonal]
    shift = np.where(diagonal > 0.0, DAMPING * diagonal, 1.0)
    values[pattern.diagonal] += shift
    factor = pattern.analysis.factor(values)
    right = jacobian.T @ (wanted - _residual_rates(problem, points, velocities))
    start = factor.solve(right)
    velocities[free] = start.reshape(-1, 3)

    def hessian(direction: Float) -> Float:
        moved = np.zeros_like(points)
        moved[free] = direction.reshape(-1, 3)
        curved = curvature(problem, points, residuals, moved)[free].reshape(-1)
        return np.asarray(jacobian.T @ (jacobian @ direction) + shift * direction + curved)

    # Conjugate gradients for (J'J + S) step = -(S u)_free, u the Gauss-Newton velocity.
    remaining = -curvature(problem, points, residuals, velocities)[free].reshape(-1)
    step = np.zeros_like(start)
    towards = direction = factor.solve(remaining)
    left = float(remaining @ towards)
    enough = tolerance**2 * (float(right @ start) + left)
    for iteration in range(iterations):
        if left <= enough:
            return velocities, VelocityReport(iteration, True, True)
        product = hessian(direction)
        curving = float(direction @ product)
        if not curving > 0.0:
            velocities[free] = start.reshape(-1, 3)
            return velocities, VelocityReport(iteration, True, False)
        step = step + left / curving * direction
        velocities[free] = (start + step).reshape(-1, 3)
        remaining = remaining - left / curving * product
        towards = factor.solve(remaining)
        before, left = left, float(remaining @ towards)
        direction = towards + left / before * direction
    return velocities, VelocityReport(iterations, left <= enough, True)


def _residual_rates(problem: ShellProblem, points: Float, velocities: Float) -> Float:
    """Rates ``(e' + h',)`` of the weighted residuals if the vertices move and the targets do not."""
    edges = problem.edges
    difference = velocities[edges[:, 1]] - velocities[edges[:, 0]]
    stretch = np.einsum("ei,ei->e", length_gradients(points, edges), difference)
    bend = np.einsum("hki,hki->h", dihedral_gradients(points, problem.hinges), velocities[problem.hinges])
    pulled = problem.pull.weights[:, None] * velocities[problem.patch.free][: len(problem.pull.weights)]
    return np.concatenate([problem.length_weights * stretch, problem.bending * bend, pulled.reshape(-1)])


def curvature(problem: ShellProblem, points: Float, residuals: Float, velocities: Float) -> Float:
    """Return ``S u`` ``(n, 3)``: how the gradient turns at constant residuals.

    Parameters
    ----------
    problem : ShellProblem
    points : (n, 3) float64
        Where.
    residuals : (e' + h' ...,) float64
        Weighted residuals there; those of a pull, which is straight, have no part in it.
    velocities : (n, 3) float64
        Velocities u of all vertices.
    """
    edges, hinges = problem.edges, problem.hinges
    stretch = residuals[: len(edges)] * problem.length_weights
    bend = residuals[len(edges) : len(edges) + len(hinges)] * problem.bending
    length = stretch[:, None] * _length_gradient_rates(
        points, edges, velocities, SHORTEST / problem.length_weights
    )
    angle = bend[:, None, None] * dihedral_gradient_rates(points, hinges, velocities)
    vertices = np.concatenate([edges[:, 0], edges[:, 1], hinges.reshape(-1)])
    values = np.concatenate([-length, length, angle.reshape(-1, 3)])
    return np.stack([np.bincount(vertices, column, minlength=len(points)) for column in values.T], axis=1)


def _length_gradient_rates(points: Float, edges: Index, velocities: Float, shortest: Float) -> Float:
    """Rates ``(e', 3)`` of `length_gradients`: ``(du - g (g.du)) / l``, 0 for edges up to the shortest."""
    gradients, lengths = length_gradients(points, edges), edge_lengths(points, edges)
    difference = velocities[edges[:, 1]] - velocities[edges[:, 0]]
    across = difference - np.einsum("ei,ei->e", gradients, difference)[:, None] * gradients
    inverse = np.divide(1.0, lengths, out=np.zeros_like(lengths), where=lengths > shortest)
    return np.asarray(inverse[:, None] * across)


def dihedral_gradient_rates(points: Float, hinges: Index, velocities: Float) -> Float:
    """Return the rates ``(H, 4, 3)`` of `dihedral_gradients` while the vertices move.

    This is the product of the Hessian of each angle with a vector, by the chain rule: with ``h = |e| / |n1|^2``,
    ``gc = -h n1`` and dots for rates, ``gc. = -h n1. - h (e.e. / |e|^2 - 2 n1.n1. / |n1|^2) n1``, ``gd.`` likewise;
    ``tc. = ((c - a).e + (c - a).e. - 2 tc e.e.) / |e|^2`` and ``td.`` likewise; the rates of ``ga`` and ``gb``
    follow from the product rule. Where a face is flat in itself they are 0.
    """
    a, b, c, d = (points[hinges[:, i]] for i in range(4))
    va, vb, vc, vd = (velocities[hinges[:, i]] for i in range(4))
    e, ve = b - a, vb - va
    squared = _dot(e, e)
    safe = np.maximum(squared, np.finfo(np.float64).tiny)
    growth = _dot(e, ve) / safe
    turns, smooth = [], np.ones((len(hinges), 1), dtype=bool)
    for arm, speed, sign in ((c - a, vc - va, 1.0), (d - a, vd - va, -1.0)):
        n = sign * np.cross(e, arm)
        vn = sign * (np.cross(ve, arm) + np.cross(e, speed))
        area = _dot(n, n)
        smooth &= area > (FLAT * squared) ** 2
        area = np.where(smooth, area, 1.0)
        h = np.sqrt(squared) / area
        g = -h * n
        vg = -h * vn + (growth - 2.0 * _dot(n, vn) / area) * g
        t = _dot(arm, e) / safe
        vt = (_dot(speed, e) + _dot(arm, ve)) / safe - 2.0 * t * growth
        turns.append((vg, vt * g + t * vg))
    (vgc, c_part), (vgd, d_part) = turns
    vgb = -c_part - d_part
    rates = [-vgc - vgd - vgb, vgb, vgc, vgd]  # a motion of all four vertices turns nothing
    return np.where(smooth[:, None], np.stack(rates, axis=1), 0.0)


def _dot(x: Float, y: Float) -> Float:
    return np.asarray(np.einsum("hi,hi->h", x, y)[:, None])
