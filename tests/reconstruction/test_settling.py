"""Settling: the equations against finite differences, and bars whose parts were pushed out of place."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import sparse

from mixseq.errors import ReconstructionError
from mixseq.geometry.lengths_angles import dihedral_angles, edge_lengths
from mixseq.geometry.rigid import kabsch, transform
from mixseq.reconstruction.settling import Settling, SettlingProblem, settle
from mixseq.reconstruction.shells import ShellSettings
from mixseq.segmentation import decompose
from tests.meshes import bent, rotation, topology_of, tube

Float = NDArray[np.float64]


def three_parts(width: int = 2) -> tuple[Settling, Float, Float]:
    """A bar of three parts with two joints; its target, bent, and the same with the parts pushed about."""
    mesh = tube(8, 31, length=9.0)
    topology = topology_of(mesh)
    middle = mesh[0][mesh[1]].mean(axis=1)[:, 2]
    decomposition = decompose(topology, np.digitize(middle, [3.0, 6.0]), width)
    target = bent(mesh[0], 0.8, 3.0)
    settling = Settling(
        topology,
        decomposition.parts,
        np.array([0]),
        np.arange(len(topology.edges)),
        np.arange(len(topology.hinges)),
    )
    pushed = target.copy()
    for number, vector in enumerate([(0.0, 0, 0), (0.05, 0.1, -0.05), (-0.1, 0.0, 0.1)]):
        part = settling.parts[number]
        held = part[settling.holder[part] == number]
        pushed[held] = (target[held] - target[held].mean(axis=0)) @ rotation(vector).T + target[held].mean(
            axis=0
        )
        pushed[held] += [0.02 * number, 0.0, 0.01]
    first = settling.parts[0]
    pushed[first] = target[first]
    return settling, target, pushed


def problem_of(settling: Settling, target: Float, bending: float = 0.3) -> SettlingProblem:
    rows = settling.equations
    lengths = edge_lengths(target, rows.edges)
    return SettlingProblem(settling, lengths, dihedral_angles(target, rows.hinges), 1.0 / lengths, bending)


@pytest.mark.parametrize("width", [1, 2, 3])
def test_equations_are_those_of_finite_differences(width: int) -> None:
    settling, target, pushed = three_parts(width)
    problem, step = problem_of(settling, target), 1e-6
    residuals, _ = problem.measured(pushed)
    values, gradient = problem.normal_equations(pushed, residuals)
    free, parts = len(settling.free), len(settling.moving)

    def moved(unknown: int, by: float) -> Float:
        change = np.zeros(3 * free + 6 * parts)
        change[unknown] = by
        x = settling.moved(pushed, change[: 3 * free].reshape(-1, 3), change[3 * free :].reshape(-1, 6))
        return problem.measured(x)[0]

    some = np.concatenate([np.arange(0, 3 * free, 17), np.arange(3 * free, 3 * free + 6 * parts)])
    jacobian = np.stack([(moved(i, step) - moved(i, -step)) / (2 * step) for i in some], axis=1)
    np.testing.assert_allclose(gradient[some], jacobian.T @ residuals, atol=2e-6 * np.abs(gradient).max())
    pattern = settling.equations.pattern
    size = 3 * pattern.count
    lower = sparse.csc_array((values, pattern.rows, pattern.starts), shape=(size, size)).toarray()
    full = lower + np.tril(lower, -1).T
    expected = jacobian.T @ jacobian
    np.testing.assert_allclose(full[np.ix_(some, some)], expected, atol=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize("width", [1, 2, 3])
def test_parts_find_back(width: int) -> None:
    settling, target, pushed = three_parts(width)
    points, report = settle(problem_of(settling, target), pushed, ShellSettings(exact=1e-12))
    assert report.converged
    assert np.abs(points - target).max() < 1e-9


def test_what_fits_stays() -> None:
    settling, target, _ = three_parts()
    points, report = settle(problem_of(settling, target), target, ShellSettings())
    assert report.iterations == 0
    np.testing.assert_array_equal(points, target)


def test_parts_stay_rigid_and_the_first_one_stays() -> None:
    settling, target, pushed = three_parts()
    other = problem_of(settling, target)
    wanted = SettlingProblem(
        settling, 1.1 * other.lengths, 0.8 * other.angles, other.length_weights, other.bending
    )
    points, _ = settle(wanted, pushed, ShellSettings())
    first = settling.parts[0]
    np.testing.assert_array_equal(points[first], pushed[first])
    assert np.abs(points - pushed).max() > 0.1
    for number in settling.moving:
        part = settling.parts[number]
        held = part[settling.holder[part] == number]
        back = transform(pushed[held], *kabsch(pushed[held], points[held]))
        assert np.abs(back - points[held]).max() < 1e-9


def test_a_last_step_is_as_short_as_accuracy_says() -> None:
    settling, target, pushed = three_parts()
    other = problem_of(settling, target)
    problem = SettlingProblem(
        settling, 1.1 * other.lengths, other.angles, other.length_weights, other.bending
    )
    best, long = settle(problem, pushed, ShellSettings(tolerance=1e-12, accuracy=0.0))
    near, short = settle(problem, pushed, ShellSettings(tolerance=1e-12, accuracy=1e-3))
    assert short.converged
    assert short.iterations < long.iterations
    assert 0 < np.abs(near - best).max() < 1e-3


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_what_is_not_finite_is_refused(value: float) -> None:
    settling, target, pushed = three_parts()
    problem = problem_of(settling, target)
    problem.lengths[3] = value
    with pytest.raises(ReconstructionError, match="not finite"):
        settle(problem, pushed, ShellSettings())


def test_energies_fall() -> None:
    settling, target, pushed = three_parts()
    problem = problem_of(settling, target)
    energies = [settle(problem, pushed, ShellSettings(iterations=count))[1].energy for count in range(5)]
    assert all(after < before for before, after in pairwise(energies))
