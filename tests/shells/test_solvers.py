from __future__ import annotations

import os
import sys
from hashlib import sha256

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse

from mixseq.errors import ReconstructionError, SettingsError
from mixseq.shells.solvers import MIN_ROWS_FOR_THREADS, PoissonSystem, analyse, factorise
from tests.forking import in_a_fork
from tests.meshes import grid, joined, seeds, tetrahedron, topology_of


def use(monkeypatch: pytest.MonkeyPatch, solver: str) -> None:
    if solver == "SuperLU":
        monkeypatch.setitem(sys.modules, "rslab", None)
    else:
        pytest.importorskip("rslab")


def positive_definite(rng: np.random.Generator, size: int) -> np.ndarray:
    half = rng.normal(size=(2 * size, size)) * (rng.random((2 * size, size)) < 0.2)
    return np.asarray(half.T @ half + np.eye(size))


@pytest.mark.parametrize("solver", ["rslab", "SuperLU"])
def test_solves_like_a_dense_solver(solver: str, monkeypatch: pytest.MonkeyPatch) -> None:
    use(monkeypatch, solver)

    @settings(max_examples=25, deadline=None)
    @given(seed=seeds, size=st.integers(1, 40), columns=st.integers(1, 4))
    def check(seed: int, size: int, columns: int) -> None:
        rng = np.random.default_rng(seed)
        matrix, right = positive_definite(rng, size), rng.normal(size=(size, columns))
        factor = factorise(sparse.csr_array(matrix))
        np.testing.assert_allclose(factor.solve(right), np.linalg.solve(matrix, right), atol=1e-9)
        one = factor.solve(right[:, 0])
        assert one.shape == (size,)
        np.testing.assert_allclose(one, np.linalg.solve(matrix, right[:, 0]), atol=1e-9)
        fortran = np.asfortranarray(right)
        np.testing.assert_array_equal(factor.solve(fortran), factor.solve(right))

    check()


@pytest.mark.parametrize("solver", ["rslab", "SuperLU"])
def test_one_analysis_serves_all_values(solver: str, monkeypatch: pytest.MonkeyPatch) -> None:
    use(monkeypatch, solver)
    rng = np.random.default_rng(3)
    matrix = positive_definite(rng, 30)
    lower = sparse.csc_array(np.tril(matrix))
    lower.sort_indices()
    analysis = analyse(lower.indptr.astype(np.int64), lower.indices.astype(np.int64))
    right = rng.normal(size=30)
    first = analysis.factor(lower.data)
    for scale in (2.0, 0.25):
        np.testing.assert_allclose(
            analysis.factor(scale * lower.data).solve(right), np.linalg.solve(scale * matrix, right), rtol=1e-9
        )
    np.testing.assert_allclose(first.solve(right), np.linalg.solve(matrix, right), rtol=1e-9)


@pytest.mark.parametrize("solver", ["rslab", "SuperLU"])
def test_columns_do_not_depend_on_others(solver: str, monkeypatch: pytest.MonkeyPatch) -> None:
    use(monkeypatch, solver)
    rng = np.random.default_rng(4)
    factor = factorise(sparse.csr_array(positive_definite(rng, 150)))
    right = rng.normal(size=(150, 51))
    together = factor.solve(right)
    for count in (2, 3, 6, 7, 15, 48):
        np.testing.assert_array_equal(factor.solve(right[:, :count]), together[:, :count])


def test_solvers_agree(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("rslab")
    rng = np.random.default_rng(0)
    matrix = sparse.csr_array(positive_definite(rng, 200))
    right = rng.normal(size=(200, 3))
    one = factorise(matrix).solve(right)
    use(monkeypatch, "SuperLU")
    np.testing.assert_allclose(one, factorise(matrix).solve(right), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("solver", ["rslab", "SuperLU"])
def test_a_singular_system_is_an_error(solver: str, monkeypatch: pytest.MonkeyPatch) -> None:
    use(monkeypatch, solver)
    path = sparse.csr_array(np.array([[1.0, -1, 0], [-1, 1, 0], [0, 0, 0]]))
    with pytest.raises(ReconstructionError, match="no unique solution"):
        factorise(path)


@pytest.mark.parametrize("solver", ["rslab", "SuperLU"])
def test_nothing_to_solve(solver: str, monkeypatch: pytest.MonkeyPatch) -> None:
    use(monkeypatch, solver)
    nothing = np.zeros(0, dtype=np.int64)
    factor = analyse(np.zeros(1, dtype=np.int64), nothing).factor(np.zeros(0))
    assert factor.solve(np.zeros((0, 3))).shape == (0, 3)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there are no forks")
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
@pytest.mark.parametrize("size", [200, pytest.param(MIN_ROWS_FOR_THREADS + 1, marks=pytest.mark.slow)])
def test_forked_processes_solve_with_the_same_bits(size: int) -> None:
    """rslab's threads are not copied, neither for large systems nor for small ones."""
    width = int(np.sqrt(size))
    offsets = [0, -1, 1, -width, width]
    matrix = sparse.csr_array(sparse.diags_array([4.5, -1.0, -1.0, -1.0, -1.0], offsets=offsets, shape=(size, size)))
    right = np.random.default_rng(0).normal(size=(size, 3))
    factor = factorise(matrix)

    def solutions() -> list[str]:
        return [sha256(each.solve(right).tobytes()).hexdigest() for each in (factor, factorise(matrix))]

    here = str(solutions())
    assert in_a_fork(solutions) == here
    assert in_a_fork(lambda: in_a_fork(solutions)) == here


# Vertices from differences: exact where they fit, weighted least squares where they do not

TRIANGLE = np.array([[0, 1], [1, 2], [2, 0]])


def test_a_gap_is_shared_by_weight() -> None:
    """Around a triangle differences miss by 6: each side takes part of it, inversely to its weight."""
    system = PoissonSystem(TRIANGLE, np.array([1.0, 2.0, 2.0]), np.zeros(3, dtype=bool))
    x = system.solve(np.array([[2.0, 0, 0]] * 3))
    np.testing.assert_allclose(x, np.outer([0, -1, -0.5], [1, 0, 0]), atol=1e-14)


@settings(max_examples=10, deadline=None)
@given(seed=seeds)
def test_true_differences_give_the_mesh(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mesh = joined(grid(4, 5), (np.zeros((1, 3)), np.zeros((0, 3), int)), tetrahedron())
    edges = topology_of(mesh).edges.astype(np.int64)
    x = rng.normal(size=mesh[0].shape)
    system = PoissonSystem(edges, rng.uniform(0.5, 2.0, len(edges)), np.zeros(len(x), dtype=bool))
    wanted = np.concatenate([x[:30] - x[0], [[0, 0, 0]], x[31:] - x[31]])
    np.testing.assert_allclose(system.solve(x[edges[:, 1]] - x[edges[:, 0]]), wanted, atol=1e-11)


def test_sides_may_repeat_and_stand_still() -> None:
    sides = np.array([[0, 1], [1, 0], [1, 1]])
    x = PoissonSystem(sides, np.ones(3), np.zeros(2, dtype=bool)).solve(np.array([[1.0, 0, 0], [-3, 0, 0], [7, 7, 7]]))
    np.testing.assert_allclose(x, [[0, 0, 0], [2, 0, 0]])


def test_fixed_vertices_keep_their_positions() -> None:
    """Of a path 0-1-2-3, both ends are fixed a unit too far apart; the sides share it inversely to their weights."""
    path = np.array([[0, 1], [1, 2], [2, 3]])
    system = PoissonSystem(path, np.array([1.0, 2.0, 2.0]), np.array([True, False, False, True]))
    x = system.solve(np.ones((3, 1)), np.array([[5.0], [0], [0], [9]]))
    np.testing.assert_allclose(x[:, 0], [5, 6.5, 7.75, 9], atol=1e-14)


def test_points_alone_are_the_origin() -> None:
    system = PoissonSystem(np.zeros((0, 2), dtype=np.int64), np.zeros(0), np.zeros(3, dtype=bool))
    np.testing.assert_array_equal(system.solve(np.zeros((0, 3))), np.zeros((3, 3)))


def test_wrong_numbers_of_sides_and_singular_systems_are_refused() -> None:
    with pytest.raises(SettingsError, match=r"there are 2 sides; 3 are expected"):
        PoissonSystem(TRIANGLE, np.ones(3), np.zeros(3, dtype=bool)).solve(np.zeros((2, 3)))
    with pytest.raises(ReconstructionError, match="no unique solution"):
        PoissonSystem(TRIANGLE, np.zeros(3), np.zeros(3, dtype=bool)).solve(np.zeros((3, 3)))
