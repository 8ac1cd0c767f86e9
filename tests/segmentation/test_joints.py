"""Joints and the parts that remain: what always holds, and closed forms on grids and tubes."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixseq.errors import SegmentationError, SettingsError
from mixseq.mesh.measures import degenerate_faces
from mixseq.mesh.topology import Topology, face_patches
from mixseq.segmentation.joints import (
    MIN_MOTION_HEIGHT_RATIO,
    Decomposition,
    PartShapes,
    decompose,
    join_part_motion,
    measure_part_motion,
    sample_frame_ids,
)
from mixseq.segmentation.methods import segment_by_labels
from mixseq.segmentation.motion import segment_by_motion
from mixseq.types import Index
from tests.meshes import SEQUENCES, Mesh, bar, bending, grid, joined, rotation, seeds, tetrahedron, topology_of, tube
from tests.spaces.mixed.made import MESHES


def assert_sound(topology: Topology, decomposition: Decomposition) -> None:
    """Check what holds for all decompositions."""
    holders = np.zeros(topology.vertex_count, dtype=int)
    for part in decomposition.parts:
        assert (np.diff(part) > 0).all()
        assert part.size
        holders[part] += 1
    assert len(decomposition.widths) == len(decomposition.parts)
    free = np.zeros(topology.vertex_count, dtype=int)
    owners = np.zeros(len(topology.faces), dtype=int)
    for joint in decomposition.joints:
        faces = topology.faces[joint.face_ids]
        np.testing.assert_array_equal(joint.vertices, np.unique(faces))
        np.testing.assert_array_equal(joint.vertices[joint.faces], faces)
        np.testing.assert_array_equal(joint.free, holders[joint.vertices] == 0)
        np.testing.assert_array_equal(joint.edge_ids, np.unique(topology.face_edges[joint.face_ids]))
        inside = np.isin(np.arange(len(topology.faces)), joint.face_ids)
        np.testing.assert_array_equal(joint.hinge_ids, np.flatnonzero(inside[topology.hinge_faces].all(axis=1)))
        assert face_patches(topology, inside).max() == 0, "a joint hangs together across hinges"
        held = [np.isin(faces, part).all(axis=1).any() for part in decomposition.parts]
        assert any(held), "one part holds a face of every joint"
        free[joint.vertices[joint.free]] += 1
        owners[joint.face_ids] += 1
    assert owners.max(initial=0) <= 1, "joints share no face"
    np.testing.assert_array_equal(free, np.where(holders > 0, 0, 1), "held by parts, or free in one joint")
    around_free = (holders[topology.faces] == 0).any(axis=1)
    assert (owners[around_free] == 1).all(), "all faces at a free vertex are its joint's"
    np.testing.assert_array_equal(decomposition.joint_of_face >= 0, owners == 1)
    # A face that is in no joint is in one part with all its corners, so that nothing is torn.
    for face in np.flatnonzero(owners == 0):
        assert any(np.isin(topology.faces[face], part).all() for part in decomposition.parts)


@settings(max_examples=40, deadline=None)
@given(
    seed=seeds,
    mesh=st.sampled_from(MESHES),
    count=st.integers(1, 8),
    width=st.integers(1, 5),
    scattered=st.booleans(),
    with_points=st.booleans(),
)
def test_what_always_holds(seed: int, mesh: Mesh, count: int, width: int, scattered: bool, with_points: bool) -> None:
    rng = np.random.default_rng(seed)
    topology = topology_of(mesh)
    centres = mesh[0][mesh[1]].mean(axis=1)
    nearest = ((centres[:, None] - rng.choice(centres, count)) ** 2).sum(axis=2).argmin(axis=1)
    labels = segment_by_labels(rng.integers(0, count, len(mesh[1])) if scattered else nearest, topology)
    points = bending(mesh, frames=3) + 0.05 * rng.normal(size=(3, *mesh[0].shape)) if with_points else None
    decomposition = decompose(topology, labels, width, points)
    assert_sound(topology, decomposition)
    assert len(decomposition.widths) == len(decomposition.parts) == labels.max() + 1
    assert decomposition.widths.min() >= 1
    assert decomposition.widths.max() <= width
    for part, own_width in enumerate(decomposition.widths):
        corners = np.unique(topology.faces[labels == part])
        kept = np.isin(corners, decomposition.parts[part])
        assert kept.sum() >= min(len(corners), max(3, len(corners) / 3)), own_width
    if width == 1:
        assert not any(joint.free.any() for joint in decomposition.joints)


@pytest.mark.parametrize("width", [1, 3])
@pytest.mark.parametrize("name", SEQUENCES)
def test_what_always_holds_on_awkward_sequences(name: str, width: int) -> None:
    sequence = SEQUENCES[name]()
    topology = Topology(sequence.faces, sequence.vertex_count)
    z = sequence.points[0][topology.faces].mean(axis=1)[:, 2]
    labels = segment_by_labels((z > np.median(z)).astype(int), topology)
    assert_sound(topology, decompose(topology, labels, width, sequence.points))


def halves(mesh: Mesh, cut: float, axis: int) -> Index:
    """Faces below and above a plane."""
    return np.asarray(mesh[0][mesh[1]].mean(axis=1)[:, axis] > cut, dtype=np.int64)


@pytest.mark.parametrize("width", [1, 2, 3, 4])
def test_strips_on_a_tube(width: int) -> None:
    """Rings 0 to 24, cut at ring 12: the joint has `width` rings of faces to both sides, parts keep all but
    width - 1 rings, and the rings nearer than width - 1 to the cut are free."""
    mesh = tube(7, 25, length=24.0, closed=False)
    topology = topology_of(mesh)
    decomposition = decompose(topology, halves(mesh, 12.0, 2), width)
    ring = np.arange(len(mesh[0])) // 7
    below, above = (set(ring[part].tolist()) for part in decomposition.parts)
    assert below == set(range(0, 12 - width + 2))
    assert above == set(range(12 + width - 1, 25))
    (joint,) = decomposition.joints
    assert len(joint.face_ids) == 2 * width * 14
    assert set(ring[joint.vertices].tolist()) == set(range(12 - width, 12 + width + 1))
    assert set(ring[joint.vertices[joint.free]].tolist()) == set(range(12 - width + 2, 12 + width - 1))
    assert decomposition.widths.tolist() == [width, width]
    # 7 vertices a ring; 14 edges between rings, 7 within one.
    edges = 2 * width * 14 + (2 * width + 1) * 7
    assert len(joint.edge_ids) == edges
    assert decomposition.paper_dimension == 2 * edges + 3 * 7 * (len(below) + len(above)) + 6


@pytest.mark.parametrize(("angle", "width"), [(5.0, 2), (29.0, 2), (31.0, 3), (61.0, 4), (91.0, 5), (170.0, 5)])
def test_joints_are_as_wide_as_the_sequence_bends(angle: float, width: int) -> None:
    """Two rigid halves: one strip, and one more for each 30 degrees, two at least, joint_width at most."""
    mesh = tube(7, 41, length=40.0, closed=False)
    pivot = np.array([0, 0, 20.0])
    turned = mesh[0].copy()
    beyond = mesh[0][:, 2] > 20.0
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    turned[beyond] = (turned[beyond] - pivot) @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]]).T + pivot
    points = np.stack([mesh[0], turned])
    labels = halves(mesh, 20.0, 2)
    decomposition = decompose(topology_of(mesh), labels, 5, points)
    assert decomposition.widths.max() <= 5
    (joint,) = decomposition.joints
    assert len(joint.face_ids) == 2 * width * 14


def test_one_part_has_no_joint() -> None:
    mesh = tube(6, 7)
    decomposition = decompose(topology_of(mesh), np.zeros(len(mesh[1]), dtype=np.int64), 3)
    assert decomposition.joints == ()
    np.testing.assert_array_equal(decomposition.parts[0], np.arange(len(mesh[0])))
    assert decomposition.paper_dimension == 3 * len(mesh[0]) + 6
    assert (decomposition.joint_of_face == -1).all()


def test_components_that_do_not_touch_have_no_joint() -> None:
    mesh = joined(tube(5, 5), tube(5, 5))
    topology = topology_of(mesh)
    decomposition = decompose(topology, topology.component_of_face.astype(np.int64), 3)
    assert decomposition.joints == ()
    assert [len(part) for part in decomposition.parts] == [27, 27]


def test_coarse_meshes_keep_a_core() -> None:
    """A tube of six rings in three parts: three strips would take all of the middle one."""
    mesh = tube(6, 6, closed=False)
    topology = topology_of(mesh)
    z = mesh[0][mesh[1]].mean(axis=1)[:, 2]
    labels = np.digitize(z, [1.6, 2.4]).astype(np.int64)
    decomposition = decompose(topology, labels, 3)
    assert_sound(topology, decomposition)
    assert decomposition.widths[1] == 1
    for part in range(3):
        corners = np.unique(mesh[1][labels == part])
        assert len(decomposition.parts[part]) >= len(corners) / 3


def test_faces_without_area_are_never_in_a_joint() -> None:
    sequence = SEQUENCES["zero area"]()
    topology = Topology(sequence.faces, sequence.vertex_count)
    labels = segment_by_motion(sequence.points, topology, 4)
    decomposition = decompose(topology, labels, 3, sequence.points)
    assert_sound(topology, decomposition)
    assert decomposition.joints
    for joint in decomposition.joints:
        x = sequence.points[:, topology.faces[joint.face_ids]]
        area = np.linalg.norm(np.cross(x[:, :, 1] - x[:, :, 0], x[:, :, 2] - x[:, :, 0]), axis=2)
        assert area.min() > 1e-6


def test_a_face_that_loses_its_area_in_one_frame_only_counts() -> None:
    sequence = bar()
    topology = Topology(sequence.faces, sequence.vertex_count)
    labels = segment_by_labels((bar(frames=1).points[0][topology.faces].mean(axis=1)[:, 2] > 2).astype(int), topology)
    before = decompose(topology, labels, 3, sequence.points)
    victim = int(before.joints[0].face_ids[40])
    points = sequence.points.copy()
    a, b, c = topology.faces[victim]
    points[3, a] = (points[3, b] + points[3, c]) / 2
    after = decompose(topology, labels, 3, points)
    assert_sound(topology, after)
    assert victim not in np.concatenate([joint.face_ids for joint in after.joints])


def test_a_bowtie_is_held_where_its_halves_touch() -> None:
    """Two sheets that share a corner only; the cut runs through that corner."""
    sheet, faces = grid(6, 6)
    count = len(sheet)
    far, other = sheet + np.array([6.0, 6, 0]), faces + count
    other[other == count] = count - 1  # the corner (6, 6) of one is the corner (0, 0) of the other
    topology = Topology(np.concatenate([faces, other]), 2 * count)
    points = np.concatenate([sheet, far])
    centres = points[topology.faces].mean(axis=1)
    labels = segment_by_labels((centres[:, 0] > centres[:, 1]).astype(int), topology)
    decomposition = decompose(topology, labels, 3)
    assert_sound(topology, decomposition)
    assert len(decomposition.joints) == 2
    assert any(count - 1 in part for part in decomposition.parts)


@pytest.mark.parametrize("other", ["tube", "sheet"])
def test_surfaces_that_touch_in_a_vertex_within_a_joint_are_held_there(other: str) -> None:
    """Around the vertex the joint has two closed fans (tubes), or a closed and an open one (tube and sheet)."""
    ring_12 = 7 * 12
    mesh = tube(7, 25, length=24.0, closed=False)
    if other == "tube":
        second, touching = mesh, ring_12
    else:
        sheet, faces = grid(24, 4)
        second, touching = (sheet[:, [0, 2, 1]], faces), 5 * 12
    points, faces = joined(mesh, second)
    count = len(mesh[0])
    faces[faces == count + touching] = ring_12
    topology = Topology(faces, len(points))
    labels = segment_by_labels(halves((points, faces), 12.0, 2), topology)
    decomposition = decompose(topology, labels, 3)
    assert len(decomposition.joints) == 2
    assert any(ring_12 in part for part in decomposition.parts)
    assert_sound(topology, decomposition)


def test_unused_vertices_are_a_part_of_their_own() -> None:
    sequence = SEQUENCES["unused vertices"]()
    topology = Topology(sequence.faces, sequence.vertex_count)
    decomposition = decompose(topology, segment_by_motion(sequence.points, topology), 3, sequence.points)
    np.testing.assert_array_equal(decomposition.parts[-1], [0, 1, sequence.vertex_count - 1])
    assert_sound(topology, decomposition)


def test_a_width_beyond_the_mesh_is_that_of_the_widest_joint() -> None:
    mesh = tube(6, 13, length=12.0)
    topology = topology_of(mesh)
    labels = segment_by_labels(halves(mesh, 6.0, 2), topology)
    wide, wider = decompose(topology, labels, 20), decompose(topology, labels, 100)
    np.testing.assert_array_equal(wide.joint_of_face, wider.joint_of_face)
    assert_sound(topology, wider)


@pytest.mark.parametrize("width", [0, -1])
def test_the_width_is_checked(width: int) -> None:
    with pytest.raises(SettingsError, match=f"joint_width is {width}; at least 1 strip is needed"):
        decompose(topology_of(tetrahedron()), np.zeros(4, dtype=np.int64), width)


def test_the_number_of_labels_is_checked() -> None:
    with pytest.raises(SegmentationError, match=r"part_of_face has shape \(3,\), the mesh has 4 faces"):
        decompose(topology_of(tetrahedron()), np.zeros(3, dtype=np.int64))


# What is seen of frames: rotations of parts and faces without area, block by block


def test_frames_are_evenly_spread_with_both_ends() -> None:
    assert sample_frame_ids(5).tolist() == [0, 1, 2, 3, 4]
    assert sample_frame_ids(100, 4).tolist() == [0, 33, 66, 99]
    assert sample_frame_ids(1).tolist() == [0]


@pytest.mark.parametrize(("count", "at_most"), [(240, 24), (25, 24), (7, 3)])
def test_frames_looked_at_are_looked_at_again(count: int, at_most: int) -> None:
    """So that a sequence can be cut by these frames alone."""
    chosen = sample_frame_ids(count, at_most)
    assert len(chosen) == at_most
    assert sample_frame_ids(len(chosen), at_most).tolist() == list(range(at_most))


def test_rotations_are_those_of_rigid_parts() -> None:
    mesh = tube(6, 9)
    labels = (mesh[0][mesh[1]].mean(axis=1)[:, 2] > 2.0).astype(np.int64)
    turns = [rotation((0.4 * t, -0.2 * t, 0.1 * t)) for t in range(5)]
    frames = np.stack([mesh[0] @ turn.T + [t, 0, 0] for t, turn in enumerate(turns)])
    seen = measure_part_motion(PartShapes.from_labels(topology_of(mesh), labels, frames[:1]), frames)
    assert seen.rotations.shape == (5, 2, 3, 3)
    for part in range(2):
        np.testing.assert_allclose(seen.rotations[:, part], np.stack(turns), atol=1e-12)
    assert not seen.degenerate_mask.any()


def test_flat_faces_are_those_of_any_frame() -> None:
    sequence = SEQUENCES["zero area"]()
    topology = Topology(sequence.faces, sequence.vertex_count)
    seen = measure_part_motion(
        PartShapes.from_labels(topology, np.zeros(len(topology.faces), int), sequence.points), sequence.points
    )
    expected = degenerate_faces(sequence.points.astype(np.float64), topology.faces, MIN_MOTION_HEIGHT_RATIO).any(axis=0)
    assert expected.any()
    np.testing.assert_array_equal(seen.degenerate_mask, expected)


@pytest.mark.parametrize("size", [1, 2, 5])
def test_blocks_do_not_matter(size: int) -> None:
    sequence = bar(frames=7)
    topology = Topology(sequence.faces, sequence.vertex_count)
    chosen = sequence.points[sample_frame_ids(len(sequence))]
    labels = segment_by_motion(chosen, topology)
    np.testing.assert_array_equal(labels, segment_by_motion(sequence.points, topology))
    watched = pickle.loads(pickle.dumps(PartShapes.from_labels(topology, labels, chosen)))
    whole = measure_part_motion(watched, sequence.points)
    seen = join_part_motion(
        measure_part_motion(watched, sequence.points[start : start + size]) for start in range(0, 7, size)
    )
    np.testing.assert_array_equal(seen.rotations, whole.rotations)
    np.testing.assert_array_equal(seen.degenerate_mask, whole.degenerate_mask)
    at_once, streamed = (decompose(topology, labels, 3, x) for x in (sequence.points, seen))
    np.testing.assert_array_equal(at_once.joint_of_face, streamed.joint_of_face)
    np.testing.assert_array_equal(at_once.widths, streamed.widths)
