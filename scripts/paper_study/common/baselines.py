r"""Interpolation methods of others, written from their papers, to be compared with the paper's.

==================  ==================================================================================================
vertices            linear in vertices, after registration
ARAP                rotations and stretches of faces, vertices by a Poisson system (Alexa, Cohen-Or and Levin 2000)
skin                a skin fitted to the animation, bones blended along their tree (linear blend skinning)
NRIC                lengths and angles with elastic weights (Sassen, Heeren, Hildebrandt and Rumpf 2020)
geodesic            time-discrete geodesic in the space of shells (Heeren, Rumpf, Wardetzky and Wirth 2012)
==================  ==================================================================================================

*NRIC.* The point of the manifold of realisable lengths and angles that is nearest to the blend, in the metric

.. math:: \sum_e \frac{d_e}{l_e^2} (l_e - l_e^*)^2 + \delta^2 \sum_h \frac{l_h^2}{d_h} (\theta_h - \theta_h^*)^2

with a third of the area of the faces of an edge, d, and the thickness :math:`\delta`. They solve for lengths and angles
under conditions of integrability, and for vertices afterwards; over vertices the minimum is the same.

*Geodesic.* The inner shapes of a path of K = 4 segments minimise :math:`\sum_k W(x_{k-1}, x_k)`, where W is their
membrane energy of faces with unit Lamé constants, plus the second sum above between both shapes. With the squared sides
:math:`a, b` of a face before and after, :math:`M = 1 1^T - 2 I` and :math:`q_a = a^T M a` (16 squared areas), trace and
determinant of the distortion are :math:`2 a^T M b / q_a` and :math:`q_b / q_a`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy import sparse

import mixseq
from mixseq.mesh.measures import dihedral_angles, edge_lengths, triangle_areas, wrap_angles
from mixseq.mesh.rigid import kabsch, transform_points
from mixseq.mesh.topology import Topology
from mixseq.shells.fitting import ShellReport
from mixseq.shells.solvers import factorise
from mixseq.spaces.gradient import GradientSpace
from mixseq.types import Float, Index, IntArray
from scripts.paper_study.common.methods import Blended, Edge, Method
from scripts.paper_study.common.poses import Poses

THICKNESS = 0.002
"""Thickness of shells in diagonals, chosen here: a fifth of an edge of the lion, as the weights of DSO amount to."""

SEGMENTS = 4
"""Segments of the geodesic, whose inner shapes have the weights 1/4, 1/2 and 3/4."""

MAX_STEPS, MAX_DAMPING = 60, 1e8
TOLERANCE = 1e-3  # predicted decrease of an energy, as a share of it, below which it is a minimum


@dataclass(frozen=True, eq=False)
class Registered(Method):
    """Two poses in diagonals, the second moved rigidly onto the first."""

    @cached_property
    def pair(self) -> Float:
        first, second = self.poses.points / self.poses.diagonal
        return np.stack([first, transform_points(second, *kabsch(second, first))])

    def prepare(self) -> None:
        _ = self.pair

    def at(self, weights: Float) -> Blended:
        return Blended(np.tensordot(weights, self.pair, 1) * self.poses.diagonal, [])


@dataclass(frozen=True, eq=False)
class Arap(Registered):
    """Rotations and stretches of faces, from the first pose."""

    @cached_property
    def space(self) -> GradientSpace:
        """The faces of the first pose, and their Poisson system."""
        return GradientSpace(self.poses.topology, 1.0, self.pair[0])

    @cached_property
    def vectors(self) -> Float:
        """Both poses."""
        return self.space.encode(self.pair)

    def prepare(self) -> None:
        _ = self.vectors, self.space.poisson_system.factor

    def at(self, weights: Float) -> Blended:
        return Blended(self.space.decode((weights @ self.vectors)[None])[0] * self.poses.diagonal, [])


@dataclass(frozen=True, eq=False)
class Skinned(Registered):
    """A skin fitted to both poses and the animation, whose bones turn relative to their parents."""

    @cached_property
    def skin(self) -> mixseq.Skin:
        frames = np.concatenate([self.poses.points, self.poses.sampled_frames])
        return mixseq.fit_skin(mixseq.MeshSequence.from_arrays(frames, self.poses.sequence.faces))

    def prepare(self) -> None:
        _ = self.skin

    def at(self, weights: Float) -> Blended:
        first, second = self.skin.header.times[:2]
        return Blended(self.skin.resampled([first + weights[1] * (second - first)]).points()[0], [])


class Quadratic(NamedTuple):
    """Value, gradient ``(n,)`` and positive semidefinite matrix ``(n, n)`` of an energy at a point."""

    value: float
    gradient: Float
    matrix: sparse.csr_array


def minimise(
    value: Callable[[Float], float], model: Callable[[Float], Quadratic], start: Float
) -> tuple[Float, ShellReport]:
    """Minimise an energy of any array by damped steps (Levenberg and Marquardt)."""
    x, damping = np.array(start), 1e-6
    for step_id in range(MAX_STEPS):
        found = model(x)
        diagonal = found.matrix.diagonal()
        while True:
            matrix = found.matrix + sparse.diags_array(damping * diagonal + 1e-9 * float(np.median(diagonal)))
            step = -factorise(matrix).solve(found.gradient)
            gain = -float(found.gradient @ step)
            if gain <= TOLERANCE * found.value + 1e-16 or damping > MAX_DAMPING:
                return x, ShellReport(found.value, step_id, damping <= 1)
            trial = x + step.reshape(x.shape)
            if value(trial) < found.value:
                break
            damping = max(10 * damping, 0.01)
        x, damping = trial, max(damping / 5, 1e-10)
    return x, ShellReport(value(x), MAX_STEPS, False)


def angle_gradients(x: Float, hinges: IntArray) -> Float:
    """Return the gradients ``(H, 4, 3)`` of dihedral angles, in the order of their vertices."""
    a, b, c, d = (x[column] for column in hinges.T)
    side = b - a
    squared = np.maximum(np.square(side).sum(axis=1, keepdims=True), 1e-300)
    opposite, shares = [], []
    for corner, sign in ((c, 1.0), (d, -1.0)):
        normal = sign * np.cross(side, corner - a)
        length = np.maximum(np.square(normal).sum(axis=1, keepdims=True), 1e-300)
        opposite.append(-np.sqrt(squared) * normal / length)
        shares.append(((corner - a) * side).sum(axis=1, keepdims=True) / squared)
    (u, v), (s, t) = opposite, shares
    return np.stack([(s - 1) * u + (t - 1) * v, -s * u - t * v, u, v], axis=1)


@dataclass(frozen=True, eq=False)
class Elastic:
    """Elastic weights of the edges and hinges of a mesh, from shapes ``(n, V, 3)``."""

    topology: Topology
    shapes: Float
    thickness: float = THICKNESS

    @cached_property
    def weights(self) -> tuple[Float, Float]:
        """Roots of the weights of lengths ``(E,)`` and of angles ``(H,)``."""
        topology = self.topology
        lengths = edge_lengths(self.shapes, topology.edges).mean(axis=0)
        thirds = np.repeat(triangle_areas(self.shapes, topology.faces).mean(axis=0) / 3, 3)
        spread = np.maximum(np.bincount(topology.face_edges.reshape(-1), thirds, minlength=len(lengths)), 1e-12)
        bending = self.thickness * lengths[topology.hinge_edges] / np.sqrt(spread[topology.hinge_edges])
        return np.sqrt(spread) / np.maximum(lengths, 1e-9), bending

    def length_rows(self, x: Float) -> sparse.csr_array:
        """Return the derivatives ``(E, 3V)`` of half the squared lengths."""
        i, j = self.topology.edges.T
        side = x[j] - x[i]
        return _rows(self.topology.edges, np.stack([-side, side], axis=1), x.size)

    def angle_rows(self, x: Float) -> sparse.csr_array:
        """Return the derivatives ``(H, 3V)`` of angles."""
        return _rows(self.topology.hinges, angle_gradients(x, self.topology.hinges), x.size)


def _rows(vertices: IntArray, gradients: Float, size: int) -> sparse.csr_array:
    """Return gradients ``(n, k, 3)`` at vertices ``(n, k)`` as rows of a matrix."""
    columns = (3 * vertices[:, :, None] + np.arange(3)).reshape(-1)
    starts = np.arange(len(vertices) + 1) * (3 * vertices.shape[1])
    return sparse.csr_array((gradients.reshape(-1), columns, starts), shape=(len(vertices), size))


@dataclass(frozen=True, eq=False)
class Nric(Registered):
    """The mesh whose lengths and angles are nearest to the blended ones, by elastic weights."""

    @cached_property
    def elastic(self) -> Elastic:
        return Elastic(self.poses.topology, self.pair)

    @cached_property
    def shells(self) -> Edge:
        """Discrete shells, from which the search starts: they collapse no faces."""
        return Edge(self.poses)

    def prepare(self) -> None:
        _ = self.elastic.weights, self.shells.vectors

    def at(self, weights: Float) -> Blended:
        topology, (of_length, of_angle) = self.poses.topology, self.elastic.weights
        lengths, angles = self.poses.target(weights)
        lengths = lengths / self.poses.diagonal

        def residuals(x: Float) -> Float:
            away = of_length * (edge_lengths(x, topology.edges) - lengths)
            return np.concatenate([away, of_angle * wrap_angles(dihedral_angles(x, topology.hinges) - angles)])

        def value(x: Float) -> float:
            return float(np.square(residuals(x)).sum())

        def model(x: Float) -> Quadratic:
            slopes = of_length / np.maximum(edge_lengths(x, topology.edges), 1e-9)
            jacobian = sparse.vstack([
                sparse.diags_array(slopes) @ self.elastic.length_rows(x),
                sparse.diags_array(of_angle) @ self.elastic.angle_rows(x),
            ]).tocsr()  # fmt: skip
            away = residuals(x)
            return Quadratic(float(away @ away), jacobian.T @ away, sparse.csr_array(jacobian.T @ jacobian))

        x, report = minimise(value, model, self.shells.at(weights).points / self.poses.diagonal)
        return Blended(x * self.poses.diagonal, [report])


SIDES = np.ones((3, 3)) - 2 * np.eye(3)


def membrane(a: Float, b: Float) -> tuple[float, Float, Float]:
    """Return the membrane energy from faces with squared sides a to b ``(F, 3)``, and both its gradients."""
    ma, mb = a @ SIDES, b @ SIDES
    qa, qb = (np.maximum((m * x).sum(axis=1, keepdims=True), 1e-30) for m, x in ((ma, a), (mb, b)))
    mixed, root = (ma * b).sum(axis=1, keepdims=True), np.sqrt(qa)
    density = mixed / qa + qb / (4 * qa) - 0.75 * np.log(qb / qa) - 1.25
    to_b = root / 4 * (ma / qa + mb / (2 * qa) - 1.5 * mb / qb)
    to_a = density / 4 * ma / root + root / 4 * (mb / qa - (2 * mixed + qb / 2) * ma / qa**2 + 1.5 * ma / qa)
    return float((root / 4 * density).sum()), to_a, to_b


def membrane_roots(a: Float, b: Float) -> Float:
    """Return C ``(F, 6, 6)`` with the positive part of the second derivatives by a and b, ``C C^T``."""
    second, steps = np.empty((len(a), 6, 6)), 1e-6 * (a + b).mean(axis=1, keepdims=True)
    for k in range(6):
        move = np.eye(6)[k] * steps
        ends = [np.hstack(membrane(a + s * move[:, :3], b + s * move[:, 3:])[1:]) for s in (1, -1)]
        second[:, k] = (ends[0] - ends[1]) / (2 * steps)
    values, vectors = np.linalg.eigh((second + np.swapaxes(second, 1, 2)) / 2)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0))[:, None, :])


@dataclass(frozen=True, eq=False)
class Geodesic(Nric):
    """A time-discrete geodesic, all of whose shapes are found at once; weights are multiples of 1/4."""

    @cached_property
    def path(self) -> tuple[Float, ShellReport]:
        """The inner shapes ``(K - 1, V, 3)``, found from discrete shells."""
        starts = [self.shells.at(np.array([1 - w, w])).points for w in np.arange(1, SEGMENTS) / SEGMENTS]
        return minimise(self.value, self.model, np.stack(starts) / self.poses.diagonal)

    def prepare(self) -> None:
        _ = self.path

    def _coordinates(self, inner: Float) -> tuple[Float, Float, Float]:
        """Return all shapes of a path, squared sides of their faces ``(K + 1, F, 3)``, and angles ``(K + 1, H)``."""
        topology = self.poses.topology
        shapes = np.concatenate([self.pair[:1], inner, self.pair[1:]])
        sides = np.square(edge_lengths(shapes, topology.edges))[:, topology.face_edges]
        return shapes, sides, dihedral_angles(shapes, topology.hinges)

    def value(self, inner: Float) -> float:
        """Return the energy of a path."""
        _, sides, angles = self._coordinates(inner)
        bend = self.elastic.weights[1] * wrap_angles(np.diff(angles, axis=0))
        return sum(membrane(a, b)[0] for a, b in pairwise(sides)) + float((bend**2).sum())

    def model(self, inner: Float) -> Quadratic:
        """Return energy, gradient, and the second derivatives as far as they are positive."""
        shapes, sides, angles = self._coordinates(inner)
        topology, of_angle, count = self.poses.topology, self.elastic.weights[1], len(sides[0])
        select, size = topology.face_edges.reshape(-1), (3 * count, len(topology.edges))
        chosen = sparse.csr_array((np.full(3 * count, 2.0), select, np.arange(3 * count + 1)), shape=size)
        by_sides = [chosen @ self.elastic.length_rows(x) for x in shapes]
        by_angles = [sparse.diags_array(of_angle) @ self.elastic.angle_rows(x) for x in shapes]
        bends = of_angle * wrap_angles(np.diff(angles, axis=0))
        pulls, gradients = np.zeros((len(shapes), 3 * count)), np.zeros((len(shapes), shapes[0].size))
        value, rows = float((bends**2).sum()), []
        for k, (bend, (a, b)) in enumerate(zip(bends, pairwise(sides), strict=True)):
            energy, to_a, to_b = membrane(a, b)
            value += energy
            pulls[k] += to_a.reshape(-1)
            pulls[k + 1] += to_b.reshape(-1)
            gradients[k] -= 2 * (by_angles[k].T @ bend)
            gradients[k + 1] += 2 * (by_angles[k + 1].T @ bend)
            roots = np.swapaxes(membrane_roots(a, b), 1, 2)
            row: list[sparse.sparray | None] = [None] * len(shapes)
            for end, sign in ((0, -1), (1, 1)):
                block = np.ascontiguousarray(roots[:, :, 3 * end : 3 * end + 3]), np.arange(count), np.arange(count + 1)
                stretch = sparse.bsr_array(block, shape=(6 * count, 3 * count)) @ by_sides[k + end]
                row[k + end] = sparse.vstack([stretch, sign * np.sqrt(2) * by_angles[k + end]])
            rows.append(row[1:-1])
        jacobian = sparse.block_array(rows).tocsr()
        gradients += np.stack([by.T @ pull for by, pull in zip(by_sides, pulls, strict=True)])
        tension = sparse.block_diag([self._tension(np.maximum(chosen.T @ pull, 0)) for pull in pulls[1:-1]])
        matrix = sparse.csr_array(jacobian.T @ jacobian + tension)
        return Quadratic(value, gradients[1:-1].reshape(-1), matrix)

    def _tension(self, pull: Float) -> sparse.csr_array:
        """Return what edges ``(E,)`` under tension add to the second derivatives: a Laplacian ``(3V, 3V)``."""
        edges, count = self.poses.topology.edges, self.poses.topology.vertex_count
        ends = np.tile([-1.0, 1.0], len(edges)), edges.reshape(-1), np.arange(len(edges) + 1) * 2
        incidence = sparse.csr_array(ends, shape=(len(edges), count))
        laplacian = incidence.T @ sparse.diags_array(pull) @ incidence
        return sparse.csr_array(sparse.kron(laplacian, sparse.eye_array(3)))

    def at(self, weights: Float) -> Blended:
        inner, report = self.path
        number = round(SEGMENTS * float(weights[1])) - 1
        if not 0 <= number < len(inner) or not np.isclose(SEGMENTS * weights[1], number + 1):
            raise ValueError(f"a weight is {weights[1]}; a multiple of 1/{SEGMENTS} between 0 and 1 is expected")
        return Blended(inner[number] * self.poses.diagonal, [report])


def turned(poses: Poses, rotation: Float) -> Poses:
    """Turn the second pose."""
    return replace(poses, points=np.stack([poses.points[0], poses.points[1] @ rotation.T]))


BASELINES: dict[str, Callable[[Poses, Index], Method]] = {
    "vertices": lambda poses, _: Registered(poses),
    "ARAP": lambda poses, _: Arap(poses),
    "skin": lambda poses, _: Skinned(poses),
    "NRIC": lambda poses, _: Nric(poses),
    "geodesic": lambda poses, _: Geodesic(poses),
}
"""Methods of others, of two poses."""
