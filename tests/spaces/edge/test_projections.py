"""Whole meshes from lengths and angles, piece by piece, by both projections."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mixseq.errors import ReconstructionError
from mixseq.mesh.measures import (
    dihedral_angles,
    edge_lengths,
    signed_volume,
    triangle_areas,
    volume_gradient,
    wrap_angles,
)
from mixseq.mesh.rigid import kabsch
from mixseq.shells.fitting import ShellProblem, ShellSettings, fit_shell
from mixseq.spaces.edge import DiscreteShell, RelaxedShell, ShellTargets, is_sheet
from mixseq.spaces.pieces import Pieces
from mixseq.types import Float
from tests.meshes import Mesh, bent, flipped, grid, joined, pages, rotation, tetrahedron, topology_of, torus, tube
from tests.shells.formulas import jacobian

MESH: Mesh = joined(tube(6, 9), tetrahedron(), torus(9, 5), pages(3, 4, 2))
STRAY: Mesh = np.concatenate([MESH[0], [[9.0, 9, 9]]]), MESH[1]
"""A mesh of four pieces, one of them no manifold, and a vertex that no face uses."""

KINDS = "steps", "dso"


def projection_of(kind: str, mesh: Mesh) -> DiscreteShell | RelaxedShell:
    topology = topology_of(mesh)
    pieces = Pieces.from_mesh(topology, mesh[0])
    if kind == "dso":
        return DiscreteShell(topology, pieces)
    return RelaxedShell(topology, pieces, edge_lengths(mesh[0], topology.edges))


def wanted(lengths: Float, angles: Float, weights: Float | None = None) -> ShellTargets:
    return ShellTargets(lengths, 1 / lengths if weights is None else weights, angles, np.zeros(0), np.zeros(0))


def measured(mesh: Mesh, x: Float) -> tuple[Float, Float]:
    topology = topology_of(mesh)
    return edge_lengths(x, topology.edges), dihedral_angles(x, topology.hinges)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("size", [0.0, 0.1])
def test_pieces_come_back(kind: str, size: float) -> None:
    """The reference, and a mesh that is not."""
    made = projection_of(kind, STRAY)
    x = STRAY[0] + size * np.random.default_rng(3).normal(size=STRAY[0].shape)
    rows, reports = made.fit(wanted(*measured(STRAY, x)), ShellSettings())
    assert all(report.converged for report in reports)
    assert len(rows) == len(x)
    pieces = Pieces.from_mesh(topology_of(STRAY), STRAY[0])
    for place, vertices in zip(pieces.row_slices, pieces.vertices, strict=True):
        rotation, translation = kabsch(rows[place], x[vertices])
        np.testing.assert_allclose(rows[place] @ rotation.T + translation, x[vertices], atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_edges_that_do_not_count_and_lengths_that_cannot_be(kind: str) -> None:
    lengths, angles = measured(STRAY, STRAY[0])
    weights = 1 / lengths
    weights[0] = 0.0
    lengths[1] = -1.0
    rows, _ = projection_of(kind, STRAY).fit(wanted(lengths, angles, weights), ShellSettings())
    assert np.isfinite(rows).all()


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_not_finite_is_refused(kind: str) -> None:
    lengths, angles = measured(STRAY, STRAY[0])
    angles[0] = np.nan
    with pytest.raises((ReconstructionError, np.linalg.LinAlgError)):
        projection_of(kind, STRAY).fit(wanted(lengths, angles), ShellSettings())


@pytest.mark.parametrize("mesh", [tube(8, 31, length=6.0), grid(25, 7)], ids=["tube", "sheet"])
def test_steps_go_nearly_as_far_as_gauss_newton(mesh: Mesh) -> None:
    """Half-way between bends to both sides, one of them stretched: no mesh has these lengths and angles.

    Steps leave folds as they are, which costs a tenth of the energy on the sheet.
    """
    points, along = mesh[0], int(np.argmax(np.ptp(mesh[0], axis=0)))
    upright = np.roll(points, 2 - along, axis=1)
    ends = bent(upright, -1.2, 3.0, 1.0) * [1.2, 1.0, 1.0], bent(upright, 1.2, 3.0, 1.0)
    first, last = (measured(mesh, x) for x in ends)
    lengths, angles = (first[0] + last[0]) / 2, first[1] + wrap_angles(last[1] - first[1]) / 2
    settings = ShellSettings(tolerance=1e-10, accuracy=1e-10)
    (_, (ours,)), (_, (best,)) = (projection_of(kind, mesh).fit(wanted(lengths, angles), settings) for kind in KINDS)
    assert 1e-3 < ours.energy < 1.1 * best.energy


def test_volumes_of_pieces() -> None:
    topology = topology_of(STRAY)
    made = DiscreteShell(topology, Pieces.from_mesh(topology, STRAY[0]))
    volumes = made.piece_volumes(STRAY[0])
    assert volumes[1] == pytest.approx(8 / 3)
    assert volumes[2] == pytest.approx(signed_volume(*torus(9, 5)))
    assert volumes[-1] == 0
    weights = made.volume_weights(STRAY[0])
    np.testing.assert_allclose(weights[1:3] * np.abs(volumes[1:3]), 1.0)
    assert weights[-1] == made.piece_areas(STRAY[0])[-1] == 0
    assert made.piece_areas(STRAY[0])[1] == pytest.approx(8 * np.sqrt(3))


# Volumes: those of formulas, their gradients, and that the term pulls towards them


def test_tetrahedron() -> None:
    points, faces = tetrahedron()
    assert signed_volume(points, faces) == pytest.approx(8.0 / 3.0)
    assert signed_volume(points, faces[:, ::-1]) == pytest.approx(-8.0 / 3.0)
    assert triangle_areas(points, faces).sum() == pytest.approx(8.0 * np.sqrt(3.0))


def test_prism() -> None:
    """A closed tube holds its base, a regular hexagon, times its height; an open one lacks two cones."""
    base = 6 * np.sin(np.pi / 3) / 2 * 0.25
    points, faces = tube(6, 9)
    # The vertices of the caps pull the centre of the closed tube nowhere: both tubes are symmetric.
    assert signed_volume(points, faces) == pytest.approx(4.0 * base)
    assert signed_volume(*tube(6, 9, closed=False)) == pytest.approx(4.0 * base * 2 / 3)


@pytest.mark.parametrize("mesh", [tube(6, 9), tube(6, 9, closed=False), torus(9, 7)])
def test_gradient_and_rigid_motions(mesh: Mesh) -> None:
    points, faces = mesh
    rng = np.random.default_rng(0)
    x = points + 0.1 * rng.normal(size=points.shape)
    moved = x @ rotation((0.3, -2.0, 1.0)).T + [5.0, -3.0, 100.0]
    assert signed_volume(moved, faces) == pytest.approx(signed_volume(x, faces))
    gradient = volume_gradient(x, faces)
    direction = rng.normal(size=x.shape)
    step = 1e-5
    difference = (signed_volume(x + step * direction, faces) - signed_volume(x - step * direction, faces)) / (2 * step)
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
    (piece,) = DiscreteShell(topology, Pieces.from_mesh(topology, points)).shell_pieces
    assert piece is not None
    lengths, angles = edge_lengths(points, topology.edges), dihedral_angles(points, topology.hinges)
    before = signed_volume(points, faces)
    problem = ShellProblem(piece.patch, lengths, angles, 1.0 / lengths, 0.3)
    return replace(problem, volume=1.1 * before, volume_weight=weight / before), points


def test_steps_are_those_of_all_equations() -> None:
    """Sherman-Morrison finds what the dense normal equations give."""
    problem, points = inflated(3.0)
    residuals = problem.residuals(points)
    row = problem.volume_gradient(points)
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
        ratios.append(signed_volume(fitted, faces) / signed_volume(points, faces))
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
    assert plain.volume_gradient(start) is None
    assert first.iterations == second.iterations
