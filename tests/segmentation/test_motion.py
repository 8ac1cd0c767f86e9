"""Segmentation by rigid motion finds the bones of meshes that have some."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from scipy.spatial.transform import Rotation

from mixseq.errors import SettingsError
from mixseq.mesh.topology import Topology
from mixseq.segmentation import motion
from mixseq.segmentation.motion import Moments, MotionSettings, moments, segment_by_motion, union_errors
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import Float, Index
from tests.meshes import SEQUENCES, bar, bending, grid, joined, rotation, seeds, tube
from tests.segmentation.test_methods import assert_sound


def segmented(sequence: MeshSequence, parts: int | None = None) -> tuple[Topology, Index]:
    topology = Topology(sequence.faces, sequence.vertex_count)
    return topology, segment_by_motion(sequence.points, topology, parts)


def test_a_bar_of_two_bones_has_two_parts() -> None:
    mesh = tube(8, 25)
    sequence = MeshSequence.from_arrays(bending(mesh, angle=1.2), mesh[1])
    topology, labels = segmented(sequence)
    assert_sound(topology, labels)
    assert labels.max() == 1
    z = bar(frames=1).points[0][topology.faces].mean(axis=1)[:, 2]
    boundary = topology.hinge_faces[(labels[topology.hinge_faces][:, 0] != labels[topology.hinge_faces][:, 1])]
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
    np.testing.assert_array_equal(np.unique(np.stack([labels, topology.component_of_face]), axis=1).shape, (2, 3))


@pytest.mark.parametrize("name", SEQUENCES)
def test_parts_are_sound(name: str) -> None:
    assert_sound(*segmented(SEQUENCES[name]()))


def test_a_sequence_without_motion_has_a_part_for_each_component() -> None:
    mesh = joined(tube(5, 6), tube(6, 4), grid(2, 2))
    points = np.repeat(mesh[0][None], 4, axis=0)
    topology, labels = segmented(MeshSequence.from_arrays(points, mesh[1]))
    np.testing.assert_array_equal(np.unique(np.stack([labels, topology.component_of_face]), axis=1)[0], [0, 1, 2])


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
    monkeypatch.setattr(motion, "MAX_FACES_TO_REFINE", 20_000)
    found = segmented(sequence)[1]
    assert_sound(topology, found)
    assert expected.max() == found.max() == 1
    assert np.mean(expected == found) > 0.98


def random_set(rng: np.random.Generator, count: int, frames: int = 4) -> tuple[Float, Float, Float]:
    rest = rng.normal(size=(count, 3))
    moved = np.stack([rest @ rotation(rng.uniform(-2, 2, 3)).T + rng.normal(size=3) for _ in range(frames)])
    moved += 0.2 * rng.normal(size=moved.shape)
    return rest, moved.transpose(1, 0, 2), rng.uniform(0.1, 2.0, count)


def by_scipy(rest: Float, moved: Float, weights: Float) -> float:
    """The same error with SciPy's alignment of centred vectors."""
    error = 0.0
    h = rest - np.average(rest, axis=0, weights=weights)
    for frame in moved.transpose(1, 0, 2):
        x = frame - np.average(frame, axis=0, weights=weights)
        turn = Rotation.align_vectors(x, h, weights=weights)[0].as_matrix()
        error += float(weights @ np.sum((x - h @ turn.T) ** 2, axis=1))
    return error


@settings(max_examples=25, deadline=None)
@given(seed=seeds)
def test_error_is_the_residual_of_the_best_rigid_motion(seed: int) -> None:
    rest, moved, weights = random_set(np.random.default_rng(seed), 7)
    assert moments(rest, moved, weights).error() == pytest.approx(by_scipy(rest, moved, weights), rel=1e-9)


@settings(max_examples=25, deadline=None)
@given(seed=seeds)
def test_motion_has_that_error(seed: int) -> None:
    rest, moved, weights = random_set(np.random.default_rng(seed), 9)
    gathered = moments(rest, moved, weights)
    rotations, translations = gathered.motion()
    np.testing.assert_allclose(np.linalg.det(rotations), 1.0)
    predicted = np.einsum("tij,nj->nti", rotations, rest) + translations
    residual = float(weights @ np.sum((moved - predicted) ** 2, axis=(1, 2)))
    assert gathered.error() == pytest.approx(residual, rel=1e-9)


def test_mirror_images_are_not_rigid() -> None:
    rest = np.random.default_rng(0).normal(size=(8, 3))
    gathered = moments(rest, (rest * [1, 1, -1])[:, None], np.ones(8))
    assert np.linalg.det(gathered.motion()[0][0]) == pytest.approx(1)
    assert gathered.error() == pytest.approx(by_scipy(rest, (rest * [1, 1, -1])[:, None], np.ones(8)))
    assert gathered.error() > 0.1


def test_rigid_motion_has_no_error() -> None:
    rng = np.random.default_rng(1)
    rest = rng.normal(size=(30, 3))
    turns = [rotation(rng.uniform(-3, 3, 3)) for _ in range(5)]
    moved = np.stack([rest @ r.T + [1.0, 2, 3] for r in turns], axis=1)
    gathered = moments(rest, moved, rng.uniform(0.5, 1, 30))
    assert gathered.error() == pytest.approx(0, abs=1e-10)
    np.testing.assert_allclose(gathered.motion()[0], np.stack(turns), atol=1e-10)


@settings(max_examples=15, deadline=None)
@given(seed=seeds)
def test_moments_add_up(seed: int) -> None:
    rest, moved, weights = random_set(np.random.default_rng(seed), 20)
    whole = moments(rest, moved, weights)
    added = moments(rest[:6], moved[:6], weights[:6]) + moments(rest[6:], moved[6:], weights[6:])
    for field in Moments.__dataclass_fields__:
        np.testing.assert_allclose(getattr(added, field), getattr(whole, field), atol=1e-12)
    assert added.error() == pytest.approx(whole.error(), rel=1e-9)


@settings(max_examples=25, deadline=None)
@given(seed=seeds)
def test_errors_of_unions_are_those_of_sums(seed: int) -> None:
    rng = np.random.default_rng(seed)
    one, *others = (moments(*random_set(rng, count)) for count in (4, 1, 7, 2))
    expected = [(one + other).error() for other in others]
    np.testing.assert_allclose(union_errors(one, others), expected, rtol=1e-9)
