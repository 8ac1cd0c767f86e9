"""Diffusion, against the heat kernel of small meshes, which is a matrix exponential."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.distance import cdist

from mixseq.mesh.topology import Topology
from mixseq.segmentation import silhouettes
from mixseq.segmentation.elements import sample_frames
from mixseq.segmentation.methods import adjusted_rand_index
from mixseq.segmentation.silhouettes import (
    Diffusion,
    SpanningTreeSettings,
    angle_variation,
    length_variation,
    segment_by_spanning_tree,
    vertex_bending,
    vertex_strain,
)
from mixseq.types import Float, Index
from tests.meshes import Mesh, bar, bending, grid, joined, rotation, tetrahedron, topology_of, torus, tube
from tests.segmentation.bones import three_bones


def on(mesh: Mesh) -> Diffusion:
    return Diffusion(mesh[0], topology_of(mesh))


def test_areas_add_up() -> None:
    assert on(grid(3, 5)).areas.sum() == pytest.approx(15.0)
    assert on(tetrahedron()).areas == pytest.approx([np.sqrt(3.0) * 2.0] * 4)  # a third of three faces of 2 sqrt(3)


def test_cotangents_of_a_regular_tetrahedron() -> None:
    """Both angles opposite an edge are 60 degrees."""
    expected = (np.eye(4) * 4 - 1) / np.sqrt(3.0)
    np.testing.assert_allclose(on(tetrahedron()).laplacian.toarray(), expected, atol=1e-12)


@pytest.mark.parametrize("mesh", [grid(6, 4), tube(7, 9), torus(9, 6)])
def test_smoothing_keeps_the_mean_and_the_bounds(mesh: Mesh) -> None:
    surface = on(mesh)
    values = np.random.default_rng(3).uniform(-1, 2, len(mesh[0]))
    smooth = surface.smooth(values, 0.7)
    assert surface.areas @ smooth == pytest.approx(surface.areas @ values)
    assert values.min() < smooth.min() < smooth.max() < values.max()
    assert np.ptp(surface.smooth(values, 2.0)) < np.ptp(smooth)
    np.testing.assert_array_equal(surface.smooth(values, 0.0), values)
    np.testing.assert_allclose(surface.smooth(np.full(len(values), 3.0), 0.7), 3.0)


def test_smoothing_does_not_cross_from_one_component_to_another() -> None:
    values = np.zeros(8)
    values[:4] = 1.0
    np.testing.assert_allclose(on(joined(tetrahedron(), tetrahedron())).smooth(values, 5.0), values)


def test_distances_are_those_of_the_heat_kernel() -> None:
    """With K = exp(-t M^-1 L) M^-1, d_t(v, w)^2 = K_2t(v, v) + K_2t(w, w) - 2 K_2t(v, w)."""
    surface, time = on(tube(5, 6)), 0.13
    kernel = expm(-2 * time * surface.laplacian.toarray() / surface.areas[:, None]) / surface.areas
    squared = np.diag(kernel)[:, None] + np.diag(kernel) - 2 * kernel
    places = surface.embedding(time, len(surface.areas) - 1)
    np.testing.assert_allclose(cdist(places, places) ** 2, squared, atol=1e-10)


def test_the_sparse_solver_finds_the_same_distances(monkeypatch: pytest.MonkeyPatch) -> None:
    surface = on(torus(24, 10))  # a symmetric mesh: most eigenvalues are double
    dense = surface.embedding(0.3, 40)
    monkeypatch.setattr(silhouettes, "_MIN_SPARSE_VERTICES", 0)
    sparse = surface.embedding(0.3, 40)
    assert not np.allclose(dense, sparse)  # other bases ...
    np.testing.assert_allclose(cdist(sparse, sparse), cdist(dense, dense), atol=1e-6)  # ... same distances


def test_distances_depend_on_the_shape_only() -> None:
    points, faces = tube(6, 8)
    order = np.random.default_rng(1).permutation(len(points))
    place = np.argsort(order)
    turned = Diffusion(points[order] @ rotation((1.0, 2.0, 0.5)).T + 3.0, Topology(place[faces], len(points)))
    one = Diffusion(points, Topology(faces, len(points))).embedding(0.2, 30)
    other = turned.embedding(0.2, 30)[place]
    np.testing.assert_allclose(cdist(one, one), cdist(other, other), atol=1e-5)


def test_components_are_embedded_one_by_one() -> None:
    alone = on(tube(5, 6)).embedding(0.1, 12)
    both = on(joined(tube(5, 6), tetrahedron())).embedding(0.1, 12)
    np.testing.assert_allclose(cdist(both[:32], both[:32]), cdist(alone, alone), atol=1e-9)
    assert (both[32:, 3:] == 0.0).all()  # four vertices have three eigenvectors
    assert np.ptp(cdist(both[32:], both[32:])[np.triu_indices(4, 1)]) < 1e-9


def test_flat_faces_and_lone_vertices_are_no_trouble() -> None:
    points = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [1, 1, 0], [9, 9, 9]])
    surface = Diffusion(points, Topology(np.array([[0, 1, 2], [0, 1, 3], [1, 2, 3]]), 5))
    assert np.isfinite(surface.laplacian.toarray()).all()
    assert np.isfinite(surface.smooth(np.arange(5.0), 0.5)).all()
    assert np.isfinite(surface.embedding(0.1, 3)).all()


def test_faces_on_a_line_have_equal_areas() -> None:
    points, faces = grid(3, 2)
    surface = Diffusion(points * [1.0, 0.0, 0.0], Topology(faces, len(points)))
    assert np.ptp(surface.areas) == 0.0 < surface.areas[0]
    assert np.isfinite(surface.smooth(points[:, 0], 0.5)).all()
    assert np.isfinite(surface.embedding(0.1, 3)).all()


# Variations of angles and lengths, against meshes that bend by known amounts

SQUARE = Topology(np.array([[0, 1, 2], [1, 0, 3]]), 4)


def folded(angles: list[float]) -> Float:
    """Two triangles that share the edge from (0, 0, 0) to (1, 0, 0), folded about it."""
    return np.array([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, -np.cos(t), np.sin(t)]] for t in angles])


@pytest.mark.parametrize(
    ("angles", "largest"),
    [([0.3], 0.0), ([0.0, 0.5, 0.2], 0.5), ([-0.4, 0.1, 0.9], 1.3), ([3.0, -3.0], 2 * np.pi - 6.0)],
)
def test_largest_change_between_any_two_frames(angles: list[float], largest: float) -> None:
    assert angle_variation(folded(angles), SQUARE) == pytest.approx([largest], abs=1e-12)


def test_a_wheel_of_angles_varies_by_half_a_turn_at_most() -> None:
    assert angle_variation(folded([0.0, 2.0, 4.0]), SQUARE) == pytest.approx([2 * np.pi - 4.0])


def test_rigid_motion_deforms_nothing() -> None:
    points, faces = tube(7, 9)
    topology = Topology(faces, len(points))
    moved = np.stack([points, points @ rotation((0.3, 2.0, -1.0)).T + [4.0, -2, 1]])
    assert angle_variation(moved, topology).max() < 1e-12
    assert length_variation(moved, topology).max() < 1e-12
    assert vertex_bending(moved, topology).max() < 1e-12
    assert vertex_strain(moved, topology).max() < 1e-12


def test_stretching_strains_all_vertices_alike() -> None:
    mesh = grid(4, 3)
    stretched = np.stack([mesh[0], 1.5 * mesh[0], 1.2 * mesh[0]])
    np.testing.assert_allclose(vertex_strain(stretched, topology_of(mesh)), 0.5)
    np.testing.assert_allclose(vertex_bending(stretched, topology_of(mesh)), 0.0, atol=1e-12)


def test_a_bar_bends_in_the_middle_only() -> None:
    mesh = tube(8, 25)
    bends = vertex_bending(bending(mesh, wobble=0.0), topology_of(mesh))
    z = mesh[0][:, 2]
    assert bends[np.abs(z - 2.0) > 0.8].max() < 1e-9  # bones blend over 0.8 about z = 2
    assert bends[np.abs(z - 2.0) < 0.3].min() > 0.02


def test_vertices_of_no_face_do_not_deform() -> None:
    topology = Topology(SQUARE.faces, 6)
    points = np.concatenate([folded([0.0, 1.0]), np.zeros((2, 2, 3))], axis=1)
    assert vertex_bending(points, topology)[4:].tolist() == [0.0, 0.0]
    assert vertex_strain(points, topology)[4:].tolist() == [0.0, 0.0]


def test_frames_are_spread_and_in_diagonals() -> None:
    points = 7.0 + 20.0 * bar(frames=30).points
    some = sample_frames(points, 4)
    assert some.shape == (4, *points.shape[1:])
    assert np.linalg.norm(np.ptp(some[0], axis=0)) == pytest.approx(1.0)
    centred = points - points.mean(axis=1, keepdims=True)
    expected = (centred[-1] - centred[0]) / np.linalg.norm(np.ptp(points[0], axis=0))
    np.testing.assert_allclose(some[-1] - some[0], expected, atol=1e-12)


def test_a_first_frame_that_is_a_point_has_no_diagonal() -> None:
    points = np.array([[[5.0, 5, 5]] * 2, [[0, 0, 0], [3, 4, 0]], [[0, 0, 0], [0, 0, 1]]])
    np.testing.assert_allclose(np.linalg.norm(np.ptp(sample_frames(points, 9), axis=1), axis=1), [0, 1, 0.2])
    assert np.ptp(sample_frames(points[:1], 9)) == 0.0


# Cutting a spanning tree, where hinges are known to bend


def folding(crease: int = 3, angle: float = 1.0) -> tuple[Float, Index]:
    """A sheet of 4 x 8 squares that folds sharply about the line x = crease, in four frames."""
    points, faces = grid(4, 8)
    beyond = points[:, 0] > crease
    frames = []
    for t in np.linspace(0, angle, 4):
        x = points.copy()
        x[beyond] = (points[beyond] - [crease, 0, 0]) @ rotation((0, t, 0)).T + [crease, 0, 0]
        frames.append(x)
    return np.stack(frames), faces


def test_the_plain_tree_is_cut_exactly_at_a_crease() -> None:
    """No smoothing: hinges bend at the crease and nowhere else."""
    points, faces = folding()
    labels = segment_by_spanning_tree(
        points, Topology(faces, points.shape[1]), settings=SpanningTreeSettings(radius=0.0)
    )
    beyond = points[0][faces].mean(axis=1)[:, 0] > 3
    np.testing.assert_array_equal(labels, np.where(beyond, 0, 1))  # the larger part is number 0


def test_small_bends_are_noise() -> None:
    points, faces = folding(angle=np.radians(0.09))
    assert segment_by_spanning_tree(points, Topology(faces, points.shape[1])).max() == 0
    points, faces = folding(angle=np.radians(9.0))
    assert segment_by_spanning_tree(points, Topology(faces, points.shape[1])).max() == 1


def test_parts_below_the_least_area_are_not_cut_off_unless_asked_for() -> None:
    points, faces = folding(crease=1)  # an eighth
    topology = Topology(faces, points.shape[1])
    large = SpanningTreeSettings(radius=0.0, small_region=0.2)
    assert segment_by_spanning_tree(points, topology, settings=large).max() == 0
    labels = segment_by_spanning_tree(points, topology, 2, large)
    assert np.bincount(labels).tolist() == [56, 8]


def test_noise_does_not_hide_the_bones() -> None:
    sequence, bones = three_bones()
    topology = Topology(sequence.faces, sequence.vertex_count)
    noise = np.random.default_rng(5).normal(0.0, 0.002, sequence.points.shape)
    labels = segment_by_spanning_tree(sequence.points + noise, topology, 3)
    assert adjusted_rand_index(labels, bones) > 0.8
