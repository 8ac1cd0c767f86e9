"""Non-rigid registration: exact and approximate results, and errors."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from mixseq.errors import SettingsError
from mixseq.mesh.nearest import ClosestPointQuery
from mixseq.retargeting import registration
from mixseq.retargeting.markers import Markers, align_similarly, pair_components
from mixseq.retargeting.registration import (
    DataTerm,
    Deformation,
    Energy,
    SoftConstraints,
    nearest_similarities,
    register,
)
from mixseq.shells.solvers import Factor
from mixseq.types import Float
from tests.meshes import Mesh, bent, grid, joined, rotation, torus, tube
from tests.retargeting.pairs import surface

pytestmark = pytest.mark.slow

TUBE = tube(10, 25)
MARKED = np.array([0, 5, 62, 67, 120, 125, 182, 187, 243, 248, 250, 251])


def registered(source: Mesh, target: Mesh, marked: NDArray[np.int64] = MARKED) -> Float:
    """Register meshes of which equal vertices are marked."""
    markers = Markers(marked, marked)
    start, goal = surface(source), surface(target)
    return register(start, goal, pair_components(start.topology, goal.topology, markers), markers)


def diagonal(points: Float) -> float:
    return float(np.linalg.norm(np.ptp(points, axis=0)))


def test_a_mesh_is_already_on_itself() -> None:
    result = registered(TUBE, TUBE)
    np.testing.assert_allclose(result, TUBE[0], atol=1e-9)


def test_similarities_are_recovered() -> None:
    points = 40.0 * TUBE[0] @ rotation((0.3, -1.2, 2.0)).T + [300.0, 20.0, -70.0]
    result = registered(TUBE, (points, TUBE[1]))
    np.testing.assert_allclose(result, points, atol=1e-9 * diagonal(points))


def test_mirrored_points_get_a_rotation() -> None:
    points = np.random.default_rng(0).normal(size=(9, 3))
    axes = np.concatenate([np.zeros((1, 3)), np.eye(3)])
    origin, *ends = align_similarly(axes, points, points * [1.0, 1.0, -1.0])
    assert np.linalg.det(np.array(ends) - origin) > 0


@pytest.mark.parametrize("coarse_vertices", [3000, 120])
def test_a_smooth_warp_is_found(monkeypatch: pytest.MonkeyPatch, coarse_vertices: int) -> None:
    """A tube that widens and winds: no vertex is further from where it went than a third of an edge."""
    monkeypatch.setattr(registration, "COARSE_VERTICES", coarse_vertices)
    z = TUBE[0][:, 2:]
    points = TUBE[0] * [1.0, 1.0, 1.1] * (1 + 0.1 * z * [1, 1, 0])
    points[:, 0] += 0.3 * np.sin(z[:, 0])
    result = registered(TUBE, (points, TUBE[1]))
    error = np.linalg.norm(result - points, axis=1) / diagonal(points)
    assert error.mean() < 0.003
    assert error.max() < 0.013


def test_a_sharp_bend_is_covered() -> None:
    """Where a featureless tube bends between markers, vertices may slide along it, but not off it."""
    points = bent(TUBE[0], 1.2)
    result = registered(TUBE, (points, TUBE[1]))
    distances = ClosestPointQuery.from_mesh(result, TUBE[1]).query(points).distances / diagonal(points)
    assert distances.max() < 0.02
    error = np.linalg.norm(result - points, axis=1) / diagonal(points)
    assert error.max() < 0.08  # two edges


def test_affine_deformations_of_decimated_components_are_interpolated(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each of two concentric tubes, which share no marker, takes along its own vertices exactly."""
    monkeypatch.setattr(registration, "COARSE_VERTICES", 200)
    mesh = surface(joined(TUBE, tube(10, 25, radius=0.7)))
    marked, is_inner = np.concatenate([MARKED, MARKED + len(TUBE[0])]), np.arange(len(mesh.points)) < len(TUBE[0])
    markers = Markers(marked, marked)
    fine = DataTerm.from_pairings(mesh, mesh, pair_components(mesh.topology, mesh.topology, markers), markers)
    coarse = fine.decimated()
    assert len(coarse.vertices) == 200 and np.isin(marked, coarse.vertices).all()
    np.testing.assert_array_equal(coarse.vertices[coarse.markers.corners[:, 0]], marked)
    maps = np.where(is_inner[:, None, None], np.diag([1.0, 2.0, 3.0]), rotation((0.3, -1.2, 2.0)))
    points = np.einsum("vij,vj->vi", maps, mesh.points) + np.array([5.0, 6.0, 7.0])
    rows = coarse.vertices
    found = fine.interpolate(coarse, Deformation(points[rows], maps[rows], Factor(np.zeros_like)))
    np.testing.assert_allclose(found.points, points, atol=1e-12)
    np.testing.assert_allclose(found.maps, maps, atol=1e-12)


def test_energy_is_invariant_to_similarities() -> None:
    mesh = torus(12, 8)
    energy = Energy(surface(mesh))
    turned = 1.7 * rotation((1.0, 2.0, 0.5))
    goals = mesh[0] @ turned.T + [1.0, 2, 3]
    marked = np.array([[0], [30], [60], [77]])
    pull = SoftConstraints(marked, np.ones((4, 1)), goals[marked[:, 0]], np.full(4, 1e3))
    found = energy.minimise(1.0, np.broadcast_to(turned, (len(goals), 3, 3)), [pull])
    np.testing.assert_allclose(found.points, goals, atol=1e-8)
    np.testing.assert_allclose(found.maps, np.broadcast_to(turned, found.maps.shape), atol=1e-8)


def test_a_kept_factor_refines_a_deformation_to_the_minimum(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three further vertices change the matrix by rank 3, so that four conjugate gradients reach the minimum."""
    energy = Energy(surface(torus(12, 8)))
    points, identity = energy.mesh.points, np.broadcast_to(np.eye(3), (96, 3, 3))
    few, more = (
        SoftConstraints(np.array(ids)[:, None], np.ones((len(ids), 1)), 1.1 * points[ids], np.ones(len(ids)))
        for ids in ([0, 20, 40, 60, 80], [0, 20, 40, 60, 80, 10, 50, 90])
    )
    before = energy.minimise(0.1, identity, [few])
    exact = energy.minimise(0.1, before.maps, [more]).points
    distances = []
    for count in (1, 4):
        monkeypatch.setattr(registration, "REFINEMENT_STEPS", count)
        refined = energy.minimise(0.1, before.maps, [more], before).points
        distances.append(np.abs(refined - exact).max() / np.abs(before.points - exact).max())
    assert distances[0] < 0.7 and distances[1] < 1e-6


def test_a_refined_flat_mesh_stays_flat() -> None:
    """Across the mesh there is no residual, by which conjugate gradients would divide."""
    points, faces = grid(4, 4)
    points = points * [1.0, 1.0, 0.0]
    energy, corners = Energy(surface((points, faces))), np.array([[0], [3], [12]])
    pull = SoftConstraints(corners, np.ones((3, 1)), 1.2 * points[corners[:, 0]], np.ones(3))
    flat = energy.minimise(1.0, np.broadcast_to(np.eye(3), (len(points), 3, 3)), [pull])
    np.testing.assert_array_equal(energy.minimise(1.0, flat.maps, [pull], flat).points[:, 2], 0.0)


def test_a_pull_on_a_triangle_is_a_pull_on_its_point() -> None:
    """Four points that all go the same way take the mesh along."""
    mesh = torus(12, 8)
    energy = Energy(surface(mesh))
    corners, weights = mesh[1][[3, 40, 90, 150]], np.array([[0.2, 0.3, 0.5]] * 4)
    moved = mesh[0] + np.array([0.5, 0.0, -1.0])
    goals = np.einsum("nk,nkc->nc", weights, moved[corners])
    identity = np.broadcast_to(np.eye(3), (len(mesh[0]), 3, 3))
    points = energy.minimise(1.0, identity, [SoftConstraints(corners, weights, goals, np.ones(4))]).points
    np.testing.assert_allclose(points, moved, atol=1e-8)


def test_keys_of_large_meshes_have_more_than_32_bits() -> None:
    """All points of a mesh are pulled by one vector, as faces with 32-bit indices have it."""
    energy = Energy(surface(torus(150, 80)))
    corners, shift = energy.mesh.faces.astype(np.int32), np.array([0.1, 0.2, 0.3])
    assert 16 * len(energy.mesh.points) ** 2 > 2**31
    thirds, weights = np.full(corners.shape, 1 / 3), np.full(len(corners), 1 / len(corners))
    goals = energy.mesh.points[corners].mean(axis=1) + shift
    identity = np.broadcast_to(np.eye(3), (len(energy.mesh.points), 3, 3))
    points = energy.minimise(1.0, identity, [SoftConstraints(corners, thirds, goals, weights)]).points
    np.testing.assert_allclose(points, energy.mesh.points + shift, atol=1e-9)


def test_nearest_similarities_are_proper() -> None:
    maps = np.stack([np.diag([2.0, 2.0, 2.0]), np.diag([1.0, 2.0, 3.0]), np.diag([-1.0, 1.0, 1.0])])
    found = nearest_similarities(maps)
    np.testing.assert_allclose(found[:2], np.stack([2 * np.eye(3), 2 * np.eye(3)]), atol=1e-12)
    assert np.linalg.det(found[2]) >= 0


def test_a_component_without_marker_follows_its_neighbour() -> None:
    small = tube(5, 4, length=0.3, radius=0.1)
    at = np.array([0.8, 0.0, 3.7])
    source = joined(TUBE, (small[0] + at, small[1]))
    points = 2.0 * TUBE[0] + [5.0, 0, 0]
    result = registered(source, (points, TUBE[1]))
    np.testing.assert_allclose(result[len(TUBE[0]) :], 2.0 * (small[0] + at) + [5.0, 0, 0], atol=1e-7)


def test_components_match_their_counterparts() -> None:
    """Two concentric tubes change their radii so that each ends nearer to where the other began."""
    inner, outer = tube(10, 25, radius=0.5), tube(10, 25, radius=0.7)
    source = joined(inner, outer)
    target = joined(tube(10, 25, radius=0.62), tube(10, 25, radius=0.8))
    marked = np.concatenate([MARKED, MARKED + len(inner[0])])
    result = registered(source, target, marked)
    np.testing.assert_allclose(result, target[0], atol=0.01)


def test_progress_is_reported() -> None:
    told: list[tuple[int, int, str]] = []
    markers = Markers(MARKED, MARKED)
    mesh = surface(TUBE)
    pairings = pair_components(mesh.topology, mesh.topology, markers)
    register(mesh, mesh, pairings, markers, lambda *step: told.append(step), steps=2)
    assert [done for done, _, _ in told] == list(range(5))  # two rounds of closest points for each step
    assert {total for _, total, _ in told} == {4}


def test_markers_in_one_place_are_refused() -> None:
    with pytest.raises(SettingsError, match="in one place"):
        align_similarly(np.eye(3), np.zeros((5, 3)), np.random.default_rng(0).normal(size=(5, 3)))
