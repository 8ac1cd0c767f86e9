r"""Fit a patch of triangles to edge lengths and dihedral angles: linear initialisation, then Gauss-Newton.

Minimises, over the free vertices of a patch,

.. math::

    E(x) = \sum_e w_e^2 (l_e - l_e^*)^2 + \sum_h w_h^2\, \mathrm{wrap}(\theta_h - \theta_h^*)^2
         + \sum_v w_v^2 |x_v - x_v^*|^2 + w^2 (V - V^*)^2

with ``w_e = 1 / mean length of e`` and one weight for all angles, so that both terms count relative changes
(Froehlich and Botsch 2011). Soft constraints of positions and the volume V of the patch are optional. Angle residuals
are wrapped to (-pi, pi], so that folds beyond half a turn are pulled the right way.

A step s solves :math:`(J^T J + \lambda \, \mathrm{diag}\, J^T J)\, s = -J^T r` (Levenberg-Marquardt). If it does not
lower the energy, it is tried again with ten times the damping :math:`\lambda`; if it lowers it as the linear model
predicts, damping falls.

The linear initialisation (after Wang, Liu and Tong 2012) uses no pose:

1. Frames: minimise :math:`\sum \|F_j - F_i T_{ij}\|^2`, a sparse linear system; faces whose vertices are all fixed
   have known frames (if nothing is fixed the first face gets the identity). Project every frame to a rotation.
2. Vertices: minimise :math:`\sum_f \sum_{ab \in f} \|x_b - x_a - F_f\, u_{ab}\|^2` over the sides of all faces, where
   ``u`` is the side in the frame; fixed vertices stay (if there are none the first one is the origin).

Where a mesh has these lengths and angles the result is that mesh, exactly.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy import sparse

from mixseq.errors import ReconstructionError
from mixseq.mesh.measures import clamp_lengths, dihedral_angles, edge_lengths, signed_volume, volume_gradient
from mixseq.mesh.rigid import nearest_rotations
from mixseq.mesh.rotations import quat_to_matrix
from mixseq.mesh.topology import Topology
from mixseq.runtime.lazy import PickledWithoutCaches
from mixseq.segmentation.joints import Joint
from mixseq.shells.face_frames import HingeFrames, flat_triangles, triangle_frames
from mixseq.shells.gauss_newton import BlockSparsePattern, ShellReport, ShellSettings
from mixseq.shells.kernels import conjugate_gradients, shell_equations, shell_residuals
from mixseq.shells.solvers import Factor, factorise
from mixseq.types import Float, Index, Mask


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Lengths and angles around the free vertices of a patch, and the pattern of their matrix."""

    edges: Index  # (e', 2) edges with a free vertex
    hinges: Index  # (h', 4) hinges with a free vertex
    free_ids: Index  # (f,) the free vertices
    free_index: Index  # (n,) place of every vertex among them, -1 if fixed
    pattern: BlockSparsePattern  # pattern of the matrix, one triple of unknowns for each free vertex
    edge_blocks: Index  # (e',) block that couples the two vertices of an edge, -1 if one is fixed
    # (h', 6) blocks that couple the vertices ba, ca, cb, da, db, dc of a hinge, -1 if one is fixed.
    hinge_blocks: Index

    @classmethod
    def from_elements(
        cls, edges: Index, hinges: Index, free: Index, number: Index, threads: int | None = None
    ) -> NormalEquations:
        """Find the blocks of edges and hinges."""
        ends, corners = number[edges], number[hinges]
        p, o = np.tril_indices(4, -1)
        first, second = corners[:, p], corners[:, o]
        pairs = np.concatenate([ends, np.stack([first, second], axis=-1).reshape(-1, 2)])
        pattern = BlockSparsePattern.from_pairs(len(free), pairs, threads)
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
    """A hinge-connected patch of triangles in local indices, with some vertices fixed in space."""

    faces: Index  # (m, 3) triangles
    edges: Index  # (e, 2) edges, in the order of the lengths
    face_edges: Index  # (m, 3) edge of the sides 01, 12, 20 of every face
    hinges: Index  # (h, 4) hinges a, b, c, d, in the order of the angles
    hinge_faces: Index  # (h, 2) their two faces
    fixed_mask: Mask  # (n,) vertices whose positions are given
    threads: int | None = None  # threads that factor one matrix; by default from its size

    @classmethod
    def from_joint(cls, topology: Topology, joint: Joint, fixed: Mask) -> Patch:
        """Make the patch of a joint; `fixed` ``(n,)`` marks the joint's given vertices."""
        return cls(
            faces=joint.faces,
            edges=np.searchsorted(joint.vertices, topology.edges[joint.edge_ids]),
            face_edges=np.searchsorted(joint.edge_ids, topology.face_edges[joint.face_ids]),
            hinges=np.searchsorted(joint.vertices, topology.hinges[joint.hinge_ids]),
            hinge_faces=np.searchsorted(joint.face_ids, topology.hinge_faces[joint.hinge_ids]),
            fixed_mask=fixed,
        )

    def cached_values(self) -> tuple[object, ...]:
        """Implement `PickledWithoutCaches.cached_values` for the linear initialisation and Gauss-Newton."""
        return self.equations.pattern, self.frame_pattern, self.laplacian_factor

    @cached_property
    def free_ids(self) -> Index:
        """Unknown vertices."""
        return np.flatnonzero(~self.fixed_mask)

    @cached_property
    def free_index(self) -> Index:
        """Place ``(n,)`` of every vertex among the free ones, -1 if fixed."""
        number = np.full(len(self.fixed_mask), -1, dtype=np.int64)
        number[self.free_ids] = np.arange(len(self.free_ids))
        return number

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
        """Mark the faces ``(m,)`` whose three vertices are fixed."""
        return np.asarray(self.fixed_mask[self.faces].all(axis=1))

    @cached_property
    def hinge_frames(self) -> HingeFrames:
        """The hinges in the frames of their faces."""
        return HingeFrames(self.faces, self.hinges, self.hinge_faces)

    @cached_property
    def equations(self) -> NormalEquations:
        """The normal equations of lengths and angles around the free vertices."""
        return NormalEquations.from_elements(
            self.edges[self.free_edge_mask],
            self.hinges[self.free_hinge_mask],
            self.free_ids,
            self.free_index,
            self.threads,
        )

    @cached_property
    def frame_pattern(self) -> BlockSparsePattern:
        """Block pattern of unknown frames of faces, coupled by hinges."""
        count, pairs = int((self.unknown_face_index >= 0).sum()), self.unknown_face_index[self.hinge_faces]
        return BlockSparsePattern.from_pairs(count, pairs, self.threads)

    @cached_property
    def unknown_face_index(self) -> Index:
        """Place ``(m,)`` of every face among those with unknown frames; -1 for fixed faces, or for the first one."""
        known = self.fixed_face_mask.copy()
        known[0] |= not known.any()
        return np.where(known, -1, np.cumsum(~known) - 1)

    @cached_property
    def laplacian(self) -> sparse.csr_array:
        """Graph Laplacian ``(n, n)``; an edge counts once per face."""
        starts = self.faces.reshape(-1)
        ends = np.roll(self.faces, -1, axis=1).reshape(-1)
        size = (len(self.fixed_mask), len(self.fixed_mask))
        half = sparse.coo_array((np.ones(len(starts)), (starts, ends)), shape=size).tocsr()
        adjacency = (half + half.T).tocsr()
        return (sparse.diags_array(np.asarray(adjacency.sum(axis=1)).reshape(-1)) - adjacency).tocsr()

    @cached_property
    def laplacian_factor(self) -> Factor:
        """Factor of the Laplacian's block of integrated vertices; constant over a sequence."""
        return factorise(self.laplacian[self.unknown_ids][:, self.unknown_ids])

    @cached_property
    def unknown_ids(self) -> Index:
        """Unknown vertices of the Poisson system: the free ones, but the first where nothing is fixed."""
        return self.free_ids if self.fixed_mask.any() else self.free_ids[1:]


CONJUGATE_GRADIENT_TOLERANCE = 0.03
"""Relative residual at which conjugate gradients stop; the next Gauss-Newton step corrects the rest."""

MAX_CONJUGATE_GRADIENT_STEPS = 100
"""Largest number of conjugate gradient steps; beyond it the matrix is factored."""

MAX_SQUARABLE_RESIDUAL = 1e150
"""Largest residual of the volume whose square fits into double precision."""

MAX_DAMPING = 1e12
"""Damping at which the fit stops: the energy is not smooth here, or not finite."""

MAX_CONVERGED_DAMPING = 1e-2
"""Damping above which short steps do not indicate convergence."""

LEVEL_ENERGY_RATIO = 0.1
"""Ratio of energies below which a step is not the last: a mesh fits exactly."""


class SoftConstraint(NamedTuple):
    """Soft constraints of positions of free vertices."""

    positions: Float  # (f, 3) where they are expected, in the unit of the points
    weights: Float  # (f,) weights of the distances from there, per unit; empty for no constraints at all


NO_CONSTRAINT = SoftConstraint(np.zeros((0, 3)), np.zeros(0))


@dataclass(frozen=True, eq=False)
class ShellProblem:
    """Targets and weights of the patch's free edges and hinges, and optionally of positions and the volume."""

    patch: Patch
    lengths: Float  # (e',) target lengths of edges with a free vertex
    angles: Float  # (h',) target angles of hinges with a free vertex, in radians
    length_weights: Float  # (e',) one over typical lengths
    bending: float  # weight of an angle in radians
    constraint: SoftConstraint = NO_CONSTRAINT
    volume: float | None = None  # target volume, whose residual is the last one
    volume_weight: float = 1.0  # weight of the volume, over that of the reference

    def residuals(self, points: Float) -> Float:
        """Weighted residuals of points ``(n, 3)``: ``e' + h'``, ``3 free`` of soft constraints, and of the volume."""
        return self.residuals_and_energy(points)[0]

    def energy(self, points: Float) -> float:
        """Sum of the squared residuals."""
        return self.residuals_and_energy(points)[1]

    def residuals_and_energy(self, points: Float) -> tuple[Float, float]:
        """Return the residuals of points ``(n, 3)`` and the sum of their squares; infinite for a hopeless mesh."""
        rows = self.patch.equations
        residuals = np.empty(len(rows.edges) + len(rows.hinges) + 3 * len(self.constraint.weights))
        energy = shell_residuals(
            points,
            rows.edges,
            rows.hinges,
            self.lengths,
            self.angles,
            self.length_weights,
            self.bending,
            rows.free_ids,
            self.constraint.positions,
            self.constraint.weights,
            residuals,
        )
        if self.volume is None:
            return residuals, float(energy)
        last = self.volume_weight * (signed_volume(points, self.patch.faces) - self.volume)
        square = (
            last**2 if abs(last) < MAX_SQUARABLE_RESIDUAL else np.inf
        )  # Python raises where squares overflow
        return np.append(residuals, last), float(energy) + square

    def normal_equations(self, points: Float, residuals: Float) -> tuple[Float, Float]:
        """Values ``(N,)`` of ``J^T J`` in the patch's pattern, and ``J^T r`` ``(3 free,)``, without the volume."""
        rows = self.patch.equations
        values, gradient = np.empty(len(rows.pattern.rows)), np.empty(3 * len(rows.free_ids))
        shell_equations(
            points,
            rows.edges,
            rows.hinges,
            self.length_weights,
            self.bending,
            self.constraint.weights,
            residuals,
            rows.free_index,
            rows.edge_blocks,
            rows.hinge_blocks,
            rows.pattern.places,
            values,
            gradient,
        )
        return values, gradient

    def volume_gradient(self, points: Float) -> Float | None:
        """Derivatives ``(3 free,)`` of the residual of the volume, if there is one."""
        if self.volume is None:
            return None
        slopes = self.volume_weight * volume_gradient(points, self.patch.faces)
        return slopes[self.patch.free_ids].reshape(-1)


def fit_shell(
    problem: ShellProblem, start: Float, settings: ShellSettings | None = None
) -> tuple[Float, ShellReport]:
    """Fit a patch to edge lengths and dihedral angles: start ``(n, 3)``; result ``(n, 3)``."""
    settings = settings or ShellSettings()
    pattern, free = problem.patch.equations.pattern, problem.patch.free_ids
    points = np.array(start, dtype=np.float64)
    residuals, energy = problem.residuals_and_energy(points)
    if not np.isfinite(energy):
        raise ReconstructionError(
            "lengths, angles, volumes or fixed vertices of a joint are not finite, or too large to be squared"
        )
    damping, constrained = 1e-6, bool(problem.constraint.weights.size)
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
                step, constrained = _solve_step(pattern, values, gradient, constrained)
            else:
                step = _solve_step_with_volume(pattern, values, gradient, row)
            promised = -float(gradient @ step)  # what the linear model gains, for small damping
            if promised <= settings.tolerance * energy:
                return points, ShellReport(energy, iteration, damping <= MAX_CONVERGED_DAMPING)
            candidate = points.copy()
            candidate[free] += step.reshape(-1, 3)
            new_residuals, new_energy = problem.residuals_and_energy(candidate)
            if new_energy < energy:
                break
            if not damping < MAX_DAMPING:
                return points, ShellReport(energy, iteration, False)
            damping *= 10.0
        gain = (energy - new_energy) / promised
        level = new_energy > LEVEL_ENERGY_RATIO * energy
        points, residuals, energy = candidate, new_residuals, new_energy
        if level and damping <= MAX_CONVERGED_DAMPING and np.abs(step).max() <= settings.accuracy:
            return points, ShellReport(energy, iteration + 1, True)
        damping = max(damping * (0.2 if gain > 0.75 else 1.0 if gain > 0.25 else 4.0), 1e-10)
    return points, ShellReport(energy, settings.iterations, False)


def _solve_step(
    pattern: BlockSparsePattern, values: Float, gradient: Float, constrained: bool
) -> tuple[Float, bool]:
    """Solve for a step, by conjugate gradients if `constrained`; return whether these are worth trying again.

    With all positions constrained the matrix is well conditioned: a few conjugate gradients cost a tenth of a
    factorisation. Without constraints soft bends make it ill conditioned.
    """
    if constrained:
        step = np.empty_like(gradient)
        steps = conjugate_gradients(
            pattern.starts,
            pattern.rows,
            pattern.places,
            values,
            -gradient,
            CONJUGATE_GRADIENT_TOLERANCE,
            MAX_CONJUGATE_GRADIENT_STEPS,
            step,
        )
        if steps >= 0:
            return step, True
    return -pattern.analysis.factor(values).solve(gradient), False


def _solve_step_with_volume(pattern: BlockSparsePattern, values: Float, gradient: Float, row: Float) -> Float:
    """Solve ``(A + row row^T) step = -gradient`` with the factor of A alone (Sherman and Morrison 1950)."""
    both = pattern.analysis.factor(values).solve(np.stack([-gradient, row], axis=1))
    step, along = both.T
    return np.asarray(step - along * (row @ step) / (1.0 + row @ along))


MAX_GUESS_RESIDUAL = 0.5
"""Largest weighted residual of a guess from which Gauss-Newton may start."""


def linear_initialisation(patch: Patch, lengths: Float, angles: Float, positions: Float) -> Float:
    """Rebuild a patch ``(n, 3)`` linearly from lengths ``(e,)``, angles ``(h,)`` and fixed positions ``(n, 3)``."""
    local = flat_triangles(lengths[patch.face_edges])
    frames = _initial_frames(patch, local, angles, positions)
    sides = np.einsum("fij,fkj->fki", frames[:, :, :2], np.roll(local, -1, axis=1) - local)
    return integrate(patch, sides, positions)


def _initial_frames(patch: Patch, local: Float, angles: Float, positions: Float) -> Float:
    known = np.zeros((len(patch.faces), 3, 3))
    is_known = patch.fixed_face_mask.copy()
    if is_known.any():
        known[is_known] = quat_to_matrix(triangle_frames(positions, patch.faces[is_known]))
    else:
        is_known[0] = True
        known[0] = np.eye(3)
    number = patch.unknown_face_index
    unknown = np.flatnonzero(number >= 0)
    if not unknown.size:
        return known

    # Rows of F (one per world coordinate) are independent: F_j - F_i T = 0 reads f_j - T^T f_i = 0 for rows f.
    i, j = patch.hinge_faces.T
    turns = quat_to_matrix(patch.hinge_frames.rotations(local, angles))
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
    places = pattern.places[pattern.find_blocks(first, second)][:, None, :] + np.arange(3)[:, None]
    np.add.at(values, places, blocks)
    solution = pattern.analysis.factor(values).solve(right.reshape(-1, 3)).reshape(-1, 3, 3)
    known[unknown] = nearest_rotations(np.swapaxes(solution, 1, 2))
    return known


def integrate(patch: Patch, sides: Float, positions: Float) -> Float:
    """Solve for the vertices whose sides ``x_b - x_a`` are closest to ``(m, 3, 3)`` given ones."""
    count = len(patch.fixed_mask)
    right = np.zeros((count, 3))
    np.add.at(right, patch.faces.reshape(-1), -sides.reshape(-1, 3))
    np.add.at(right, np.roll(patch.faces, -1, axis=1).reshape(-1), sides.reshape(-1, 3))
    result = np.where(patch.fixed_mask[:, None], positions, 0.0)
    coupling = patch.laplacian[patch.unknown_ids][:, patch.fixed_mask]
    right = right[patch.unknown_ids] - coupling @ result[patch.fixed_mask]
    result[patch.unknown_ids] = patch.laplacian_factor.solve(right)
    return result


def rebuild_patch(
    patch: Patch,
    lengths: Float,
    angles: Float,
    weights: Float,
    positions: Float,
    settings: ShellSettings,
    guess: Float | None = None,
    soft: SoftConstraint = NO_CONSTRAINT,
) -> tuple[Float, ShellReport]:
    """Rebuild a patch ``(n, 3)`` from lengths ``(e',)`` and angles ``(h',)``, in radians, at its free vertices.

    Weights ``(e',)`` are inverse typical lengths. Of positions ``(n, 3)`` those of fixed vertices are used. A guess
    ``(f, 3)`` is an alternative start of the free vertices.
    """
    lengths = clamp_lengths(lengths, weights)
    problem = ShellProblem(patch, lengths, angles, weights, settings.bending, soft)
    if guess is None:
        return fit_shell(problem, _linear_start(problem, positions), settings)
    start = np.array(positions, dtype=np.float64)
    start[patch.free_ids] = guess
    if not soft.weights.size and np.abs(problem.residuals(start)).max(initial=0.0) > MAX_GUESS_RESIDUAL:
        start = min(_linear_start(problem, positions), start, key=problem.energy)
    return fit_shell(problem, start, settings)


def _linear_start(problem: ShellProblem, positions: Float) -> Float:
    """Return the linear start; lengths and angles between fixed vertices are their own."""
    patch = problem.patch
    lengths, angles = edge_lengths(positions, patch.edges), dihedral_angles(positions, patch.hinges)
    lengths[patch.free_edge_mask], angles[patch.free_hinge_mask] = problem.lengths, problem.angles
    return linear_initialisation(patch, lengths, angles, positions)
