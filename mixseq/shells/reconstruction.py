r"""Rebuild a patch from edge lengths and dihedral angles: linear initialisation, then Gauss-Newton.

The linear initialisation (after Wang, Liu and Tong 2012) uses no pose:

1. Frames: minimise :math:`\sum \|F_j - F_i T_{ij}\|^2`, a sparse linear system; faces whose vertices are all fixed
   have known frames (if nothing is fixed the first face gets the identity). Project every frame to a rotation.
2. Vertices: minimise :math:`\sum_f \sum_{ab \in f} \|x_b - x_a - F_f\, u_{ab}\|^2` over the sides of all faces, where
   ``u`` is the side in the frame; fixed vertices stay (if there are none the first one is the origin).

Where a mesh has these lengths and angles the result is that mesh, exactly.
"""

from __future__ import annotations

import numpy as np

from mixseq.arrays import Float
from mixseq.geometry.lengths_angles import dihedral_angles, edge_lengths, sound_lengths
from mixseq.geometry.rigid import nearest_rotations
from mixseq.geometry.rotations import rotations_of
from mixseq.shells.face_frames import flat_triangles, frames_of
from mixseq.shells.fitting import (
    UNCONSTRAINED,
    ShellProblem,
    ShellReport,
    ShellSettings,
    SoftConstraint,
    fit_shell,
)
from mixseq.shells.patch import Patch

NEAR = 0.5
"""Largest weighted residual of a guess from which Gauss-Newton may start."""


def linear_initialisation(patch: Patch, lengths: Float, angles: Float, positions: Float) -> Float:
    """Rebuild a patch ``(n, 3)`` linearly from lengths ``(e,)``, angles ``(h,)`` and fixed positions ``(n, 3)``."""
    return integrate(patch, _sides(patch, lengths, angles, positions), positions)


def _sides(patch: Patch, lengths: Float, angles: Float, positions: Float) -> Float:
    """Return the sides 01, 12, 20 of all faces ``(m, 3, 3)``, in their frames, before solving for vertices."""
    local = flat_triangles(lengths[patch.face_edges])
    frames = _frames(patch, local, angles, positions)
    return np.asarray(np.einsum("fij,fkj->fki", frames[:, :, :2], np.roll(local, -1, axis=1) - local))


def _frames(patch: Patch, local: Float, angles: Float, positions: Float) -> Float:
    known = np.zeros((len(patch.faces), 3, 3))
    is_known = patch.fixed_faces.copy()
    if is_known.any():
        known[is_known] = rotations_of(frames_of(positions, patch.faces[is_known]))
    else:
        is_known[0] = True
        known[0] = np.eye(3)
    number = patch.face_number
    unknown = np.flatnonzero(number >= 0)
    if not unknown.size:
        return known

    # Rows of F (one per world coordinate) are independent: F_j - F_i T = 0 reads f_j - T^T f_i = 0 for rows f.
    i, j = patch.hinge_faces.T
    turns = rotations_of(patch.hinge_frames.turns(local, angles))
    right = np.zeros((unknown.size, 3, 3))  # (face, column of F, world coordinate)
    for target, source, turn in ((j, i, turns), (i, j, np.swapaxes(turns, 1, 2))):
        border = is_known[source] & ~is_known[target]
        pulled = known[source[border]] @ turn[border]
        np.add.at(right, number[target[border]], np.swapaxes(pulled, 1, 2))

    pattern = patch.frame_pattern
    values = np.zeros(len(pattern.rows))
    counts = np.bincount(patch.hinge_faces.reshape(-1), minlength=len(patch.faces))
    values[pattern.diagonal] = np.repeat(counts[unknown].astype(np.float64), 3)
    inner = ~is_known[i] & ~is_known[j]
    first, second = number[i[inner]], number[j[inner]]
    # -T^T couples row block j to column block i; below the diagonal is the higher number's row.
    turned = turns[inner]
    blocks = -np.where((second > first)[:, None, None], np.swapaxes(turned, 1, 2), turned)
    places = pattern.places[pattern.block(first, second)][:, None, :] + np.arange(3)[:, None]
    np.add.at(values, places, blocks)
    solution = pattern.analysis.factor(values).solve(right.reshape(-1, 3)).reshape(-1, 3, 3)
    known[unknown] = nearest_rotations(np.swapaxes(solution, 1, 2))
    return known


def integrate(patch: Patch, sides: Float, positions: Float) -> Float:
    """Solve for the vertices whose sides ``x_b - x_a`` are closest to ``(m, 3, 3)`` given ones."""
    count = len(patch.fixed)
    right = np.zeros((count, 3))
    np.add.at(right, patch.faces.reshape(-1), -sides.reshape(-1, 3))
    np.add.at(right, np.roll(patch.faces, -1, axis=1).reshape(-1), sides.reshape(-1, 3))
    result = np.where(patch.fixed[:, None], positions, 0.0)
    coupling = patch.laplacian[patch.integrated][:, patch.fixed]
    right = right[patch.integrated] - coupling @ result[patch.fixed]
    result[patch.integrated] = patch.laplacian_factor.solve(right)
    return result


def rebuild(
    patch: Patch,
    lengths: Float,
    angles: Float,
    weights: Float,
    positions: Float,
    settings: ShellSettings,
    guess: Float | None = None,
    soft: SoftConstraint = UNCONSTRAINED,
) -> tuple[Float, ShellReport]:
    """Rebuild a patch ``(n, 3)`` from lengths ``(e',)`` and angles ``(h',)``, in radians, at its free vertices.

    Weights ``(e',)`` are inverse typical lengths. Of positions ``(n, 3)`` those of fixed vertices are used. A guess
    ``(f, 3)`` is an alternative start of the free vertices.
    """
    lengths = sound_lengths(lengths, weights)
    problem = ShellProblem(patch, lengths, angles, weights, settings.bending, soft)
    if guess is None:
        return fit_shell(problem, _initial(problem, positions), settings)
    start = np.array(positions, dtype=np.float64)
    start[patch.free] = guess
    if not soft.weights.size and np.abs(problem.residuals(start)).max(initial=0.0) > NEAR:
        start = min(_initial(problem, positions), start, key=problem.energy)
    return fit_shell(problem, start, settings)


def _initial(problem: ShellProblem, positions: Float) -> Float:
    """Return the linear start; lengths and angles between fixed vertices are their own."""
    patch = problem.patch
    lengths, angles = edge_lengths(positions, patch.edges), dihedral_angles(positions, patch.hinges)
    lengths[patch.free_edges], angles[patch.free_hinges] = problem.lengths, problem.angles
    return linear_initialisation(patch, lengths, angles, positions)
