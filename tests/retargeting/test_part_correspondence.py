"""Parts of another mesh."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from mixseq.mesh.topology import Topology
from mixseq.retargeting.markers import Correspondence
from mixseq.retargeting.parts import carry_labels, carry_parts, vertex_parts, without_small_regions
from mixseq.segmentation.joints import Decomposition, decompose
from mixseq.types import Index
from tests.meshes import Mesh, grid, joined, rotation, tetrahedron, topology_of, tube
from tests.retargeting.pairs import from_subdivided, same, subdivided, to_subdivided


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
    found = carry_parts(cut, turning(3), same(mesh), topology_of(mesh), mesh[0], 3)
    np.testing.assert_array_equal(found.target.part_of_face, cut.part_of_face)
    assert found.sources.tolist() == [0, 1, 2]
    for own, other in zip(found.target.parts, cut.parts, strict=True):
        np.testing.assert_array_equal(own, other)


def test_a_finer_mesh_is_cut_along_the_same_lines() -> None:
    mesh = tube(8, 25)
    fine = subdivided(mesh)
    cut = halves(mesh, 2.0)
    found = carry_parts(cut, turning(2), to_subdivided(mesh), topology_of(fine), fine[0], 3)
    np.testing.assert_array_equal(found.target.part_of_face, np.repeat(cut.part_of_face, 4))
    assert found.sources.tolist() == [0, 1]
    back = carry_parts(found.target, turning(2), from_subdivided(mesh), topology_of(mesh), mesh[0], 3)
    np.testing.assert_array_equal(back.target.part_of_face, cut.part_of_face)


@pytest.mark.parametrize(("degrees", "strips"), [(5.0, 2), (170.0, 3)])
def test_joints_are_as_wide_as_they_bend(degrees: float, strips: int) -> None:
    mesh = tube(8, 41)
    turns = np.stack([np.eye(3), rotation((np.radians(degrees), 0, 0))])
    seen = np.stack([np.tile(np.eye(3), (2, 1, 1)), turns])
    found = carry_parts(halves(mesh, 2.0), seen, same(mesh), topology_of(mesh), mesh[0], 3)
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
    found = carry_parts(cut, turning(2), replace(correspondence, faces=faces), topology_of(mesh), mesh[0], 3)
    assert found.sources.tolist() == [0, 0, 1]
    assert len(found.target.parts) == 3


def test_what_follows_a_leader_is_of_its_part() -> None:
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
    found = carry_parts(halves(mesh, 2.0), turning(2), correspondence, topology_of(target), target[0], 3)
    assert found.sources.tolist() == [0, 1, 1]
    assert set(found.target.part_of_face[-4:].tolist()) == {2}


def test_triangles_with_a_corner_that_follows_are_of_its_leaders_part() -> None:
    """Only one corner of a triangle is unmatched, and not its first: it counts, whatever the first one is."""
    one = Correspondence.identity(6, 3)
    faces = np.array([[0, 1, 5], [0, 1, 2], [3, 4, 2]])  # vertex 5 follows vertex 3
    corners, leaders = one.corners.copy(), one.leaders.copy()
    corners[5], leaders[5] = -1, 3
    given = replace(one, corners=corners, leaders=leaders, faces=np.array([-1, 1, 2]))
    assert carry_labels(np.array([0, 1, 2]), given, faces).tolist() == [2, 1, 2]
    # Nothing moves a triangle at the leader: the first label.
    alone = replace(given, faces=np.array([-1, 1, -1]))
    assert carry_labels(np.array([0, 1, 2]), alone, faces).tolist() == [0, 1, 0]


def test_vertices_of_no_face_are_a_part_that_follows_the_first() -> None:
    mesh = tube(8, 25)
    points = np.concatenate([mesh[0], [[9.0, 9, 9]]])
    topology = Topology(mesh[1], len(points))
    one = Correspondence.identity(len(points), len(mesh[1]))
    found = carry_parts(decompose(topology, by_height(mesh, 2.0), 3), turning(2), one, topology, points, 3)
    assert found.sources.tolist() == [0, 1, 0]
    assert found.target.parts[2].tolist() == [len(mesh[0])]
    assert vertex_parts(found.target, topology)[-1] == 2


def test_vertices_have_a_part_of_a_face_at_them() -> None:
    mesh = tube(8, 25)
    cut = halves(mesh, 2.0)
    of_vertex = vertex_parts(cut, topology_of(mesh))
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
    np.testing.assert_array_equal(without_small_regions(topology_of(sheet), labels, areas(sheet)), expected)
    assert labels[30] == 1  # what was given is as it was


def test_a_small_part_is_no_small_region() -> None:
    sheet = grid(6, 12)
    labels = np.zeros(len(sheet[1]), dtype=np.int64)
    labels[40] = 1
    np.testing.assert_array_equal(without_small_regions(topology_of(sheet), labels, areas(sheet)), labels)


def test_a_patch_without_a_neighbour_stays() -> None:
    mesh = joined(tube(8, 25), (0.05 * tetrahedron()[0] + [3.0, 0, 0], tetrahedron()[1]))
    labels = by_height(mesh, 2.0)
    labels[-4:] = 1
    np.testing.assert_array_equal(without_small_regions(topology_of(mesh), labels, areas(mesh)), labels)


def test_small_regions_of_small_regions_are_swept() -> None:
    """A small_region within a small_region: the smallest goes first, then what it joined."""
    sheet = grid(16, 16)
    x, y, _ = sheet[0][sheet[1]].mean(axis=1).T
    labels = (x > 8).astype(np.int64)
    clean = labels.copy()
    labels[(abs(x - 4) < 1.5) & (abs(y - 8) < 1.5)] = 1
    labels[(abs(x - 4) < 0.5) & (abs(y - 8) < 0.5)] = 0
    np.testing.assert_array_equal(without_small_regions(topology_of(sheet), labels, areas(sheet)), clean)
