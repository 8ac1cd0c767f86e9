"""The source of a transfer."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mixseq
from mixseq.compression.compressed_model import CompressedModel
from mixseq.compression.numbering import walk_numbering
from mixseq.errors import InvalidSequenceError, MixseqWarning, SegmentationError, SettingsError
from mixseq.mesh.rigid import kabsch
from mixseq.retargeting.sources import Alignment, _quarter_turns, fit_alignment, prepare_source
from mixseq.sequence.sequence import MeshSequence, load_frames
from mixseq.spaces.making import make_space
from mixseq.spaces.mixed.mixed_space import MixedSpace, as_mixed
from mixseq.types import Float, FloatArray
from tests.meshes import bar, coarse_walk, grid, rigid_motions, rotation, seeds, tube
from tests.retargeting.pairs import furthest

WALK = bar(frames=6)


def still(points: FloatArray) -> MeshSequence:
    return MeshSequence.from_arrays(points[None], WALK.faces)


def test_the_rest_is_a_frame() -> None:
    for rest, frame in ((0, 0), (4, 4), (-1, 5), (np.int64(2), 2)):
        motion = prepare_source(WALK, rest)  # type: ignore[arg-type]
        np.testing.assert_array_equal(motion.rest, WALK.points[frame])
    assert motion.rest.dtype == np.float64
    assert motion.header.frame_count == len(motion.points) == 6


def test_the_rest_is_a_mesh_of_any_size() -> None:
    straight = WALK.points[0]
    assert np.array_equal(prepare_source(WALK, still(straight)).rest, straight)
    larger = prepare_source(WALK, still(7.0 * straight + 1.0)).rest
    # As large as in the motion, but for the little that edges stretch there.
    ratio = np.linalg.norm(np.ptp(larger, axis=0)) / np.linalg.norm(np.ptp(straight, axis=0))
    assert ratio == pytest.approx(1.0, abs=0.02)


def test_nearly_equal_sizes_are_not_rescaled() -> None:
    slightly = 1.03 * WALK.points[0]
    assert np.array_equal(prepare_source(WALK, still(slightly)).rest, slightly)


def test_of_a_rest_with_many_frames_the_first_counts() -> None:
    rest = MeshSequence.from_arrays(WALK.points[2:4], WALK.faces)
    np.testing.assert_array_equal(prepare_source(WALK, rest).rest, WALK.points[2])


def test_zero_length_edges_are_ignored_in_scale() -> None:
    collapsed = 4.0 * WALK.points[0]
    collapsed[1] = collapsed[0]
    motion = prepare_source(WALK, still(collapsed))
    assert np.isfinite(motion.rest).all()
    assert furthest(motion.rest, collapsed / 4) < 0.02 * WALK.diagonal


def test_parts_of_a_mixed_model_are_used() -> None:
    height = WALK.points[0][WALK.faces].mean(axis=1)[:, 2]
    model = mixseq.fit(WALK, parts=np.searchsorted([1.0, 1.7, 3.1], height), exact=True)
    assert isinstance(model.space, MixedSpace)
    motion = prepare_source(model)
    own = model.space.decomposition.part_of_face
    assert own.max() == 3
    np.testing.assert_array_equal(motion.part_of_face(), own)
    np.testing.assert_allclose(motion.points[:], model.sample().points, atol=1e-12)
    # Unless others are given.
    assert prepare_source(model, parts=np.zeros_like(own)).part_of_face().max() == 0


def test_a_model_of_another_space_has_no_parts() -> None:
    model = mixseq.fit(WALK, space="vertex", exact=True)
    assert prepare_source(model).parts is None


def test_parts_are_found_counted_or_given() -> None:
    middle = WALK.points[0][WALK.faces].mean(axis=1)[:, 2]
    assert prepare_source(WALK).part_of_face().max() >= 1
    assert prepare_source(WALK, parts=3).part_of_face().max() == 2
    given = np.where(middle > 2, 7, 3)
    np.testing.assert_array_equal(prepare_source(WALK, parts=given).part_of_face(), np.where(middle > 2, 1, 0))


@pytest.mark.parametrize("rest", [6, -7, 1.0, "0", None, True])
def test_missing_rest_frames_are_refused(rest: object) -> None:
    with pytest.raises(SettingsError, match=r"rest is .*; a frame from 0 to 5 is expected, or a mesh at rest"):
        prepare_source(WALK, rest)  # type: ignore[arg-type]


def test_a_rest_of_another_mesh_is_refused() -> None:
    other = bar(sides=6)
    with pytest.raises(
        InvalidSequenceError, match="the mesh at rest has 152 vertices, the motion 202; give the same mesh"
    ):
        prepare_source(WALK, other)
    mirrored = MeshSequence.from_arrays(WALK.points, WALK.faces[:, ::-1])
    with pytest.raises(InvalidSequenceError, match=r"polygon 0 of the motion \(vertices .*\) is flipped in the mesh"):
        prepare_source(WALK, mirrored)


def test_a_rest_may_list_its_faces_in_another_order() -> None:
    """As Blender does, which groups the faces of OBJ files by material."""
    shuffled = MeshSequence.from_arrays(WALK.points[2:3], np.roll(WALK.faces[::-1], 1, axis=1))
    np.testing.assert_array_equal(prepare_source(WALK, shuffled).rest, WALK.points[2])


def test_parts_of_another_mesh_are_refused() -> None:
    with pytest.raises(SegmentationError, match="each of the 400 triangles"):
        prepare_source(WALK, parts=[0, 1, 2]).part_of_face()


@pytest.mark.parametrize("count", [0, -3])
def test_invalid_part_counts_are_refused(count: int) -> None:
    with pytest.raises(SettingsError, match="part"):
        prepare_source(WALK, parts=count).part_of_face()


def test_invalid_sources_are_refused() -> None:
    with pytest.raises(InvalidSequenceError):
        prepare_source(WALK.points)  # type: ignore[arg-type]


# How a target stands to its source

QUARTER = rotation((np.pi / 2, 0, 0))


def angle(a: Float, b: Float) -> float:
    """Between two rotations, in degrees."""
    return float(np.degrees(2 * np.arcsin(min(1.0, np.linalg.norm(a - b) / np.sqrt(8)))))


def cloud(seed: int, count: int = 40) -> Float:
    return np.random.default_rng(seed).normal(size=(count, 3)) * [3.0, 2.0, 1.0]


@given(rigid_motions, st.floats(0.01, 100.0), seeds)
@settings(max_examples=50, deadline=None)
def test_alignment_recovers_rotation_and_scale(motion: tuple[Float, Float], scale: float, seed: int) -> None:
    turn, shift = motion
    source = cloud(seed)
    weights = np.random.default_rng(seed).uniform(0.1, 1.0, len(source))
    found = fit_alignment(source, scale * source @ turn.T + shift, weights)
    np.testing.assert_allclose(found.rotation, turn, atol=1e-9)
    assert found.scale == pytest.approx(scale, rel=1e-12)


@pytest.mark.parametrize("number", range(24))
def test_slight_rotations_between_bodies_are_ignored(number: int) -> None:
    turn = _quarter_turns()[number]
    source = cloud(3, 200)
    # A hump and a neck: as if the body leant, although it stands upright.
    other = source * [1.0, 1.4, 0.7] + 0.25 * source[:, [1]] * [1.0, 0.0, 0.0]
    best = kabsch(source, other)[0]
    assert 2.0 < angle(best, np.eye(3)) < 20.0
    assert np.array_equal(fit_alignment(source, other @ turn.T, np.ones(200)).rotation, turn)


def test_a_body_that_is_clearly_turned_is_not_straightened() -> None:
    turn = rotation((0.0, np.radians(35.0), 0.0))
    source = cloud(1, 200)
    other = (source * [1.0, 1.1, 0.9]) @ turn.T
    assert angle(fit_alignment(source, other, np.ones(200)).rotation, turn) < 5.0


@given(seeds)
@settings(max_examples=30, deadline=None)
def test_a_mirrored_body_is_turned_and_not_mirrored(seed: int) -> None:
    source = cloud(seed)
    found = fit_alignment(source, source * [-1.0, 1.0, 1.0], np.ones(len(source)))
    assert np.linalg.det(found.rotation) == pytest.approx(1.0)
    np.testing.assert_allclose(found.rotation @ found.rotation.T, np.eye(3), atol=1e-12)


@given(seeds)
@settings(max_examples=30, deadline=None)
def test_exchanged_meshes_have_the_inverse_scale(seed: int) -> None:
    source, target = cloud(seed), 2.5 * cloud(seed + 1) + 7.0
    weights = np.random.default_rng(seed).uniform(size=len(source))
    there, back = fit_alignment(source, target, weights), fit_alignment(target, source, weights)
    assert there.scale * back.scale == pytest.approx(1.0, rel=1e-12)


def test_points_without_weight_are_ignored() -> None:
    source = cloud(5)
    target = 2.0 * source @ QUARTER.T
    target[::2] += 50.0
    found = fit_alignment(source, target, np.arange(len(source)) % 2 * np.float64(1.0))
    np.testing.assert_allclose(found.rotation, QUARTER, atol=1e-12)
    assert found.scale == pytest.approx(2.0)


@pytest.mark.parametrize("points", [grid(3, 4)[0], tube(6, 5)[0], np.outer([0.0, 1, 3], [1.0, 2, 2])])
def test_sheets_tubes_and_lines_are_not_rotated(points: Float) -> None:
    """Whatever the points leave free is not turned."""
    found = fit_alignment(points, 3.0 * points, np.ones(len(points)))
    np.testing.assert_allclose(found.rotation, np.eye(3), atol=1e-7)
    assert found.scale == pytest.approx(3.0)


def test_the_quarter_turns_are_24_rotations() -> None:
    turns = np.stack(_quarter_turns())
    assert len(np.unique(turns, axis=0)) == 24
    np.testing.assert_array_equal(turns @ np.swapaxes(turns, 1, 2), np.tile(np.eye(3), (24, 1, 1)))
    np.testing.assert_allclose(np.linalg.det(turns), 1.0)


def test_alignment_maps_vectors_and_matrices() -> None:
    alignment = Alignment(QUARTER, 2.0)
    np.testing.assert_allclose(alignment.map_vectors(np.array([[1.0, 2, 3]])), [[2.0, -6, 4]], atol=1e-12)
    # A turn about y is one about z, where y points there.
    np.testing.assert_allclose(
        alignment.rotate_matrices(rotation((0, 0.3, 0))[None]), [rotation((0, 0, 0.3))], atol=1e-12
    )


def test_points_in_one_place_are_refused() -> None:
    points, place = cloud(2), np.ones((40, 3))
    with pytest.raises(InvalidSequenceError, match="of the source are in one place"):
        fit_alignment(place, points, np.ones(40))
    with pytest.raises(InvalidSequenceError, match="of the target are in one place"):
        fit_alignment(points, place, np.ones(40))
    with pytest.raises(InvalidSequenceError, match="no area at rest"):
        fit_alignment(points, points, np.zeros(40))


def test_a_rest_may_have_the_numbers_of_a_compressed_file() -> None:
    rest = MeshSequence.from_arrays(WALK.points[2:3], WALK.faces)
    free = walk_numbering(WALK.polygons, [WALK.vertex_count], vertices=True)
    assert free.order == "free"
    renumbered = free.renumber_frames(rest)
    assert isinstance(renumbered, MeshSequence)
    with pytest.warns(MixseqWarning, match="^vertices of .* have other numbers in"):
        np.testing.assert_array_equal(prepare_source(WALK, renumbered).rest, WALK.points[2])
    with pytest.warns(MixseqWarning, match="^vertices of .* have other numbers in"):
        np.testing.assert_array_equal(prepare_source(free.renumber_frames(WALK), rest).rest, renumbered.points[0])


def test_parts_of_a_sequence_are_those_of_its_model() -> None:
    """A rest among the frames is no further pose, which would weigh twice."""
    walk = coarse_walk(frames=6)
    expected = as_mixed(make_space(load_frames(walk))).decomposition.part_of_face
    np.testing.assert_array_equal(prepare_source(walk).part_of_face(), expected)
    np.testing.assert_array_equal(prepare_source(walk, rest=5).part_of_face(), expected)


@pytest.mark.slow
@pytest.mark.realdata
def test_a_compressed_file_moves_a_stretched_body_as_its_original(data: Path) -> None:
    """Measured: 5.2e-4 diagonals. With a part more than the compressed file has, the original moves by 2.0e-2."""
    wolf = mixseq.read(data / "npz/q_wolf_gallop.npz")
    coded = CompressedModel.from_sequence(mixseq.compress(wolf, max_error=1e-4, inbetweens=False))
    stretched = MeshSequence.from_arrays(wolf.points[:1] * [1.0, 1.5, 1.0], wolf.polygons)
    moved, expected = (mixseq.transfer(source, stretched).points for source in (coded, wolf))
    assert np.linalg.norm(moved - expected, axis=2).max() <= 1e-3 * stretched.diagonal
