"""Lengths, signed dihedral angles, their gradients."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from mixseq.mesh.measures import (
    dihedral_angles,
    edge_lengths,
    unwrap_angles,
    wrap,
)
from mixseq.types import Float
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
    difference = wrap(dihedral_angles(moved, HINGE) - dihedral_angles(points, HINGE))
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
            change = wrap(dihedral_angles(points + shift, HINGE) - dihedral_angles(points - shift, HINGE))
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
    (wrapped,) = wrap(np.array([angle]))
    assert -np.pi < wrapped <= np.pi
    assert np.exp(1j * wrapped) == pytest.approx(np.exp(1j * angle))
    assert np.exp(1j * wrap(np.array([angle + turns * 2 * np.pi]))[0]) == pytest.approx(np.exp(1j * angle))


def test_wrap_at_half_a_turn() -> None:
    np.testing.assert_allclose(wrap(np.array([np.pi, -np.pi, 3 * np.pi, 0.0])), [np.pi, np.pi, np.pi, 0.0])


@settings(max_examples=50, deadline=None)
@given(steps=arrays.arrays(np.float64, (20, 3), elements=st.floats(-3.1, 3.1)))
def test_unwrapping_undoes_wrapping(steps: Float) -> None:
    """Angles that move by less than half a turn per frame are recovered from their wrapped values."""
    angles = np.cumsum(steps, axis=0)
    unwrapped = unwrap_angles(wrap(angles))
    np.testing.assert_allclose(unwrapped - unwrapped[0], angles - angles[0], atol=1e-9)
    np.testing.assert_allclose(unwrapped[0], wrap(angles[0]), atol=1e-12)
    np.testing.assert_allclose(unwrap_angles(wrap(angles), reference=angles[0]), angles, atol=1e-9)


def test_unwrapping_leaves_its_input_alone() -> None:
    angles = np.array([[3.0], [-3.0]])
    unwrap_angles(angles, np.array([9.0]))
    assert angles.tolist() == [[3.0], [-3.0]]
    assert unwrap_angles(np.zeros((0, 2)), np.zeros(2)).shape == (0, 2)
