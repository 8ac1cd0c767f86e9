"""One joint from its lengths and angles: the linear start, then Gauss-Newton."""

from __future__ import annotations

import numpy as np

from mixseq.arrays import Float
from mixseq.geometry.lengths_angles import dihedral_angles, edge_lengths
from mixseq.shells.fitting import NO_PULL, Pull, ShellProblem, ShellReport, ShellSettings, fit_shell
from mixseq.shells.linear_initialisation import linear_initialisation
from mixseq.shells.patch import Patch

NEAR = 0.5
"""A guess without a larger weighted residual is near the answer."""

SHORTEST = 1e-6
"""Shortest length of an edge, relative to its typical length."""

NO_LENGTH = 1e-12
"""Edges that are shorter, in diagonals, have no direction to be moved along, and do not count; the value is ours."""


def rebuild(
    patch: Patch,
    lengths: Float,
    angles: Float,
    weights: Float,
    positions: Float,
    settings: ShellSettings,
    guess: Float | None = None,
    pull: Pull = NO_PULL,
) -> tuple[Float, ShellReport]:
    """Rebuild a patch from the edge lengths and dihedral angles around its free vertices.

    Parameters
    ----------
    patch : Patch
        The joint and which of its vertices are fixed.
    lengths : (e',) float64
        Lengths of `Patch.free_edges`.
    angles : (h',) float64
        Angles of `Patch.free_hinges`, radians.
    weights : (e',) float64
        Weights of the lengths: one over the typical length of every edge.
    positions : (n, 3) float64
        Positions of the fixed vertices; the others are not looked at.
    settings : ShellSettings
        Weight of the angles, and when to stop.
    guess : (f, 3) float64, optional
        Another start for the free vertices.
    pull : Pull, optional
        Where the free vertices are expected.

    Returns
    -------
    points : (n, 3) float64
    report : ShellReport

    Notes
    -----
    The linear start is exact where lengths and angles are those of a mesh. Between meshes it is what makes
    Gauss-Newton find the right fold where poses are far apart; where they are near, a guess may be closer. The
    start of lower energy is taken. It is not looked for where the guess has no residual above `NEAR`, or where a pull
    tells which fold is meant.
    """
    lengths = sound_lengths(lengths, weights)
    problem = ShellProblem(patch, lengths, angles, weights, settings.bending, pull)
    if guess is None:
        return fit_shell(problem, _initial(problem, positions), settings)
    start = np.array(positions, dtype=np.float64)
    start[patch.free] = guess
    if not pull.weights.size and np.abs(problem.residuals(start)).max(initial=0.0) > NEAR:
        start = min(_initial(problem, positions), start, key=problem.energy)
    return fit_shell(problem, start, settings)


def length_weights(typical: Float) -> Float:
    """Return the weights ``(e,)`` of lengths: one over the typical ones, 0 where there is none to speak of."""
    return np.divide(1.0, typical, out=np.zeros_like(typical), where=typical > NO_LENGTH)


def sound_lengths(lengths: Float, weights: Float) -> Float:
    """Raise lengths that are too short: a curve that swings past its keys can ask for zero or less."""
    shortest = np.divide(SHORTEST, weights, out=np.zeros_like(weights), where=weights > 0)
    return np.maximum(lengths, shortest)


def _initial(problem: ShellProblem, positions: Float) -> Float:
    """The linear start; lengths and angles between fixed vertices are those they have."""
    patch = problem.patch
    lengths, angles = edge_lengths(positions, patch.edges), dihedral_angles(positions, patch.hinges)
    lengths[patch.free_edges], angles[patch.free_hinges] = problem.lengths, problem.angles
    return linear_initialisation(patch, lengths, angles, positions)
