"""The source of a transfer."""

from __future__ import annotations

import numpy as np
import pytest

import mixseq
from mixseq.errors import InvalidSequenceError, SegmentationError, SettingsError
from mixseq.retargeting.sources import source_motion
from mixseq.sequence.sequence import MeshSequence
from mixseq.spaces.mixed.mixed_space import MixedSpace
from mixseq.types import FloatArray
from tests.meshes import bar
from tests.retargeting.pairs import furthest

WALK = bar(frames=6)


def still(points: FloatArray) -> MeshSequence:
    return MeshSequence.from_arrays(points[None], WALK.faces)


def test_the_rest_is_a_frame() -> None:
    for rest, frame in ((0, 0), (4, 4), (-1, 5), (np.int64(2), 2)):
        motion = source_motion(WALK, rest)  # type: ignore[arg-type]
        np.testing.assert_array_equal(motion.rest, WALK.points[frame])
    assert motion.rest.dtype == np.float64
    assert motion.header.frame_count == len(motion.points) == 6


def test_the_rest_is_a_mesh_of_any_size() -> None:
    straight = WALK.points[0]
    assert np.array_equal(source_motion(WALK, still(straight)).rest, straight)
    larger = source_motion(WALK, still(7.0 * straight + 1.0)).rest
    # As large as in the motion, but for the little that edges stretch there.
    ratio = np.linalg.norm(np.ptp(larger, axis=0)) / np.linalg.norm(np.ptp(straight, axis=0))
    assert ratio == pytest.approx(1.0, abs=0.02)


def test_a_mesh_of_nearly_the_same_size_is_left_as_it_is() -> None:
    slightly = 1.03 * WALK.points[0]
    assert np.array_equal(source_motion(WALK, still(slightly)).rest, slightly)


def test_of_a_rest_with_many_frames_the_first_counts() -> None:
    rest = MeshSequence.from_arrays(WALK.points[2:4], WALK.faces)
    np.testing.assert_array_equal(source_motion(WALK, rest).rest, WALK.points[2])


def test_edges_without_a_length_do_not_tell_a_size() -> None:
    collapsed = 4.0 * WALK.points[0]
    collapsed[1] = collapsed[0]
    motion = source_motion(WALK, still(collapsed))
    assert np.isfinite(motion.rest).all()
    assert furthest(motion.rest, collapsed / 4) < 0.02 * WALK.diagonal


def test_parts_of_a_mixed_model_are_used() -> None:
    height = WALK.points[0][WALK.faces].mean(axis=1)[:, 2]
    model = mixseq.fit(WALK, parts=np.searchsorted([1.0, 1.7, 3.1], height), exact=True)
    assert isinstance(model.space, MixedSpace)
    motion = source_motion(model)
    own = model.space.decomposition.part_of_face
    assert own.max() == 3
    np.testing.assert_array_equal(motion.part_of_face(), own)
    np.testing.assert_allclose(motion.points[:], model.sample().points, atol=1e-12)
    # Unless others are given.
    assert source_motion(model, parts=np.zeros_like(own)).part_of_face().max() == 0


def test_a_model_of_another_space_has_no_parts() -> None:
    model = mixseq.fit(WALK, space="vertex", exact=True)
    assert source_motion(model).parts is None


def test_parts_are_found_counted_or_given() -> None:
    middle = WALK.points[0][WALK.faces].mean(axis=1)[:, 2]
    assert source_motion(WALK).part_of_face().max() >= 1
    assert source_motion(WALK, parts=3).part_of_face().max() == 2
    given = np.where(middle > 2, 7, 3)
    np.testing.assert_array_equal(source_motion(WALK, parts=given).part_of_face(), np.where(middle > 2, 1, 0))


@pytest.mark.parametrize("rest", [6, -7, 1.0, "0", None, True])
def test_a_frame_that_is_none_is_refused(rest: object) -> None:
    with pytest.raises(
        SettingsError, match=r"rest is .*; a frame from 0 to 5 is expected, or a mesh at rest"
    ):
        source_motion(WALK, rest)  # type: ignore[arg-type]


def test_a_rest_of_another_mesh_is_refused() -> None:
    other = bar(sides=6)
    with pytest.raises(
        InvalidSequenceError,
        match="the mesh at rest has 152 vertices, the motion 202; give the same mesh",
    ):
        source_motion(WALK, other)
    mirrored = MeshSequence.from_arrays(WALK.points, WALK.faces[:, ::-1])
    with pytest.raises(
        InvalidSequenceError,
        match=r"polygon 0 of the motion \(vertices .*\) is the other way round in the mesh",
    ):
        source_motion(WALK, mirrored)


def test_a_rest_may_list_its_faces_in_another_order() -> None:
    """As Blender does, which groups the faces of OBJ files by material."""
    shuffled = MeshSequence.from_arrays(WALK.points[2:3], np.roll(WALK.faces[::-1], 1, axis=1))
    np.testing.assert_array_equal(source_motion(WALK, shuffled).rest, WALK.points[2])


def test_parts_of_another_mesh_are_refused() -> None:
    with pytest.raises(SegmentationError, match="each of the 400 triangles"):
        source_motion(WALK, parts=[0, 1, 2]).part_of_face()


@pytest.mark.parametrize("count", [0, -3])
def test_a_number_of_parts_that_is_none_is_refused(count: int) -> None:
    with pytest.raises(SettingsError, match="part"):
        source_motion(WALK, parts=count).part_of_face()


def test_what_is_no_sequence_is_refused() -> None:
    with pytest.raises(InvalidSequenceError):
        source_motion(WALK.points)  # type: ignore[arg-type]
