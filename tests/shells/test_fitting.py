"""Gauss-Newton on lengths and angles."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixseq.errors import ReconstructionError
from mixseq.mesh.measures import dihedral_angles, edge_lengths
from mixseq.mesh.rigid import kabsch, transform_points
from mixseq.segmentation.joints import make_joint
from mixseq.shells.fitting import Patch, ShellProblem, ShellSettings, fit_patch_near, fit_shell, rebuild_patch
from mixseq.types import Float
from tests.meshes import Mesh, bent, flipped, grid, pages, seeds, topology_of, torus, tube
from tests.shells.formulas import jacobian

BAR = tube(6, 9, closed=False)
BENT: Mesh = (bent(BAR[0], 1.2), BAR[1])


def patch_of(mesh: Mesh, fixed: list[int]) -> Patch:
    topology = topology_of(mesh)
    joint = make_joint(topology, np.ones(len(mesh[1]), dtype=bool), np.zeros(len(mesh[0]), dtype=bool))
    return Patch.from_joint(topology, joint, np.isin(np.arange(len(mesh[0])), fixed))


def problem_of(mesh: Mesh, fixed: list[int], bending: float = 0.3) -> ShellProblem:
    """The problem whose solution is the mesh."""
    patch = patch_of(mesh, fixed)
    lengths = edge_lengths(mesh[0], patch.edges)[patch.free_edge_mask]
    angles = dihedral_angles(mesh[0], patch.hinges)[patch.free_hinge_mask]
    return ShellProblem(patch, lengths, angles, 1 / lengths, bending)


ENDS = [*range(12), *range(42, 54)]
"""Vertices of the two outer rings at both ends of the bar."""

MESHES: dict[str, tuple[Mesh, list[int]]] = {
    "bar": (BENT, ENDS),
    "free bar": (BENT, []),
    "flat sheet": (grid(4, 4), [0, 1, 5, 6]),
    "turned over": ((BENT[0], flipped(BENT[1])), ENDS),
    "pages": (pages(3, 4, 2), [0, 1, 2, 5, 6]),
    "torus": (torus(9, 5), [0, 1, 5]),
}


@settings(max_examples=20, deadline=None)
@given(seed=seeds, name=st.sampled_from(list(MESHES)))
def test_jacobian_is_the_derivative(seed: int, name: str) -> None:
    rng = np.random.default_rng(seed)
    mesh, fixed = MESHES[name]
    problem = problem_of(mesh, fixed)
    x = mesh[0] + rng.uniform(-0.05, 0.05, mesh[0].shape)
    x[fixed] = mesh[0][fixed]
    direction = np.zeros_like(x)
    direction[problem.patch.free_ids] = rng.normal(size=(len(problem.patch.free_ids), 3))
    step = 1e-6
    numeric = (problem.residuals(x + step * direction) - problem.residuals(x - step * direction)) / (2 * step)
    exact = jacobian(problem, x) @ direction[problem.patch.free_ids].reshape(-1)
    np.testing.assert_allclose(exact, numeric, atol=1e-6 * max(1.0, np.abs(numeric).max()))


def test_residuals_are_weighted_differences() -> None:
    """A hinge of two right triangles folded by 90 degrees, targets: twice as long, flat."""
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, -1], [0, -1, -1]]) * 2
    faces = np.array([[0, 1, 2], [1, 0, 3]])
    patch = patch_of((points, faces), [])
    lengths = edge_lengths(points, patch.edges)
    problem = ShellProblem(patch, 2 * lengths, np.zeros(1), np.full(5, 0.5), bending=3.0)
    np.testing.assert_allclose(problem.residuals(points)[:5], -0.5 * lengths)
    assert problem.residuals(points)[5] == pytest.approx(3.0 * np.pi / 2)
    turned = ShellProblem(patch, 2 * lengths, np.array([np.pi / 2 + 4 * np.pi]), np.full(5, 0.5), 3.0)
    assert turned.residuals(points)[5] == pytest.approx(0, abs=1e-12)  # whole turns do not count


@pytest.mark.parametrize("name", MESHES)
def test_finds_the_mesh_from_nearby(name: str) -> None:
    mesh, fixed = MESHES[name]
    problem = problem_of(mesh, fixed)
    rng = np.random.default_rng(5)
    start = mesh[0] + rng.uniform(-0.03, 0.03, mesh[0].shape)
    start[fixed] = mesh[0][fixed]
    before = float(np.sum(problem.residuals(start) ** 2))
    assert before > 1e-3
    points, report = fit_shell(problem, start)
    assert report.converged
    assert report.energy < 1e-15
    assert report.energy == pytest.approx(float(np.sum(problem.residuals(points) ** 2)), abs=1e-20)
    np.testing.assert_array_equal(points[fixed], mesh[0][fixed])
    if not fixed:
        points = transform_points(points, *kabsch(points, mesh[0]))
    np.testing.assert_allclose(points, mesh[0], atol=1e-6)


def test_a_solution_is_left_alone() -> None:
    problem = problem_of(BENT, ENDS)
    points, report = fit_shell(problem, BENT[0])
    np.testing.assert_array_equal(points, BENT[0])
    assert (report.iterations, report.converged) == (0, True)


def impossible(seed: int, bending: float) -> ShellProblem:
    rng = np.random.default_rng(seed)
    problem = problem_of(BENT, ENDS, bending)
    lengths = problem.lengths * rng.uniform(0.7, 1.4, len(problem.lengths))
    angles = problem.angles + rng.uniform(-0.5, 0.5, len(problem.angles))
    return ShellProblem(problem.patch, lengths, angles, problem.length_weights, bending)


@settings(max_examples=12, deadline=None)
@given(seed=seeds, bending=st.sampled_from([0.05, 0.3, 2.0]))
def test_energy_never_rises(seed: int, bending: float) -> None:
    problem = impossible(seed, bending)
    energies = [float(np.sum(problem.residuals(BENT[0]) ** 2))]
    for steps in range(1, 7):
        points, report = fit_shell(problem, BENT[0], ShellSettings(bending=bending, iterations=steps))
        assert report.iterations <= steps
        assert report.energy == pytest.approx(float(np.sum(problem.residuals(points) ** 2)), rel=1e-12)
        np.testing.assert_array_equal(points[ENDS], BENT[0][ENDS])
        energies.append(report.energy)
    assert all(later <= earlier for earlier, later in pairwise(energies))
    assert energies[-1] < 0.9 * energies[0]


@pytest.mark.parametrize("seed", range(3))
def test_where_it_stops_the_energy_is_stationary(seed: int) -> None:
    problem = impossible(seed, 0.3)
    points, report = fit_shell(problem, BENT[0], ShellSettings(tolerance=1e-13, accuracy=1e-12, iterations=300))
    assert report.converged
    slope = 2 * jacobian(problem, points).T @ problem.residuals(points)
    begin = 2 * jacobian(problem, BENT[0]).T @ problem.residuals(BENT[0])
    assert np.linalg.norm(slope) < 1e-3 * np.linalg.norm(begin)
    rng = np.random.default_rng(seed)
    for _ in range(20):
        nearby = points.copy()
        nearby[problem.patch.free_ids] += 1e-4 * rng.normal(size=(len(problem.patch.free_ids), 3))
        assert np.sum(problem.residuals(nearby) ** 2) > report.energy


def test_too_few_steps_are_told() -> None:
    _, report = fit_shell(impossible(0, 0.3), BENT[0], ShellSettings(iterations=1))
    assert (report.iterations, report.converged) == (1, False)


@pytest.mark.parametrize("what", ["lengths", "angles", "start"])
def test_values_that_are_not_finite_are_an_error(what: str) -> None:
    problem = problem_of(BENT, ENDS)
    start = BENT[0].copy()
    {"lengths": problem.lengths, "angles": problem.angles, "start": start[20]}[what][0] = np.nan
    with pytest.raises(ReconstructionError, match="not finite"):
        fit_shell(problem, start)


NEAR_WEIGHT = 0.4
"""Weight of distances from the start, per unit."""


def fitted_near(problem: ShellProblem, start: Float, settings: ShellSettings) -> Float:
    """Fit the free vertices of a problem near a start, with different weights in all three directions' vertices."""
    weights = NEAR_WEIGHT * np.linspace(1.0, 2.0, len(problem.patch.free_ids))
    targets = problem.lengths, problem.angles, problem.length_weights
    return fit_patch_near(problem.patch, *targets, start, weights, replace(settings, bending=problem.bending))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", MESHES)
def test_near_positions_the_sum_of_both_energies_is_stationary(name: str, seed: int) -> None:
    """Their gradients balance, as far as energies of sixteen digits can be compared."""
    mesh, fixed = MESHES[name]
    rng, problem = np.random.default_rng(seed), problem_of(mesh, fixed)
    problem = replace(problem, lengths=problem.lengths * rng.uniform(0.9, 1.1, len(problem.lengths)))
    start, free = mesh[0] + rng.normal(scale=0.02, size=mesh[0].shape), problem.patch.free_ids
    points = fitted_near(problem, start, ShellSettings(tolerance=0.0, accuracy=0.0, iterations=500))
    np.testing.assert_array_equal(points[fixed], start[fixed])
    weights = NEAR_WEIGHT * np.linspace(1.0, 2.0, len(free))
    pull = np.square(weights)[:, None] * (points - start)[free]
    slope = (jacobian(problem, points).T @ problem.residuals(points)).reshape(-1, 3)
    assert np.abs(pull).max() > 1e-4
    np.testing.assert_allclose(slope, -pull, atol=1e-6 * np.abs(pull).max())


def test_near_a_solution_all_stays() -> None:
    problem = problem_of(BENT, ENDS)
    np.testing.assert_array_equal(fitted_near(problem, BENT[0], ShellSettings()), BENT[0])
    moved = BENT[0] + 0.01 * np.sin(9 * BENT[0])
    np.testing.assert_array_equal(fitted_near(problem, moved, ShellSettings(iterations=0)), moved)


def test_fits_near_what_is_not_finite_are_an_error() -> None:
    problem = problem_of(BENT, ENDS)
    problem.angles[0] = np.nan
    with pytest.raises(ReconstructionError, match="not finite"):
        fitted_near(problem, BENT[0], ShellSettings())


def rebuilt(mesh: Mesh, fixed: list[int], lengths: Float | None = None) -> tuple[Float, bool]:
    problem = problem_of(mesh, fixed)
    wanted = problem.lengths if lengths is None else lengths
    weights = problem.length_weights
    given_points = np.where(problem.patch.fixed_mask[:, None], mesh[0], 0.0)
    tight = ShellSettings(accuracy=1e-9)
    points, report = rebuild_patch(problem.patch, wanted, problem.angles, weights, given_points, tight)
    return points, report.converged


@pytest.mark.parametrize("name", [name for name, (_, fixed) in MESHES.items() if fixed])
def test_a_joint_between_fixed_vertices_is_rebuilt(name: str) -> None:
    mesh, fixed = MESHES[name]
    points, converged = rebuilt(mesh, fixed)
    assert converged
    np.testing.assert_allclose(points, mesh[0], atol=1e-9)


def test_lengths_below_zero_do_no_harm() -> None:
    """Curves that swing past their keys ask for them."""
    problem = problem_of(BENT, ENDS)
    lengths = problem.lengths.copy()
    lengths[::7] = [-0.3 if k % 2 else 0.0 for k in range(len(lengths[::7]))]
    points, _ = rebuilt(BENT, ENDS, lengths)
    assert np.isfinite(points).all()
    shortest = np.maximum(lengths, 1e-6 * problem.lengths)  # edges as good as closed are meant
    np.testing.assert_array_equal(points, rebuilt(BENT, ENDS, shortest)[0])
