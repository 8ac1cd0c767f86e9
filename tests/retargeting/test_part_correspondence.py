"""Parts and joints of the target from those of the source."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from numpy.typing import NDArray

from mixseq.mesh.topology import Topology
from mixseq.retargeting.limbs import ArticulatedBody
from mixseq.retargeting.markers import Correspondence
from mixseq.retargeting.parts import (
    MAX_GAP_CORRECTION_RADII,
    Pivots,
    PivotSolver,
    assign_vertices_to_parts,
    merge_small_regions,
    transfer_labels,
    transfer_parts,
)
from mixseq.segmentation.joints import Decomposition, decompose
from mixseq.types import Float, Index
from tests.meshes import (
    Mesh,
    grid,
    joined,
    rigid_motions,
    rotation,
    seeds,
    tetrahedron,
    topology_of,
    tube,
)
from tests.retargeting.pairs import from_subdivided, gradients, same, subdivided, to_subdivided


def by_height(mesh: Mesh, *heights: float) -> Index:
    """Part of every face: between heights on the z axis."""
    return np.asarray(np.searchsorted(heights, mesh[0][mesh[1]].mean(axis=1)[:, 2]), dtype=np.int64)


def turning(parts: int) -> NDArray[np.float64]:
    """Every part turns by 40 degrees more than that before it."""
    turned = np.stack([rotation((np.radians(40) * part, 0, 0)) for part in range(parts)])
    return np.stack([np.tile(np.eye(3), (parts, 1, 1)), turned])


def halves(mesh: Mesh, *heights: float) -> Decomposition:
    return decompose(topology_of(mesh), by_height(mesh, *heights), 3)


def areas(mesh: Mesh) -> NDArray[np.float64]:
    a, b, c = (mesh[0][corner] for corner in mesh[1].T)
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2)


def test_the_same_mesh_is_cut_the_same_way() -> None:
    mesh = tube(8, 25)
    cut = halves(mesh, 1.5, 3.0)
    found = transfer_parts(cut, turning(3), same(mesh), topology_of(mesh), mesh[0], 3)
    np.testing.assert_array_equal(found.target.part_of_face, cut.part_of_face)
    assert found.source_parts.tolist() == [0, 1, 2]
    for own, other in zip(found.target.parts, cut.parts, strict=True):
        np.testing.assert_array_equal(own, other)


def test_a_finer_mesh_is_cut_along_the_same_lines() -> None:
    mesh = tube(8, 25)
    fine = subdivided(mesh)
    cut = halves(mesh, 2.0)
    found = transfer_parts(cut, turning(2), to_subdivided(mesh), topology_of(fine), fine[0], 3)
    np.testing.assert_array_equal(found.target.part_of_face, np.repeat(cut.part_of_face, 4))
    assert found.source_parts.tolist() == [0, 1]
    back = transfer_parts(found.target, turning(2), from_subdivided(mesh), topology_of(mesh), mesh[0], 3)
    np.testing.assert_array_equal(back.target.part_of_face, cut.part_of_face)


@pytest.mark.parametrize(("degrees", "strips"), [(5.0, 2), (170.0, 3)])
def test_joints_are_as_wide_as_they_bend(degrees: float, strips: int) -> None:
    mesh = tube(8, 41)
    turns = np.stack([np.eye(3), rotation((np.radians(degrees), 0, 0))])
    seen = np.stack([np.tile(np.eye(3), (2, 1, 1)), turns])
    found = transfer_parts(halves(mesh, 2.0), seen, same(mesh), topology_of(mesh), mesh[0], 3)
    (joint,) = found.target.joints
    assert len(joint.face_ids) == 2 * strips * 16  # a strip is a ring of sixteen triangles


def test_a_part_in_two_places_is_two_parts() -> None:
    """Both ends of a tube correspond to one end of the source."""
    mesh = tube(8, 25)
    cut = halves(mesh, 1.0)
    upper = np.flatnonzero(by_height(mesh, 1.0, 3.0) == 2)
    correspondence = same(mesh)
    lowest = int(np.flatnonzero(cut.part_of_face == 0)[0])
    faces = correspondence.faces.copy()
    faces[upper] = lowest
    found = transfer_parts(cut, turning(2), replace(correspondence, faces=faces), topology_of(mesh), mesh[0], 3)
    assert found.source_parts.tolist() == [0, 0, 1]
    assert len(found.target.parts) == 3


def test_followers_belong_to_the_part_of_their_leader() -> None:
    mesh, hat = tube(8, 25), tetrahedron()
    target = joined(mesh, (hat[0] + [5.0, 0, 0], hat[1]))
    one, count = same(mesh), len(mesh[0])
    leader = 8 * 23  # in the upper part
    correspondence = Correspondence(
        one.source_size,
        (count + 4, len(mesh[1]) + 4),
        np.concatenate([one.corners, np.full((4, 3), -1)]),
        np.concatenate([one.weights, np.zeros((4, 3))]),
        np.concatenate([one.faces, np.full(4, -1)]),
        np.concatenate([one.leaders, np.full(4, leader)]),
    )
    found = transfer_parts(halves(mesh, 2.0), turning(2), correspondence, topology_of(target), target[0], 3)
    assert found.source_parts.tolist() == [0, 1, 1]
    assert set(found.target.part_of_face[-4:].tolist()) == {2}


def test_triangles_with_a_corner_that_follows_are_of_its_leaders_part() -> None:
    """Only one corner of a triangle is unmatched, and not its first: it counts, whatever the first one is."""
    one = Correspondence.identity(6, 3)
    faces = np.array([[0, 1, 5], [0, 1, 2], [3, 4, 2]])  # vertex 5 follows vertex 3
    corners, leaders = one.corners.copy(), one.leaders.copy()
    corners[5], leaders[5] = -1, 3
    given = replace(one, corners=corners, leaders=leaders, faces=np.array([-1, 1, 2]))
    assert transfer_labels(np.array([0, 1, 2]), given, faces).tolist() == [2, 1, 2]
    # Nothing moves a triangle at the leader: the first label.
    alone = replace(given, faces=np.array([-1, 1, -1]))
    assert transfer_labels(np.array([0, 1, 2]), alone, faces).tolist() == [0, 1, 0]


def test_vertices_of_no_face_are_a_part_that_follows_the_first() -> None:
    mesh = tube(8, 25)
    points = np.concatenate([mesh[0], [[9.0, 9, 9]]])
    topology = Topology(mesh[1], len(points))
    one = Correspondence.identity(len(points), len(mesh[1]))
    found = transfer_parts(decompose(topology, by_height(mesh, 2.0), 3), turning(2), one, topology, points, 3)
    assert found.source_parts.tolist() == [0, 1, 0]
    assert found.target.parts[2].tolist() == [len(mesh[0])]
    assert assign_vertices_to_parts(found.target, topology)[-1] == 2


def test_vertices_have_a_part_of_a_face_at_them() -> None:
    mesh = tube(8, 25)
    cut = halves(mesh, 2.0)
    of_vertex = assign_vertices_to_parts(cut, topology_of(mesh))
    assert of_vertex[0] == of_vertex[-2] == 0
    assert of_vertex[-3] == of_vertex[-1] == 1
    for vertex, part in enumerate(of_vertex.tolist()):
        assert part in cut.part_of_face[(mesh[1] == vertex).any(axis=1)]


def test_small_regions_join_the_neighbour_they_share_most_with() -> None:
    sheet = grid(6, 12)
    labels = (sheet[0][sheet[1]].mean(axis=1)[:, 0] > 6).astype(np.int64)
    clean = labels.copy()
    labels[30] = 1  # one triangle in the middle of part 0
    labels[[4, 5]] = 2  # part 2 is a larger patch elsewhere
    labels[100:110] = 2
    expected = clean.copy()
    expected[100:110] = 2
    expected[[4, 5]] = 2  # two of ten are no small_region
    np.testing.assert_array_equal(merge_small_regions(topology_of(sheet), labels, areas(sheet)), expected)
    assert labels[30] == 1  # what was given is as it was


def test_a_small_part_is_no_small_region() -> None:
    sheet = grid(6, 12)
    labels = np.zeros(len(sheet[1]), dtype=np.int64)
    labels[40] = 1
    np.testing.assert_array_equal(merge_small_regions(topology_of(sheet), labels, areas(sheet)), labels)


def test_a_patch_without_a_neighbour_stays() -> None:
    mesh = joined(tube(8, 25), (0.05 * tetrahedron()[0] + [3.0, 0, 0], tetrahedron()[1]))
    labels = by_height(mesh, 2.0)
    labels[-4:] = 1
    np.testing.assert_array_equal(merge_small_regions(topology_of(mesh), labels, areas(mesh)), labels)


def test_small_regions_of_small_regions_are_swept() -> None:
    """A small region within a small region: the smallest is merged first, then the merged one."""
    sheet = grid(16, 16)
    x, y, _ = sheet[0][sheet[1]].mean(axis=1).T
    labels = (x > 8).astype(np.int64)
    clean = labels.copy()
    labels[(abs(x - 4) < 1.5) & (abs(y - 8) < 1.5)] = 1
    labels[(abs(x - 4) < 0.5) & (abs(y - 8) < 0.5)] = 0
    np.testing.assert_array_equal(merge_small_regions(topology_of(sheet), labels, areas(sheet)), clean)


# Parts that hang together by pivots


def body(seed: int, extra: int = 0, parts: int = 7) -> tuple[PivotSolver, Float, Float]:
    """A random tree of parts, with some loops; rotations of its parts and gaps at its pivots."""
    rng = np.random.default_rng(seed)
    order = rng.permutation(parts)
    pairs = [(order[k], order[rng.integers(k)]) for k in range(1, parts)]
    pairs += [tuple(rng.choice(parts, 2, replace=False)) for _ in range(extra)]
    count = len(pairs)
    pivots, centres = rng.normal(size=(count, 3)), rng.normal(size=(parts, 3))
    made = PivotSolver(
        ArticulatedBody(centres, np.array(pairs), pivots, int(rng.integers(parts))),
        rng.uniform(0.5, 2.0, count),
        rng.uniform(0.1, 1.0, count),
    )
    turns = np.stack([rotation(vector) for vector in 2 * rng.normal(size=(parts, 3))])
    return made, turns, 0.3 * rng.normal(size=(count, 3))


def test_an_elbow_by_hand() -> None:
    ends = np.array([[0.5, 0, 0], [1.75, 0, 0]])
    arm = PivotSolver(ArticulatedBody(ends, np.array([[0, 1]]), np.array([[1.0, 0, 0]]), 0), np.ones(1), np.ones(1))
    turns = np.stack([np.eye(3), rotation((0, 0, np.pi / 2))])
    bent = arm.solve_centres(turns, np.zeros((1, 3)), np.array([0.5, 0, 0]))
    np.testing.assert_allclose(bent, [[0.5, 0, 0], [1.0, 0.75, 0]], atol=1e-12)
    # The first part is away from the second by the gap.
    opened = arm.solve_centres(turns, np.array([[0, 0, 0.1]]), np.array([0.5, 1, 0]))
    np.testing.assert_allclose(opened, [[0.5, 1, 0], [1.0, 1.75, -0.1]], atol=1e-12)


@given(seeds)
@settings(max_examples=30, deadline=None)
def test_a_tree_has_exactly_the_gaps_it_should(seed: int) -> None:
    tree, turns, gaps = body(seed)
    root = np.array([5.0, -2.0, 1.0])
    placed = tree.solve_centres(turns, gaps, root)
    assert np.array_equal(placed[tree.body.root], root)
    np.testing.assert_allclose(tree.body.gaps(turns, placed), gaps, atol=1e-10)


@given(seeds)
@settings(max_examples=30, deadline=None)
def test_loops_are_solved_by_least_squares(seed: int) -> None:
    """Weighted by the squares of the lengths of boundaries."""
    loops, turns, gaps = body(seed, extra=4)
    root = np.array([1.0, 2.0, 3.0])
    placed = loops.solve_centres(turns, gaps, root)
    # Gaps are affine in the centres: of these the matrix and the rest, one number at a time.
    still = np.zeros((7, 3))
    still[loops.body.root] = root
    others = [part for part in range(7) if part != loops.body.root]
    matrix = np.stack(
        [
            loops.body.gaps(turns, still + np.outer(np.arange(7) == part, [1.0, 0, 0]))[:, 0]
            - loops.body.gaps(turns, still)[:, 0]
            for part in others
        ],
        axis=1,
    )
    weights = loops.lengths[:, None]
    wanted = np.linalg.lstsq(weights * matrix, weights * (gaps - loops.body.gaps(turns, still)), rcond=None)[0]
    np.testing.assert_allclose(placed[others], wanted, atol=1e-9)


@given(seeds, rigid_motions)
@settings(max_examples=30, deadline=None)
def test_a_rigid_motion_of_the_world_moves_all_parts(seed: int, motion: tuple[Float, Float]) -> None:
    turn, shift = motion
    loops, turns, gaps = body(seed, extra=3)
    root = np.array([1.0, 0.5, -0.5])
    placed = loops.solve_centres(turns, gaps, root)
    moved = loops.solve_centres(turn @ turns, gaps @ turn.T, turn @ root + shift)
    np.testing.assert_allclose(moved, placed @ turn.T + shift, atol=1e-9)


def test_at_rest_parts_are_at_rest() -> None:
    loops, turns, gaps = body(3, extra=3)
    turns = np.tile(np.eye(3), (7, 1, 1))
    np.testing.assert_allclose(loops.body.gaps(turns, loops.body.centres), 0.0, atol=1e-12)
    placed = loops.solve_centres(turns, np.zeros_like(gaps), loops.body.centres[loops.body.root])
    np.testing.assert_allclose(placed, loops.body.centres, atol=1e-10)


def test_a_single_part_has_the_given_centre() -> None:
    none = np.zeros(0)
    one = ArticulatedBody(np.ones((1, 3)), np.zeros((0, 2), dtype=np.int64), np.zeros((0, 3)), 0)
    alone = PivotSolver(one, none, none)
    placed = alone.solve_centres(np.eye(3)[None], np.zeros((0, 3)), np.array([3.0, 4, 5]))
    assert placed.tolist() == [[3.0, 4, 5]]
    assert alone.body.gaps(np.eye(3)[None], placed).shape == (0, 3)


def test_boundaries_of_zero_length_keep_parts_together() -> None:
    tree, turns, gaps = body(4)
    thin = replace(tree, lengths=tree.lengths * (np.arange(6) % 2), radii=np.zeros(6))
    placed = thin.solve_centres(turns, gaps, np.ones(3))
    np.testing.assert_allclose(thin.body.gaps(turns, placed), gaps, atol=1e-9)


def test_gaps_stay_within_the_reach_of_their_boundaries() -> None:
    tree, _, gaps = body(5)
    smooth = np.random.default_rng(0).normal(size=gaps.shape)
    np.testing.assert_allclose(tree.limit_gaps(smooth, smooth), smooth)
    reach = MAX_GAP_CORRECTION_RADII * tree.radii
    for size in (1e-4, 1.0, 1e4):
        away = tree.limit_gaps(smooth + size * gaps, smooth) - smooth
        assert (np.linalg.norm(away, axis=1) <= np.minimum(reach, size * np.linalg.norm(gaps, axis=1))).all()
        # Along the difference, and nearly it where it is small.
        np.testing.assert_allclose(np.cross(away, gaps), 0.0, atol=1e-9)
    small = tree.limit_gaps(smooth + 1e-5 * gaps, smooth) - smooth
    np.testing.assert_allclose(small, 1e-5 * gaps, rtol=1e-4)
    rigid = replace(tree, radii=np.zeros(len(gaps)))
    np.testing.assert_allclose(rigid.limit_gaps(gaps, smooth), smooth)
    # Pieces that nothing but a vertex holds may be far away.
    np.testing.assert_allclose(rigid.limit_gaps(1e6 * gaps, smooth), smooth)
    np.testing.assert_array_equal(rigid.limit_gaps(smooth, smooth), smooth)


def test_two_bones_and_an_eye() -> None:
    """The bones meet in an octagon, the eye is held by a vertex."""
    mesh = joined(tube(8, 33, radius=0.3), (0.1 * tetrahedron()[0] + [0.0, 0.45, 3.5], tetrahedron()[1]))
    points, faces = mesh
    labels = (points[faces].mean(axis=1)[:, 2] > 2).astype(np.int64)
    labels[-4:] = 2
    pivots = Pivots.from_decomposition(gradients(mesh, mesh), decompose(topology_of(mesh), labels, 3))
    assert pivots.pairs.tolist() == [[0, 1], [2, 1]]
    middle, held = pivots.points(points)
    np.testing.assert_allclose(middle, [0.0, 0.0, 2.0], atol=1e-12)
    assert (points[-4:] == held).all(axis=1).any()
    lengths, radii = pivots.boundary_sizes(points)
    np.testing.assert_allclose(lengths, [8 * 0.6 * np.sin(np.pi / 8), 0.0])
    np.testing.assert_allclose(radii, [0.3 * np.cos(np.pi / 8), 0.0])
