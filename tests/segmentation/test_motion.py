"""Segmentation by rigid motion finds the bones of meshes that have some."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.errors import SettingsError
from mixseq.mesh.topology import Topology, face_patches
from mixseq.segmentation import motion
from mixseq.segmentation.motion import MotionSettings, segment_by_motion
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import Float, Index
from tests.meshes import SEQUENCES, bar, bending, grid, joined, rotation, tube


def segmented(sequence: MeshSequence, parts: int | None = None) -> tuple[Topology, Index]:
    topology = Topology(sequence.faces, sequence.vertex_count)
    return topology, segment_by_motion(sequence.points, topology, parts)


def assert_sound(topology: Topology, labels: Index) -> None:
    assert labels.shape == (len(topology.faces),)
    np.testing.assert_array_equal(np.unique(labels), np.arange(labels.max() + 1))
    for part in range(labels.max() + 1):
        assert face_patches(topology, labels == part).max() == 0, "a part is connected across edges"


def test_a_bar_of_two_bones_has_two_parts() -> None:
    mesh = tube(8, 25)
    sequence = MeshSequence.from_arrays(bending(mesh, angle=1.2), mesh[1])
    topology, labels = segmented(sequence)
    assert_sound(topology, labels)
    assert labels.max() == 1
    z = bar(frames=1).points[0][topology.faces].mean(axis=1)[:, 2]
    boundary = topology.hinge_faces[
        (labels[topology.hinge_faces][:, 0] != labels[topology.hinge_faces][:, 1])
    ]
    assert np.abs(z[boundary] - 2.0).max() < 0.5  # bones meet at z = 2 and blend over 0.8
    assert len(set(labels[z < 1.5])) == len(set(labels[z > 2.5])) == 1


def three_bones() -> MeshSequence:
    """A bar that bends at z = 4/3 about x and at z = 8/3 about y, each bone rigid."""
    mesh = tube(6, 25)
    z = mesh[0][:, 2]
    frames = []
    for t in np.linspace(0, 1, 6):
        x = mesh[0].copy()
        for joint, turn in ((8 / 3, rotation((0, t, 0))), (4 / 3, rotation((-0.9 * t, 0, 0)))):
            pivot = np.array([0, 0, joint])
            beyond = z > joint + 1e-9
            x[beyond] = (x[beyond] - pivot) @ turn.T + pivot
        frames.append(x)
    return MeshSequence.from_arrays(np.stack(frames), mesh[1])


def test_three_bones() -> None:
    topology, labels = segmented(three_bones())
    assert_sound(topology, labels)
    assert labels.max() == 2
    z = three_bones().points[0][topology.faces]
    for bone, (low, high) in enumerate(((-1.0, 4 / 3), (4 / 3, 8 / 3), (8 / 3, 5.0))):
        inside = ((z[:, :, 2] > low + 0.2) & (z[:, :, 2] < high - 0.2)).all(axis=1)
        assert len(set(labels[inside])) == 1, f"bone {bone}"


@pytest.mark.parametrize("parts", [1, 2, 3, 5, 8])
def test_as_many_parts_as_asked_for(parts: int) -> None:
    topology, labels = segmented(bar(), parts)
    assert_sound(topology, labels)
    assert labels.max() + 1 == parts


def test_every_component_has_a_part_whatever_is_asked_for() -> None:
    sequence = SEQUENCES["several components"]()
    topology, labels = segmented(sequence, 1)
    assert_sound(topology, labels)
    np.testing.assert_array_equal(
        np.unique(np.stack([labels, topology.component_of_face]), axis=1).shape, (2, 3)
    )


@pytest.mark.parametrize("name", SEQUENCES)
def test_parts_are_sound(name: str) -> None:
    assert_sound(*segmented(SEQUENCES[name]()))


def test_a_sequence_without_motion_has_a_part_for_each_component() -> None:
    mesh = joined(tube(5, 6), tube(6, 4), grid(2, 2))
    points = np.repeat(mesh[0][None], 4, axis=0)
    topology, labels = segmented(MeshSequence.from_arrays(points, mesh[1]))
    np.testing.assert_array_equal(
        np.unique(np.stack([labels, topology.component_of_face]), axis=1)[0], [0, 1, 2]
    )


def test_a_rigid_sequence_is_one_part() -> None:
    mesh = tube(6, 13)
    turns = [rotation((2.0 * t, t, 0.5)) for t in np.linspace(0, 3, 7)]
    points = np.stack([mesh[0] @ r.T + [i, 0, 0] for i, r in enumerate(turns)])
    assert segmented(MeshSequence.from_arrays(points, mesh[1]))[1].max() == 0


def test_many_components() -> None:
    """Eighty tetrahedra that fly apart are eighty parts."""
    rng = np.random.default_rng(4)
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    starts, ways = rng.uniform(-5, 5, (80, 1, 3)), rng.normal(size=(80, 1, 3))
    points = np.stack([(0.3 * corners + starts + t * ways).reshape(-1, 3) for t in range(3)])
    topology, labels = segmented(
        MeshSequence.from_arrays(points, (faces + 4 * np.arange(80)[:, None, None]).reshape(-1, 3))
    )
    assert_sound(topology, labels)
    np.testing.assert_array_equal(np.bincount(labels), np.full(80, 4))


def test_the_result_is_the_same_every_time_and_in_every_unit() -> None:
    sequence = bar()
    topology, labels = segmented(sequence)
    np.testing.assert_array_equal(segmented(sequence)[1], labels)
    for points in (sequence.points * 100.0, sequence.points.astype(np.float32)):
        np.testing.assert_array_equal(segment_by_motion(points, topology), labels)


def test_parts_are_numbered_by_area() -> None:
    sequence = bar()
    topology, labels = segmented(sequence, 5)
    x = sequence.points[0][topology.faces]
    area = 0.5 * np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1)
    of_parts = np.bincount(labels, area)
    assert (np.diff(of_parts) <= 1e-12).all()


def test_a_boundary_needs_its_bend() -> None:
    sequence = bar()
    topology = Topology(sequence.faces, sequence.vertex_count)
    stiff = segment_by_motion(sequence.points, topology, settings=MotionSettings(bend=100.0))
    soft = segment_by_motion(sequence.points, topology, settings=MotionSettings(bend=5.0))
    assert stiff.max() == 0
    assert soft.max() >= 1


def collapsed() -> Float:
    return np.zeros((3, *tube(5, 5)[0].shape))


def test_a_mesh_without_size_is_one_part() -> None:
    topology, labels = segmented(MeshSequence.from_arrays(collapsed(), tube(5, 5)[1]))
    assert_sound(topology, labels)


@pytest.mark.parametrize("parts", [0, -3, 10**6])
def test_the_number_of_parts_is_checked(parts: int) -> None:
    with pytest.raises(SettingsError, match=rf"parts is {parts}; a whole number from 1 to 400 \(the faces\)"):
        segmented(bar(), parts)


def test_large_meshes_have_the_parts_of_others_to_an_edge(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = tube(130, 130)
    sequence = MeshSequence.from_arrays(bending(mesh, angle=1.2), mesh[1])
    topology, expected = segmented(sequence)
    monkeypatch.setattr(motion, "LARGE", 20_000)
    found = segmented(sequence)[1]
    assert_sound(topology, found)
    assert expected.max() == found.max() == 1
    assert np.mean(expected == found) > 0.98
