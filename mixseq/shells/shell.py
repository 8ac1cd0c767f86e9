r"""A mesh as a shell: vertices from sides of faces, and relaxation steps that reduce errors of lengths and angles.

The energy is that of discrete shells (Froehlich and Botsch 2011), with weights that count relative changes,

.. math:: E(x) = \tfrac12 \sum_e \frac{(l_e - l_e^*)^2}{\bar l_e^2}
               + \tfrac12 \sum_h \beta^2 \cos^4 \frac{\delta_h}{2}
                 \Bigl( 2 \sin \frac{\theta_h - \theta_h^*}{2} \Bigr)^2 .

The sine approximates small angles, and is smooth at half a turn. Hinges with a large error :math:`\delta_h` at the
start count less: they are folds, and steps that unfold them now and then make vertices jump in time.

The energy is lowered by gradients in the metric of one constant matrix, the Laplacian of the mesh with weights
:math:`1 / \bar l_e^2` (after Liu, Bouaziz and Kavan 2017), in Chebyshev's steps: their lengths are fixed by the range
of curvatures in that metric, which is found once. A step costs a gradient and a back-substitution, without a line
search, and the result is as smooth as the start. The same matrix integrates sides of faces (`Shell.integrate`).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from mixseq.errors import ReconstructionError, SettingsError
from mixseq.mesh.measures import MIN_DIRECTED_LENGTH, dihedral_angles, edge_lengths, length_weights
from mixseq.mesh.topology import Topology
from mixseq.runtime.lazy import PickledWithoutCaches
from mixseq.shells import kernels
from mixseq.shells.face_frames import flat_triangles
from mixseq.shells.solvers import Factor, factorise_laplacian
from mixseq.types import Float, Index, Mask

POWER_ITERATIONS = 15
"""Rounds of power iteration for the largest curvature."""

CURVATURE_SAFETY_FACTOR = 1.3
"""Safety factor of the largest curvature, which is estimated from below, in the reference."""

CURVATURE_RANGE = 30.0
"""Ratio of largest to least curvature that steps reduce; softer modes stay as in the start."""

SLENDER_HEIGHT_RATIO = 0.25
"""Ratio of height to sides below which hinges of a triangle count less: noise would rotate them."""

MIN_AREA_RATIO = 0.7
"""Least share of a triangle's area in its gradient: smaller ones have larger curvatures, and steps shake vertices."""

ZERO_AREA_HEIGHT_RATIO = 1e-6
"""Ratio of height to sides below which a triangle has no area."""

ROUNDED_HEIGHT = 2.0**-19
"""Height, in diagonals, below which a triangle has no area: reference frames may be rounded to half of it."""

RELATIVE_DIFFERENCE_STEP = 1e-4
"""Size of a difference quotient, relative to edges."""

MIN_HINGE_NEARNESS = 0.5
"""Least `nearness` of hinges, at an error of a right angle, at which zero energy means zero errors."""

EXACT_MEAN_RESIDUAL = 1e-8
"""Mean weighted residual below which lengths and angles are those of the mesh, and no steps are taken."""


@dataclass(frozen=True)
class Relaxation:
    """Settings of relaxation steps."""

    bending: float = 0.25  # weight of an angle in radians against a relative length
    steps: int = 10  # number of steps

    def __post_init__(self) -> None:
        if not (np.isfinite(self.bending) and self.bending > 0):
            raise SettingsError(f"bending is {self.bending}; a positive weight is expected")
        if not isinstance(self.steps, int | np.integer) or self.steps < 0:
            raise SettingsError(f"steps is {self.steps!r}; a whole number of 0 or more is expected")


class Relaxed(NamedTuple):
    """A mesh after relaxation steps."""

    points: Float  # (V, 3) its vertices
    energy: float  # final energy, in which hinges that were far off at the start count less


@dataclass(frozen=True, eq=False)
class Shell(PickledWithoutCaches):
    """A mesh with an energy of lengths and angles."""

    topology: Topology  # connectivity
    reference: Float  # (V, 3) a reference shape, in diagonals
    typical_lengths: Float  # (E,) typical lengths of all edges, in diagonals
    # (V,) weights of expected positions relative to those of the sides of faces: positive for at least one vertex of
    # every component.
    position_weights: Float
    bending: float  # weight of an angle in radians against a relative length
    # (t, 2) further pairs of vertices with known sides, which connect parts without edges
    ties: Index = field(default_factory=lambda: np.zeros((0, 2), dtype=np.int64))

    def cached_values(self) -> tuple[object, ...]:
        """Implement `PickledWithoutCaches.cached_values`."""
        return self.factor, self.max_curvature

    @cached_property
    def _faces(self) -> Index:
        return self.topology.faces.astype(np.int64)

    @cached_property
    def length_weights(self) -> Float:
        """Weights ``(E,)`` of lengths: inverse typical ones, 0 for edges without length."""
        return length_weights(self.typical_lengths)

    @cached_property
    def _longest_sides(self) -> Float:
        """Typical lengths ``(F,)`` of the longest sides of faces."""
        return np.asarray(
            np.maximum(self.typical_lengths[self.topology.face_edges].max(axis=1), MIN_DIRECTED_LENGTH)
        )

    @cached_property
    def _normal_lengths(self) -> Float:
        """Typical lengths ``(F,)`` of the normals of faces: twice their areas."""
        flat = flat_triangles(self.typical_lengths[self.topology.face_edges])
        return np.asarray(flat[:, 1, 0] * flat[:, 2, 1])

    @cached_property
    def degenerate_face_ids(self) -> Index:
        """Faces without area, whose frames do not determine their sides."""
        return np.flatnonzero(
            self._normal_lengths
            <= np.maximum(ZERO_AREA_HEIGHT_RATIO * self._longest_sides, ROUNDED_HEIGHT) * self._longest_sides
        )

    @cached_property
    def relative_angle_weights(self) -> Float:
        """Relative weights ``(H,)`` of angles, at most 1: less where a triangle is `SLENDER`."""
        faces = self.topology.hinge_faces
        edge = np.maximum(self.typical_lengths[self.topology.hinge_edges], MIN_DIRECTED_LENGTH)
        height = self._normal_lengths[faces].min(axis=1, initial=np.inf) / edge
        return np.asarray(
            np.minimum(
                1.0, height / (SLENDER_HEIGHT_RATIO * self._longest_sides[faces].max(axis=1, initial=0.0))
            )
        )

    @cached_property
    def sound_hinge_mask(self) -> Mask:
        """Mark the hinges ``(H,)`` of triangles with area."""
        thin = np.isin(self.topology.hinge_faces, self.degenerate_face_ids).any(axis=1)
        return np.asarray((self.relative_angle_weights > ZERO_AREA_HEIGHT_RATIO) & ~thin)

    @cached_property
    def _angle_weights(self) -> Float:
        """Weights ``(H,)`` of angles, zero for noise."""
        return np.where(self.sound_hinge_mask, self.bending * self.relative_angle_weights, 0.0)

    @cached_property
    def _min_squared_normals(self) -> Float:
        """Least squares ``(H, 2)`` of normals."""
        return np.square(MIN_AREA_RATIO * self._normal_lengths[self.topology.hinge_faces])

    @cached_property
    def side_weights(self) -> Float:
        """Weights ``(F, 3)`` of the sides of faces: those of an edge add up to the squared weight of its length."""
        weights = np.square(self.length_weights)
        weights = np.where(
            weights > 0, weights, np.square(1.0 / max(float(self.typical_lengths.max()), MIN_DIRECTED_LENGTH))
        )
        return np.asarray((weights / self.topology.edge_face_counts)[self.topology.face_edges])

    @cached_property
    def tie_weight(self) -> float:
        """Typical weight of a side."""
        return float(np.median(self.side_weights)) if len(self.side_weights) else 1.0

    @cached_property
    def factor(self) -> Factor:
        """Factor of the Laplacian."""
        i = np.concatenate([self._faces.reshape(-1), self.ties[:, 0]])
        j = np.concatenate([np.roll(self._faces, -1, axis=1).reshape(-1), self.ties[:, 1]])
        weights = np.concatenate([self.side_weights.reshape(-1), np.full(len(self.ties), self.tie_weight)])
        return factorise_laplacian(np.stack([i, j], axis=1), weights, self.tie_weight * self.position_weights)

    def integrate(self, sides: Float, expected: Float, tied: Float | None = None) -> Float:
        """Solve for vertices ``(V, 3)`` from sides ``(F, 3, 3)`` of faces, and of ties ``(t, 3)`` if there are any."""
        right = (self.tie_weight * self.position_weights)[:, None] * expected
        kernels.add_weighted_sides(self._faces, self.side_weights, sides, right)
        if tied is not None:
            np.add.at(right, self.ties[:, 1], self.tie_weight * tied)
            np.add.at(right, self.ties[:, 0], -self.tie_weight * tied)
        return self.factor.solve(right)

    def relax(self, start: Float, lengths: Float, angles: Float, steps: int) -> Relaxed:
        """Relax a start ``(V, 3)`` towards lengths ``(E,)`` and angles ``(H,)``."""
        turns = _cosines_and_sines(angles)
        near = np.where(
            self.sound_hinge_mask, kernels.hinge_nearness(start, self.topology.hinges, turns), 1.0
        )
        bend = near * self._angle_weights
        gradient, energy = self._gradient_and_energy(start, lengths, turns, bend)
        if not np.isfinite(energy):
            raise ReconstructionError("lengths, angles or vertices are not finite")
        if not steps or (self.is_exact(energy) and near.min(initial=1.0) > MIN_HINGE_NEARNESS):
            return Relaxed(start, energy)
        largest = CURVATURE_SAFETY_FACTOR * self.max_curvature
        middle, half = (
            0.5 * (largest + largest / CURVATURE_RANGE),
            0.5 * (largest - largest / CURVATURE_RANGE),
        )
        ratio = half / middle
        step = self.factor.solve(gradient) / -middle
        x, left = start + step, energy
        for number in range(steps):
            gradient, left = self._gradient_and_energy(x, lengths, turns, bend)
            if number == steps - 1:
                break
            before, ratio = ratio, 1.0 / (2.0 * middle / half - ratio)
            step = ratio * before * step - 2.0 * ratio / half * self.factor.solve(gradient)
            x = x + step
        return Relaxed(x, left) if left < energy else Relaxed(start, energy)

    def is_exact(self, energy: float) -> bool:
        """Whether this energy is zero up to rounding."""
        return energy <= 0.5 * EXACT_MEAN_RESIDUAL**2 * (len(self.topology.edges) + len(self.topology.hinges))

    def energy(self, x: Float, lengths: Float, angles: Float) -> float:
        """Return the energy of a mesh ``(V, 3)``, with the full weight of all hinges."""
        return self._gradient_and_energy(x, lengths, _cosines_and_sines(angles), self._angle_weights)[1]

    def _gradient_and_energy(
        self, x: Float, lengths: Float, turns: Float, bend: Float
    ) -> tuple[Float, float]:
        """Gradient ``(V, 3)`` and energy, for cosines and sines ``(H, 2)`` of angles with weights ``(H,)``."""
        topology, gradient = self.topology, np.empty_like(x)
        energy = kernels.shell_energy(
            x,
            topology.edges,
            topology.hinges,
            lengths,
            turns,
            self.length_weights,
            bend,
            self._min_squared_normals,
            gradient,
        )
        return gradient, float(energy)

    @cached_property
    def max_curvature(self) -> float:
        """Largest curvature of the energy of the reference, in the metric of the matrix, by power iteration."""
        x, topology = self.reference, self.topology
        lengths, turns = (
            edge_lengths(x, topology.edges),
            _cosines_and_sines(dihedral_angles(x, topology.hinges)),
        )
        way, curvature = np.random.default_rng(0).normal(size=x.shape), 0.0
        size = (
            RELATIVE_DIFFERENCE_STEP
            * max(float(np.median(self.typical_lengths)), MIN_DIRECTED_LENGTH)
            * np.sqrt(len(x))
        )
        for _ in range(POWER_ITERATIONS):
            way *= size / max(float(np.linalg.norm(way)), MIN_DIRECTED_LENGTH)
            ahead, behind = (
                self._gradient_and_energy(x + sign * way, lengths, turns, self._angle_weights)[0]
                for sign in (1, -1)
            )
            way = self.factor.solve(0.5 * (ahead - behind))
            curvature = float(np.linalg.norm(way)) / size
        return max(curvature, MIN_DIRECTED_LENGTH)


def _cosines_and_sines(angles: Float) -> Float:
    """Cosines and sines ``(H, 2)`` of angles ``(H,)``."""
    with np.errstate(invalid="ignore"):  # detected by the energy
        return np.stack([np.cos(angles), np.sin(angles)], axis=1)
