"""Making the mixed space: which faces are joints, what counts there, and whom the space is for."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.choices import PLACEMENTS, PlacementName
from mixseq.errors import SettingsError
from mixseq.mesh.topology import Topology
from mixseq.segmentation.joints import decompose
from mixseq.segmentation.methods import segment_by_labels
from mixseq.segmentation.motion import segment_by_motion
from mixseq.sequence.sequence import MeshSequence
from mixseq.spaces.mixed.construction import (
    FAR_HOLD,
    FAR_RELATIONS,
    FREE_STEPS,
    MAX_STEPS,
    MIN_STEPS,
    REFERENCE_STEP,
    SIZE_REDUCTION,
    Purpose,
    are_far_apart,
    faces_at_winding_hinges,
    faces_without_area,
    midpoint_errors,
    mixed_space,
)
from mixseq.spaces.mixed.mixed_space import MixedSpace, Projection
from mixseq.types import Float, FloatArray
from tests.meshes import SEQUENCES, bar, bent, coarse_walk, grid, topology_of, tube
from tests.spaces.mixed.made import sequence_of, sliced, space_of


def curled() -> MeshSequence:
    """A tube, straight and curled up to a ring: no part of it is rigid."""
    points, faces = tube(8, 41, length=10.0)
    x, y, z = points.T
    frames = []
    for share in (0.0, 0.5, 1.0):
        angle = np.maximum(share * np.pi * z / 10.0, 1e-9)
        radius = z / angle
        spot = np.stack([x, radius * (np.cos(angle) - 1), radius * np.sin(angle)], axis=1)
        frames.append(spot + np.stack([0 * x, y * np.cos(angle), y * np.sin(angle)], axis=1))
    return MeshSequence.from_arrays(np.stack(frames), faces)


CURLED = curled()


def space_for(
    sequence: MeshSequence, parts: int, purpose: Purpose = "sequence", placement: PlacementName = "anchored"
) -> MixedSpace:
    topology = Topology(sequence.faces, sequence.vertex_count)
    labels = segment_by_motion(sequence.points, topology, parts)
    return mixed_space(sequence.points, topology, decompose(topology, labels, 3), placement, purpose)


def share_of_all(space: MixedSpace) -> float:
    """How many times shorter vectors are than those of all lengths and angles."""
    return (len(space.topology.edges) + len(space.topology.hinge_faces)) / space.dim


def test_faces_are_wrong_by_how_far_they_are_off_half_way() -> None:
    """A sheet that stretches evenly, of whose edges only diagonals are off a little, and one that folds."""
    mesh = grid(12, 4)
    frames = np.stack([mesh[0], mesh[0] * [1.0, 1.5, 1.0]])
    topology = topology_of(mesh)
    labels = (mesh[0][mesh[1]].mean(axis=1)[:, 1] > 6).astype(int)
    space = mixed_space(frames, topology, decompose(topology, labels, 2))
    assert midpoint_errors(space, [frames], 0.1, 25.0).max() < 0.06
    folded = np.stack([mesh[0], bent(mesh[0][:, [0, 2, 1]], 2.4, 6.0, 1.0)[:, [0, 2, 1]]])
    space = mixed_space(folded, topology, decompose(topology, labels, 2))
    wrong = midpoint_errors(space, [folded], 0.01, 4.0)
    near = np.abs(mesh[0][mesh[1]].mean(axis=1)[:, 1] - 6.0) < 2.0
    assert wrong[~near].max() < 0.2 < 1.0 < wrong[near].max()
    np.testing.assert_allclose(midpoint_errors(space, [folded], 0.02, 8.0), wrong / 2, rtol=1e-9)


@pytest.mark.parametrize("name", SEQUENCES)
def test_vectors_of_sequences_are_shorter_than_all_lengths_and_angles(name: str) -> None:
    space = space_of(name)
    assert share_of_all(space) >= SIZE_REDUCTION * 0.999 or not space.joint_faces.any()


def test_the_worst_faces_are_joints_within_the_budget() -> None:
    rng = np.random.default_rng(0)
    mesh = tube(8, 33)
    points = np.stack([mesh[0] + noise * rng.normal(size=mesh[0].shape) for noise in (0.0, 0.05, 0.05)])
    topology = topology_of(mesh)
    decomposition = decompose(topology, sliced(mesh, 2.0), 3)
    small = mixed_space(points, topology, decomposition)
    assert 0 < small.joint_faces.sum() < len(mesh[1])
    assert SIZE_REDUCTION * 0.999 <= share_of_all(small) < SIZE_REDUCTION * 1.05
    plain = mixed_space(points, topology, decomposition, purpose="blends")
    wrong = midpoint_errors(small, (points[k : k + 2] for k in range(2)), 0.1, 25.0)
    told, others = (
        small.joint_faces,
        ~small.joint_faces & ~faces_without_area(topology, points) & ~faces_at_winding_hinges(topology, points),
    )
    assert wrong[told].min() >= wrong[others].max() * 0.9
    assert share_of_all(plain) < SIZE_REDUCTION


def test_frames_that_are_near_have_no_steps() -> None:
    for purpose in ("sequence", "reduced"):
        space = space_for(bar(frames=9), 2, purpose)
        assert space.projection == Projection()


def test_frames_that_are_far_apart_have_steps() -> None:
    """But not in reduced models."""
    ends = MeshSequence.from_arrays(CURLED.points[[0, 2]], CURLED.faces)
    far = space_for(ends, 1)
    assert are_far_apart(far, ends.points)
    projection = far.projection
    assert MIN_STEPS <= projection.steps <= MAX_STEPS
    assert (projection.share, projection.hold, projection.relations) == (1.0, FAR_HOLD, FAR_RELATIONS)
    few = space_for(ends, 1, "reduced")
    assert few.projection == Projection() and few.joint_faces.any()


def test_blends_follow_lengths_and_angles_all_the_way() -> None:
    space = space_for(bar(frames=2), 2, "blends")
    assert space.projection.share == 1.0 and space.projection.steps >= MIN_STEPS
    assert space.joint_faces.sum() > space_for(bar(frames=2), 2).joint_faces.sum()


@pytest.mark.parametrize("purpose", ["sequence", "reduced", "blends"])
def test_what_does_not_move_has_no_joints(purpose: Purpose) -> None:
    for name in ("still", "one frame"):
        space = space_of(name, purpose=purpose)
        assert not space.joint_faces.any() and space.block_sizes[:2] == (0, 0)
        assert space.projection.steps == 0


def far(points: FloatArray) -> bool:
    return are_far_apart(space_for(MeshSequence.from_arrays(points, CURLED.faces), 1), points)


def test_steps_between_many_frames_on_the_way_are_not_needed() -> None:
    assert far(CURLED.points[[0, 2]])
    assert not far(np.repeat(CURLED.points[:1], 3, axis=0))
    assert not far(CURLED.points[:1])
    assert not far(walk_like(40))


def walk_like(frames: int) -> Float:
    """The curl in so many frames."""
    weights = np.linspace(0.0, 0.1, frames)[:, None, None]
    return np.asarray((1.0 - weights) * CURLED.points[0] + weights * CURLED.points[1])


def test_triangles_that_lose_their_area_are_no_joints() -> None:
    mesh = tube(6, 17)
    angles = np.linspace(0.0, 2.6, 3)
    points = np.stack([bent(mesh[0], angle) for angle in angles])
    topology = topology_of(mesh)
    decomposition = decompose(topology, sliced(mesh, 2.0), 3)
    sound = mixed_space(points, topology, decomposition, purpose="blends")
    face = int(np.flatnonzero(sound.joint_faces)[7])
    a, b, c = mesh[1][face]
    points[1, c] = (points[1, a] + points[1, b]) / 2
    assert face in np.flatnonzero(faces_without_area(topology, points))
    assert not faces_without_area(topology, points[::2]).any()
    space = mixed_space(points, topology, decomposition, purpose="blends")
    assert not space.joint_faces[faces_without_area(topology, points)].any()
    assert space.joint_faces.any()


def test_mean_shapes_and_reference_are_on_a_grid() -> None:
    """They take few bytes, and frames come back all the same."""
    space = space_of("bar")
    points = sequence_of("bar").points
    for block in (space.shapes, space.reference):
        np.testing.assert_array_equal(np.round(block / REFERENCE_STEP) * REFERENCE_STEP, block)
    np.testing.assert_allclose(space.reference, points[0] / space.scale, atol=REFERENCE_STEP)
    for start, part in zip(
        np.cumsum([0, *map(len, space.decomposition.parts)]), space.decomposition.parts, strict=False
    ):
        np.testing.assert_allclose(space.shapes[start : start + len(part)].mean(axis=0), 0.0, atol=REFERENCE_STEP)


def test_steadiness_is_learned_from_the_frames() -> None:
    """Parts of a mesh that does not move are as steady as can be, the others less."""
    still, moving = space_of("still").steadiness, space_of("bar").steadiness
    assert still is not None and moving is not None
    assert moving.centres.max() < still.centres.min()
    assert moving.relation_turns.max() < still.turns.min()


@pytest.mark.parametrize("name", SEQUENCES)
def test_in_the_free_placement_faces_that_follow_no_part_alone_are_joints(name: str) -> None:
    space = space_of(name, "free")
    corners = space.rigid_part_of_vertex[space.topology.faces]
    mixed = (corners < 0).any(axis=1) | (corners != corners[:, :1]).any(axis=1)
    assert (space.joint_faces >= mixed).all()
    assert space.projection == Projection("free", 1.0, FAR_HOLD, FREE_STEPS, FAR_RELATIONS)


def test_settings_are_checked() -> None:
    sequence = bar(frames=2)
    topology = Topology(sequence.faces, sequence.vertex_count)
    whole = decompose(topology, np.zeros(len(sequence.faces), dtype=np.int64))
    with pytest.raises(SettingsError, match=r"placement is 'loose'; 'anchored' or 'free' is expected"):
        mixed_space(sequence.points, topology, whole, "loose")  # type: ignore[arg-type]


@pytest.mark.parametrize("placement", PLACEMENTS)
def test_progress_is_told(placement: PlacementName) -> None:
    points, space = sequence_of("bar").points, space_of("bar", placement)
    told: list[tuple[int, int, str]] = []
    mixed_space(points, space.topology, space.decomposition, placement, progress=lambda *step: told.append(step))
    assert {what for _, _, what in told} == {"registering parts"}
    assert told[-1][0] == told[-1][1]


@pytest.mark.parametrize("placement", PLACEMENTS)
def test_spaces_are_the_same_whenever_they_are_made(placement: PlacementName) -> None:
    points, space = sequence_of("bar").points, space_of("bar", placement)
    other = mixed_space(points, space.topology, space.decomposition, placement)
    np.testing.assert_array_equal(other.encode(points), space.encode(points))


def test_single_precision_makes_nearly_the_same_space() -> None:
    points = bar().points
    topology = topology_of((points[0], bar().faces.astype(np.int64)))
    labels = segment_by_labels(segment_by_motion(points, topology, 2), topology)
    decomposition = decompose(topology, labels, 3)
    spaces = [mixed_space(x, topology, decomposition) for x in (points, points.astype(np.float32))]
    np.testing.assert_allclose(spaces[0].shapes, spaces[1].shapes, atol=2 * REFERENCE_STEP)
    double, single = (space.skinning_weights.toarray() for space in spaces)
    np.testing.assert_allclose(double, single, atol=1e-2)


def test_the_walk_is_near_and_its_vectors_are_short() -> None:
    space = space_for(coarse_walk(frames=24), 12)
    assert space.projection.steps == 0
    assert share_of_all(space) >= SIZE_REDUCTION


# Hinges that close are no joints: nothing says by how many turns their angles are apart


FLAP = np.array([[0, 1, 2], [1, 0, 3], [2, 1, 4]])


def _flapping(turn: float) -> Float:
    """Turn the second face of `FLAP` by degrees to both sides."""
    frames = []
    for angle in np.radians([-turn, 0.0, turn]):
        flap = [0.5, -np.cos(angle), np.sin(angle)]
        frames.append([[0, 0, 0], [1, 0, 0], [0.5, 1, 0], flap, [1.5, 1, 0]])
    return np.array(frames, dtype=np.float64)


@pytest.mark.parametrize(("turn", "winding"), [(80.0, False), (100.0, True)])
def test_faces_at_hinges_that_turn_by_more_than_half_a_turn_are_marked(turn: float, winding: bool) -> None:
    """A flap beside two faces that lie still."""
    marked = faces_at_winding_hinges(Topology(FLAP, 5), _flapping(turn).astype(np.float32))
    np.testing.assert_array_equal(marked, [winding, winding, False])


def test_blends_keep_lengths_at_hinges_that_wind() -> None:
    """Every face is far off half-way, and those of the flap wind."""
    frames = _flapping(100.0)
    topology = Topology(FLAP, 5)
    decomposition = decompose(topology, np.zeros(3, dtype=int), 3)
    joint_faces = mixed_space(frames, topology, decomposition, purpose="blends").joint_faces
    assert joint_faces[:2].all()
