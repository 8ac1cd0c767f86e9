"""Volumes: those of formulas, their gradients, and that the term pulls towards them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mixseq.errors import ReconstructionError
from mixseq.mesh.measures import dihedral_angles, edge_lengths, triangle_areas, volume, volume_gradient
from mixseq.shells.fitting import ShellProblem, fit_shell
from mixseq.shells.gauss_newton import ShellSettings
from mixseq.spaces.edge import DiscreteShell, is_sheet
from mixseq.spaces.pieces import Pieces
from mixseq.types import Float
from tests.meshes import Mesh, flipped, grid, rotation, tetrahedron, topology_of, torus, tube
from tests.shells.formulas import jacobian


def test_tetrahedron() -> None:
    points, faces = tetrahedron()
    assert volume(points, faces) == pytest.approx(8.0 / 3.0)
    assert volume(points, faces[:, ::-1]) == pytest.approx(-8.0 / 3.0)
    assert triangle_areas(points, faces).sum() == pytest.approx(8.0 * np.sqrt(3.0))


def test_prism() -> None:
    """A closed tube holds its base, a regular hexagon, times its height; an open one lacks two cones."""
    base = 6 * np.sin(np.pi / 3) / 2 * 0.25
    points, faces = tube(6, 9)
    # The vertices of the caps pull the centre of the closed tube nowhere: both tubes are symmetric.
    assert volume(points, faces) == pytest.approx(4.0 * base)
    assert volume(*tube(6, 9, closed=False)) == pytest.approx(4.0 * base * 2 / 3)


@pytest.mark.parametrize("mesh", [tube(6, 9), tube(6, 9, closed=False), torus(9, 7)])
def test_gradient_and_rigid_motions(mesh: Mesh) -> None:
    points, faces = mesh
    rng = np.random.default_rng(0)
    x = points + 0.1 * rng.normal(size=points.shape)
    moved = x @ rotation((0.3, -2.0, 1.0)).T + [5.0, -3.0, 100.0]
    assert volume(moved, faces) == pytest.approx(volume(x, faces))
    gradient = volume_gradient(x, faces)
    direction = rng.normal(size=x.shape)
    step = 1e-5
    difference = (volume(x + step * direction, faces) - volume(x - step * direction, faces)) / (2 * step)
    assert np.sum(gradient * direction) == pytest.approx(difference, rel=1e-7)
    assert np.abs(gradient.sum(axis=0)).max() < 1e-12


def test_sheets_have_no_volume() -> None:
    assert is_sheet(*grid(4, 5))
    assert is_sheet(np.zeros((3, 3)), np.array([[0, 1, 2]]))
    points, faces = torus(9, 7)
    assert not is_sheet(points, faces)
    assert is_sheet(points, flipped(faces, every=2))


def inflated(weight: float) -> tuple[ShellProblem, Float]:
    """A torus that should keep its lengths and angles but hold a tenth more."""
    mesh = torus(12, 8)
    points, faces = mesh[0] / 5.0, mesh[1]
    topology = topology_of(mesh)
    (piece,) = DiscreteShell(topology, Pieces.of(topology, points)).shells
    assert piece is not None
    lengths, angles = edge_lengths(points, topology.edges), dihedral_angles(points, topology.hinges)
    before = volume(points, faces)
    problem = ShellProblem(piece.patch, lengths, angles, 1.0 / lengths, 0.3)
    return replace(problem, volume=1.1 * before, volume_weight=weight / before), points


def test_steps_are_those_of_all_equations() -> None:
    """Sherman-Morrison finds what the dense normal equations give."""
    problem, points = inflated(3.0)
    residuals = problem.residuals(points)
    row = problem.volume_row(points)
    assert row is not None
    slopes = np.vstack([jacobian(problem, points).toarray(), row])
    values, gradient = problem.normal_equations(points, residuals)
    np.testing.assert_allclose(gradient + residuals[-1] * row, slopes.T @ residuals, atol=1e-12)
    once, _ = fit_shell(problem, points, ShellSettings(iterations=1))
    normal = slopes.T @ slopes
    diagonal = values[problem.patch.equations.pattern.diagonal]
    damped = normal + np.diag(1e-6 * diagonal + 1e-12 * diagonal.max())
    expected = points - np.linalg.solve(damped, slopes.T @ residuals).reshape(-1, 3)
    np.testing.assert_allclose(once, expected, atol=1e-8)


def test_the_term_pulls_and_the_fit_is_a_minimum() -> None:
    ratios = []
    for weight in (0.1, 1.0, 10.0, 100.0):
        problem, points = inflated(weight)
        fitted, report = fit_shell(problem, points, ShellSettings(tolerance=1e-9, accuracy=1e-12))
        assert report.converged
        faces = problem.patch.faces
        ratios.append(volume(fitted, faces) / volume(points, faces))
        rng = np.random.default_rng(1)
        for _ in range(5):
            assert problem.energy(fitted + 1e-4 * rng.normal(size=points.shape)) > report.energy
    assert ratios == sorted(ratios)
    assert 1.0 < ratios[0] < 1.01
    assert ratios[-1] == pytest.approx(1.1, abs=1e-3)


@pytest.mark.parametrize("target", [1e154, -1e200, np.inf, np.nan])
def test_volumes_whose_squares_are_no_numbers_are_an_error(target: float) -> None:
    problem, points = inflated(1.0)
    problem = replace(problem, volume=target, volume_weight=1e3)
    assert problem.energy(points) == np.inf
    with pytest.raises(ReconstructionError, match="not finite"):
        fit_shell(problem, points)


def test_without_a_term_nothing_changes() -> None:
    problem, points = inflated(1.0)
    rng = np.random.default_rng(2)
    start = points + 0.01 * rng.normal(size=points.shape)
    plain = replace(problem, volume=None)
    light = replace(problem, volume=0.0, volume_weight=0.0)
    one, first = fit_shell(plain, start)
    other, second = fit_shell(light, start)
    np.testing.assert_allclose(one, other, atol=1e-7)
    assert plain.volume_row(start) is None
    assert first.iterations == second.iterations
