"""Vertices from sides, and steps that make lengths and angles agree."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.errors import ReconstructionError
from mixseq.mesh.measures import degenerate_faces, dihedral_angles, edge_lengths, wrap_angles
from mixseq.mesh.rigid import kabsch
from mixseq.shells import kernels
from mixseq.shells.fitting import Patch, ShellProblem, ShellSettings, fit_shell
from mixseq.shells.shell import BENDING_WEIGHT, Shell
from mixseq.types import Float
from tests.meshes import Mesh, grid, rotation, topology_of, torus, tube

MESHES = [tube(6, 9), torus(9, 6), grid(5, 5)]


def shell_of(mesh: Mesh, hold: float = 0.0) -> Shell:
    topology = topology_of(mesh)
    position_weights = np.full(topology.vertex_count, hold)
    position_weights[0] = max(hold, 1.0)
    return Shell(topology, mesh[0], edge_lengths(mesh[0], topology.edges), position_weights)


def shaken(mesh: Mesh, size: float, seed: int = 0) -> Float:
    return np.asarray(mesh[0] + size * np.random.default_rng(seed).normal(size=mesh[0].shape))


def measured(shell: Shell, x: Float) -> tuple[Float, Float]:
    return edge_lengths(x, shell.topology.edges), dihedral_angles(x, shell.topology.hinges)


def sides_of(mesh: Mesh, x: Float) -> Float:
    corners = x[mesh[1]]
    return np.asarray(np.roll(corners, -1, axis=1) - corners)


def test_the_energy_is_half_the_squared_residuals_and_has_its_gradient() -> None:
    mesh = tube(6, 9)
    shell, x = shell_of(mesh), shaken(mesh, 0.1)
    lengths, angles = measured(shell, shaken(mesh, 0.1, 1))
    stretch, bend, smallest = shell.length_weights, shell._angle_weights, shell._min_squared_normals
    turns = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    arrays = shell.topology.edges, shell.topology.hinges, lengths, turns, stretch, bend, 0.0 * smallest
    gradient = np.empty_like(x)
    energy = kernels.shell_energy(x, *arrays, gradient)
    own_lengths, own_angles = measured(shell, x)
    longer, turned = stretch * (own_lengths - lengths), 2 * bend * np.sin((own_angles - angles) / 2)
    np.testing.assert_array_equal(bend, BENDING_WEIGHT * shell.relative_angle_weights)
    assert energy == pytest.approx(0.5 * (longer @ longer + turned @ turned), rel=1e-12)
    rng, step, nowhere = np.random.default_rng(4), 1e-6, np.empty_like(x)
    for _ in range(5):
        way = rng.normal(size=x.shape)
        ahead, behind = (kernels.shell_energy(x + sign * step * way, *arrays, nowhere) for sign in (1, -1))
        assert np.vdot(gradient, way) == pytest.approx((ahead - behind) / (2 * step), rel=1e-6)


@pytest.mark.parametrize("mesh", MESHES)
def test_vertices_follow_from_sides(mesh: Mesh) -> None:
    x = shaken(mesh, 0.2)
    found = shell_of(mesh).integrate(sides_of(mesh, x), np.zeros_like(x))
    np.testing.assert_allclose(found - found[0], x - x[0], atol=1e-12)


def test_vertices_that_are_held_stay_where_they_are_expected() -> None:
    mesh = grid(6, 6)
    shell, sides = shell_of(mesh, 1e4), sides_of(mesh, shaken(mesh, 0.2))
    found = shell.integrate(sides, mesh[0])
    assert np.abs(found - mesh[0]).max() < 0.01 * np.abs(shaken(mesh, 0.2) - mesh[0]).max()


def test_ties_hold_what_no_edge_does() -> None:
    """A vertex that no face uses goes with the one that it is tied to."""
    points, faces = grid(3, 3)
    mesh = np.concatenate([points, [[5.0, 5.0, 5.0]]]), faces
    topology = topology_of(mesh)
    position_weights, ties = np.eye(1, len(mesh[0]))[0], np.array([[2, len(points)]])
    shell = Shell(topology, mesh[0], edge_lengths(mesh[0], topology.edges), position_weights, ties)
    found = shell.integrate(sides_of(mesh, mesh[0]), np.zeros_like(mesh[0]), np.array([[0.0, 1.0, 2.0]]))
    np.testing.assert_allclose(found[-1] - found[2], [0, 1, 2], atol=1e-12)


@pytest.mark.parametrize("mesh", MESHES)
def test_a_mesh_with_its_lengths_and_angles_stays(mesh: Mesh) -> None:
    shell, x = shell_of(mesh), shaken(mesh, 0.1)
    moved = x @ rotation((1.0, 2.0, 3.0)).T + 5.0
    result = shell.relax(moved, *measured(shell, x), 10)
    np.testing.assert_allclose(result.points, moved, atol=1e-12)


@pytest.mark.parametrize("mesh", MESHES)
def test_steps_find_a_mesh_that_has_the_lengths_and_angles(mesh: Mesh) -> None:
    shell, wanted = shell_of(mesh), shaken(mesh, 0.05, 1)
    lengths, angles = measured(shell, wanted)
    few, many = (shell.relax(mesh[0], lengths, angles, n) for n in (9, 200))
    first = shell.relax(mesh[0], lengths, angles, 0)
    assert many.energy < 1e-8 * first.energy and few.energy < 0.1 * first.energy
    turn, shift = kabsch(many.points, wanted)
    np.testing.assert_allclose(many.points @ turn.T + shift, wanted, atol=1e-3)


def test_steps_go_where_gauss_newton_goes() -> None:
    """Where no mesh has the lengths and angles, too: half-way between a straight and a bent tube."""
    mesh = tube(8, 21)
    angle = 1.2 * np.clip(mesh[0][:, 2] / np.ptp(mesh[0][:, 2]), 0, 1)
    bent = np.stack([rotation((a, 0, 0)) @ x for a, x in zip(angle, mesh[0], strict=True)])
    shell = shell_of(mesh)
    (la, ta), (lb, tb) = measured(shell, mesh[0]), measured(shell, bent)
    lengths, angles = (la + lb) / 2, ta + wrap_angles(tb - ta) / 2
    t = shell.topology
    faces, edges, face_edges, hinges, hinge_faces = (
        each.astype(np.int64) for each in (t.faces, t.edges, t.face_edges, t.hinges, t.hinge_faces)
    )
    patch = Patch(faces, edges, face_edges, hinges, hinge_faces, np.zeros(len(bent), bool))
    problem = ShellProblem(patch, lengths, angles, shell.length_weights, 0.25)
    assert (shell.relative_angle_weights > 0.9).all()
    _, report = fit_shell(problem, mesh[0], ShellSettings(tolerance=1e-10))
    ours = shell.relax(mesh[0], lengths, angles, 300)
    assert 2 * ours.energy < 1.01 * report.energy


def test_slender_triangles_count_less_and_flat_ones_nothing() -> None:
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0.5, 0.9, 0], [0.5, -0.9, 0], [0.5, -0.1, 0], [1.5, 0, 0]])
    for second, low, high in ((3, 1.0, 1.0), (4, 0.2, 0.6), (5, 0.0, 0.0)):
        mesh = points, np.array([[0, 1, 2], [1, 0, second]])
        (bend,) = shell_of(mesh).relative_angle_weights
        assert low <= bend <= high


def test_what_is_not_finite_is_refused() -> None:
    mesh = grid(4, 4)
    shell = shell_of(mesh)
    lengths, angles = measured(shell, mesh[0])
    lengths[3] = np.inf
    with pytest.raises(ReconstructionError, match="not finite"):
        shell.relax(mesh[0], lengths, angles, 10)


def test_hinges_count_less_the_farther_they_are_off() -> None:
    mesh = tube(6, 9)
    shell, x = shell_of(mesh), shaken(mesh, 0.1)
    off = np.linspace(-np.pi, np.pi, len(shell.topology.hinges))
    wanted = measured(shell, x)[1] - off
    turns = np.stack([np.cos(wanted), np.sin(wanted)], axis=1)
    near, collapsed = kernels.hinge_nearness(x, shell.topology.hinges, turns, 1e-6)
    np.testing.assert_allclose(near, np.cos(off / 2) ** 2, atol=1e-12)
    assert not collapsed.any()


@pytest.mark.parametrize("ratio", [0.5, 0.4, 1e-6])
def test_hinges_of_low_triangles_are_marked(ratio: float) -> None:
    points, faces = tube(6, 9)
    shell, x = shell_of((points, faces)), points + 0.0
    a, b, c = faces[10]
    x[c] = (x[a] + x[b]) / 2
    topology = shell.topology
    _, marked = kernels.hinge_nearness(x, topology.hinges, np.ones((len(topology.hinges), 2)), ratio)
    expected = degenerate_faces(x, topology.faces, ratio)
    assert expected[10] and not expected.all()
    np.testing.assert_array_equal(marked, expected[topology.hinge_faces].any(axis=1))


def test_the_energy_counts_all_hinges() -> None:
    """Also those that are half a turn off, which the steps leave alone: such a mesh does not agree."""
    mesh = tube(6, 9)
    shell, x = shell_of(mesh), mesh[0]
    lengths, angles = measured(shell, x)
    assert shell.energy(x, lengths, angles) < 1e-20
    angles[7] += np.pi
    expected = 2.0 * (BENDING_WEIGHT * shell.relative_angle_weights[7]) ** 2
    assert shell.energy(x, lengths, angles) == pytest.approx(expected, rel=1e-9)
    assert not shell.is_exact(shell.energy(x, lengths, angles))


def test_triangles_without_area_say_nothing_of_angles() -> None:
    """Also where rounding of the reference gives them a little: their angles are noise, and meshes stay."""
    points, faces = grid(4, 4)
    a, b, c = faces[10].tolist()
    x = np.concatenate([points, [(points[a] + points[b]) / 2]]) / 8.0
    middle = len(points)
    closed = np.concatenate([np.delete(faces, 10, axis=0), [[a, middle, c], [middle, b, c], [a, b, middle]]])
    topology = topology_of((x, closed))
    rounded = x + 4e-7 * np.random.default_rng(0).uniform(-1, 1, x.shape)
    lengths = edge_lengths(rounded, topology.edges)
    shell = Shell(topology, rounded, lengths, np.ones(len(x)))
    assert shell.degenerate_face_ids.tolist() == [len(closed) - 1]
    of_thin = (topology.hinge_faces == len(closed) - 1).any(axis=1)
    np.testing.assert_array_equal(shell.sound_hinge_mask, ~of_thin)
    angles = dihedral_angles(x, topology.hinges)
    angles[of_thin] += 1.0
    found = shell.relax(x, edge_lengths(x, topology.edges), angles, 10)
    np.testing.assert_array_equal(found.points, x)
