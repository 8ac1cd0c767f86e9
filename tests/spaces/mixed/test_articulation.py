"""Bodies and how their parts stand: closed forms, agreement, and nothing that depends on where a body is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixseq.mesh.rotations import (
    align_quat_signs,
    matrix_to_quat,
    normalise_quat,
    quat_multiply,
    quat_to_matrix,
    rotate_vectors,
)
from mixseq.mesh.topology import connected_components
from mixseq.segmentation.elements import Boundaries
from mixseq.segmentation.joints import decompose
from mixseq.spaces.base import radii_of_gyration
from mixseq.spaces.mixed import posing_kernels as kernels
from mixseq.spaces.mixed.articulation import MOTION_FLOOR, Articulation, PartPoses, Steadiness, find_articulation
from mixseq.spaces.mixed.joint_projection import from_complex_step, to_complex_step
from mixseq.spaces.mixed.pose_interpolation import PoseInterpolation
from mixseq.spaces.temporal import (
    CANDIDATE_LENGTH_SCALES,
    Poses,
    TemporalOperator,
    insert_midpoints,
    interpolate_poses,
    select_operator,
)
from mixseq.types import Float, Index
from tests.meshes import Mesh, joined, rigid_motions, rotation, seeds, topology_of, tube
from tests.spaces.mixed.made import sliced
from tests.spaces.moving import turns_of, wandering

MESH = tube(6, 17)
AXIS = np.array([2.0, -1.0, 2.0]) / 3


def articulated(mesh: Mesh, labels: Index) -> Articulation:
    decomposition = decompose(topology_of(mesh), labels, 1)
    centres = np.stack([mesh[0][part].mean(axis=0) for part in decomposition.parts])
    shapes = np.concatenate([mesh[0][part] - centre for part, centre in zip(decomposition.parts, centres, strict=True)])
    radii = radii_of_gyration(shapes, decomposition.parts)
    return find_articulation(topology_of(mesh), decomposition, mesh[0], centres, radii)


def links(parts: int) -> Articulation:
    """A tube, cut into links of equal length."""
    return articulated(MESH, sliced(MESH, *np.linspace(0, 4, parts + 1)[1:-1]))


CHAIN = links(4)
TWO = articulated(
    joined(MESH, (MESH[0] + [9.0, 0, 0], MESH[1])), np.concatenate([sliced(MESH, 2.0), 2 + sliced(MESH, 2.0)])
)


def wild(seed: int, parts: int = 4, frames: int = 1, spread: float = 3.0) -> Poses:
    """Poses by chance, in any axes."""
    rng = np.random.default_rng(seed)
    turns = normalise_quat(np.array([1.0, 0, 0, 0]) + spread * rng.normal(size=(frames, parts, 4)))
    return Poses(turns, rng.normal(size=(frames, parts, 3)))


def bending(chain: Articulation, bend: float) -> Poses:
    """Each link turned by an angle against the one before it, at the boundary between them."""
    order = np.argsort(chain.rest_centres[:, 2])
    turns, centres = np.zeros((1, len(order), 4)), np.zeros((1, len(order), 3))
    pivot = np.zeros(3)
    for number, part in enumerate(order):
        turn = rotation(AXIS * bend * number)
        rest, end = chain.rest_centres[part], np.array([0, 0, 4.0 * (number + 1) / len(order)])
        start = np.array([0, 0, 4.0 * number / len(order)])
        turns[0, part], centres[0, part] = matrix_to_quat(turn), pivot + turn @ (rest - start)
        pivot = pivot + turn @ (end - start)
    return Poses(turns, centres)


def assert_same_poses(found: Poses, expected: Poses, atol: float = 1e-12) -> None:
    np.testing.assert_allclose(quat_to_matrix(found.rotations), quat_to_matrix(expected.rotations), atol=atol)
    np.testing.assert_allclose(found.centres, expected.centres, atol=atol)


def moved(poses: Poses, turn: Float, shift: Float) -> Poses:
    return Poses(quat_multiply(matrix_to_quat(turn), poses.rotations), poses.centres @ turn.T + shift)


def angle_between(first: Float, second: Float) -> Float:
    return np.asarray(2.0 * np.arccos(np.minimum(np.abs(np.einsum("...i,...i", first, second)), 1.0)))


# Who is of what body --------------------------------------------------------------------------------------


def test_neighbours_see_each_other_at_the_middle_of_their_boundary() -> None:
    labels = sliced(MESH, 1.0, 2.0, 3.0)
    boundaries = Boundaries.from_labels(topology_of(MESH), labels)
    pairs = boundaries.parts
    np.testing.assert_array_equal(CHAIN.pairs, np.concatenate([pairs, pairs[:, ::-1]]))
    places = CHAIN.pivots + CHAIN.rest_centres[CHAIN.pairs[:, 1]]
    np.testing.assert_allclose(places, np.tile(boundaries.middles(MESH[0]), (2, 1)), atol=1e-12)
    assert (len(CHAIN.radii), CHAIN.body_count) == (4, 1)


@pytest.mark.parametrize(("gap", "bodies"), [(0.05, 1), (0.2, 2)])
def test_components_that_touch_are_one_body(gap: float, bodies: int) -> None:
    """They see each other where they are nearest."""
    mesh = joined(MESH, (MESH[0] + [0, 0, 4.0 + gap], MESH[1]))
    both = articulated(mesh, np.repeat([0, 1], len(MESH[1])))
    assert both.body_count == bodies
    assert len(both.pairs) == 2 * (2 - bodies)
    if bodies == 1:
        places = both.pivots + both.rest_centres[both.pairs[:, 1]]
        np.testing.assert_allclose(places[:, 2], 4.0 + gap / 2, atol=1e-12)


def test_parts_hang_on_the_largest_of_their_body() -> None:
    chain = articulated(MESH, sliced(MESH, 1.0, 1.5))
    large = int(np.argmax(chain.areas))
    order = np.argsort(chain.rest_centres[:, 2])
    assert large == order[2]
    assert chain.parents[large] == -1
    assert chain.parents[order[1]] == large and chain.parents[order[0]] == order[1]
    assert (TWO.parents < 0).sum() == TWO.body_count == 2


def test_radii_of_bodies_are_those_of_all_their_vertices() -> None:
    """As far as parts share no vertices."""
    mesh = joined(MESH, (MESH[0] + [0, 0, 4.05], MESH[1]))
    both = articulated(mesh, np.repeat([0, 1], len(MESH[1])))
    away = mesh[0] - mesh[0].mean(axis=0)
    assert both.body_radii[0] == pytest.approx(np.sqrt(np.square(away).sum(axis=1).mean()), rel=1e-12)


# From frames ----------------------------------------------------------------------------------------------


@given(motion=rigid_motions)
def test_parts_that_move_as_one_are_a_body_with_that_motion(motion: tuple[Float, Float]) -> None:
    turn, shift = motion
    rest = Poses(np.tile(np.eye(4)[:1], (1, 4, 1)), CHAIN.rest_centres[None])
    body, poses = (CHAIN.fit_bodies(each) for each in (rest, moved(rest, turn, shift)))
    np.testing.assert_allclose(quat_to_matrix(poses.rotations[0, 0]), turn, atol=1e-12)
    np.testing.assert_allclose(poses.centres[0, 0], turn @ body.centres[0, 0] + shift, atol=1e-12)
    seen = CHAIN.to_body_axes(moved(rest, turn, shift), poses)
    assert_same_poses(seen, rest._replace(centres=rest.centres - body.centres))


@pytest.mark.parametrize("degrees", [10.0, 40.0])
def test_a_chain_that_bends_is_as_turned_as_its_links_on_average(degrees: float) -> None:
    body = CHAIN.fit_bodies(bending(CHAIN, np.radians(degrees)))
    turned_by = angle_between(body.rotations[0, 0], matrix_to_quat(rotation(AXIS * np.radians(1.5 * degrees))))
    assert turned_by < np.radians(0.11 * degrees)


@given(seed=seeds, motion=rigid_motions)
def test_a_rigid_motion_of_a_body_changes_its_pose_and_nothing_else(seed: int, motion: tuple[Float, Float]) -> None:
    """Also if only one of the bodies moves."""
    turn, shift = motion
    poses = wild(seed, 4, spread=0.2)
    other = Poses(*(block.copy() for block in poses))
    own = np.flatnonzero(TWO.body_of_part == 1)
    for block, carried in zip(other, moved(poses, turn, shift), strict=True):
        block[:, own] = carried[:, own]
    before, after = (TWO.fit_bodies(each) for each in (poses, other))
    assert_same_poses(TWO.to_body_axes(other, after), TWO.to_body_axes(poses, before), 1e-9)
    there = moved(before, turn, shift)
    for found, expected, some in ((after, there, slice(1, 2)), (after, before, slice(0, 1))):
        found, expected = (Poses(*(block[:, some] for block in each)) for each in (found, expected))
        assert_same_poses(found, expected, 1e-9)


@given(seed=seeds)
def test_placing_is_the_inverse_of_seeing_from_bodies(seed: int) -> None:
    poses = wild(seed, 4, frames=3)
    bodies = TWO.fit_bodies(poses)
    assert_same_poses(TWO.to_world_axes(TWO.to_body_axes(poses, bodies), bodies), poses)


@given(seed=seeds, motion=rigid_motions)
def test_relations_are_the_same_in_all_axes(seed: int, motion: tuple[Float, Float]) -> None:
    poses = wild(seed)
    here, there = CHAIN.add_relations(poses), CHAIN.add_relations(moved(poses, *motion))
    np.testing.assert_allclose(there.relation_points, here.relation_points, atol=1e-12)
    np.testing.assert_allclose(
        quat_to_matrix(there.relation_rotations), quat_to_matrix(here.relation_rotations), atol=1e-12
    )


def test_what_moves_less_is_steadier() -> None:
    """One over the mean squared motion: here the turns of the last link, by its radius, about the mean."""
    rest = Poses(np.tile(np.eye(4)[:1], (4, 4, 1)), np.tile(CHAIN.rest_centres[None], (4, 1, 1)))
    last, angles = int(np.argmax(CHAIN.rest_centres[:, 2])), np.array([-0.3, -0.1, 0.1, 0.3])
    rest.rotations[:, last] = matrix_to_quat(np.stack([rotation(AXIS * angle) for angle in angles]))
    found = CHAIN.measure_steadiness(CHAIN.add_relations(rest))
    expected = np.full(4, MOTION_FLOOR**2)
    expected[last] += np.square(angles).mean() * CHAIN.radii[last] ** 2
    np.testing.assert_allclose(found.turns, 1.0 / expected, rtol=1e-9)
    np.testing.assert_allclose(found.centres, 1.0 / MOTION_FLOOR**2)
    sees = (CHAIN.pairs == last).any(axis=1)
    assert found.relation_turns[sees].max() < found.relation_turns[~sees].min()


def test_a_part_that_goes_around_has_a_steadiness() -> None:
    """The mean of its quaternions is nothing."""
    angles = np.pi * np.arange(4.0)
    turns = np.stack([np.cos(angles / 2), np.sin(angles / 2), 0 * angles, 0 * angles], axis=1)
    around = Poses(np.tile(turns[:, None], (1, 4, 1)), np.zeros((4, 4, 3)))
    for block in CHAIN.measure_steadiness(CHAIN.add_relations(around)):
        assert np.isfinite(block).all() and (block > 0).all()


# Agreement ------------------------------------------------------------------------------------------------


@settings(max_examples=25, deadline=None)
@given(seed=seeds, weight=st.sampled_from([0.1, 3.0]))
def test_poses_and_relations_of_one_frame_agree(seed: int, weight: float) -> None:
    """However far the parts are turned against each other."""
    for articulation in (CHAIN, TWO):
        poses = wild(seed, 4, frames=2)
        found = replace(articulation, relation_weight=weight).reconcile(articulation.add_relations(poses))
        assert_same_poses(found, poses)


@pytest.mark.parametrize("wrong", range(4))
def test_a_wrong_pose_is_pulled_to_where_neighbours_see_the_part(wrong: int) -> None:
    right = CHAIN.add_relations(bending(CHAIN, 0.4))
    turns, centres = right.rotations.copy(), right.centres.copy()
    turns[0, wrong] = quat_multiply(matrix_to_quat(rotation((0.4, 0.0, 0.0))), turns[0, wrong])
    centres[0, wrong] += [0.3, 0.0, 0.0]
    given_poses = right._replace(rotations=turns, centres=centres)
    off = []
    for weight in (0.01, 1.0, 100.0):
        found = replace(CHAIN, relation_weight=weight).reconcile(given_poses)
        turn = angle_between(found.rotations[0, wrong], right.rotations[0, wrong])
        off.append((turn, np.linalg.norm(found.centres[0, wrong] - right.centres[0, wrong])))
    for sizes, whole in zip(np.transpose(off), (0.4, 0.3), strict=True):
        assert whole * 1.01 > sizes[0] > sizes[1] > sizes[2] > 0
        assert sizes[0] > 0.85 * whole and sizes[2] < 0.6 * whole


def test_what_is_steady_is_trusted() -> None:
    right = CHAIN.add_relations(bending(CHAIN, 0.4))
    turns = right.rotations.copy()
    turns[0, 1] = quat_multiply(matrix_to_quat(rotation((0.4, 0.0, 0.0))), turns[0, 1])
    off = []
    for steady in (0.01, 1.0, 100.0):
        parts = Steadiness(*np.ones((2, 4)), *np.ones((2, len(CHAIN.pairs))))
        parts.turns[1] = steady
        found = replace(CHAIN, steadiness=parts).reconcile(right._replace(rotations=turns))
        off.append(float(angle_between(found.rotations[0, 1], right.rotations[0, 1])))
    assert off == sorted(off)
    assert off[0] < 0.15 and off[2] > 0.3


def misfit(chain: Articulation, poses: PartPoses, found: Poses) -> float:
    """What rotations minimise: squared sines of half the angles that are left, weighted."""
    own, weights = ((chain.masses * chain.radii**2), np.minimum(*(chain.masses * chain.radii**2)[chain.pairs.T]))
    i, j = chain.pairs.T
    seen = quat_multiply(found.rotations[:, i], poses.relation_rotations)
    cosines = [
        np.einsum("tpi,tpi->tp", found.rotations, poses.rotations),
        np.einsum("tpi,tpi->tp", found.rotations[:, j], seen),
    ]
    return float(sum((w * (1.0 - c**2)).sum() for w, c in zip((own, weights), cosines, strict=True)))


def test_agreed_rotations_nearly_have_the_least_misfit() -> None:
    rng = np.random.default_rng(0)
    poses = CHAIN.add_relations(bending(CHAIN, 0.4))
    noisy = poses._replace(
        rotations=normalise_quat(poses.rotations + 0.1 * rng.normal(size=poses.rotations.shape)),
        relation_rotations=normalise_quat(
            poses.relation_rotations + 0.1 * rng.normal(size=poses.relation_rotations.shape)
        ),
    )
    found = CHAIN.reconcile(noisy)
    least = misfit(CHAIN, noisy, found)
    assert least < 0.8 * misfit(CHAIN, noisy, Poses(noisy.rotations, noisy.centres))
    for _ in range(50):
        step = normalise_quat(np.array([1.0, 0, 0, 0]) + 0.03 * rng.normal(size=(1, 4, 4)))
        assert misfit(CHAIN, noisy, Poses(quat_multiply(step, found.rotations), found.centres)) > least


@given(seed=seeds, motion=rigid_motions)
@settings(max_examples=12, deadline=None)
def test_agreement_is_the_same_in_all_axes(seed: int, motion: tuple[Float, Float]) -> None:
    poses, others = (CHAIN.add_relations(wild(seed, spread=0.3)), CHAIN.add_relations(wild(seed + 1, spread=0.3)))
    turn, shift = motion
    here = others._replace(rotations=poses.rotations, centres=poses.centres)
    carried = moved(Poses(poses.rotations, poses.centres), turn, shift)
    there = here._replace(rotations=carried.rotations, centres=carried.centres)
    assert_same_poses(CHAIN.reconcile(there), moved(CHAIN.reconcile(here), turn, shift), 1e-9)


@pytest.mark.parametrize("weight", [-0.5, 0.25, 0.5, 0.75, 1.5])
def test_chains_stay_closed_between_far_poses(weight: float) -> None:
    """Sums of centres open them, as chords are shorter than arcs."""
    chain = replace(links(3), relation_weight=3.0)
    near, far = (chain.add_relations(bending(chain, bend)) for bend in (0.0, 1.2))
    blend = PartPoses(*((1.0 - weight) * a + weight * b for a, b in zip(near, far, strict=True)))

    def gap(poses: Poses) -> float:
        seen = chain.pairs[:, 1]
        places = rotate_vectors(quat_to_matrix(poses.rotations[:, seen]), chain.pivots) + poses.centres[:, seen]
        return float(np.linalg.norm(np.diff(places.reshape(2, -1, 3), axis=0), axis=2).max())

    opened = gap(Poses(blend.rotations, blend.centres))
    assert opened > 0.03
    assert gap(chain.reconcile(blend)) < 0.5 * opened


def test_blends_of_half_turns_are_rotations() -> None:
    """Whose quaternions may add up to nothing, of parts, relations and all."""
    poses = CHAIN.add_relations(wild(0))
    nothing = poses._replace(rotations=0.0 * poses.rotations)
    nowhere = nothing._replace(relation_rotations=0.0 * poses.relation_rotations)
    halves = poses._replace(rotations=np.tile(np.eye(4)[1], (1, 4, 1)))
    for each in (nothing, nowhere, poses._replace(relation_rotations=0.0 * poses.relation_rotations), halves):
        found = CHAIN.reconcile(each)
        np.testing.assert_allclose(np.linalg.norm(found.rotations, axis=2), 1.0, atol=1e-12)
        assert np.isfinite(found.centres).all()


@pytest.mark.parametrize("degrees", [179.0, 180.0, 181.0])
def test_parts_half_a_turn_apart_agree(degrees: float) -> None:
    chain = links(2)
    poses = bending(chain, np.radians(degrees))
    assert_same_poses(chain.reconcile(chain.add_relations(poses)), poses)


# Corrections and motions ----------------------------------------------------------------------------------


@settings(max_examples=15, deadline=None)
@given(seed=seeds, size=st.sampled_from([1e-9, 1e-3, 0.5]))
def test_corrections_lead_from_poses_to_targets(seed: int, size: float) -> None:
    rng = np.random.default_rng(seed)
    poses = wild(seed, frames=3)
    step = normalise_quat(np.array([1.0, 0, 0, 0]) + size * rng.normal(size=(3, 4, 4)))
    targets = Poses(quat_multiply(poses.rotations, step), poses.centres + size * rng.normal(size=(3, 4, 3)))
    found = CHAIN.pose_corrections(poses, targets).reshape(3, 2, 4, 3)
    for frame in range(3):
        turns, centres = kernels.correct_poses(poses.rotations[frame], poses.centres[frame], *found[frame])
        assert_same_poses(Poses(turns, centres), Poses(*(block[frame] for block in targets)))


def test_no_correction_changes_nothing() -> None:
    poses = wild(1)
    assert not CHAIN.pose_corrections(poses, poses).round(15).any()
    turns, centres = kernels.correct_poses(poses.rotations[0], poses.centres[0], *np.zeros((2, 4, 3)))
    np.testing.assert_array_equal(turns, poses.rotations[0])
    np.testing.assert_array_equal(centres, poses.centres[0])


def test_corrections_of_a_sequence_do_not_jump() -> None:
    """Past half a turn they go on."""
    angles = np.linspace(0, 1.5 * np.pi, 9)
    targets = Poses(
        np.stack([np.tile(matrix_to_quat(rotation(AXIS * angle)), (4, 1)) for angle in angles]), np.zeros((9, 4, 3))
    )
    found = CHAIN.pose_corrections(Poses(np.tile(np.eye(4)[0], (9, 4, 1)), np.zeros((9, 4, 3))), targets)
    np.testing.assert_allclose(found[:, :3], angles[:, None] * AXIS, atol=1e-9)


def motions(chain: Articulation, poses: Poses, bodies: Poses | None = None) -> Float:
    """Motions of the parts of one frame, as dual quaternions."""
    bodies = chain.fit_bodies(poses) if bodies is None else bodies
    parts = chain.add_relations(chain.to_body_axes(poses, bodies))
    frame = PartPoses(*(block[0] for block in parts))
    none = np.zeros(6 * len(chain.radii))
    return np.asarray(chain.part_motions(frame, (bodies.rotations[0], bodies.centres[0]), none))


def applied(dual: Float, points: Float) -> Float:
    back = dual[:4] * np.array([1.0, -1, -1, -1])
    return np.asarray(rotate_vectors(quat_to_matrix(dual[:4]), points) + 2.0 * quat_multiply(dual[4:], back)[1:])


@settings(max_examples=15, deadline=None)
@given(seed=seeds)
def test_motions_take_parts_from_rest_to_where_they_are(seed: int) -> None:
    for chain in (CHAIN, TWO):
        poses = wild(seed, spread=0.3)
        for part, dual in enumerate(motions(chain, poses)):
            turn = quat_to_matrix(poses.rotations[0, part])
            points = np.random.default_rng(seed).normal(size=(5, 3))
            expected = (points - chain.rest_centres[part]) @ turn.T + poses.centres[0, part]
            np.testing.assert_allclose(applied(dual, points), expected, atol=1e-11)
            np.testing.assert_allclose([dual[:4] @ dual[:4], dual[:4] @ dual[4:]], [1.0, 0.0], atol=1e-12)


@pytest.mark.parametrize("degrees", [10.0, 100.0, 170.0])
def test_signs_of_motions_follow_from_neighbour_to_neighbour(degrees: float) -> None:
    """However far the ends of a chain turn against each other."""
    chain = links(8)
    duals = motions(chain, bending(chain, np.radians(degrees)))
    i, j = chain.pairs.T
    assert (np.einsum("ni,ni->n", duals[i, :4], duals[j, :4]) > 0).all()


@settings(max_examples=10, deadline=None)
@given(seed=seeds)
def test_rates_of_motions_are_difference_quotients(seed: int) -> None:
    """Quaternions need not be of length one, nor stay so; poses need not agree."""
    rng = np.random.default_rng(seed)
    poses, bodies = CHAIN.add_relations(wild(seed, spread=0.3)), wild(seed + 1, 1)
    values = [block[0] for block in (*poses, *bodies)]
    values[2] = values[2] + 0.1 * rng.normal(size=values[2].shape)
    values.append(0.3 * rng.normal(size=24))
    rates = [rng.normal(size=value.shape) for value in values]

    def at(time: float) -> Float:
        now = [value + time * rate for value, rate in zip(values, rates, strict=True)]
        return np.asarray(CHAIN.part_motions(PartPoses(*now[:4]), (now[4], now[5]), now[6]))

    numbers = [to_complex_step(value, rate) for value, rate in zip(values, rates, strict=True)]
    found, velocity = from_complex_step(
        CHAIN.part_motions(PartPoses(*numbers[:4]), (numbers[4], numbers[5]), numbers[6])
    )
    np.testing.assert_allclose(found, at(0.0), atol=1e-13)
    step = 1e-5
    quotient = (at(step) - at(-step)) / (2 * step)
    assert np.abs(velocity - quotient).max() < 1e-6 * np.abs(quotient).max()


def test_small_corrections_have_the_rates_of_large_ones() -> None:
    """Their exponential is a power series below an angle, and both sides of it agree."""
    small = np.sqrt(kernels.SERIES_SQUARED_ANGLE)
    turns, none = np.eye(4)[:1].astype(complex), np.zeros((1, 3), complex)
    found = []
    for size in (0.999999 * small, 1.000001 * small):
        spins = to_complex_step(size * AXIS[None], AXIS[None])
        value, rate = from_complex_step(kernels.correct_poses(turns, none, spins, none)[0])
        np.testing.assert_allclose(value[0], [np.cos(size / 2), *np.sin(size / 2) * AXIS], atol=1e-15)
        found.append(rate)
    np.testing.assert_allclose(found[0], found[1], atol=1e-8)


# Poses of parts between frames: joints that stay closed, bodies that turn, and nothing that depends on axes


def related(pairs: Index, pivots: Float, radii: Float, rest: Float) -> Articulation:
    """Parts whose neighbours see each other at pivots; those without neighbours are bodies of their own."""
    count = len(radii)
    return Articulation(
        rest_centres=rest,
        radii=radii,
        masses=np.ones(count),
        areas=np.ones(count),
        body_of_part=connected_components(count, pairs),
        pairs=pairs,
        pivots=pivots,
        steadiness=Steadiness(*np.ones((2, count)), *np.ones((2, len(pairs)))),
    )


def strangers(count: int) -> Articulation:
    rest = np.random.default_rng(0).normal(size=(count, 3))
    return related(np.zeros((0, 2), dtype=np.int64), np.zeros((0, 3)), np.full(count, 0.5), rest)


def ring(parts: int, seed: int = 0, alone: int = 0) -> Articulation:
    """Every part sees the one before and the one after it, but for the last ones, which are alone."""
    rng = np.random.default_rng(seed)
    pairs = np.stack([np.arange(parts), (np.arange(parts) + 1) % parts], axis=1)
    both, count = np.concatenate([pairs, pairs[:, ::-1]]), parts + alone
    pivots = rng.normal(scale=0.5, size=(len(both), 3))
    return related(both, pivots, rng.uniform(0.2, 1.0, count), rng.normal(size=(count, 3)))


def two_bones(bends: Float, turns: Float, shifts: Float) -> tuple[Poses, Articulation]:
    """A lower bone that moves about, and an upper one that is hinged to it at its end; both are 2 long."""
    lower = turns_of(turns)[:, 0]
    upper = quat_multiply(lower, turns_of(bends, np.array([1.0, 0, 0]))[:, 0])
    end = np.array([0.0, 0.0, 1.0])
    pivots = shifts + rotate_vectors(quat_to_matrix(lower), end)
    centres = np.stack([shifts, pivots + rotate_vectors(quat_to_matrix(upper), end)], axis=1)
    poses = Poses(align_quat_signs(np.stack([lower, upper], axis=1)), centres)
    rest = np.stack([0 * end, 2 * end])
    return poses, related(np.array([[0, 1], [1, 0]]), np.array([-end, end]), np.full(2, 0.6), rest)


def gaps(poses: Poses, parts: Articulation) -> Float:
    """How far the two ends of every pivot are apart, ``(N, n)``."""
    seen = parts.pairs[:, 1]
    places = rotate_vectors(quat_to_matrix(poses.rotations[:, seen]), parts.pivots) + poses.centres[:, seen]
    half = len(seen) // 2
    return np.asarray(np.linalg.norm(places[:, :half] - places[:, half:], axis=2))


def predicted(operator: TemporalOperator, poses: Poses, parts: Articulation, times: Float) -> Poses:
    bodies, seen = PoseInterpolation(parts, operator, poses).at(times)
    placed = parts.to_world_axes(seen, bodies)
    return placed._replace(rotations=align_quat_signs(placed.rotations))


@settings(max_examples=10, deadline=None)
@given(seed=seeds, length=st.sampled_from(CANDIDATE_LENGTH_SCALES), frames=st.sampled_from([2, 3, 12, 60]))
def test_frames_are_passed(seed: int, length: float, frames: int) -> None:
    poses = wandering(seed, 3, frames)
    times = np.cumsum(np.random.default_rng(seed).uniform(0.5, 1.5, frames))
    found = predicted(TemporalOperator(times, length), poses, ring(3), insert_midpoints(times))
    np.testing.assert_allclose(found.centres[::2], poses.centres, atol=1e-12)
    np.testing.assert_allclose(quat_to_matrix(found.rotations)[::2], quat_to_matrix(poses.rotations), atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(found.rotations, axis=2), 1.0, atol=1e-14)
    assert (np.einsum("tpi,tpi->tp", found.rotations[1:], found.rotations[:-1]) > 0).all()


def test_fused_poses_come_near_frames_without_a_jump() -> None:
    """What is solved for near a frame goes to what is taken over at the frame."""
    poses, operator = wandering(3, 4), TemporalOperator(np.arange(12.0), 2.0)
    near = predicted(operator, poses, ring(4), np.array([4.0, 4.0 + 1e-7, 5.0 - 1e-7, 5.0]))
    for block in near:
        np.testing.assert_allclose(block[1], block[0], atol=1e-6)
        np.testing.assert_allclose(block[2], block[3], atol=1e-6)


@settings(max_examples=10, deadline=None)
@given(seed=seeds, motion=rigid_motions, parts=st.integers(1, 5))
def test_rigid_motions_of_everything_go_through(seed: int, motion: tuple[Float, Float], parts: int) -> None:
    poses, articulation = wandering(seed, parts), ring(parts) if parts > 1 else strangers(1)
    operator = TemporalOperator(np.arange(12.0), 4.0)
    times = insert_midpoints(operator.times)
    here = moved(predicted(operator, poses, articulation, times), *motion)
    there = predicted(operator, moved(poses, *motion), articulation, times)
    np.testing.assert_allclose(quat_to_matrix(there.rotations), quat_to_matrix(here.rotations), atol=1e-9)
    np.testing.assert_allclose(there.centres, here.centres, atol=1e-9)


@pytest.mark.parametrize("frames", [2, 4, 12])
def test_in_the_body_a_turn_of_all_is_no_motion_of_parts(frames: int) -> None:
    """Parts of a body that turns about its middle keep their distances; each in the world takes a chord."""
    chain = ring(3)
    rest = chain.rest_centres - chain.rest_centres.mean(axis=0)
    turns = turns_of(np.radians(80.0) * np.arange(float(frames)))
    turns = np.repeat(turns, 3, axis=1)
    poses = Poses(turns, rotate_vectors(quat_to_matrix(turns), rest))
    operator, middles = TemporalOperator(np.arange(float(frames))), np.arange(frames - 1.0) + 0.5
    _, seen = PoseInterpolation(chain, operator, poses).at(middles)
    np.testing.assert_allclose(seen.centres, np.broadcast_to(rest, seen.centres.shape), atol=1e-6)
    back = quat_to_matrix(turns_of(np.radians(80.0) * middles)).swapaxes(2, 3)
    alone = interpolate_poses(operator.weights_at(middles), poses)
    assert np.abs(rotate_vectors(back, alone.centres) - rest).max() > 1e-2


@settings(max_examples=10, deadline=None)
@given(seed=seeds, frames=st.sampled_from([4, 12, 60]))
def test_turns_of_whole_frames_do_not_change_how_parts_stand_to_each_other(seed: int, frames: int) -> None:
    """Every frame is turned on its own, by any angle."""
    poses, parts, operator = wandering(seed, 4, frames), ring(4), TemporalOperator(np.arange(float(frames)), 4.0)
    rng = np.random.default_rng(seed)
    turns = normalise_quat(rng.normal(size=(frames, 1, 4)))
    turned = Poses(
        align_quat_signs(quat_multiply(turns, poses.rotations)),
        rotate_vectors(quat_to_matrix(turns), poses.centres) + rng.normal(size=(frames, 1, 3)),
    )
    times = np.arange(frames - 1.0) + 0.3
    here, there = (parts.add_relations(predicted(operator, each, parts, times)) for each in (poses, turned))
    np.testing.assert_allclose(
        quat_to_matrix(there.relation_rotations), quat_to_matrix(here.relation_rotations), atol=1e-8
    )
    np.testing.assert_allclose(there.relation_points, here.relation_points, atol=1e-8)


def test_parts_are_interpolated_in_the_axes_of_the_part_around_which_they_turn_evenly() -> None:
    """A hub that reels, and wheels that turn evenly around it; a wheel is the largest part, a hub the third."""
    rng, count = np.random.default_rng(0), 16
    hub = turns_of(np.cumsum(rng.uniform(-2.0, 2.0, count)))[:, 0]
    axis = np.array([0.0, 0.0, 1.0])
    evenly = np.stack([turns_of(np.linspace(0.0, last, count), axis)[:, 0] for last in (13.5, -10.5, 0.0)], axis=1)
    turns = align_quat_signs(quat_multiply(hub[:, None], evenly))
    offsets = np.array([[1.0, 0, 0], [-1.0, 0, 0], [0, 0, 0]])
    poses = Poses(turns, rotate_vectors(quat_to_matrix(hub[:, None]), offsets))
    pairs = np.array([[2, 0], [2, 1], [0, 2], [1, 2]])
    wheels = replace(related(pairs, np.zeros((4, 3)), np.full(3, 0.5), offsets), areas=np.array([3.0, 2.0, 1.0]))
    interpolation = PoseInterpolation(wheels, TemporalOperator(np.arange(float(count))), poses)
    assert interpolation._roots.tolist() == [2]


def test_a_heavy_limb_that_turns_over_does_not_turn_its_body_over() -> None:
    """Its mean with a light torso would jump past a quarter turn; the torso is steadier."""
    angles = np.radians(np.linspace(0.0, 180.0, 10))
    limb = turns_of(angles, np.eye(3)[0])
    poses = Poses(np.concatenate([np.tile([1.0, 0, 0, 0], (10, 1, 1)), limb], axis=1), np.zeros((10, 2, 3)))
    body = related(np.array([[0, 1], [1, 0]]), np.zeros((2, 3)), np.full(2, 0.5), np.zeros((2, 3)))
    body = replace(body, masses=np.array([1.0, 2.0]))

    def largest_step(parts: Articulation) -> float:
        turns = quat_to_matrix(parts.fit_bodies(poses).rotations[:, 0])
        cosines = (np.einsum("tij,tij->t", turns[1:], turns[:-1]) - 1.0) / 2.0
        return float(np.degrees(np.arccos(np.clip(cosines, -1.0, 1.0))).max())

    steadiness = body.measure_steadiness(body.add_relations(poses))
    assert largest_step(replace(body, steadiness=steadiness)) < 5.0
    assert largest_step(body) > 15.0


def test_units_of_length_matter_only_where_errors_are_small() -> None:
    """A mesh that is twice as large moves twice as far, but for errors below `FLOOR`."""
    poses, parts, times = wandering(6, 3), ring(3), np.arange(12.0)
    here = predicted(TemporalOperator(times), poses, parts, insert_midpoints(times))
    twice = related(parts.pairs, 2 * parts.pivots, 2 * parts.radii, 2 * parts.rest_centres)
    there = predicted(
        TemporalOperator(times), Poses(poses.rotations, 2 * poses.centres), twice, insert_midpoints(times)
    )
    np.testing.assert_allclose(there.centres, 2 * here.centres, atol=1e-4)


@pytest.mark.parametrize("frames", [4, 12])
def test_joints_stay_closed(frames: int) -> None:
    """Each on its own the bones come apart; what they see of each other keeps them together."""
    rng = np.random.default_rng(frames)
    bends, turns = np.cumsum(rng.uniform(-1.5, 1.5, (2, frames)), axis=1)
    poses, bones = two_bones(bends, turns, np.cumsum(rng.normal(scale=0.3, size=(frames, 3)), axis=0))
    assert gaps(poses, bones).max() < 1e-12
    times = np.arange(frames) / 24
    operator, middles = TemporalOperator(times), (times[1:] + times[:-1]) / 2
    alone = gaps(interpolate_poses(operator.weights_at(middles), poses), bones)
    together = gaps(predicted(operator, poses, bones, middles), bones)
    assert alone.mean() > 0.05
    assert together.mean() < 0.6 * alone.mean()
    assert together.max() < alone.max()


def test_an_elbow_that_bends_evenly_is_predicted() -> None:
    """Sparse frames: the forearm's centre is on a circle, of which the spline knows four points."""
    angles = np.radians([0.0, 60.0, 120.0, 180.0])
    poses, bones = two_bones(angles, np.zeros(4), np.zeros((4, 3)))
    operator, middles = TemporalOperator(np.arange(4.0)), np.arange(3.0) + 0.5
    expected, _ = two_bones(np.radians([30.0, 90.0, 150.0]), np.zeros(3), np.zeros((3, 3)))
    alone = interpolate_poses(operator.weights_at(middles), poses)
    together = predicted(operator, poses, bones, middles)
    off = [gaps(found, bones).max() for found in (alone, together)]
    assert off[1] < 0.5 * off[0]
    np.testing.assert_allclose(quat_to_matrix(together.rotations), quat_to_matrix(expected.rotations), atol=5e-3)


def test_parts_that_move_as_one_nearly_stay_as_they_are_to_each_other() -> None:
    """Their relations do not change at all, and weigh as much as errors of `FLOOR` let them."""
    body, parts = wandering(7, 1), ring(3)
    rest = np.random.default_rng(2).normal(size=(3, 3))
    turns = np.repeat(body.rotations, 3, axis=1)
    poses = Poses(turns, rotate_vectors(quat_to_matrix(turns), rest) + body.centres)
    operator, middles = TemporalOperator(np.arange(12.0)), np.arange(11.0) + 0.5

    def away(found: Poses) -> Float:
        back = np.swapaxes(quat_to_matrix(found.rotations[:, :1]), -1, -2)
        seen = rotate_vectors(back, found.centres - found.centres[:, :1])
        return np.asarray(np.linalg.norm(seen - (rest - rest[0]), axis=2)[:, 1:])

    found = predicted(operator, poses, parts, middles)
    assert away(found).mean() < 0.5 * away(interpolate_poses(operator.weights_at(middles), poses)).mean()
    cosines = np.einsum("tpi,ti->tp", found.rotations, found.rotations[:, 0])
    assert cosines.min() > 1 - 1e-8


def test_what_is_still_stays() -> None:
    poses = Poses(*(np.repeat(block[:1], 6, axis=0) for block in wandering(8, 4)))
    times = np.arange(6.0)
    found = predicted(select_operator(times, np.zeros((6, 3))), poses, ring(4), insert_midpoints(times))
    for block, own in zip(found, poses, strict=True):
        np.testing.assert_allclose(block, np.broadcast_to(own[0], block.shape), atol=1e-9)


def test_who_has_no_neighbours_is_alone() -> None:
    poses, operator, middles = wandering(10, 4), TemporalOperator(np.arange(12.0)), np.arange(11.0) + 0.5
    alone = interpolate_poses(operator.weights_at(middles), poses)
    for parts, some in ((strangers(4), slice(None)), (ring(3, alone=1), slice(3, None))):
        found = predicted(operator, poses, parts, middles)
        turns, expected = (quat_to_matrix(each.rotations[:, some]) for each in (found, alone))
        np.testing.assert_allclose(turns, expected, atol=1e-12)
        np.testing.assert_allclose(found.centres[:, some], alone.centres[:, some], atol=1e-12)


def test_one_frame_is_everywhere() -> None:
    poses = wandering(11, 3, 1)
    found = predicted(TemporalOperator(np.array([0.5])), poses, ring(3), np.array([0.0, 0.5, 2.0]))
    turns = quat_to_matrix(found.rotations)
    np.testing.assert_allclose(turns, np.repeat(quat_to_matrix(poses.rotations), 3, axis=0), atol=1e-12)
    np.testing.assert_allclose(found.centres, np.repeat(poses.centres, 3, axis=0), atol=1e-12)


def test_between_two_frames_bones_bend_by_half() -> None:
    """As seen from their body, which turns by half of what both turn by."""
    poses, bones = two_bones(np.radians([0.0, 90.0]), np.zeros(2), np.zeros((2, 3)))
    found = predicted(TemporalOperator(np.array([0.0, 1.0])), poses, bones, np.array([0.5]))
    between = quat_multiply(found.rotations[0, :1] * [1.0, -1, -1, -1], found.rotations[0, 1:])
    np.testing.assert_allclose(quat_to_matrix(between)[0], rotation((np.pi / 4, 0, 0)), atol=1e-9)


def test_many_times_are_predicted_in_blocks() -> None:
    poses, operator = wandering(4, 3), TemporalOperator(np.arange(12.0))
    times = np.linspace(0.01, 10.99, 150)
    whole = predicted(operator, poses, ring(3), times)
    for number in (0, 63, 64, 149):
        single = predicted(operator, poses, ring(3), times[number : number + 1])
        turns, expected = (quat_to_matrix(each) for each in (single.rotations[0], whole.rotations[number]))
        np.testing.assert_allclose(turns, expected, atol=1e-12)
        np.testing.assert_allclose(single.centres[0], whole.centres[number], atol=1e-12)
