"""Lengths, signed dihedral angles, their gradients."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from mixseq.mesh import measures
from mixseq.mesh.measures import (
    Diagonal,
    bounding_box,
    corner_normals,
    degenerate_faces,
    dihedral_angles,
    edge_lengths,
    hard_edges_from_normals,
    triangle_areas,
    unwrap_angles,
    vector_areas,
    wrap_angles,
)
from mixseq.mesh.polygons import Polygons
from mixseq.sequence.sequence import bounding_diagonal
from mixseq.types import Float, Mask
from tests.meshes import rigid_motions, tetrahedron, topology_of, tube
from tests.shells.formulas import dihedral_gradients, length_gradients

HINGE = np.array([[0, 1, 2, 3]])

hinge_points = arrays.arrays(np.float64, (4, 3), elements=st.floats(-2, 2, width=32))


def folded(degrees: float, height: float = 1.0) -> Float:
    """A hinge along x, flat in the plane z = 0 at 0 degrees; its second face goes down for positive angles."""
    angle = np.radians(degrees)
    c = [0.3, height, 0.0]
    d = [0.8, -2.0 * np.cos(angle), -2.0 * np.sin(angle)]
    return np.array([[0.0, 0, 0], [1, 0, 0], c, d])


@pytest.mark.parametrize("degrees", [-179, -90, -30, 0, 0.001, 45, 90, 135, 179.9])
def test_angles_are_signed(degrees: float) -> None:
    """abc is counter-clockwise seen from z > 0, the outside: folding down is convex, positive."""
    assert np.degrees(dihedral_angles(folded(degrees), HINGE)) == pytest.approx(degrees, abs=1e-9)


@pytest.mark.parametrize("corner", [2, 3])
@pytest.mark.parametrize("end", [0, 1])
def test_hinges_at_faces_without_area_have_no_angle(corner: int, end: int) -> None:
    """Not even pi, as zero is the angle of two zeros, and pi that of zero and a negative zero."""
    for signs in np.stack(np.meshgrid(*3 * [[-1.0, 1.0]]), axis=-1).reshape(-1, 3):
        points = signs * folded(30)
        points[corner] = points[end]
        assert dihedral_angles(points, HINGE)[0] == 0


def test_no_hinges_have_no_angles() -> None:
    assert dihedral_angles(np.zeros((0, 3)), np.zeros((0, 4), np.int64)).shape == (0,)


def test_convex_solids_have_positive_angles() -> None:
    points, _ = tetrahedron()
    angles = dihedral_angles(points, topology_of(tetrahedron()).hinges)
    np.testing.assert_allclose(angles, np.pi - np.arccos(1 / 3))


def test_the_angle_does_not_depend_on_which_face_is_first() -> None:
    points = folded(37.0)
    swapped = dihedral_angles(points, np.array([[1, 0, 3, 2]]))
    assert swapped == pytest.approx(dihedral_angles(points, HINGE))
    inside_out = dihedral_angles(points, np.array([[1, 0, 2, 3]]))
    assert inside_out == pytest.approx(-dihedral_angles(points, HINGE))


@pytest.mark.parametrize("sides", [3, 4, 7, 50])
def test_a_prism_of_n_sides_turns_by_a_full_turn(sides: int) -> None:
    mesh = tube(sides, 4, length=3.0, radius=2.0, closed=False)
    topology = topology_of(mesh)
    angles = dihedral_angles(mesh[0], topology.hinges)
    ends = mesh[0][topology.hinges[:, :2]]
    along = np.abs(ends[:, 0, 2] - ends[:, 1, 2]) > 0.5
    same_side = np.linalg.norm((ends[:, 1] - ends[:, 0])[:, :2], axis=1) < 1e-9
    np.testing.assert_allclose(angles[along & same_side], 2 * np.pi / sides, atol=1e-9)
    np.testing.assert_allclose(angles[~(along & same_side)], 0, atol=1e-9)
    assert np.count_nonzero(along & same_side) == 3 * sides

    lengths = edge_lengths(mesh[0], topology.edges)
    chord = 4 * np.sin(np.pi / sides)
    expected = {round(x, 9) for x in (chord, 1.0, np.hypot(chord, 1.0))}
    assert {round(float(x), 9) for x in lengths} == expected


def test_frames_are_done_at_once() -> None:
    mesh = tube(5, 4)
    topology = topology_of(mesh)
    frames = np.stack([mesh[0], 2 * mesh[0] + 1, mesh[0][:, [1, 2, 0]]])
    lengths, angles = edge_lengths(frames, topology.edges), dihedral_angles(frames, topology.hinges)
    for frame in range(3):
        np.testing.assert_allclose(lengths[frame], edge_lengths(frames[frame], topology.edges))
        np.testing.assert_allclose(angles[frame], dihedral_angles(frames[frame], topology.hinges))
    np.testing.assert_allclose(lengths[1], 2 * lengths[0])
    np.testing.assert_allclose(angles[2], angles[0], atol=1e-12)


def test_hinges_without_a_face_have_no_angle_and_no_warning() -> None:
    collapsed = np.array([[0.0, 0, 0], [1, 0, 0], [0.5, 0, 0], [0.3, 1, 0]])
    for points in (collapsed, np.zeros((4, 3))):
        assert dihedral_angles(points, HINGE).tolist() == [0.0]
        assert np.isfinite(dihedral_gradients(points, HINGE)).all()
        assert np.isfinite(length_gradients(points, np.array([[0, 1]]))).all()


@settings(max_examples=50, deadline=None)
@given(points=hinge_points, motion=rigid_motions)
def test_rigid_motions_change_nothing(points: Float, motion: tuple[Float, Float]) -> None:
    assume(not degenerate(points))
    moved = points @ motion[0].T + motion[1]
    edges = np.array([[0, 1], [2, 3]])
    np.testing.assert_allclose(edge_lengths(moved, edges), edge_lengths(points, edges), atol=1e-9)
    difference = wrap_angles(dihedral_angles(moved, HINGE) - dihedral_angles(points, HINGE))
    np.testing.assert_allclose(difference, 0, atol=1e-6)


def degenerate(points: Float) -> bool:
    """Whether a face of the hinge is too thin for finite differences."""
    a, b, c, d = points
    doubled = [np.linalg.norm(np.cross(b - a, c - a)), np.linalg.norm(np.cross(d - a, b - a))]
    return bool(min(*doubled, np.linalg.norm(b - a)) < 0.1)


@settings(max_examples=100, deadline=None)
@given(points=hinge_points)
def test_angle_gradients_are_the_derivatives(points: Float) -> None:
    assume(not degenerate(points))
    gradient = dihedral_gradients(points, HINGE)[0]
    step = 1e-5
    for vertex in range(4):
        for axis in range(3):
            shift = np.zeros((4, 3))
            shift[vertex, axis] = step
            change = wrap_angles(dihedral_angles(points + shift, HINGE) - dihedral_angles(points - shift, HINGE))
            numeric = change[0] / (2 * step)
            assert gradient[vertex, axis] == pytest.approx(numeric, rel=1e-4, abs=1e-4)


@settings(max_examples=50, deadline=None)
@given(points=hinge_points)
def test_rigid_motions_are_no_change_of_angle(points: Float) -> None:
    """The gradient has no part along translations and rotations: it sums up to zero, and so does its torque."""
    assume(not degenerate(points))
    gradient = dihedral_gradients(points, HINGE)[0]
    size = np.abs(gradient).max()
    np.testing.assert_allclose(gradient.sum(axis=0), 0, atol=1e-9 * size)
    np.testing.assert_allclose(np.cross(points, gradient).sum(axis=0), 0, atol=1e-8 * size)


@settings(max_examples=50, deadline=None)
@given(points=hinge_points)
def test_length_gradients_are_the_derivatives(points: Float) -> None:
    edges = np.array([[0, 1], [3, 2]])
    assume(edge_lengths(points, edges).min() > 0.1)
    gradients = length_gradients(points, edges)
    step = 1e-6
    for row, (_, end) in enumerate(edges):
        for axis in range(3):
            shift = np.zeros((4, 3))
            shift[end, axis] = step
            ahead, behind = edge_lengths(points + shift, edges)[row], edge_lengths(points - shift, edges)[row]
            assert gradients[row, axis] == pytest.approx((ahead - behind) / (2 * step), abs=1e-6)


@settings(max_examples=100, deadline=None)
@given(angle=st.floats(-50, 50), turns=st.integers(-5, 5))
def test_wrap(angle: float, turns: int) -> None:
    (wrapped,) = wrap_angles(np.array([angle]))
    assert -np.pi < wrapped <= np.pi
    assert np.exp(1j * wrapped) == pytest.approx(np.exp(1j * angle))
    assert np.exp(1j * wrap_angles(np.array([angle + turns * 2 * np.pi]))[0]) == pytest.approx(np.exp(1j * angle))


def test_wrap_at_half_a_turn() -> None:
    np.testing.assert_allclose(wrap_angles(np.array([np.pi, -np.pi, 3 * np.pi, 0.0])), [np.pi, np.pi, np.pi, 0.0])


@settings(max_examples=50, deadline=None)
@given(steps=arrays.arrays(np.float64, (20, 3), elements=st.floats(-3.1, 3.1)))
def test_unwrapping_undoes_wrapping(steps: Float) -> None:
    """Angles that move by less than half a turn per frame are recovered from their wrapped values."""
    angles = np.cumsum(steps, axis=0)
    unwrapped = unwrap_angles(wrap_angles(angles))
    np.testing.assert_allclose(unwrapped - unwrapped[0], angles - angles[0], atol=1e-9)
    np.testing.assert_allclose(unwrapped[0], wrap_angles(angles[0]), atol=1e-12)
    np.testing.assert_allclose(unwrap_angles(wrap_angles(angles), reference=angles[0]), angles, atol=1e-9)


def test_unwrapping_leaves_its_input_alone() -> None:
    angles = np.array([[3.0], [-3.0]])
    unwrap_angles(angles, np.array([9.0]))
    assert angles.tolist() == [[3.0], [-3.0]]
    assert unwrap_angles(np.zeros((0, 2)), np.zeros(2)).shape == (0, 2)


# Diagonals, and lengths in them, at any scale

BOX = np.array([[0.0, 0, 0], [2, 0, 0], [0, 3, 6]])


@pytest.mark.parametrize("exponent", [-1060, -600, -100, 0, 100, 600, 1021])
def test_diagonals_of_any_size(exponent: int) -> None:
    points = np.ldexp(BOX, exponent)
    unit = Diagonal.from_points(points)
    assert unit == Diagonal(7 / 8, exponent + 3)
    assert unit.length == np.ldexp(7.0, exponent)
    np.testing.assert_array_equal(unit.rescale(points), BOX / 8)


def test_digits_are_those_of_the_plain_formula() -> None:
    for points in np.random.default_rng(1).normal(size=(50, 10, 3)):
        extent = points.max(axis=0) - points.min(axis=0)
        assert bounding_diagonal(points) == np.linalg.norm(extent)
        assert bounding_diagonal(points.astype(np.float32)) > 0


@pytest.mark.parametrize("count", [1, 63, 64, 65, 200])
def test_boxes_of_any_number_of_points(count: int) -> None:
    points = np.random.default_rng(count).normal(size=(count, 3))
    for each in (points, points.astype(np.float32), points[::-1]):
        np.testing.assert_array_equal(bounding_box(each), [each.min(axis=0), each.max(axis=0)])


def test_places_do_not_matter() -> None:
    assert Diagonal.from_points(BOX + 2.0**40) == Diagonal.from_points(BOX)


def test_one_point_has_none() -> None:
    for place in (0.0, 1e300, np.finfo(np.float64).max):
        assert Diagonal.from_points(np.full((3, 3), place)) == Diagonal(0.0, 0)


def test_what_does_not_fit_into_a_double() -> None:
    most = np.finfo(np.float64).max
    unit = Diagonal.from_points(np.array([[-most, 0, 0], [most, 0, 0]]))
    assert (round(unit.fraction, 12), unit.exponent) == (1.0, 1025)
    assert unit.length == np.inf
    assert Diagonal.from_points(BOX * 1e-300).rescale(np.array([1e300])) == np.inf


# Normals of a cube in closed form, with its edges hard and soft

CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)
SIDES = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
CUBE = Polygons(np.full(6, 4), SIDES.reshape(-1))
OUTWARDS = np.array([[-1, 0, 0], [1, 0, 0], [0, -1, 0], [0, 1, 0], [0, 0, -1], [0, 0, 1]])


def test_vector_areas_of_a_cube() -> None:
    np.testing.assert_allclose(vector_areas(CORNERS[None], CUBE)[0], 4.0 * OUTWARDS)


def test_areas_do_not_cancel_far_away() -> None:
    far = CORNERS[None] + 1e7
    np.testing.assert_array_equal(vector_areas(far, CUBE)[0], 4.0 * OUTWARDS)


def test_soft_corners_point_along_the_diagonals() -> None:
    np.testing.assert_allclose(corner_normals(CORNERS[None], CUBE)[0], CORNERS / np.sqrt(3), atol=1e-7)


def test_hard_edges_keep_the_normals_of_their_sides() -> None:
    hard = np.repeat(np.arange(6), 4)
    np.testing.assert_allclose(corner_normals(CORNERS[None], CUBE, hard)[0], OUTWARDS, atol=1e-7)


def test_normals_turn_with_the_mesh() -> None:
    turned = CORNERS[:, [1, 2, 0]]
    both = corner_normals(np.stack([CORNERS, turned]), CUBE)
    np.testing.assert_allclose(both[1], both[0][:, [1, 2, 0]], atol=1e-7)


def test_no_area_no_direction() -> None:
    flat = np.zeros((1, 8, 3))
    np.testing.assert_array_equal(corner_normals(flat, CUBE)[0], np.tile([0.0, 0.0, 1.0], (8, 1)))


def test_hard_edges_are_found_and_kept() -> None:
    authored = np.repeat(OUTWARDS, 4, axis=0).astype(np.float32)
    groups = hard_edges_from_normals(CUBE, authored)
    assert groups is not None
    assert len(np.unique(groups)) == 24
    again = corner_normals(CORNERS[None], CUBE, groups)[0][groups]
    np.testing.assert_allclose(again, authored, atol=1e-6)


def test_one_normal_per_vertex_is_no_hard_edge() -> None:
    smooth = (CORNERS / np.sqrt(3))[CUBE.indices]
    assert hard_edges_from_normals(CUBE, smooth + 1e-5) is None


def test_triangles_have_the_normals_of_polygons() -> None:
    random = np.random.default_rng(0)
    points, triangles = random.standard_normal((2, 12, 3)), random.integers(0, 12, (40, 3))
    with_a_square = Polygons(np.append(np.full(40, 3), 4), np.append(triangles, [0, 0, 0, 0]))  # without an area
    expected = corner_normals(points, with_a_square)
    np.testing.assert_array_equal(corner_normals(points, Polygons.from_triangles(triangles)), expected)


def test_blocks_change_no_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Large meshes are measured in blocks: of one frame or several, and also where there are no elements."""
    points, faces = tube(6, 9, length=3.0)
    points = points + 0.1 * np.sin(7.0 * points[:, [1, 2, 0]])
    topology, frames = topology_of((points, faces)), np.stack([points, 1.5 * points])

    def measured() -> list[Float | Mask]:
        none = np.zeros((0, 4), dtype=np.int64)
        return [
            edge_lengths(frames, topology.edges),
            dihedral_angles(frames, topology.hinges),
            degenerate_faces(frames, topology.faces, 0.5),
            triangle_areas(points, topology.faces),
            dihedral_angles(frames, none),
        ]

    whole = measured()
    monkeypatch.setattr(measures, "ELEMENTS_PER_BLOCK", 8)
    for before, after in zip(whole, measured(), strict=True):
        np.testing.assert_array_equal(after, before)
        assert after.dtype == before.dtype


def test_many_hinges_take_less_memory_than_their_corners() -> None:
    hinges = np.tile(HINGE, (300_000, 1))
    tracemalloc.start()
    angles = dihedral_angles(folded(30.0), hinges)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    np.testing.assert_allclose(angles, np.radians(30.0))
    assert peak < 12 * angles.nbytes
