"""Deformation gradients: exact for every frame, rotations and stretches in between."""

from __future__ import annotations

import pickle
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mixseq
from mixseq.errors import ReconstructionError, SettingsError
from mixseq.mesh.topology import Topology
from mixseq.mesh.triangle_mesh import DEGENERATE_HEIGHT_RATIO
from mixseq.spaces.gradient import SYMMETRIC_ENTRY_IDS, GradientSpace
from mixseq.types import Float, FloatArray, IntArray
from tests.meshes import SEQUENCES, Mesh, bar, grid, rotation, tetrahedron, torus, tube


def space_of(points: FloatArray, faces: IntArray) -> GradientSpace:
    """The space of a sequence ``(T, V, 3)``, or of what there is of it."""
    scale = float(np.linalg.norm(np.ptp(points[0], axis=0))) or 1.0
    return GradientSpace(Topology(faces, points.shape[1]), scale, points[0].astype(np.float64) / scale)


def error(space: GradientSpace, points: FloatArray, decoded: Float) -> float:
    return float(np.abs(decoded - points).max() / space.scale)


def box() -> Mesh:
    """The box from -1 to 1."""
    points = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3, indexing="ij"), axis=3).reshape(-1, 3)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return points, np.array([face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))])


@cache
def on_a_torus() -> GradientSpace:
    mesh = torus(8, 6)
    return space_of(mesh[0][None], mesh[1])


# Frames come back -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SEQUENCES)
def test_frames_come_back(name: str) -> None:
    sequence = SEQUENCES[name]()
    space = space_of(sequence.points, sequence.faces)
    assert error(space, sequence.points, space.decode(space.encode(sequence.points))) < 1e-11


@pytest.mark.parametrize("name", ["bar", "several components", "repeated corners", "bowtie"])
def test_encoding_block_by_block_is_encoding(name: str) -> None:
    sequence = SEQUENCES[name]()
    space = space_of(sequence.points, sequence.faces)
    whole = space.encode(sequence.points)
    second = space.encode(sequence.points[2:], previous=whole[1])
    np.testing.assert_array_equal(np.concatenate([space.encode(sequence.points[:2]), second]), whole)


entries = st.floats(-2.0, 2.0, allow_nan=False)
affine_maps = st.tuples(
    st.lists(entries, min_size=9, max_size=9).map(lambda a: np.reshape(a, (3, 3))),
    st.lists(entries, min_size=3, max_size=3).map(np.array),
)


@settings(max_examples=50, deadline=None)
@given(affine=affine_maps)
def test_affine_maps_come_back(affine: tuple[Float, Float]) -> None:
    """Also those that flatten the mesh, or turn it inside out."""
    space, (matrix, shift) = on_a_torus(), affine
    points = torus(8, 6)[0] @ matrix.T + shift
    vectors = space.encode(points[None])
    np.testing.assert_allclose(space.decode(vectors)[0], points, atol=1e-12)
    stretches = space.split(vectors).stretches[0][:, SYMMETRIC_ENTRY_IDS]
    # A face thinner than FLAT counts as one without area: its fourth vertex may be on either side.
    assert np.linalg.eigvalsh(stretches).min() > -100 * DEGENERATE_HEIGHT_RATIO


@pytest.mark.parametrize("flat", ["reference", "frame", "both"])
@pytest.mark.parametrize(
    "squeeze", [(1.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 0.0), (1.0, 1e-5, 1e-5), (1, 1e-9, 1)]
)
def test_meshes_without_area_come_back(squeeze: tuple[float, float, float], flat: str) -> None:
    """A sheet, a line, a point, and what is nearly that, as what gradients are from, or are of."""
    points, faces = tube(6, 5)
    turned = points @ rotation((0.3, 0.8, -0.4)).T
    thin = points * squeeze
    frames = {"reference": (thin, turned), "frame": (turned, thin), "both": (thin, thin[::-1])}[flat]
    space = space_of(np.stack(frames), faces)
    vectors = space.encode(np.stack(frames))
    assert np.isfinite(vectors).all()
    assert np.abs(space.decode(vectors) - np.stack(frames)).max() < 1e-9
    assert (space.weights > 0).all()


def test_the_fourth_vertex_of_a_flat_face_follows_its_neighbours() -> None:
    """A face that flattens does not turn: the sheet around it tells how it lies."""
    points, faces = grid(2, 2)
    squeezed = points.copy()
    squeezed[4] = squeezed[0]  # the middle onto a corner: two faces are lines
    squeezed[8] = [2, 2, 0]
    space = space_of(np.stack([points, squeezed]), faces)
    turns = space.split(space.encode(np.stack([points, squeezed]))).rotation_vectors[1]
    assert (np.abs(turns[:, :2]) < 1e-12).all()  # about z only


# What is between them -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("mesh", [tetrahedron(), torus(7, 5), tube(5, 4)], ids=["tetrahedron", "torus", "tube"])
def test_half_way_to_three_times_the_size_is_twice_the_size(mesh: Mesh) -> None:
    points = np.stack([mesh[0], 3 * mesh[0] + [1.0, 0, 0]])
    space = space_of(points, mesh[1])
    half = space.decode(space.encode(points).mean(axis=0, keepdims=True))[0]
    np.testing.assert_allclose(half, 2 * mesh[0] + [0.5, 0, 0], atol=1e-13)


@pytest.mark.parametrize("mesh", [box(), grid(3, 4)], ids=["box", "sheet"])
def test_stretches_along_the_axes_of_faces_blend_linearly(mesh: Mesh) -> None:
    stretch = np.array([2.0, 0.5, 3.0])
    points = np.stack([mesh[0], mesh[0] * stretch])
    space = space_of(points, mesh[1])
    vectors = space.encode(points)
    np.testing.assert_allclose(space.split(vectors).rotation_vectors, 0, atol=1e-12)
    for w in (0.3, 0.5, 1.2):
        between = space.decode((1 - w) * vectors[:1] + w * vectors[1:])[0]
        np.testing.assert_allclose(between, mesh[0] * (1 - w + w * stretch), atol=1e-13)


def test_half_way_through_a_turn_is_half_the_turn() -> None:
    mesh = torus(7, 5)
    axis, angle = np.array([1.0, 2, 2]) / 3, 2.8
    points = np.stack([mesh[0], mesh[0] @ rotation(axis * angle).T + [1, 2, 3]])
    space = space_of(points, mesh[1])
    half = space.decode(space.encode(points).mean(axis=0, keepdims=True))[0]
    np.testing.assert_allclose(half, mesh[0] @ rotation(axis * angle / 2).T + [0.5, 1, 1.5], atol=1e-12)


def test_a_linear_blend_of_matrices_would_be_one_of_vertices() -> None:
    """Why rotations and stretches are stored."""
    sequence = bar()
    space = space_of(sequence.points, sequence.faces)
    first, last = sequence.points[0] / space.scale, sequence.points[-1] / space.scale
    gradients = (space.complete_triangles(first) + space.complete_triangles(last)) @ space.inverse_triangles / 2
    rows = space.poisson_system.solve(np.swapaxes(gradients @ space.reference_sides, 1, 2).reshape(-1, 3))
    averaged = (first + last) / 2
    np.testing.assert_allclose(rows - rows.mean(axis=0), averaged - averaged.mean(axis=0), atol=1e-13)
    half = space.decode(space.encode(sequence.points)[[0, -1]].mean(axis=0, keepdims=True))[0]
    lengths = [np.linalg.norm(np.diff(x[[0, 8 * 24]], axis=0)) for x in (first, half / space.scale, averaged)]
    assert lengths[1] > lengths[2]


def test_without_rotations_decoding_is_linear() -> None:
    space = on_a_torus()
    rng = np.random.default_rng(3)
    vectors = rng.normal(size=(2, space.dim))
    vectors[:, : 3 * len(space.face_rows)] = 0
    one, other = space.decode(vectors)
    np.testing.assert_allclose(space.decode([0.3, 0.7] @ vectors[None])[0], 0.3 * one + 0.7 * other, atol=1e-11)


def test_the_integral_weighs_by_area() -> None:
    """The residual of P_f has no divergence: its sums around vertices, weighted by area, are zero."""
    space = on_a_torus()
    stretches = np.random.default_rng(1).normal(size=(len(space.face_rows), 3, 3))
    wanted = np.swapaxes(stretches @ space.reference_sides, 1, 2).reshape(-1, 3)
    rows = space.poisson_system.solve(wanted)
    corners = rows[space.face_rows]
    pinv = np.linalg.pinv(space.reference_triangles[:, :, :2])  # the gradient in the plane of the reference
    got = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=2) @ pinv
    inside = stretches @ space.reference_triangles[:, :, :2] @ pinv
    areas = np.linalg.norm(np.cross(space.reference_sides[:, :, 0], space.reference_sides[:, :, 1]), axis=1) / 2
    residual = areas[:, None, None] * (got - inside) @ np.swapaxes(pinv, 1, 2)
    sums = np.zeros_like(rows)
    for corner, part in ((1, residual[:, :, 0]), (2, residual[:, :, 1]), (0, -residual.sum(axis=2))):
        np.add.at(sums, space.face_rows[:, corner], part)
    np.testing.assert_allclose(sums, 0, atol=1e-12)


def test_reflections_are_rotations_of_the_surface() -> None:
    mesh = torus(7, 5)
    points = np.stack([mesh[0], mesh[0] * [1, 1, -1.0]])
    space = space_of(points, mesh[1])
    blocks = space.split(space.encode(points))
    assert (np.linalg.det(blocks.stretches[1][:, SYMMETRIC_ENTRY_IDS]) > 0.5).all()
    np.testing.assert_allclose(space.decode(space.encode(points)), points, atol=1e-13)


def test_a_body_that_turns_twice_goes_on() -> None:
    mesh = tube(5, 4)
    angles = np.linspace(0, 4 * np.pi, 13)
    points = np.stack([mesh[0] @ rotation((0, angle, 0)).T for angle in angles])
    space = space_of(points, mesh[1])
    vectors = space.encode(points)
    turns = space.split(vectors).rotation_vectors
    np.testing.assert_allclose(turns[:, :, 1], np.tile(angles[:, None], (1, len(mesh[1]))), atol=1e-9)
    np.testing.assert_allclose(space.encode(points[6:], vectors[5]), vectors[6:], atol=1e-12)
    assert np.abs(space.split(space.encode_independently(points)).rotation_vectors).max() < np.pi + 1e-9


# The vector ---------------------------------------------------------------------------------------------------


def test_a_change_by_hand_arrives_after_more_than_half_a_turn() -> None:
    x, faces = torus(8, 6)
    points = np.stack([x @ rotation((0.0, 0.0, angle)).T for angle in np.linspace(0.0, 1.75 * np.pi, 9)])
    space = space_of(points, faces)
    vector = space.encode(points)[-1]
    before = space.decode(vector[None])[0]
    after = before.copy()
    after[5] += [0.1, 0.2, 0.0]
    vector[: space.dim - space.placement_dim] += space.shape_difference(vector, before, after)
    changed = space.decode(vector[None])[0]
    np.testing.assert_allclose(changed - changed.mean(axis=0), after - after.mean(axis=0), atol=1e-9)


def test_blocks_and_their_metric() -> None:
    points, faces = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 5, 5]]), np.array([[0, 1, 2]])
    space = GradientSpace(Topology(faces, 4), 2.0, points)
    assert space.dim == 9 + 6
    assert space.shape_dim == 9
    assert (space.rotation_count, space.centre_count, space.placement_dim) == (0, 2, 6)
    blocks = space.split(space.encode(2 * points[None] * [1, 3, 1]))
    np.testing.assert_allclose(blocks.rotation_vectors, [[[0, 0, 0]]], atol=1e-14)
    np.testing.assert_allclose(blocks.stretches[0, 0], np.array([1, 3, np.sqrt(3), 0, 0, 0]), atol=1e-14)
    np.testing.assert_allclose(blocks.centres[0], np.array([[1 / 3, 1.0, 0.0], [5.0, 15.0, 5.0]]))
    size = np.sqrt(4 / 3)
    expected = np.repeat([size, size * np.sqrt(2), 1.0], [6, 3, 6])
    np.testing.assert_allclose(space.weights, expected)
    vectors = np.random.default_rng(0).normal(size=(3, space.dim))
    np.testing.assert_array_equal(space.join(space.split(vectors)), vectors)


def test_a_pickled_space_is_the_same() -> None:
    space = on_a_torus()
    vectors = np.random.default_rng(0).normal(size=(1, space.dim))
    decoded = space.decode(vectors)
    copy = pickle.loads(pickle.dumps(space))
    np.testing.assert_array_equal(copy.decode(vectors), decoded)


def test_vectors_that_are_not_finite_are_refused() -> None:
    space = on_a_torus()
    vectors = np.zeros((3, space.dim))
    vectors[1, 7] = np.nan
    with pytest.raises(ReconstructionError, match="vector 1 is not finite"):
        space.decode(vectors)


def test_vectors_of_other_spaces_are_refused() -> None:
    space = on_a_torus()
    with pytest.raises(SettingsError, match=rf"vectors have shape \(1, 5\); \(T, {space.dim}\) is expected"):
        space.decode(np.zeros((1, 5)))


@pytest.mark.realdata
@pytest.mark.parametrize("name", ["lion_poses", "cat_poses", "horse_poses", "horse_gallop", "fox_run"])
def test_real_frames_come_back(data: Path, name: str) -> None:
    sequence = mixseq.read(data / "npz" / f"{name}.npz")
    space = space_of(sequence.points, sequence.faces)
    some = sequence.points[:: max(1, sequence.frame_count // 2)]
    assert error(space, some, space.decode(space.encode(some))) < 1e-9
