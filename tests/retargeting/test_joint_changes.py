"""Lengths and angles of the target's joints."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.mesh.measures import dihedral_angles, edge_lengths
from mixseq.mesh.nearest import ClosestPointQuery
from mixseq.mesh.rigid import kabsch
from mixseq.mesh.rotations import rotvec_to_matrix
from mixseq.retargeting.joints import EdgewiseMetrics, GradientMetrics, HarmonicSkin, harmonic_weights, limit_bends
from mixseq.retargeting.markers import Correspondence
from mixseq.retargeting.mixed_transfer import MixedTransfer, mixed_transfer
from mixseq.segmentation.joints import make_joint
from mixseq.shells.fitting import Patch, ShellSettings
from mixseq.types import Float
from tests.meshes import Mesh, bent, grid, rotation, topology_of, tube
from tests.retargeting.pairs import furthest, gradients, same

BEND = 1.0
"""Radians by which `arched` turns the end of a tube."""


def test_bends_that_contradict_the_skinned_positions_are_limited() -> None:
    skinned, turns = np.array([0.4, -3.0]), 2 * np.pi * np.arange(-1, 2)[:, None]
    np.testing.assert_allclose(limit_bends(skinned + 1e-3, skinned), skinned + 1e-3, atol=1e-8)
    np.testing.assert_allclose(limit_bends(skinned + turns, skinned), np.tile(skinned, (3, 1)), atol=1e-12)
    folded = [limit_bends(skinned + np.pi + noise, skinned) for noise in (-1e-3, 1e-3)]
    np.testing.assert_allclose(folded, np.stack([skinned, skinned]), atol=1e-5)
    cosine = (np.sqrt(65) - 1) / 8  # of the largest difference, where 4 cos^2 + cos = 4
    largest = np.sqrt(1 - cosine**2) * np.exp(4 * (cosine - 1))
    limited = limit_bends(np.linspace(-np.pi, np.pi, 10_001), np.zeros(10_001))
    assert np.abs(limited).max() == pytest.approx(largest, abs=1e-6)


def arched(points: Float, share: float = 1.0) -> Float:
    """Bend a tube along z in [0, 4] towards y, evenly over a share of it about its middle."""
    start, bent_length = 2.0 - 2.0 * share, 4.0 * share
    along = points[:, 2] - start
    angle = BEND * np.clip(along / bent_length, 0.0, 1.0)
    radius = bent_length / BEND
    before, after = np.minimum(along, 0.0), np.maximum(along - bent_length, 0.0)
    y = radius * (1 - np.cos(angle)) + after * np.sin(angle)
    z = start + before + radius * np.sin(angle) + after * np.cos(angle)
    return np.stack([points[:, 0], y + points[:, 1] * np.cos(angle), z - points[:, 1] * np.sin(angle)], axis=1)


def on(source: Mesh, target: Mesh) -> Correspondence:
    """Closest points of a mesh with nearly the same surface."""
    nearest = ClosestPointQuery.from_mesh(*source)
    points, corners = target[0], target[0][target[1]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    found, faces = nearest.query(points), nearest.query(corners.mean(axis=1), normals)
    return Correspondence(
        (len(source[0]), len(source[1])),
        (len(points), len(corners)),
        source[1][found.faces],
        found.weights,
        faces.faces,
        np.arange(len(points)),
    )


def joined_in_the_middle(source: Mesh, target: Mesh, correspondence: Correspondence) -> MixedTransfer:
    """Two parts, and a joint over most of them."""
    halves = (source[0][source[1]].mean(axis=1)[:, 2] > 2).astype(np.int64)
    frames = np.stack([source[0], bent(source[0], 3.1)])
    made = gradients(source, target, correspondence)
    return mixed_transfer(made, frames, halves, 40, ShellSettings())


def hinges_of(method: MixedTransfer) -> tuple[Float, Float]:
    """Sides ``(H', 3)`` of the stored hinges, and the way ``(H', 3)`` from the centre of one face to the other's."""
    topology, rest = method.gradients.target.topology, method.gradients.target.reference
    a, b, c, d = (rest[corner] for corner in topology.hinges[method.joint_solver.joints.hinge_ids].T)
    return b - a, (d - c) / 3


@pytest.mark.parametrize(("sides", "rings"), [(18, 49), (6, 17), (10, 33)])
def test_joint_angles_measure_most_of_a_bend_at_any_resolution(sides: int, rings: int) -> None:
    """Steiner's measure of a bend, angles times lengths, of the strip of squares at the top and at the bottom.

    Turns of faces are averaged around their corners, so the triangles of a square no longer turn as one.
    """
    source, target = tube(10, 33, radius=0.3), tube(sides, rings, radius=0.3)
    method = joined_in_the_middle(source, target, on(source, target))
    joints, scale = (
        GradientMetrics(method.gradients, method.joint_solver.joints),
        method.gradients.source.scale,
    )
    change = (
        joints.lengths_and_angles(arched(source[0], 0.125) / scale)[1] - joints.lengths_and_angles(source[0] / scale)[1]
    )
    topology = method.gradients.target.topology
    middles = target[0][topology.edges].mean(axis=1)[topology.hinge_edges[method.joint_solver.joints.hinge_ids]]
    width = np.linalg.norm(target[0][1] - target[0][0])
    lengths = np.linalg.norm(hinges_of(method)[0], axis=1) * method.gradients.target.scale
    for top in (-1, 1):
        chosen = (np.abs(middles[:, 0]) < 1e-9) & (top * middles[:, 1] > 0)
        total = np.sum((lengths * change)[chosen]) / width
        assert 0.8 * BEND < -top * total < 1.01 * BEND  # 0.84 to 0.97


@pytest.mark.parametrize(
    ("sides", "rings", "length"), [(18, 49, 4.0), (6, 17, 4.0), (10, 33, 4.0), (18, 49, 7.0), (6, 33, 3.0)]
)
@pytest.mark.parametrize("share", [0.125, 0.25])
def test_a_tube_bends_as_much_in_all_as_its_source(sides: int, rings: int, length: float, share: float) -> None:
    source, target = tube(10, 33, radius=0.3), tube(sides, rings, radius=0.3)
    correspondence = on(source, target)
    longer = target[0] * [1.0, 1.0, length / 4]
    method = joined_in_the_middle(source, (longer, target[1]), correspondence)
    moved = method.transfer_frames(arched(source[0], share)[None])[0]
    ends = (np.flatnonzero(some) for some in (target[0][:, 2] < 0.6, target[0][:, 2] > 3.4))
    first, last = (kabsch(longer[end], moved[end])[0] for end in ends)
    turn = np.arccos((np.trace(first.T @ last) - 1) / 2)
    assert turn == pytest.approx(BEND, rel=5e-3)  # 0.4 % at most
    if length == 4.0:  # it is a copy but for its triangles
        wanted = arched(target[0], share)  # either half may be the root
        turn_back, shift = kabsch(moved, wanted)
        assert furthest(moved @ turn_back.T + shift, wanted) < 0.016 * 4.0  # 0.7 %, and 1.4 % where coarse


@pytest.mark.parametrize(("sides", "rings"), [(30, 65), (14, 17), (18, 33)])
def test_an_even_bend_is_spread_evenly(sides: int, rings: int) -> None:
    """Faces rotate about x in proportion to their distance, hinges by the component along their edge."""
    source, target = tube(18, 33, radius=0.3), tube(sides, rings, radius=0.3)
    method = joined_in_the_middle(source, target, on(source, target))
    joints = GradientMetrics(method.gradients, method.joint_solver.joints)
    lengths, angles = joints.lengths_and_angles(arched(source[0]) / method.gradients.source.scale)
    rest_lengths, rest_angles = joints.lengths_and_angles(method.gradients.source.reference)
    sides_of, ways = hinges_of(method)
    curvature = BEND / 4 * method.gradients.target.scale
    wanted = -curvature * ways[:, 2] * sides_of[:, 0] / np.linalg.norm(sides_of, axis=1)
    wrong = angles - rest_angles - wanted
    assert np.sqrt(np.mean(wrong**2)) < 0.3 * np.sqrt(np.mean(wanted**2))  # 0.26 at most
    # Edges along the tube are as much shorter as they are on its inner side.
    rest, topology = method.gradients.target.reference, method.gradients.target.topology
    edges = rest[topology.edges[method.joint_solver.joints.edge_ids]]
    along = np.linalg.norm(np.diff(edges, axis=1)[:, 0, :2], axis=1) < 1e-9
    stretch = (lengths / rest_lengths)[along] - 1
    bent_in = -curvature * edges[along, 0, 1]
    assert np.abs(stretch - bent_in).max() < 0.1 * np.abs(bent_in).max()


def test_edges_keep_rest_lengths_at_rest() -> None:
    source, target = tube(10, 33), tube(6, 20)
    turned = target[0] * [1.0, 1.0, 1.5] @ rotation((0.0, np.pi / 2, 0.0)).T
    method = joined_in_the_middle(source, (turned, target[1]), on(source, target))
    assert isinstance(method.joint_metrics, GradientMetrics)
    lengths, angles = method.joint_metrics.lengths_and_angles(method.gradients.source.reference)
    topology, rest = method.gradients.target.topology, method.gradients.target.reference
    np.testing.assert_allclose(lengths, edge_lengths(rest, topology.edges[method.joint_solver.joints.edge_ids]))
    np.testing.assert_allclose(
        angles, dihedral_angles(rest, topology.hinges[method.joint_solver.joints.hinge_ids]), atol=1e-9
    )


def test_a_rigid_motion_changes_no_joint_and_a_size_all_lengths() -> None:
    source, target = tube(10, 33), tube(6, 20)
    method = joined_in_the_middle(source, target, on(source, target))
    rest = method.joint_metrics.lengths_and_angles(method.gradients.source.reference)
    moved = method.joint_metrics.lengths_and_angles(
        2.0 * method.gradients.source.reference @ rotation((1.0, -2.0, 0.4)).T + 3.0
    )
    np.testing.assert_allclose(moved[0], 2.0 * rest[0])
    np.testing.assert_allclose(moved[1], rest[1], atol=1e-9)


def same_edges(source: Mesh, target: Mesh) -> tuple[EdgewiseMetrics, MixedTransfer]:
    method = joined_in_the_middle(source, target, same(source))
    assert isinstance(method.joint_metrics, EdgewiseMetrics)
    return method.joint_metrics, method


def test_on_the_same_mesh_joints_are_the_sources() -> None:
    mesh = tube(10, 33)
    joints, method = same_edges(mesh, mesh)
    x = arched(mesh[0]) / method.gradients.source.scale
    lengths, angles = joints.lengths_and_angles(x)
    topology = method.gradients.target.topology
    np.testing.assert_allclose(lengths, edge_lengths(x, topology.edges[method.joint_solver.joints.edge_ids]))
    np.testing.assert_allclose(
        angles, dihedral_angles(x, topology.hinges[method.joint_solver.joints.hinge_ids]), atol=1e-12
    )


def test_on_the_same_triangles_lengths_are_ratios_and_angles_are_differences() -> None:
    source = tube(10, 33)
    target = source[0] * [2.0, 1.5, 1.2], source[1]
    joints, method = same_edges(source, target)
    topology = method.gradients.target.topology
    edges, hinges = (
        topology.edges[method.joint_solver.joints.edge_ids],
        topology.hinges[method.joint_solver.joints.hinge_ids],
    )
    theirs, ours = method.gradients.source.reference, method.gradients.target.reference
    x = arched(source[0]) / method.gradients.source.scale
    lengths, angles = joints.lengths_and_angles(x)
    np.testing.assert_allclose(
        lengths / edge_lengths(ours, edges), edge_lengths(x, edges) / edge_lengths(theirs, edges)
    )
    np.testing.assert_allclose(
        angles - dihedral_angles(ours, hinges),
        dihedral_angles(x, hinges) - dihedral_angles(theirs, hinges),
        atol=1e-12,
    )


def folded(points: Float, angle: float) -> Float:
    """A sheet folded along y = 2 by an angle."""
    upper = points[:, 1] > 2
    result = points.copy()
    pivot = np.array([0.0, 2.0, 0.0])
    result[upper] = (points[upper] - pivot) @ rotation((angle, 0, 0)).T + pivot
    return result


def test_an_angle_changes_the_short_way() -> None:
    """From 170 degrees of a fold to -170 is 20 degrees, whichever angle the target's own fold has."""
    sheet = grid(4, 4)
    topology = topology_of(sheet)
    fold = np.flatnonzero((sheet[0][topology.edges][:, :, 1] == 2).all(axis=1)[topology.hinge_edges])
    rest, own = folded(sheet[0], np.radians(170.0)), folded(sheet[0], np.radians(30.0))

    class Rows:
        edge_ids, hinge_ids = np.zeros(0, dtype=np.int64), fold

    joints = EdgewiseMetrics(topology, Rows(), rest, own)  # type: ignore[arg-type]
    angles = joints.lengths_and_angles(folded(sheet[0], np.radians(190.0)))[1]
    sign = np.sign(dihedral_angles(own, topology.hinges[fold]))
    np.testing.assert_allclose(sign * angles, np.radians(50.0))


def test_a_sharp_fold_shrinks_nothing() -> None:
    """Turns are averaged apart from stretches: means of matrices that differ by 150 degrees are near zero."""
    sheet = grid(20, 4)
    sheet = sheet[0] - [0.0, 8.0, 0.0], sheet[1]
    lower = (sheet[0][sheet[1]].mean(axis=1)[:, 1] > 2).astype(np.int64)
    x = folded(sheet[0], np.radians(150.0))
    method = mixed_transfer(gradients(sheet, sheet), np.stack([sheet[0], x]), lower, 3, ShellSettings())
    joints = GradientMetrics(method.gradients, method.joint_solver.joints)
    edges = method.gradients.target.topology.edges[method.joint_solver.joints.edge_ids]
    assert len(edges)
    lengths = joints.lengths_and_angles(x / method.gradients.source.scale)[0]
    np.testing.assert_allclose(lengths, edge_lengths(method.gradients.target.reference, edges))


def test_an_edge_without_a_length_keeps_the_targets() -> None:
    sheet = grid(1, 1)
    topology = topology_of(sheet)

    class Rows:
        edge_ids, hinge_ids = np.arange(5), np.zeros(0, dtype=np.int64)

    collapsed = sheet[0].copy()
    collapsed[1] = collapsed[0]
    joints = EdgewiseMetrics(topology, Rows(), collapsed, sheet[0])  # type: ignore[arg-type]
    lengths = joints.lengths_and_angles(2.0 * collapsed)[0]
    own = edge_lengths(sheet[0], topology.edges)
    np.testing.assert_allclose(lengths, own * [1.0, 2.0, 2.0, 2.0, 2.0])


# Free vertices that follow the parts around them

SIDES, RINGS = 6, 9
BAR, FACES = tube(SIDES, RINGS, length=8.0, closed=False)
RING = np.arange(SIDES * RINGS) // SIDES
OWNER = np.where(RING < 2, 0, np.where(RING >= RINGS - 2, 4, -1))
"""The ends belong to the parts 0 and 4."""


@pytest.fixture
def patch() -> Patch:
    topology = topology_of((BAR, FACES))
    whole = make_joint(topology, np.ones(len(FACES), dtype=bool), np.zeros(len(BAR), dtype=bool))
    return Patch.from_joint(topology, whole, OWNER >= 0)


def motions(first: Float, last: Float, shift: Float) -> tuple[Float, Float]:
    """Rotation vectors of the parts 0 and 4, and the shift of part 4; the other parts are far away."""
    turns, shifts = np.full((5, 3), 2.0), np.full((5, 3), 1e6)
    turns[0], turns[4], shifts[0], shifts[4] = first, last, 0.0, shift
    return rotvec_to_matrix(turns), shifts


def test_weights_are_harmonic(patch: Patch) -> None:
    """Along a tube they fall evenly from one end to the other; parts elsewhere have none."""
    weights = harmonic_weights(patch, OWNER, 5)
    np.testing.assert_allclose(weights[:, 4], (RING[patch.free_ids] - 1) / (RINGS - 3), atol=1e-12)
    np.testing.assert_allclose(weights[:, 0] + weights[:, 4], 1.0, atol=1e-12)
    assert not weights[:, 1:4].any()


def skin_of(patch: Patch) -> HarmonicSkin:
    return HarmonicSkin(harmonic_weights(patch, OWNER, 5), BAR[patch.free_ids])


def test_a_common_motion_moves_the_joint_rigidly(patch: Patch) -> None:
    turn, shift = np.array([0.3, -1.0, 0.5]), np.zeros(3)
    placed = skin_of(patch).deform(*motions(turn, turn, shift))
    np.testing.assert_allclose(placed, BAR[patch.free_ids] @ rotvec_to_matrix(turn).T, atol=1e-12)


def test_vertices_follow_in_proportion(patch: Patch) -> None:
    skin, shift = skin_of(patch), np.array([0.0, 2.0, 0.0])
    placed = skin.deform(*motions(np.zeros(3), np.zeros(3), shift))
    np.testing.assert_allclose(placed - skin.rest, skin.weights[:, 4:] * shift, atol=1e-12)
