"""The compiled loops against the formulas in NumPy, and against dense matrices."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixseq.mesh.measures import dihedral_angles, edge_lengths, wrap_angles
from mixseq.shells.fitting import NormalEquations, Patch, ShellProblem
from mixseq.shells.solvers import BlockPattern
from mixseq.types import Float
from tests.meshes import seeds
from tests.shells.formulas import jacobian
from tests.shells.test_fitting import MESHES, problem_of


def dense(pattern: BlockPattern, values: Float) -> Float:
    size = 3 * pattern.block_count
    lower = np.zeros((size, size))
    columns = np.repeat(np.arange(size), np.diff(pattern.starts))
    assert (pattern.rows >= columns).all()
    lower[pattern.rows, columns] = values
    return lower + np.tril(lower, -1).T


@settings(max_examples=30, deadline=None)
@given(seed=seeds, name=st.sampled_from(list(MESHES)))
def test_residuals_and_equations(seed: int, name: str) -> None:
    rng = np.random.default_rng(seed)
    mesh, fixed = MESHES[name]
    problem = problem_of(mesh, fixed)
    x = mesh[0] + rng.normal(scale=0.3, size=mesh[0].shape)
    expected = [
        problem.length_weights * (edge_lengths(x, problem.patch.equations.edges) - problem.lengths),
        problem.bending * wrap_angles(dihedral_angles(x, problem.patch.equations.hinges) - problem.angles),
    ]
    residuals = problem.residuals(x)
    np.testing.assert_allclose(residuals, np.concatenate(expected), atol=1e-12)
    assert problem.energy(x) == pytest.approx(float(residuals @ residuals), rel=1e-12)

    values, gradient = problem.normal_equations(x, residuals)
    slopes = jacobian(problem, x).toarray()
    normal = slopes.T @ slopes
    tight = 1e-11 * np.abs(normal).max()
    np.testing.assert_allclose(dense(problem.patch.equations.pattern, values), normal, atol=tight)
    np.testing.assert_allclose(gradient, slopes.T @ residuals, atol=tight)


@pytest.mark.parametrize("turn", [-3, -1, 0, 1, 5])
def test_angles_are_compared_the_shorter_way(turn: int) -> None:
    problem = problem_of(*MESHES["bar"])
    turned = ShellProblem(
        problem.patch, problem.lengths, problem.angles + turn * 2 * np.pi, problem.length_weights, 0.3
    )
    assert np.abs(turned.residuals(MESHES["bar"][0][0])).max() < 1e-13


def test_two_faces_on_the_same_vertices() -> None:
    """A pillow of two triangles: both hinges' opposite vertices are one."""
    faces = np.array([[0, 1, 2], [0, 2, 1]])
    edges = np.array([[0, 1], [0, 2], [1, 2]])
    hinges = np.array([[0, 1, 2, 2], [1, 2, 0, 0], [2, 0, 1, 1]])
    patch = Patch(
        faces, edges, np.array([[0, 2, 1], [1, 2, 0]]), hinges, np.array([[0, 1]] * 3), np.zeros(3, dtype=bool)
    )
    x = np.array([[0.0, 0, 0], [1, 0, 0], [0.2, 1, 0.3]])
    problem = ShellProblem(patch, np.ones(3), np.full(3, 2.0), np.ones(3), 0.3)
    values, gradient = problem.normal_equations(x, problem.residuals(x))
    slopes = jacobian(problem, x).toarray()
    np.testing.assert_allclose(dense(patch.equations.pattern, values), slopes.T @ slopes, atol=1e-12)
    np.testing.assert_allclose(gradient, slopes.T @ problem.residuals(x), atol=1e-12)


@settings(max_examples=25, deadline=None)
@given(seed=seeds, count=st.integers(1, 12))
def test_pattern_and_factors(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    pairs = rng.integers(-1, count, size=(2 * count, 2))
    pattern = BlockPattern.from_pairs(count, pairs)
    values = rng.normal(size=len(pattern.rows))
    values[pattern.diagonal] = 60.0
    matrix = dense(pattern, values)
    for i, j in pairs:
        block = pattern.find_blocks(np.array([i]), np.array([j]))[0]
        if min(i, j) < 0:
            assert block == -1
        else:
            row, column = max(i, j), min(i, j)
            assert values[pattern.places[block, 0] + 2] == matrix[3 * row + 2, 3 * column]
    right = rng.normal(size=3 * count)
    solution = pattern.analysis.factor(values).solve(right)
    np.testing.assert_allclose(solution, np.linalg.solve(matrix, right), atol=1e-9)


def test_nothing_free() -> None:
    none = np.zeros(0, dtype=np.int64)
    rows = NormalEquations.from_elements(np.zeros((0, 2), int), np.zeros((0, 4), int), none, np.full(3, -1))
    assert rows.pattern.block_count == 0 and rows.hinge_blocks.shape == (0, 6)
