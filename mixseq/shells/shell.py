r"""Treat a mesh as a shell: integrate vertices from sides of faces, and relax errors of lengths and angles.

The energy of discrete shells (Froehlich and Botsch 2011), with weights that measure relative changes, is

.. math:: E(x) = \tfrac12 \sum_e \frac{(l_e - l_e^*)^2}{\bar l_e^2}
               + \tfrac12 \sum_h \beta^2 \cos^4 \frac{\delta_h}{2}
                 \Bigl( 2 \sin \frac{\theta_h - \theta_h^*}{2} \Bigr)^2 .

The sine approximates small angles, and is smooth at 180 degrees. Hinges with a large initial error :math:`\delta_h`
have less weight. They are folds, and steps that unfold only some folds make vertices jump in time.

The energy is minimised by Chebyshev iteration with a constant preconditioner, the Laplacian of the mesh with weights
:math:`1 / \bar l_e^2` (after Liu, Bouaziz and Kavan 2017). Step lengths follow from the range of preconditioned
curvatures, which is computed once. A step costs a gradient and a back-substitution, without a line search, and the
result is as smooth in time as the start. The same matrix integrates sides of faces (`Shell.integrate`).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from mixseq.errors import ReconstructionError
from mixseq.mesh.measures import MIN_DIRECTED_LENGTH, dihedral_angles, edge_lengths, length_weights
from mixseq.mesh.topology import Topology
from mixseq.runtime.lazy import PickledWithoutCaches, cached_property
from mixseq.shells import kernels
from mixseq.shells.face_frames import HingeFrames, flat_triangles
from mixseq.shells.solvers import Factor, factorise_laplacian
from mixseq.types import Float, Index, Mask

POWER_ITERATIONS = 15  # number of power iterations for the largest curvature
CURVATURE_SAFETY_FACTOR = 1.3  # safety factor of the largest curvature, which is underestimated at the reference
CURVATURE_RANGE = 30.0  # ratio of the largest to the least curvature that is reduced; softer errors remain
SLENDER_HEIGHT_RATIO = 0.25  # height to longest side below which hinges have less weight, as angles are noisy
MIN_AREA_RATIO = 0.7  # least ratio of area to typical area in gradients, below which the iteration is unstable
ZERO_AREA_HEIGHT_RATIO = 1e-6  # ratio of height to longest side below which a triangle is degenerate
ROUNDED_HEIGHT = 2.0**-19  # height of degenerate triangles in diagonals: twice the rounding step of references
DIFFERENCE_STEP_EDGES = 1e-4  # step of difference quotients, relative to the median edge length
MIN_HEIGHT_RATIO = 1e-6  # ratio of height to longest side of collapsed triangles at the start, whose angles are noise
MIN_HINGE_NEARNESS = 0.5  # the `hinge_nearness` of a right angle; above it, zero energy implies zero errors
EXACT_MEAN_RESIDUAL = 1e-8  # mean weighted residual of exact lengths and angles, which are not relaxed

BENDING_WEIGHT = 0.25
r"""Weight :math:`\beta` of an angle in radians relative to a relative change of length."""


class Relaxed(NamedTuple):
    """A mesh after relaxation."""

    points: Float  # (V, 3) relaxed vertices
    energy: float  # final energy, in which hinges with large initial errors have less weight


@dataclass(frozen=True, eq=False)
class Shell(PickledWithoutCaches):
    """A mesh with an energy of lengths and angles."""

    topology: Topology  # connectivity
    reference: Float  # (V, 3) a reference shape, in diagonals
    typical_lengths: Float  # (E,) typical lengths of edges, in diagonals
    position_weights: Float  # (V,) weights relative to sides; positive at least once per component
    # (t, 2) pairs of vertices with known differences, besides the edges
    ties: Index = field(default_factory=lambda: np.zeros((0, 2), dtype=np.int64))

    @cached_property
    def _sides(self) -> Index:
        """Vertices ``(3F, 2)`` of the sides 01, 12, 20 of all faces."""
        faces = self.topology.faces.astype(np.int64)
        return np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)

    @cached_property
    def hinge_frames(self) -> HingeFrames:
        """Hinges, expressed in the frames of their two faces."""
        return HingeFrames(self.topology.faces, self.topology.hinges, self.topology.hinge_faces)

    @cached_property
    def length_weights(self) -> Float:
        """Weights ``(E,)`` of lengths: inverse typical lengths, 0 for degenerate edges."""
        return length_weights(self.typical_lengths)

    @cached_property
    def _longest_sides(self) -> Float:
        """Typical lengths ``(F,)`` of the longest sides of faces."""
        longest = self.typical_lengths[self.topology.face_edges].max(axis=1)
        return np.asarray(np.maximum(longest, MIN_DIRECTED_LENGTH))

    @cached_property
    def _normal_lengths(self) -> Float:
        """Typical lengths ``(F,)`` of the normals of faces: twice their areas."""
        flat = flat_triangles(self.typical_lengths[self.topology.face_edges])
        return np.asarray(flat[:, 1, 0] * flat[:, 2, 1])

    @cached_property
    def degenerate_face_ids(self) -> Index:
        """Degenerate faces, whose frames do not determine their sides."""
        min_heights = np.maximum(ZERO_AREA_HEIGHT_RATIO * self._longest_sides, ROUNDED_HEIGHT)
        return np.flatnonzero(self._normal_lengths <= min_heights * self._longest_sides)

    @cached_property
    def relative_angle_weights(self) -> Float:
        """Relative weights ``(H,)`` of angles: 1, or less at slender triangles."""
        faces = self.topology.hinge_faces
        edge = np.maximum(self.typical_lengths[self.topology.hinge_edges], MIN_DIRECTED_LENGTH)
        height = self._normal_lengths[faces].min(axis=1, initial=np.inf) / edge
        longest = self._longest_sides[faces].max(axis=1, initial=0.0)
        return np.asarray(np.minimum(1.0, height / (SLENDER_HEIGHT_RATIO * longest)))

    @cached_property
    def sound_hinge_mask(self) -> Mask:
        """Mark the hinges ``(H,)`` between triangles that are not degenerate."""
        is_degenerate = np.isin(self.topology.hinge_faces, self.degenerate_face_ids).any(axis=1)
        return np.asarray((self.relative_angle_weights > ZERO_AREA_HEIGHT_RATIO) & ~is_degenerate)

    @cached_property
    def _angle_weights(self) -> Float:
        """Weights ``(H,)`` of angles, 0 at degenerate triangles."""
        return np.where(self.sound_hinge_mask, BENDING_WEIGHT * self.relative_angle_weights, 0.0)

    @cached_property
    def _min_squared_normals(self) -> Float:
        """Lower bounds ``(H, 2)`` of squared normals in gradients."""
        return np.square(MIN_AREA_RATIO * self._normal_lengths[self.topology.hinge_faces])

    @cached_property
    def side_weights(self) -> Float:
        """Weights ``(F, 3)`` of sides of faces; the weights of sides on an edge add up to its squared length weight."""
        weights = np.square(self.length_weights)
        default = 1.0 / max(float(self.typical_lengths.max()), MIN_DIRECTED_LENGTH)
        weights = np.where(weights > 0, weights, np.square(default))
        return np.asarray((weights / self.topology.edge_face_counts)[self.topology.face_edges])

    @cached_property
    def tie_weight(self) -> float:
        """Weight of ties: the median weight of a side."""
        return float(np.median(self.side_weights)) if len(self.side_weights) else 1.0

    @cached_property
    def factor(self) -> Factor:
        """Factor of the Laplacian."""
        weights = np.concatenate([self.side_weights.reshape(-1), np.full(len(self.ties), self.tie_weight)])
        edges = np.concatenate([self._sides, self.ties])
        return factorise_laplacian(edges, weights, self.tie_weight * self.position_weights)

    def integrate(self, sides: Float, expected: Float, tie_sides: Float | None = None) -> Float:
        """Integrate sides of faces ``(F, 3, 3)`` and ties ``(t, 3)`` to vertices near expected positions ``(V, 3)``."""
        right = (self.tie_weight * self.position_weights)[:, None] * expected
        kernels.add_weighted_sides(self._sides, self.side_weights.reshape(-1), sides.reshape(-1, 3), right)
        if tie_sides is not None:
            np.add.at(right, self.ties[:, 1], self.tie_weight * tie_sides)
            np.add.at(right, self.ties[:, 0], -self.tie_weight * tie_sides)
        return self.factor.solve(right)

    def relax(self, start: Float, lengths: Float, angles: Float, steps: int) -> Relaxed:
        """Relax a mesh ``(V, 3)`` towards lengths ``(E,)`` and angles ``(H,)``, in a number of steps."""
        targets = _cosines_and_sines(angles)
        nearness, is_collapsed = kernels.hinge_nearness(start, self.topology.hinges, targets, MIN_HEIGHT_RATIO)
        nearness = np.where(self.sound_hinge_mask & ~is_collapsed, nearness, 1.0)
        angle_weights = np.where(is_collapsed, 0.0, nearness * self._angle_weights)
        gradient, energy = self._gradient_and_energy(start, lengths, targets, angle_weights)
        if not np.isfinite(energy):
            raise ReconstructionError("lengths, angles or vertices are not finite")
        if not steps or (self.is_exact(energy) and nearness.min(initial=1.0) > MIN_HINGE_NEARNESS):
            return Relaxed(start, energy)
        largest = CURVATURE_SAFETY_FACTOR * self.max_curvature
        centre = 0.5 * (largest + largest / CURVATURE_RANGE)
        half_range = 0.5 * (largest - largest / CURVATURE_RANGE)
        rho = half_range / centre
        step = self.factor.solve(gradient) / -centre
        x, final_energy = start + step, energy
        for number in range(steps):
            gradient, final_energy = self._gradient_and_energy(x, lengths, targets, angle_weights)
            if number == steps - 1:
                break
            previous, rho = rho, 1.0 / (2.0 * centre / half_range - rho)
            step = rho * previous * step - 2.0 * rho / half_range * self.factor.solve(gradient)
            x = x + step
        return Relaxed(x, final_energy) if final_energy < energy else Relaxed(start, energy)

    def is_exact(self, energy: float) -> bool:
        """Whether an energy is zero up to rounding."""
        return energy <= 0.5 * EXACT_MEAN_RESIDUAL**2 * (len(self.topology.edges) + len(self.topology.hinges))

    def energy(self, x: Float, lengths: Float, angles: Float) -> float:
        """Return the energy of a mesh ``(V, 3)`` with the full weight of all hinges."""
        return self._gradient_and_energy(x, lengths, _cosines_and_sines(angles), self._angle_weights)[1]

    def _gradient_and_energy(
        self, x: Float, lengths: Float, targets: Float, angle_weights: Float
    ) -> tuple[Float, float]:
        """Gradient ``(V, 3)`` and energy, for cosines and sines ``(H, 2)`` of target angles."""
        mesh, gradient = (self.topology.edges, self.topology.hinges), np.empty_like(x)
        weights = self.length_weights, angle_weights, self._min_squared_normals
        energy = kernels.shell_energy(x, *mesh, lengths, targets, *weights, gradient)
        return gradient, float(energy)

    @cached_property
    def max_curvature(self) -> float:
        """Largest preconditioned curvature of the energy at the reference, by power iteration."""
        x, topology = self.reference, self.topology
        lengths = edge_lengths(x, topology.edges)
        targets = _cosines_and_sines(dihedral_angles(x, topology.hinges))
        direction, curvature = np.random.default_rng(0).normal(size=x.shape), 0.0
        typical = max(float(np.median(self.typical_lengths)), MIN_DIRECTED_LENGTH)
        size = DIFFERENCE_STEP_EDGES * typical * np.sqrt(len(x))
        for _ in range(POWER_ITERATIONS):
            direction *= size / max(float(np.linalg.norm(direction)), MIN_DIRECTED_LENGTH)
            ahead, behind = (
                self._gradient_and_energy(x + sign * direction, lengths, targets, self._angle_weights)[0]
                for sign in (1, -1)
            )
            direction = self.factor.solve(0.5 * (ahead - behind))
            curvature = float(np.linalg.norm(direction)) / size
        return max(curvature, MIN_DIRECTED_LENGTH)


def _cosines_and_sines(angles: Float) -> Float:
    """Cosines and sines ``(H, 2)`` of angles ``(H,)``."""
    with np.errstate(invalid="ignore"):  # the energy detects infinite angles
        return np.stack([np.cos(angles), np.sin(angles)], axis=1)
