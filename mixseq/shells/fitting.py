r"""Fit a patch of triangles to edge lengths and dihedral angles: linear initialisation, then Gauss-Newton.

The energy of the free vertices of a patch is

.. math::

    E(x) = \sum_e w_e^2 (l_e - l_e^*)^2 + \sum_h w_h^2\, \mathrm{wrap}(\theta_h - \theta_h^*)^2
         + w^2 (V - V^*)^2

with ``w_e = 1 / mean length of e`` and a constant ``w_h``, so that both terms measure relative changes (Froehlich and
Botsch 2011). A soft constraint of the volume V of the patch is optional. Angle residuals are wrapped to (-pi, pi], so
that folds beyond 180 degrees unfold the shorter way.

A step s solves :math:`(J^T J + \lambda \, \mathrm{diag}\, J^T J)\, s = -J^T r` (Levenberg-Marquardt). A step that does
not lower the energy is repeated with ten times the damping :math:`\lambda`. If a step lowers the energy as predicted by
the linear model, the damping is reduced.

The linear initialisation (after Wang, Liu and Tong 2012) is independent of the pose:

1. Frames: minimise :math:`\sum \|F_j - F_i T_{ij}\|^2` by a sparse linear system. Faces with three fixed vertices have
   known frames. Without such faces, the first frame is the identity. Project every frame to a rotation.
2. Vertices: minimise :math:`\sum_f \sum_{ab \in f} \|x_b - x_a - F_f\, u_{ab}\|^2` over the sides of all faces, where
   ``u`` is the side in frame axes. Fixed vertices keep their positions; without them, the first vertex is the origin.

The result is exact for consistent lengths and angles.

Fits *near positions* (`fit_patch_near`) start there, and add :math:`\sum_v w_v^2 |x_v - x_v^*|^2` to the energy. Then
the matrix is well conditioned, and a few conjugate gradient steps cost a tenth of a factorisation.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np

from mixseq.errors import ReconstructionError, SettingsError
from mixseq.mesh.measures import clamp_lengths, dihedral_angles, edge_lengths, signed_volume, volume_gradient
from mixseq.mesh.rotations import quat_to_matrix
from mixseq.mesh.topology import Topology
from mixseq.runtime.lazy import PickledWithoutCaches, cached_property
from mixseq.segmentation.joints import Joint
from mixseq.shells.face_frames import HingeFrames, flat_triangles, rotate_sides, triangle_frames
from mixseq.shells.kernels import (
    LEVEL_ENERGY_RATIO,
    MAX_CONVERGED_DAMPING,
    MAX_DAMPING,
    fit_near,
    shell_equations,
    shell_residuals,
)
from mixseq.shells.solvers import BlockPattern, PoissonSystem, index_of, solve_frames
from mixseq.types import Float, Index, Mask


@dataclass(frozen=True)
class ShellSettings:
    """Settings of fits to lengths and angles.

    Attributes
    ----------
    bending : float
        Weight of an angle in radians relative to a relative change of length.
    iterations : int
        Largest number of steps.
    tolerance : float
        Convergence limit of the predicted decrease of the energy, as a fraction of the energy.
    exact : float
        Alternative convergence limit of the largest weighted residual.
    accuracy : float
        Alternative convergence limit of the largest change of a coordinate in a step, in the unit of the points
        (diagonals), once the energy has levelled off. Steps shrink about tenfold, so that the final error is smaller.

    Raises
    ------
    SettingsError
        If a setting is not a number, or is negative.
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


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Edges and hinges around the free vertices of a patch, and the pattern of their normal matrix."""

    edges: Index  # (e', 2) edges with a free vertex
    hinges: Index  # (h', 4) hinges with a free vertex
    free_ids: Index  # (f,) free vertices
    free_index: Index  # (n,) index of every vertex among the free ones, -1 if fixed
    pattern: BlockPattern  # pattern of the matrix, a triple of unknowns per free vertex
    edge_blocks: Index  # (e',) block that couples the two vertices of an edge, -1 if one is fixed
    hinge_blocks: Index  # (h', 6) blocks of the vertices ba, ca, cb, da, db, dc of a hinge, -1 if fixed

    @classmethod
    def from_elements(cls, edges: Index, hinges: Index, free: Index, number: Index) -> Self:
        """Find the blocks of edges and hinges with a free vertex."""
        ends, corners = number[edges], number[hinges]
        p, o = np.tril_indices(4, -1)
        first, second = corners[:, p], corners[:, o]
        pairs = np.concatenate([ends, np.stack([first, second], axis=-1).reshape(-1, 2)])
        pattern = BlockPattern.from_pairs(len(free), pairs)
        return cls(
            edges=np.ascontiguousarray(edges),
            hinges=np.ascontiguousarray(hinges),
            free_ids=free,
            free_index=number,
            pattern=pattern,
            edge_blocks=pattern.find_blocks(*ends.T),
            hinge_blocks=np.ascontiguousarray(pattern.find_blocks(first, second)),
        )


@dataclass(frozen=True, eq=False)
class Patch(PickledWithoutCaches):
    """A hinge-connected patch of triangles in local indices, with fixed and free vertices."""

    faces: Index  # (m, 3) triangles
    edges: Index  # (e, 2) edges, in the order of the lengths
    face_edges: Index  # (m, 3) edge of the sides 01, 12, 20 of every face
    hinges: Index  # (h, 4) hinges a, b, c, d, in the order of the angles
    hinge_faces: Index  # (h, 2) the two faces of every hinge
    fixed_mask: Mask  # (n,) vertices with given positions

    @classmethod
    def from_joint(cls, topology: Topology, joint: Joint, fixed: Mask) -> Patch:
        """Make the patch of a joint with a mask ``(n,)`` of fixed vertices."""
        return cls(
            faces=joint.faces,
            edges=np.searchsorted(joint.vertices, topology.edges[joint.edge_ids]),
            face_edges=np.searchsorted(joint.edge_ids, topology.face_edges[joint.face_ids]),
            hinges=np.searchsorted(joint.vertices, topology.hinges[joint.hinge_ids]),
            hinge_faces=np.searchsorted(joint.face_ids, topology.hinge_faces[joint.hinge_ids]),
            fixed_mask=fixed,
        )

    @cached_property
    def free_ids(self) -> Index:
        """Free vertices ``(f,)``."""
        return np.flatnonzero(~self.fixed_mask)

    @cached_property
    def free_index(self) -> Index:
        """Index ``(n,)`` of every vertex among the free ones, -1 if fixed."""
        return index_of(self.free_ids, len(self.fixed_mask))

    @cached_property
    def free_edge_mask(self) -> Mask:
        """Mark the edges ``(e,)`` with a free vertex."""
        return np.asarray(~self.fixed_mask[self.edges].all(axis=1))

    @cached_property
    def free_hinge_mask(self) -> Mask:
        """Mark the hinges ``(h,)`` with a free vertex."""
        return np.asarray(~self.fixed_mask[self.hinges].all(axis=1))

    @cached_property
    def fixed_face_mask(self) -> Mask:
        """Mark the faces ``(m,)`` with three fixed vertices."""
        return np.asarray(self.fixed_mask[self.faces].all(axis=1))

    @cached_property
    def hinge_frames(self) -> HingeFrames:
        """Hinges in the frames of their faces."""
        return HingeFrames(self.faces, self.hinges, self.hinge_faces)

    @cached_property
    def equations(self) -> NormalEquations:
        """The normal equations of lengths and angles around the free vertices."""
        edges, hinges = self.edges[self.free_edge_mask], self.hinges[self.free_hinge_mask]
        return NormalEquations.from_elements(edges, hinges, self.free_ids, self.free_index)

    @cached_property
    def frame_pattern(self) -> BlockPattern:
        """Block pattern of unknown frames of faces, coupled by hinges."""
        count, pairs = int((self.unknown_face_index >= 0).sum()), self.unknown_face_index[self.hinge_faces]
        return BlockPattern.from_pairs(count, pairs)

    @cached_property
    def unknown_face_index(self) -> Index:
        """Index ``(m,)`` of every face among the faces with unknown frames, -1 if known."""
        is_known = self.fixed_face_mask.copy()
        is_known[0] |= not is_known.any()
        return np.where(is_known, -1, np.cumsum(~is_known) - 1)

    @cached_property
    def poisson_system(self) -> PoissonSystem:
        """The Poisson system of the sides 01, 12, 20 of all faces."""
        sides = np.stack([self.faces, np.roll(self.faces, -1, axis=1)], axis=2).reshape(-1, 2)
        return PoissonSystem(sides, np.ones(len(sides)), self.fixed_mask)


NOT_FINITE = "lengths, angles, volumes or fixed vertices are not finite, or overflow if squared"
"""Message of fits that cannot start."""

MAX_SQUARABLE_RESIDUAL = 1e150
"""Largest residual of the volume with a finite square."""


@dataclass(frozen=True, eq=False)
class ShellProblem:
    """Targets and weights of the lengths and angles of a patch, and optionally of the volume."""

    patch: Patch
    lengths: Float  # (e',) target lengths of edges with a free vertex
    angles: Float  # (h',) target angles of hinges with a free vertex, in radians
    length_weights: Float  # (e',) inverse typical lengths
    bending: float  # weight of an angle in radians
    volume: float | None = None  # target volume
    volume_weight: float = 1.0  # weight of the volume, the inverse of a typical volume

    def residuals(self, points: Float) -> Float:
        """Weighted residuals of points ``(n, 3)``: of lengths, angles and the volume."""
        return self.residuals_and_energy(points)[0]

    def energy(self, points: Float) -> float:
        """Sum of the squared residuals."""
        return self.residuals_and_energy(points)[1]

    def residuals_and_energy(self, points: Float) -> tuple[Float, float]:
        """Return the residuals of points ``(n, 3)`` and the sum of their squares, which may be infinite."""
        equations = self.patch.equations
        residuals = np.empty(len(equations.edges) + len(equations.hinges))
        targets = self.lengths, self.angles, self.length_weights, self.bending
        energy = float(shell_residuals(points, equations.edges, equations.hinges, *targets, residuals))
        if self.volume is None:
            return residuals, energy
        volume_residual = self.volume_weight * (signed_volume(points, self.patch.faces) - self.volume)
        # Python raises an exception if a square overflows.
        square = volume_residual**2 if abs(volume_residual) < MAX_SQUARABLE_RESIDUAL else np.inf
        return np.append(residuals, volume_residual), energy + square

    def normal_equations(self, points: Float, residuals: Float) -> tuple[Float, Float]:
        """Return the values ``(N,)`` of ``J^T J``, and ``J^T r`` ``(3 f,)``, without the volume term."""
        equations = self.patch.equations
        values, gradient = np.empty(len(equations.pattern.rows)), np.empty(3 * len(equations.free_ids))
        weights = self.length_weights, self.bending
        blocks = equations.free_index, equations.edge_blocks, equations.hinge_blocks, equations.pattern.places
        mesh = points, equations.edges, equations.hinges
        arguments = *mesh, *weights, residuals, *blocks, values, gradient
        shell_equations(*arguments)
        return values, gradient

    def volume_gradient(self, points: Float) -> Float | None:
        """Return the gradient ``(3 f,)`` of the residual of the volume, or None without a target volume."""
        if self.volume is None:
            return None
        gradient = self.volume_weight * volume_gradient(points, self.patch.faces)
        return gradient[self.patch.free_ids].reshape(-1)


def fit_shell(problem: ShellProblem, start: Float, settings: ShellSettings | None = None) -> tuple[Float, ShellReport]:
    """Fit a patch to edge lengths and dihedral angles from a start ``(n, 3)``; return vertices ``(n, 3)``."""
    settings = settings or ShellSettings()
    pattern, free = problem.patch.equations.pattern, problem.patch.free_ids
    points = np.array(start, dtype=np.float64)
    residuals, energy = problem.residuals_and_energy(points)
    if not np.isfinite(energy):
        raise ReconstructionError(NOT_FINITE)
    damping = 1e-6
    for iteration in range(settings.iterations):
        if np.abs(residuals).max(initial=0.0) <= settings.exact:
            return points, ShellReport(energy, iteration, True)
        values, gradient = problem.normal_equations(points, residuals)
        row, diagonal = problem.volume_gradient(points), values[pattern.diagonal]
        if row is not None:
            gradient += residuals[-1] * row
        while True:
            values[pattern.diagonal] = diagonal + damping * diagonal + 1e-12 * diagonal.max(initial=0.0)
            if row is None:
                step = -pattern.analysis.factor(values).solve(gradient)
            else:
                step = _solve_step_with_volume(pattern, values, gradient, row)
            predicted_gain = -float(gradient @ step)  # of the linear model, for small damping
            if predicted_gain <= settings.tolerance * energy:
                return points, ShellReport(energy, iteration, damping <= MAX_CONVERGED_DAMPING)
            candidate = points.copy()
            candidate[free] += step.reshape(-1, 3)
            new_residuals, new_energy = problem.residuals_and_energy(candidate)
            if new_energy < energy:
                break
            if not damping < MAX_DAMPING:
                return points, ShellReport(energy, iteration, False)
            damping *= 10.0
        gain_ratio = (energy - new_energy) / predicted_gain
        has_levelled = new_energy > LEVEL_ENERGY_RATIO * energy
        points, residuals, energy = candidate, new_residuals, new_energy
        if has_levelled and damping <= MAX_CONVERGED_DAMPING and np.abs(step).max() <= settings.accuracy:
            return points, ShellReport(energy, iteration + 1, True)
        damping = max(damping * (0.2 if gain_ratio > 0.75 else 1.0 if gain_ratio > 0.25 else 4.0), 1e-10)
    return points, ShellReport(energy, settings.iterations, False)


def _solve_step_with_volume(pattern: BlockPattern, values: Float, gradient: Float, row: Float) -> Float:
    """Solve ``(A + row row^T) step = -gradient`` with the factor of A (Sherman and Morrison 1950)."""
    columns = np.stack([-gradient, row], axis=1)
    step, change = pattern.analysis.factor(values).solve(columns).T
    return np.asarray(step - change * (row @ step) / (1.0 + row @ change))


def linear_initialisation(patch: Patch, lengths: Float, angles: Float, positions: Float) -> Float:
    """Rebuild a patch linearly from lengths ``(e,)``, angles ``(h,)`` and fixed positions ``(n, 3)``."""
    flat = flat_triangles(lengths[patch.face_edges])
    frames = _initial_frames(patch, flat, angles, positions)
    return patch.poisson_system.solve(rotate_sides(frames, flat).reshape(-1, 3), positions)


def _initial_frames(patch: Patch, flat: Float, angles: Float, positions: Float) -> Float:
    known = np.tile(np.eye(3), (len(patch.faces), 1, 1))
    fixed = patch.fixed_face_mask
    known[fixed] = quat_to_matrix(triangle_frames(positions, patch.faces[fixed]))
    rotations = quat_to_matrix(patch.hinge_frames.rotations(flat, angles))
    return solve_frames(patch.frame_pattern, patch.unknown_face_index, patch.hinge_faces, rotations, known)


def rebuild_patch(
    patch: Patch, lengths: Float, angles: Float, weights: Float, positions: Float, settings: ShellSettings
) -> tuple[Float, ShellReport]:
    """Rebuild a patch ``(n, 3)`` from lengths ``(e',)``, and angles ``(h',)`` in radians, around its free vertices.

    Weights ``(e',)`` are inverse typical lengths. Fixed vertices are at `positions` ``(n, 3)``.
    """
    problem = ShellProblem(patch, clamp_lengths(lengths, weights), angles, weights, settings.bending)
    return fit_shell(problem, _linear_start(problem, positions), settings)


def _linear_start(problem: ShellProblem, positions: Float) -> Float:
    """Return the linear start ``(n, 3)``; lengths and angles between fixed vertices are measured at the positions."""
    patch = problem.patch
    lengths, angles = edge_lengths(positions, patch.edges), dihedral_angles(positions, patch.hinges)
    lengths[patch.free_edge_mask], angles[patch.free_hinge_mask] = problem.lengths, problem.angles
    return linear_initialisation(patch, lengths, angles, positions)


def fit_patch_near(
    patch: Patch,
    lengths: Float,
    angles: Float,
    weights: Float,
    positions: Float,
    position_weights: Float,
    settings: ShellSettings,
) -> Float:
    """Return the vertices ``(n, 3)`` of a patch fitted to lengths, of at least 0, and angles as `rebuild_patch`.

    Distances of the free vertices from `positions` ``(n, 3)``, the start, have weights ``(f,)`` in inverse units.
    """
    points, rows = np.array(positions, dtype=np.float64), patch.equations
    elements = rows.edges, rows.hinges, lengths, angles, weights, settings.bending
    limits = settings.iterations, settings.tolerance, settings.exact, settings.accuracy
    energy = fit_near(points, *elements, rows.free_ids, rows.free_index, position_weights, *limits)
    if not np.isfinite(energy):
        raise ReconstructionError(NOT_FINITE)
    return points
