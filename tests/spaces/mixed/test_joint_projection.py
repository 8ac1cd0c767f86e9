"""P_m at joints: nothing where lengths and angles are right, towards them where they are not, and smooth."""

from __future__ import annotations

import pickle
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixseq.mesh.measures import dihedral_angles, edge_lengths, wrap_angles
from mixseq.mesh.rotations import matrix_to_quat, normalise_quat, quat_multiply
from mixseq.shells.solvers import factorise_laplacian
from mixseq.spaces.mixed import posing_kernels as kernels
from mixseq.spaces.mixed.joint_projection import JointProjection, from_complex_step, solve_columns, to_complex_step
from mixseq.types import Float, Int32, Mask
from tests.meshes import Mesh, grid, joined, rigid_motions, rotation, seeds, topology_of, torus, tube
from tests.spaces.mixed.made import MESHES

SHEET = grid(24, 3)
"""A sheet along y."""


def joints_of(mesh: Mesh, marked: Mask | None = None, hold: float = 0.003) -> JointProjection:
    marked = np.ones(len(mesh[1]), dtype=bool) if marked is None else marked
    return JointProjection(topology_of(mesh), mesh[0] / 10.0, marked, hold)


def between(mesh: Mesh, low: float, high: float, axis: int = 1) -> Mask:
    """Faces whose middles are between two places along an axis."""
    middles = mesh[0][mesh[1]].mean(axis=1)[:, axis]
    return np.asarray((middles > low) & (middles < high))


def rolled(points: Float, angle: float) -> Float:
    """A sheet, rolled up about x by an angle altogether between y = 8 and y = 16, by arcs of a circle."""
    x, y, z = points.T
    along = np.clip(y - 8.0, 0.0, 8.0)
    bend, radius = angle * along / 8.0, 8.0 / angle
    beyond = y - np.clip(y, 8.0, 16.0)
    before, after = np.minimum(beyond, 0.0), np.maximum(beyond, 0.0)
    place = 8.0 + before + (radius - z) * np.sin(bend) + after * np.cos(bend)
    height = radius - (radius - z) * np.cos(bend) + after * np.sin(bend)
    return np.stack([x, place, height], axis=1)


def stretched(points: Float, factor: float) -> Float:
    """A sheet whose middle is longer."""
    x, y, z = points.T
    return np.stack([x, y + (factor - 1.0) * np.clip(y - 8.0, 0.0, 8.0), z], axis=1)


def told(joints: JointProjection, x: Float) -> tuple[Float, Float]:
    """Lengths and angles that joints have in a mesh."""
    topology = joints.topology
    return edge_lengths(x, topology.edges[joints.edge_ids]), dihedral_angles(x, topology.hinges[joints.hinge_ids])


def errors(joints: JointProjection, x: Float, target: Float) -> tuple[float, float]:
    """Root mean square errors of lengths, relative, and of angles in radians, in joints."""
    (lengths, angles), (wanted, expected) = told(joints, x), told(joints, target)
    return (
        float(np.sqrt(np.square(lengths / wanted - 1.0).mean())),
        float(np.sqrt(np.square(wrap_angles(angles - expected)).mean())),
    )


@pytest.mark.parametrize("mesh", MESHES)
def test_no_share_leaves_the_posed_mesh(mesh: Mesh) -> None:
    joints, x = joints_of(mesh), mesh[0] / 10.0
    lengths, angles = told(joints, 1.3 * x)
    assert joints.project(x, lengths, angles + 0.2, 0.0) is x


@settings(max_examples=20, deadline=None)
@given(
    seed=seeds,
    mesh=st.sampled_from(MESHES),
    share=st.sampled_from([0.25, 1.0]),
    noise=st.sampled_from([0.0, 0.02, 0.5]),
    marked=st.sampled_from([0.1, 0.5, 1.0]),
)
def test_a_mesh_with_these_lengths_and_angles_stays(
    seed: int, mesh: Mesh, share: float, noise: float, marked: float
) -> None:
    rng = np.random.default_rng(seed)
    joints = joints_of(mesh, rng.random(len(mesh[1])) < marked, rng.choice([0.003, 0.1]))
    x = mesh[0] / 10.0 + noise * rng.normal(size=mesh[0].shape)
    np.testing.assert_allclose(joints.project(x, *told(joints, x), share), x, atol=1e-12)


@pytest.mark.parametrize("place", ["middle", "corner"])
def test_meshes_stay_where_triangles_have_lost_their_area(place: str) -> None:
    """Angles there are noise: told of the same mesh, moved by rounding errors, they are others."""
    mesh = tube(6, 17)
    x = mesh[0] / 10.0
    for face in (30, 57, 90):
        a, b, c = mesh[1][face]
        x[c] = x[a] if place == "corner" else (x[a] + x[b]) / 2
    joints = joints_of(mesh)
    lengths, angles = told(joints, x + 1e-16 * np.random.default_rng(0).normal(size=x.shape))
    np.testing.assert_allclose(joints.project(x, lengths, angles, 1.0), x, atol=1e-12)
    targets = joints.mesh_targets(x, lengths, angles)
    np.testing.assert_allclose(joints.shell.relax(x, *targets, 10).points, x, atol=1e-12)


@pytest.mark.parametrize(
    "change",
    [lambda x: rolled(x, 0.8), lambda x: stretched(x, 1.15), lambda x: stretched(rolled(x, 0.5), 0.9)],
    ids=["bent", "stretched", "both"],
)
def test_lengths_and_angles_go_where_they_are_told_to_go(change: Callable[[Float], Float]) -> None:
    """By shares of the way; one end of the sheet is held, the other follows."""
    marked = between(SHEET, 8, 24)
    joints, x, target = joints_of(SHEET, marked), SHEET[0] / 10.0, change(SHEET[0]) / 10.0
    found = [errors(joints, joints.project(x, *told(joints, target), share), target) for share in (0.5, 1.0)]
    before = errors(joints, x, target)
    for half, whole, start in zip(*found, before, strict=True):
        if start > 1e-2:
            assert whole < 0.65 * start
            assert whole < half < start


def test_joints_that_end_in_the_mesh_bend_to_any_shape() -> None:
    """Nothing holds the end of the sheet: it goes all the way."""
    joints, target = joints_of(SHEET, hold=1e-9), rolled(SHEET[0], 1.2) / 10.0
    found = joints.project(SHEET[0] / 10.0, *told(joints, target), 1.0)
    assert max(errors(joints, found, target)) < 0.02


def test_all_lengths_longer_make_a_mesh_larger() -> None:
    mesh = torus(14, 7)
    joints, x = joints_of(mesh, hold=1e-9), mesh[0] / 10.0
    found = joints.project(x, *told(joints, 1.1 * x), 1.0)
    np.testing.assert_allclose(found - found.mean(axis=0), 1.1 * (x - x.mean(axis=0)), atol=1e-6)


def test_only_joints_and_a_ring_around_them_move() -> None:
    marked = between(SHEET, 8, 16)
    joints, x = joints_of(SHEET, marked), SHEET[0] / 10.0
    lengths, angles = told(joints, rolled(stretched(SHEET[0], 1.2), 0.7) / 10.0)
    still = np.flatnonzero((x != joints.project(x, lengths, angles, 1.0)).any(axis=1))
    np.testing.assert_array_equal(still, joints.moving_vertex_ids)
    y = SHEET[0][joints.moving_vertex_ids, 1]
    assert y.min() == 8.0 and y.max() == 16.0


def test_edges_and_hinges_of_joint_faces_have_targets() -> None:
    marked = between(SHEET, 8, 10)
    joints, topology = joints_of(SHEET, marked), topology_of(SHEET)
    np.testing.assert_array_equal(joints.edge_ids, np.unique(topology.face_edges[marked]))
    np.testing.assert_array_equal(joints.hinge_ids, np.flatnonzero(marked[topology.hinge_faces].any(axis=1)))


def test_the_whole_mesh_has_targets() -> None:
    """Those of joints, and elsewhere what the posed mesh has."""
    marked = between(SHEET, 8, 10)
    joints, x = joints_of(SHEET, marked), rolled(SHEET[0], 0.9) / 10.0
    lengths, angles = told(joints, 1.2 * x)
    angles = angles + 0.1
    all_lengths, all_angles = joints.mesh_targets(x, lengths, angles)
    expected = edge_lengths(x, joints.topology.edges), dihedral_angles(x, joints.topology.hinges)
    expected[0][joints.edge_ids], expected[1][joints.hinge_ids] = lengths, angles
    np.testing.assert_allclose(all_lengths, expected[0], atol=1e-13)
    np.testing.assert_allclose(wrap_angles(all_angles - expected[1]), 0.0, atol=1e-9)
    assert (joints.mesh_targets(x, -lengths, angles)[0][joints.edge_ids] == 0).all()


@settings(max_examples=15, deadline=None)
@given(motion=rigid_motions)
def test_where_the_mesh_is_does_not_matter(motion: tuple[Float, Float]) -> None:
    turn, shift = motion
    joints, x = joints_of(SHEET, between(SHEET, 8, 16)), rolled(SHEET[0], 0.3) / 10.0
    targets = told(joints, rolled(SHEET[0], 0.9) / 10.0)
    here, there = (joints.project(posed, *targets, 0.7) for posed in (x, x @ turn.T + shift))
    np.testing.assert_allclose(there, here @ turn.T + shift, atol=1e-10)


def test_angles_count_up_to_whole_turns() -> None:
    joints, x = joints_of(SHEET), SHEET[0] / 10.0
    lengths, angles = told(joints, rolled(SHEET[0], 0.9) / 10.0)
    turns = 2.0 * np.pi * np.random.default_rng(0).integers(-2, 3, len(angles))
    here, there = (joints.project(x, lengths, each, 1.0) for each in (angles, angles + turns))
    np.testing.assert_allclose(there, here, atol=1e-12)


@pytest.mark.parametrize("angle", [np.pi, -np.pi, 3.0])
@pytest.mark.parametrize("lengths", [0.0, -1.0, 5.0])
def test_targets_of_no_mesh_are_no_trouble(angle: float, lengths: float) -> None:
    """Hinges half a turn off, lengths that are none, and triangles that there are not."""
    for mesh in (SHEET, joined(tube(5, 7), torus(8, 5))):
        joints, x = joints_of(mesh), mesh[0] / 10.0
        wanted, angles = told(joints, x)
        wanted[::3] *= lengths
        for share in (0.3, 1.0):
            assert np.isfinite(joints.project(x, wanted, angles + angle, share)).all()


def test_without_joints_nothing_moves() -> None:
    joints = joints_of(SHEET, np.zeros(len(SHEET[1]), dtype=bool))
    x = SHEET[0] / 10.0
    assert joints.frame_factor is None and joints.vertex_factor is None
    assert joints.project(x, np.zeros(0), np.zeros(0), 1.0) is x


@settings(max_examples=12, deadline=None)
@given(seed=seeds, mesh=st.sampled_from(MESHES), share=st.sampled_from([0.25, 1.0]))
def test_complex_steps_are_difference_quotients(seed: int, mesh: Mesh, share: float) -> None:
    rng = np.random.default_rng(seed)
    joints = joints_of(mesh, rng.random(len(mesh[1])) < 0.7)
    x = mesh[0] / 10.0 + 0.002 * rng.normal(size=mesh[0].shape)
    lengths, angles = told(joints, mesh[0] / 10.0 + 0.002 * rng.normal(size=mesh[0].shape))
    speeds, growth, bends = (rng.normal(size=each.shape) for each in (x, lengths, angles))

    def at(time: float) -> Float:
        return np.asarray(joints.project(x + time * speeds, lengths + time * growth, angles + time * bends, share))

    numbers = to_complex_step(x, speeds), to_complex_step(lengths, growth), to_complex_step(angles, bends)
    values, found = from_complex_step(joints.project(*numbers, share))
    np.testing.assert_allclose(values, at(0.0), atol=1e-12)
    step = 1e-7
    quotient = (8 * (at(step) - at(-step)) - (at(2 * step) - at(-2 * step))) / (12 * step)
    assert np.abs(found - quotient).max() < 1e-6 * np.abs(quotient).max()


def test_joints_can_be_sent() -> None:
    joints, x = joints_of(SHEET), SHEET[0] / 10.0
    targets = told(joints, rolled(SHEET[0], 0.9) / 10.0)
    expected = joints.project(x, *targets, 1.0)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(joints)).project(x, *targets, 1.0), expected)


# Blended motions: rigid where a vertex follows one part, half a screw between two, and back

AXIS = np.array([2.0, -1.0, 2.0]) / 3
POINTS = np.random.default_rng(3).normal(size=(40, 3))


def dual(turn: Float, shift: Float) -> Float:
    """The motion that turns about the origin, then shifts, as a unit dual quaternion."""
    real = matrix_to_quat(turn)
    return np.concatenate([real, 0.5 * quat_multiply(np.array([0.0, *shift]), real)])


def rows(weights: Float) -> tuple[Int32, Int32, Float]:
    """Weights ``(V, p)`` as rows of a sparse matrix; zeros are none."""
    vertices, parts = np.nonzero(weights)
    starts = np.concatenate([[0], np.cumsum(np.bincount(vertices, minlength=len(weights)))])
    return starts.astype(np.int32), parts.astype(np.int32), weights[vertices, parts]


def wild(seed: int, parts: int = 4) -> tuple[tuple[Int32, Int32, Float], Float]:
    """Weights of some of the parts, and motions by less than half a turn from each other."""
    rng = np.random.default_rng(seed)
    weights = rng.dirichlet(np.ones(parts), len(POINTS)) * (rng.random((len(POINTS), parts)) < 0.6)
    weights[np.arange(len(POINTS)), rng.integers(0, parts, len(POINTS))] += 0.2
    weights /= weights.sum(axis=1, keepdims=True)
    first, shifts = rng.normal(size=3), rng.normal(size=(parts, 3))
    turns = [rotation(first) @ rotation(0.5 * rng.normal(size=3)) for _ in range(parts)]
    duals = np.stack([dual(turn, shift) for turn, shift in zip(turns, shifts, strict=True)])
    signs = np.where(duals[:, :4] @ duals[0, :4] < 0, -1.0, 1.0)
    return rows(weights), duals * signs[:, None]


@settings(max_examples=15, deadline=None)
@given(motion=rigid_motions)
def test_who_follows_one_part_moves_as_it_does(motion: tuple[Float, Float]) -> None:
    turn, shift = motion
    weights = rows(np.tile([[1.0, 0.0]], (len(POINTS), 1)))
    duals = np.stack([dual(turn, shift), dual(rotation((1.0, 2, 3)), np.ones(3))])
    np.testing.assert_allclose(kernels.skin_vertices(*weights, duals, POINTS), POINTS @ turn.T + shift, atol=1e-13)


@pytest.mark.parametrize("share", [0.0, 0.25, 0.5, 1.0])
def test_parts_that_move_as_one_take_all_along(share: float) -> None:
    turn, shift = rotation((1.0, -2, 0.5)), np.array([3.0, -1, 2])
    weights = rows(np.tile([[share, 1.0 - share]], (len(POINTS), 1)))
    moved = kernels.skin_vertices(*weights, np.stack([dual(turn, shift)] * 2), POINTS)
    np.testing.assert_allclose(moved, POINTS @ turn.T + shift, atol=1e-13)


@pytest.mark.parametrize("angle", [0.0, 0.5, np.pi / 2, -2.0, 3.1])
@pytest.mark.parametrize("way", [0.0, 0.6])
def test_half_of_a_screw_is_half_the_turn_and_half_the_way(angle: float, way: float) -> None:
    """About an axis that is not through the origin."""
    pivot, half = np.array([0.5, 0, 2.0]), rotation(AXIS * angle / 2)
    full = half @ half
    duals = np.stack([dual(np.eye(3), np.zeros(3)), dual(full, pivot - full @ pivot + way * AXIS)])
    weights = rows(np.full((len(POINTS), 2), 0.5))
    expected = (POINTS - pivot) @ half.T + pivot + way / 2 * AXIS
    np.testing.assert_allclose(kernels.skin_vertices(*weights, duals, POINTS), expected, atol=1e-13)


@settings(max_examples=15, deadline=None)
@given(seed=seeds)
def test_posing_and_unposing_are_inverse(seed: int) -> None:
    weights, duals = wild(seed)
    posed = kernels.skin_vertices(*weights, duals, POINTS)
    np.testing.assert_allclose(kernels.unskin_vertices(*weights, duals, posed), POINTS, atol=1e-12)
    np.testing.assert_allclose(
        kernels.skin_vertices(*weights, duals, kernels.unskin_vertices(*weights, duals, POINTS)), POINTS, atol=1e-12
    )


@settings(max_examples=15, deadline=None)
@given(seed=seeds)
def test_distances_to_neighbours_that_follow_the_same_are_kept(seed: int) -> None:
    """Every motion is rigid, however far apart those that are blended are."""
    (starts, parts, shares), duals = wild(seed)
    first = slice(starts[0], starts[1])
    count = starts[1]
    alike = (
        np.arange(len(POINTS) + 1, dtype=np.int32) * count,
        np.tile(parts[first], len(POINTS)),
        np.tile(shares[first], len(POINTS)),
    )
    moved = kernels.skin_vertices(*alike, duals, POINTS)
    here, there = (np.linalg.norm(x[:, None] - x, axis=2) for x in (POINTS, moved))
    np.testing.assert_allclose(there, here, atol=1e-12)


def test_motions_that_add_up_to_nothing_move_nothing() -> None:
    weights, duals = rows(np.full((len(POINTS), 2), 0.5)), dual(rotation((1.0, 2, 3)), np.ones(3))
    np.testing.assert_array_equal(kernels.skin_vertices(*weights, np.stack([duals, -duals]), POINTS), POINTS)


@settings(max_examples=15, deadline=None)
@given(seed=seeds, back=st.booleans())
def test_complex_steps_of_posing_are_difference_quotients(seed: int, back: bool) -> None:
    rng = np.random.default_rng(seed)
    weights, duals = wild(seed)
    rates, speeds = rng.normal(size=duals.shape), rng.normal(size=POINTS.shape)
    rates[:, :4] -= duals[:, :4] * np.einsum("pi,pi->p", rates[:, :4], duals[:, :4])[:, None]
    kernel, step = kernels.unskin_vertices if back else kernels.skin_vertices, 1e-5

    def at(time: float) -> Float:
        real = duals[:, :4] + time * rates[:, :4]
        moved = np.concatenate([normalise_quat(real), duals[:, 4:] + time * rates[:, 4:]], axis=1)
        return np.asarray(kernel(*weights, moved, POINTS + time * speeds))

    values, found = from_complex_step(kernel(*weights, to_complex_step(duals, rates), to_complex_step(POINTS, speeds)))
    np.testing.assert_allclose(values, at(0.0), atol=1e-13)
    quotient = (at(step) - at(-step)) / (2 * step)
    assert np.abs(found - quotient).max() < 1e-6 * np.abs(quotient).max()


# Complex steps: derivatives to the last digits, of what is analytic

RNG = np.random.default_rng(0)
VALUES, RATES = RNG.normal(size=(2, 5, 3))


def test_numbers_with_rates_have_these() -> None:
    values, rates = from_complex_step(to_complex_step(VALUES, RATES))
    np.testing.assert_array_equal(values, VALUES)
    np.testing.assert_array_equal(rates, RATES)
    assert values.flags.c_contiguous


def test_functions_have_their_derivatives_to_the_last_digits() -> None:
    x = to_complex_step(VALUES, RATES)
    values, rates = from_complex_step(np.sqrt(1.0 + x * x) * np.sin(x))
    root = np.sqrt(1.0 + VALUES**2)
    np.testing.assert_allclose(values, root * np.sin(VALUES), rtol=1e-15)
    expected = RATES * (VALUES / root * np.sin(VALUES) + root * np.cos(VALUES))
    np.testing.assert_allclose(rates, expected, rtol=1e-13, atol=1e-15)


def test_a_system_is_solved_for_values_and_for_rates() -> None:
    factor = factorise_laplacian(np.array([[0, 1], [1, 2], [2, 3], [3, 4]]), np.arange(1.0, 5.0), np.ones(5))
    values, rates = from_complex_step(solve_columns(factor, to_complex_step(VALUES, RATES)))
    np.testing.assert_allclose(values, factor.solve(VALUES), rtol=1e-13)
    np.testing.assert_allclose(rates, factor.solve(RATES), rtol=1e-13)
    np.testing.assert_array_equal(solve_columns(factor, VALUES), factor.solve(VALUES))
