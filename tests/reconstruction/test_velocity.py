"""How fast the free vertices of a joint move."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixseq.geometry.lengths_angles import dihedral_angles, dihedral_gradients, edge_lengths
from mixseq.reconstruction.joint import rebuild
from mixseq.reconstruction.patch import Patch
from mixseq.reconstruction.shells import ShellProblem, ShellSettings, fit_shell
from mixseq.reconstruction.velocity import (
    JointRates,
    VelocityReport,
    curvature,
    dihedral_gradient_rates,
    joint_velocity,
)
from mixseq.segmentation.joints import make_joint
from tests.meshes import Float, Mesh, bent, flipped, grid, pages, seeds, topology_of, torus, tube

BAR = tube(6, 9, closed=False)
BENT: Mesh = (bent(BAR[0], 1.2), BAR[1])
ENDS = [*range(12), *range(42, 54)]
MESHES: dict[str, tuple[Mesh, list[int]]] = {
    "bar": (BENT, ENDS),
    "flat sheet": (grid(4, 4), [0, 1, 5, 6, 18, 19, 23, 24]),
    "turned over": ((BENT[0], flipped(BENT[1])), ENDS),
    "pages": (pages(3, 4, 2), [0, 1, 2, 5, 6]),
    "torus": (torus(9, 5), [0, 1, 5, 22, 23]),
}
TIGHT = ShellSettings(tolerance=1e-18, exact=1e-14, accuracy=1e-14, iterations=1000)


def problem_of(mesh: Mesh, fixed: list[int]) -> ShellProblem:
    """The problem whose solution is the mesh."""
    topology = topology_of(mesh)
    joint = make_joint(topology, np.ones(len(mesh[1]), dtype=bool), np.zeros(len(mesh[0]), dtype=bool))
    patch = Patch.of_joint(topology, joint, np.isin(np.arange(len(mesh[0])), fixed))
    lengths = edge_lengths(mesh[0], patch.edges)[patch.free_edges]
    angles = dihedral_angles(mesh[0], patch.hinges)[patch.free_hinges]
    return ShellProblem(patch, lengths, angles, 1 / lengths, TIGHT.bending)


def velocity(
    problem: ShellProblem, points: Float, rates: JointRates, iterations: int = 50, bending: float = 0.3
) -> tuple[Float, VelocityReport]:
    return joint_velocity(
        problem.patch,
        problem.lengths,
        problem.angles,
        problem.length_weights,
        points,
        rates,
        ShellSettings(bending=bending),
        iterations,
    )


def still(problem: ShellProblem, positions: Float) -> JointRates:
    return JointRates(np.zeros(len(problem.lengths)), np.zeros(len(problem.angles)), positions)


def strained(name: str, seed: int, amount: float = 0.1) -> tuple[ShellProblem, Float]:
    """Targets that no mesh has, and the points that fit them best."""
    mesh, fixed = MESHES[name]
    problem, rng = problem_of(mesh, fixed), np.random.default_rng(seed)
    lengths = problem.lengths * rng.uniform(1 - amount, 1 + amount, len(problem.lengths))
    angles = problem.angles + rng.uniform(-amount, amount, len(problem.angles))
    problem = ShellProblem(problem.patch, lengths, angles, problem.length_weights, problem.bending)
    points, report = fit_shell(problem, mesh[0], TIGHT)
    assert report.energy > 1e-3
    return problem, points


# Closed forms ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("strain", [False, True])
def test_a_rigid_motion_of_the_fixed_vertices_is_one_of_all(name: str, strain: bool) -> None:
    mesh, fixed = MESHES[name]
    problem, points = strained(name, 0) if strain else (problem_of(mesh, fixed), mesh[0])
    moving = np.cross([0.3, -0.5, 0.9], points) + np.array([1.0, 2.0, -3.0])
    given_rates = np.where(problem.patch.fixed[:, None], moving, np.nan)  # free vertices are not looked at
    result, report = velocity(problem, points, still(problem, given_rates))
    np.testing.assert_allclose(result, moving, atol=1e-5)
    assert report.converged and report.definite


@pytest.mark.parametrize("name", MESHES)
def test_growth(name: str) -> None:
    """Lengths and fixed vertices grow by their own size a second, angles stay: so do all vertices."""
    mesh, fixed = MESHES[name]
    problem = problem_of(mesh, fixed)
    rates = JointRates(problem.lengths, np.zeros(len(problem.angles)), mesh[0])
    result, _ = velocity(problem, mesh[0], rates)
    np.testing.assert_allclose(result, mesh[0], atol=1e-8)


@pytest.mark.parametrize("angle", [-2.0, 0.0, 0.7])
def test_a_page_turns_about_its_hinge(angle: float) -> None:
    d = np.array([0.3, -2 * np.cos(angle), -2 * np.sin(angle)])
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], d])
    problem = problem_of((points, np.array([[0, 1, 2], [1, 0, 3]])), [0, 1, 2])
    np.testing.assert_allclose(problem.angles, [angle], atol=1e-12)
    rates = JointRates(np.zeros(2), np.array([5.0]), np.zeros((4, 3)))
    result, _ = velocity(problem, points, rates)
    np.testing.assert_allclose(result[3], np.cross([5.0, 0, 0], d), atol=1e-9)
    np.testing.assert_array_equal(result[:3], 0)


def star(length: float) -> tuple[ShellProblem, Float]:
    """A vertex between three fixed ones at distance 1 that it wants to be at another distance; no bending."""
    turn = np.arange(3) * 2 * np.pi / 3
    points = np.concatenate([np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1), np.zeros((1, 3))])
    problem = problem_of((points, np.array([[0, 1, 3], [1, 2, 3], [2, 0, 3]])), [0, 1, 2])
    ones = np.ones(3)
    return ShellProblem(problem.patch, length * ones, problem.angles, ones, 0.0), points


def test_strained_springs() -> None:
    """In the plane ``H = 3/2 (1 + r)`` with the residual r = 1 - length, and Gauss-Newton knows ``3/2``."""
    problem, points = star(0.6)
    away = np.zeros((4, 3))
    away[0, 0] = 1.0
    full, report = velocity(problem, points, still(problem, away), bending=0.0)
    np.testing.assert_allclose(full[3], [1 / 1.5 / 1.4, 0, 0], atol=1e-9)
    assert report.converged and report.definite
    short, _ = velocity(problem, points, still(problem, away), iterations=0, bending=0.0)
    np.testing.assert_allclose(short[3], [1 / 1.5, 0, 0], atol=1e-9)
    aside = np.zeros((4, 3))
    aside[0, 1] = 1.0  # changes no length, but where the spring pulls
    full, report = velocity(problem, points, still(problem, aside), bending=0.0)
    np.testing.assert_allclose(full[3], [0, 0.4 / 1.5 / 1.4, 0], atol=1e-9)
    assert report.converged and report.definite


def test_what_is_no_minimum_is_told() -> None:
    """Pressed springs are about to pop out of their plane."""
    problem, points = star(1.4)
    up = np.zeros((4, 3))
    up[0, 2] = 1.0
    result, report = velocity(problem, points, still(problem, up), bending=0.0)
    assert not report.definite
    np.testing.assert_array_equal(
        result, velocity(problem, points, still(problem, up), iterations=0, bending=0.0)[0]
    )
    assert np.isfinite(result).all()


# Against differences ------------------------------------------------------------------------------------------


@settings(max_examples=20, deadline=None)
@given(seed=seeds, name=st.sampled_from(list(MESHES)))
def test_second_derivatives(seed: int, name: str) -> None:
    rng = np.random.default_rng(seed)
    mesh, fixed = MESHES[name]
    problem = problem_of(mesh, fixed)
    x = mesh[0] + rng.uniform(-0.05, 0.05, mesh[0].shape)
    v, h = rng.normal(size=x.shape), 1e-6
    ahead, behind = (dihedral_gradients(x + s * v, problem.hinges) for s in (h, -h))
    numeric = (ahead - behind) / (2 * h)
    np.testing.assert_allclose(
        dihedral_gradient_rates(x, problem.hinges, v), numeric, atol=1e-6 * np.abs(numeric).max()
    )
    residuals = problem.residuals(x)
    ahead, behind = (problem.jacobian(x + s * v).T @ residuals for s in (h, -h))
    numeric = (ahead - behind) / (2 * h)
    exact = curvature(problem, x, residuals, v)[problem.patch.free].reshape(-1)
    np.testing.assert_allclose(exact, numeric, atol=1e-6 * max(1.0, np.abs(numeric).max()))


@pytest.mark.parametrize("name", MESHES)
def test_differences_of_minima(name: str) -> None:
    problem, points = strained(name, 1)
    rng = np.random.default_rng(2)
    rates = JointRates(
        rng.normal(size=len(problem.lengths)) * problem.lengths,
        rng.normal(size=len(problem.angles)),
        np.where(problem.patch.fixed[:, None], rng.normal(size=points.shape), 0.0),
    )
    ends, h = [], 1e-4
    for s in (h, -h):
        moved = ShellProblem(
            problem.patch,
            problem.lengths + s * rates.lengths,
            problem.angles + s * rates.angles,
            problem.length_weights,
            problem.bending,
        )
        ends.append(fit_shell(moved, points + s * rates.positions, TIGHT)[0])
    numeric = (ends[0] - ends[1]) / (2 * h)
    full, report = velocity(problem, points, rates)
    assert report.converged and report.definite
    error = np.linalg.norm(full - numeric) / np.linalg.norm(numeric)
    short = np.linalg.norm(velocity(problem, points, rates, iterations=0)[0] - numeric)
    assert error < 1e-4
    assert error < 0.1 * short / np.linalg.norm(numeric)


# Limits -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", MESHES)
def test_nothing_moves_by_itself(name: str) -> None:
    problem, points = strained(name, 3)
    result, report = velocity(problem, points, still(problem, np.zeros_like(points)))
    np.testing.assert_array_equal(result, 0)
    assert report == VelocityReport(0, True, True)


def test_at_a_frame_gauss_newton_is_enough() -> None:
    problem, rng = problem_of(BENT, ENDS), np.random.default_rng(0)
    rates = still(problem, rng.normal(size=BENT[0].shape))
    result, report = velocity(problem, BENT[0], rates)
    np.testing.assert_allclose(result, velocity(problem, BENT[0], rates, iterations=0)[0], atol=1e-9)
    assert report.iterations <= 1


def test_lengths_at_their_bound_stand_still() -> None:
    problem, rng = problem_of(BENT, ENDS), np.random.default_rng(0)
    lengths = problem.lengths.copy()
    lengths[::7] = -0.3
    patch, weights = problem.patch, problem.length_weights
    points, _ = rebuild(patch, lengths, problem.angles, weights, BENT[0], ShellSettings())
    rates = JointRates(rng.normal(size=len(lengths)), np.zeros(len(problem.angles)), np.ones_like(points))
    result, _ = joint_velocity(patch, lengths, problem.angles, weights, points, rates, ShellSettings())
    assert np.isfinite(result).all()
    rates.lengths[::7] = 99.0
    again, _ = joint_velocity(patch, lengths, problem.angles, weights, points, rates, ShellSettings())
    np.testing.assert_array_equal(again, result)


def test_a_triangle_without_area_does_not_hold_the_others() -> None:
    """Three vertices in one line, or in one point, have an angle without derivatives, or with huge ones."""
    problem = problem_of(BENT, ENDS)
    points = BENT[0].copy()
    shift = np.array([1.0, 2, 3])
    for height in (0.0, 1e-12, 1e-7):
        points[26] = (points[25] + points[31]) / 2 + height
        result, _ = velocity(problem, points, still(problem, np.tile(shift, (len(points), 1))))
        np.testing.assert_allclose(result, np.tile(shift, (len(points), 1)), atol=1e-2)
    points[26] = points[25]
    result, _ = velocity(problem, points, still(problem, np.tile(shift, (len(points), 1))))
    assert np.isfinite(result).all()


def test_without_fixed_vertices() -> None:
    problem = problem_of(BENT, [])
    rates = JointRates(problem.lengths, np.zeros(len(problem.angles)), np.zeros_like(BENT[0]))
    result, _ = velocity(problem, BENT[0], rates)
    edges = problem.edges
    along, difference = BENT[0][edges[:, 1]] - BENT[0][edges[:, 0]], result[edges[:, 1]] - result[edges[:, 0]]
    stretch = np.einsum("ei,ei->e", along, difference) / problem.lengths
    np.testing.assert_allclose(stretch, problem.lengths, rtol=1e-6)
