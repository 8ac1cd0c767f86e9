from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse

from mixseq.errors import ReconstructionError
from mixseq.reconstruction.solvers import factorise
from tests.meshes import seeds


@settings(max_examples=25, deadline=None)
@given(seed=seeds, size=st.integers(1, 40), columns=st.integers(1, 4))
def test_solves_like_a_dense_solver(seed: int, size: int, columns: int) -> None:
    rng = np.random.default_rng(seed)
    half = rng.normal(size=(2 * size, size)) * (rng.random((2 * size, size)) < 0.2)
    matrix = half.T @ half + np.eye(size)
    right = rng.normal(size=(size, columns))
    factor = factorise(sparse.csr_array(matrix))
    np.testing.assert_allclose(factor.solve(right), np.linalg.solve(matrix, right), atol=1e-9)
    one = factor.solve(right[:, 0])
    assert one.shape == (size,)
    np.testing.assert_allclose(one, np.linalg.solve(matrix, right[:, 0]), atol=1e-9)
    fortran = np.asfortranarray(right)
    np.testing.assert_array_equal(factor.solve(fortran), factor.solve(right))


def test_a_singular_system_is_an_error() -> None:
    path = sparse.csr_array(np.array([[1.0, -1, 0], [-1, 1, 0], [0, 0, 0]]))
    with pytest.raises(ReconstructionError, match="no unique solution"):
        factorise(path)
