"""Transfer of a motion to another body."""

from __future__ import annotations

import pickle
import warnings
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from scipy.spatial import cKDTree

import mixseq
from mixseq.choices import TRANSFERS, TransferName
from mixseq.compression.numbering import walk_numbering
from mixseq.errors import InvalidSequenceError, MixseqWarning, SettingsError
from mixseq.mesh.polygons import Polygons
from mixseq.retargeting.gradient_transfer import GradientTransfer
from mixseq.retargeting.markers import Correspondence, Markers
from mixseq.retargeting.mixed_transfer import MixedTransfer
from mixseq.retargeting.proposals import similarity_residuals
from mixseq.retargeting.sources import prepare_source
from mixseq.retargeting.transfer import TransferSettings, _most_similar_pose, plan_transfer
from mixseq.runtime.parallel import serial_executor, thread_executor
from mixseq.sequence.sequence import MeshSequence, load_frames
from mixseq.signals.model import Model
from mixseq.spaces.mixed.mixed_space import MixedSpace
from mixseq.types import Float, FloatArray, Index
from tests.meshes import SEQUENCES, bar, bent, rigid_motions, rotation, tube
from tests.retargeting.pairs import from_subdivided, furthest, subdivided, to_subdivided

both = pytest.mark.parametrize("method", TRANSFERS)


def first(sequence: MeshSequence) -> MeshSequence:
    return MeshSequence.from_arrays(sequence.points[:1], sequence.faces)


def one(points: FloatArray, like: MeshSequence) -> MeshSequence:
    return MeshSequence.from_arrays(points[None], like.faces)


def shaped(points: FloatArray) -> Float:
    """Another body: longer above than below, and a little thicker."""
    z = points[:, 2]
    return np.stack([1.2 * points[:, 0], 1.1 * points[:, 1], z + 0.1 * z**2], axis=1)


@both
@pytest.mark.parametrize("name", SEQUENCES)
def test_transfer_to_the_same_mesh_is_identity(name: str, method: TransferName) -> None:
    sequence = SEQUENCES[name]()
    moved = mixseq.transfer(sequence, first(sequence), method=method)
    assert furthest(moved.points, sequence.points) <= 1e-6 * sequence.diagonal


@both
@pytest.mark.parametrize("name", ["bar", "rigid component", "several components", "three pages", "unused vertices"])
def test_transfer_commutes_with_scaling(name: str, method: TransferName) -> None:
    sequence = SEQUENCES[name]()
    turn, size, shift = rotation((0.5, -1.3, 2.1)), 7.3, np.array([10.0, -3.0, 5.0])
    copies = size * sequence.points @ turn.T + shift
    moved = mixseq.transfer(sequence, one(copies[0], sequence), method=method)
    assert furthest(moved.points, copies) <= 1e-6 * size * sequence.diagonal


@both
@given(motion=rigid_motions)
@settings(max_examples=8, deadline=None)
def test_a_rigid_motion_of_all_frames_is_one_of_the_result(method: TransferName, motion: tuple[Float, Float]) -> None:
    """With the rest where it was; whatever body the target is."""
    turn, shift = motion
    source = bar(sides=5, rings=15, frames=3)
    rest, target = first(source), one(shaped(source.points[0]), source)
    mover = plan_transfer(source, target, TransferSettings(method=method, rest=rest), workers=serial_executor).method
    still = mixseq.transfer(source, target, method=method, rest=rest, workers=serial_executor).points
    away = source.with_points(source.points @ turn.T + shift)
    moved = mixseq.transfer(away, target, method=method, rest=rest, workers=serial_executor).points
    # The root starts from the target's place at rest, and goes as far from there as the source's for its size.
    own, theirs = target.points[0].mean(axis=0), source.points[0].mean(axis=0)
    made = mover.gradients if isinstance(mover, MixedTransfer) else mover
    assert isinstance(made, GradientTransfer)
    if isinstance(mover, MixedTransfer):
        root = mover.body.root
        own = mover.body.centres[root] * made.target.scale
        theirs = mover.source_body.centres[root] * made.source.scale
    np.testing.assert_array_equal(made.alignment.rotation, np.eye(3))
    size = made.alignment.scale
    offset = (np.eye(3) - turn) @ (own - size * theirs) + size * shift
    assert furthest(moved, still @ turn.T + offset) <= 2e-6 * source.diagonal


@both
def test_transfer_is_invariant_to_the_source_pose_in_space(method: TransferName) -> None:
    """Source and rest moved together: that is only another place of the source."""
    source = bar(sides=5, rings=15, frames=3)
    target = one(2.0 * source.points[0], source)
    moved = source.with_points(source.points @ rotation((1.0, 0.3, -2.0)).T + [5.0, 6.0, 7.0])
    results = [mixseq.transfer(each, target, method=method).points for each in (source, moved)]
    assert furthest(*results) <= 1e-6 * 2 * source.diagonal


def lower(mesh: tuple[FloatArray, Index], height: float = 2.2) -> Index:
    """Two parts: triangles below a height, and above."""
    return np.asarray(mesh[0][mesh[1]].mean(axis=1)[:, 2] > height, dtype=np.int64)


@both
def test_round_trip_over_a_dense_map(method: TransferName) -> None:
    """A to its subdivision, and back: exact by gradients; with joints solved twice within 3 % of the diagonal."""
    source = bar(sides=6, rings=21, frames=4)
    mesh = source.points[0], source.faces.astype(np.int64)
    parts = lower(mesh)
    fine = MeshSequence.from_arrays(subdivided(mesh)[0][None], subdivided(mesh)[1])
    there = mixseq.transfer(source, fine, mapping=to_subdivided(mesh), method=method, parts=parts)
    back = mixseq.transfer(
        there, first(source), mapping=from_subdivided(mesh), method=method, parts=np.repeat(parts, 4)
    )
    bound = {"gradients": 1e-9, "mixed": 0.03}[method]
    assert furthest(back.points, source.points) <= bound * source.diagonal


@both
def test_round_trip_on_equal_triangles(method: TransferName) -> None:
    """Within 0.6 % of the diagonal, whatever body is in between."""
    source = bar(sides=6, rings=21, frames=4)
    parts = lower((source.points[0], source.faces.astype(np.int64)))
    other = one(shaped(source.points[0]), source)
    there = mixseq.transfer(source, other, method=method, parts=parts)
    back = mixseq.transfer(there, first(source), method=method, parts=parts)
    assert furthest(back.points, source.points) <= 0.006 * source.diagonal


def test_methods_differ_where_proportions_do() -> None:
    source = bar(frames=3)
    target = one(shaped(source.points[0]), source)
    mixed, gradients = (mixseq.transfer(source, target, method=method).points for method in TRANSFERS)
    assert 1e-4 * source.diagonal < furthest(mixed, gradients) < 0.1 * source.diagonal
    np.testing.assert_allclose(mixed[0], target.points[0], atol=1e-6)
    np.testing.assert_allclose(gradients[0], target.points[0], atol=1e-9)


def test_the_result_has_the_targets_mesh_and_the_sources_times() -> None:
    source = bar(frames=4)
    target = MeshSequence.from_arrays(
        shaped(source.points[0])[None], source.faces, name="tall", up_axis="Z", metres_per_unit=0.01
    )
    moved = mixseq.transfer(source, target)
    np.testing.assert_array_equal(moved.times, source.times)
    assert (moved.name, moved.up_axis, moved.metres_per_unit) == ("tall", "Z", 0.01)
    assert moved.fps == source.fps
    assert moved.points.dtype == np.float64


def test_a_model_moves_as_its_frames_do_with_its_own_parts(bent_bar: MeshSequence, bar_model: Model) -> None:
    assert isinstance(bar_model.space, MixedSpace)
    target = one(shaped(bent_bar.points[0]), bent_bar)
    parts = bar_model.space.decomposition.part_of_face
    moved = mixseq.transfer(bar_model, target)
    expected = mixseq.transfer(bent_bar, target, parts=parts)
    assert furthest(moved.points, expected.points) <= 1e-6 * bent_bar.diagonal
    planned = plan_transfer(bar_model, target)
    assert planned.method.parts is not None
    np.testing.assert_array_equal(planned.method.parts.source.part_of_face, parts)


@both
def test_any_frame_may_be_the_rest(method: TransferName) -> None:
    """Onto the shape of another frame: all come back from there."""
    source = bar(frames=4)
    for rest in (2, -1):
        moved = mixseq.transfer(source, one(source.points[rest], source), rest=rest, method=method)
        assert furthest(moved.points, source.points) <= 1e-6 * source.diagonal
    shape = MeshSequence.from_arrays(source.points[2:], source.faces)
    again = mixseq.transfer(source, one(source.points[2], source), rest=shape, method=method)
    assert furthest(again.points, source.points) <= 1e-6 * source.diagonal


@both
def test_a_rest_of_another_size_is_brought_to_size(method: TransferName) -> None:
    source = bar(frames=4)
    target = one(shaped(source.points[0]), source)
    rest = one(1.67 * source.points[0], source)
    moved = mixseq.transfer(source, target, rest=rest, method=method).points
    expected = mixseq.transfer(source, target, method=method).points
    moved, expected = (points - points.mean(axis=1, keepdims=True) for points in (moved, expected))
    assert furthest(moved, expected) <= 0.03 * source.diagonal


@both
def test_one_frame_is_a_motion_as_well(method: TransferName) -> None:
    source = bar(frames=4)
    target = one(shaped(source.points[0]), source)
    parts = lower((source.points[0], source.faces.astype(np.int64)))
    whole = mixseq.transfer(source, target, method=method, parts=parts)
    last = MeshSequence.from_arrays(source.points[3:], source.faces)
    alone = mixseq.transfer(last, target, method=method, rest=first(source), parts=parts)
    assert alone.frame_count == 1
    assert furthest(alone.points[0], whole.points[3]) <= 1e-6 * source.diagonal
    still = mixseq.transfer(first(source), target, method=method)
    assert furthest(still.points, target.points) <= 1e-6 * source.diagonal


@both
def test_blocks_equal_the_whole_result(method: TransferName) -> None:
    source = bar(sides=5, rings=15, frames=21)
    target = one(shaped(source.points[0]), source)
    told: list[tuple[int, int, str]] = []
    planned = plan_transfer(source, target, TransferSettings(method=method))
    blocks = list(planned.blocks(lambda *what: told.append(what)))
    assert len(blocks) > 1
    assert planned.header.frame_count == 21
    np.testing.assert_array_equal(np.concatenate(blocks), mixseq.transfer(source, target, method=method).points)
    assert told[-1] == (21, 21, "transferring frames")


@both
def test_threads_do_not_change_a_bit(method: TransferName) -> None:
    source = bar(sides=6, rings=15, frames=20)
    mesh = source.points[0], source.faces.astype(np.int64)
    fine = MeshSequence.from_arrays(shaped(subdivided(mesh)[0])[None], subdivided(mesh)[1])
    results = [
        mixseq.transfer(source, fine, mapping=to_subdivided(mesh), method=method, workers=thread_executor(count))
        for count in (1, 2)
    ]
    assert np.array_equal(results[0].points, results[1].points)


def test_a_frame_in_the_pose_of_the_target_is_named() -> None:
    """The source begins bent and is straight in its second frame, as the target is, at twice the size."""
    points, faces = tube(10, 25)
    source = MeshSequence.from_arrays(np.stack([bent(points, 1.5), points]), faces)
    target = MeshSequence.from_arrays(2 * points[None], faces)
    with pytest.warns(MixseqWarning, match=r"in frame 1 0 %; take that one with rest=1, or --rest 1"):
        mixseq.transfer(source, target, method="gradients")
    mixseq.transfer(source, target, method="gradients", rest=1)  # no warning


def test_a_prepared_source_is_reusable() -> None:
    source = bar(frames=3)
    motion = prepare_source(source, parts=2)
    target = one(shaped(source.points[0]), source)
    planned = plan_transfer(motion, target)
    moved = np.concatenate(list(planned.blocks()))
    np.testing.assert_array_equal(moved, mixseq.transfer(source, target, parts=2).points)


def test_identity_map_equals_no_map() -> None:
    source = bar(frames=3)
    target = one(shaped(source.points[0]), source)
    given_map = Correspondence.identity(source.vertex_count, len(source.faces))
    np.testing.assert_array_equal(
        mixseq.transfer(source, target, mapping=given_map).points, mixseq.transfer(source, target).points
    )


def test_a_map_of_the_same_triangles_may_exchange_them() -> None:
    """A bar the other way round: parts are where the map says, not where the numbers are."""
    source = bar(sides=6, rings=21, frames=3)
    still = [source.points[0], source.points[0][source.faces].mean(axis=1)]  # vertices, middles of triangles
    vertices, triangles = (
        np.asarray(cKDTree(points).query(points * [1.0, -1.0, -1.0] + [0.0, 0.0, 4.0])[1]) for points in still
    )
    mapping = replace(
        Correspondence.identity(source.vertex_count, len(source.faces)),
        corners=np.repeat(vertices[:, None], 3, axis=1),
        faces=triangles,
    )
    parts = lower((source.points[0], source.faces.astype(np.int64)), 1.0)
    mover = plan_transfer(source, first(source), TransferSettings(mapping=mapping, parts=parts)).method
    assert isinstance(mover, MixedTransfer)
    own, carried = mover.parts.part_of_face
    np.testing.assert_array_equal(carried, own[mapping.faces])
    assert (carried != own).any()


@both
def test_used_transfers_are_picklable(method: TransferName) -> None:
    """As cluster workers need it, also when feet were placed before."""
    source = bar(sides=5, rings=15, frames=3)
    contacts = {"end": [0]} if method == "mixed" else None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MixseqWarning)  # never at rest
        target = one(shaped(source.points[0]), source)
        planned = plan_transfer(source, target, TransferSettings(method=method, contacts=contacts))
    own = planned.method.transfer_frames(source.points[2][None])[0]
    again = pickle.loads(pickle.dumps(planned.method))
    np.testing.assert_array_equal(again.transfer_frames(source.points[2][None])[0], own)


def test_a_fine_target_comes_in_smaller_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    source = bar(sides=5, rings=15, frames=4)
    mesh = source.points[0], source.faces.astype(np.int64)
    fine = MeshSequence.from_arrays(subdivided(mesh)[0][None], subdivided(mesh)[1])
    planned = plan_transfer(source, fine, TransferSettings(mapping=to_subdivided(mesh), method="gradients"))
    whole = np.concatenate(list(planned.blocks()))
    monkeypatch.setattr("mixseq.sequence.sequence.MAX_BLOCK_VERTICES", 2 * fine.vertex_count)
    blocks = list(planned.blocks())
    assert [len(block) for block in blocks] == [2, 2]
    np.testing.assert_array_equal(np.concatenate(blocks), whole)


def test_markers_replace_a_map() -> None:
    """A tube on one that is cut otherwise, by pairs of vertices."""
    source = bar(sides=8, rings=21, frames=3)
    other = bar(sides=8, rings=31, frames=3)
    rings = ((0, 0), (6, 9), (14, 21), (20, 30))
    pairs = [(8 * a + side, 8 * b + side) for a, b in rings for side in (0, 2, 4, 6)]
    pairs += [(168, 248), (169, 249)]
    planned = plan_transfer(source, first(other), TransferSettings(markers=pairs))
    assert planned.quality is not None
    moved = np.concatenate(list(planned.blocks()))
    assert furthest(moved, other.points) <= 0.06 * source.diagonal
    same = mixseq.transfer(source, first(other), markers=Markers.from_pairs(pairs))
    np.testing.assert_array_equal(same.points, moved)


# Refusals -------------------------------------------------------------------------------------------------

SOURCE = bar(sides=5, rings=15, frames=2)
TARGET = first(SOURCE)
OTHER = first(bar(sides=6, rings=15, frames=2))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"method": "edges"}, r"method is 'edges'; 'mixed' or 'gradients' is expected"),
        ({"rest": 2}, r"rest is 2; a frame from 0 to 1 is expected"),
        ({"markers": [[0, 0]], "mapping": Correspondence.identity(77, 150)}, "markers and a map.*give one"),
        ({"markers": [0, 1, 2]}, r"markers have shape \(3,\)"),
        (
            {"mapping": Correspondence.identity(77, 151)},
            "a source with 77 vertices and 151 triangles.*77 and 150",
        ),
        (
            {"mapping": replace(Correspondence.identity(77, 150), target_size=(78, 150))},
            "a target with 78 vertices and 150 triangles.*77 and 150",
        ),
        ({"contacts": {"left": [0]}, "method": "gradients"}, "contacts.*the method 'mixed'"),
        (
            {"contacts": {"left": [0, 77]}},
            "contact 'left' has vertex 77, but vertices of the target are 0 to 76",
        ),
        ({"contacts": {"left": [0], "right": [-1]}}, "contact 'right' has vertex -1"),
        ({"contacts": {"left": []}}, "contact 'left' is no list of vertices"),
        ({"contacts": {"left": [0.5]}}, "contact 'left' is no list of vertices"),
        ({"contacts": {"left": 3}}, "contact 'left' is no list of vertices"),
        ({"joint_width": 0}, "joint_width is 0"),
    ],
)
def test_invalid_settings_are_refused(options: dict[str, object], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        mixseq.transfer(SOURCE, TARGET, **options)  # type: ignore[arg-type]


@both
@pytest.mark.parametrize("across", [0.0, 1.0], ids=["point", "line"])
def test_a_target_without_area_is_refused(method: TransferName, across: float) -> None:
    flat = one(TARGET.points[0] * [0.0, 0.0, across], SOURCE)
    with pytest.raises(InvalidSequenceError, match="no area at rest"):
        mixseq.transfer(SOURCE, flat, method=method)


def test_other_triangles_need_a_correspondence() -> None:
    with pytest.raises(
        SettingsError,
        match=r"the source has 77 vertices and 150 triangles, the target 92 and 180.*give markers or a map",
    ):
        mixseq.transfer(SOURCE, OTHER)


def test_polygons_may_be_cut_into_triangles_in_another_order() -> None:
    """A quad and a pentagon that turn about x; the target is twice as large, cut and listed from the end."""
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 1], [3, 1, 1], [2, 2, 1]], dtype=np.float64)
    turned = points[:, [0, 2, 1]] * [1, -1, 1]  # by a quarter
    polygons = Polygons(np.array([4, 5]), np.array([0, 1, 2, 3, 1, 4, 5, 6, 2]))
    source = MeshSequence.from_arrays(np.stack([points, turned]), polygons)
    target = MeshSequence.from_arrays(2 * points[None], source.faces[::-1])
    with pytest.warns(MixseqWarning, match="^faces of .* have other numbers in"):
        result = mixseq.transfer(source, target, method="gradients").points
    expected = 2 * np.stack([points, turned])
    got, right = (each - each.mean(axis=1, keepdims=True) for each in (result, expected))
    np.testing.assert_allclose(got, right, atol=1e-6)


def test_the_same_mesh_may_have_other_numbers() -> None:
    """As compressed files of order="free" have them, and faces in another order."""
    expected = mixseq.transfer(SOURCE, TARGET, method="gradients").points
    swapped = MeshSequence.from_arrays(TARGET.points, TARGET.faces[::-1])
    with pytest.warns(MixseqWarning, match="^faces of .* have other numbers in"):
        np.testing.assert_allclose(mixseq.transfer(SOURCE, swapped, method="gradients").points, expected, atol=1e-6)
    numbering = walk_numbering(SOURCE.polygons, [SOURCE.vertex_count], vertices=True)
    free = numbering.renumber_frames(SOURCE)
    assert isinstance(free, MeshSequence)
    with pytest.warns(MixseqWarning, match="^vertices and faces of .* have other numbers in"):
        np.testing.assert_allclose(mixseq.transfer(free, TARGET, method="gradients").points, expected, atol=1e-6)


def test_markers_of_a_mesh_with_other_numbers_are_refused() -> None:
    walk = MeshSequence.from_arrays(SOURCE.points[:, ::-1], SOURCE.vertex_count - 1 - SOURCE.faces)
    small = load_frames(walk).trace(1e-3, promised=True, order="free")
    free = MeshSequence.from_header(small, walk.points)
    pairs = [[vertex, vertex] for vertex in (0, 10, 20, 30, 40)]
    for arguments in ((free, TARGET), (TARGET, free)):
        with pytest.raises(SettingsError, match=r"markers are numbers of vertices, and those of the (source|target)"):
            mixseq.transfer(*arguments, markers=pairs)
    with pytest.raises(SettingsError, match="contacts are numbers of vertices, and those of the target differ"):
        mixseq.transfer(walk, free, contacts={"foot": [0]})


@pytest.mark.parametrize("wrong", ["source", "target"])
def test_arguments_of_wrong_types_are_refused(wrong: str) -> None:
    meshes: dict[str, object] = {"source": SOURCE, "target": TARGET, wrong: SOURCE.points}
    with pytest.raises(TypeError, match=f"transfer: {wrong} is of type ndarray; MeshSequence or an open reader"):
        mixseq.transfer(**meshes)  # type: ignore[arg-type]


TUBE = tube(10, 25)


def bending_tube(*angles: float) -> MeshSequence:
    return MeshSequence.from_arrays(np.stack([bent(TUBE[0], angle) for angle in angles]), TUBE[1], fps=24)


def test_limbs_are_turned_into_the_rest_pose_of_the_source() -> None:
    """The tube itself, in a pose that no frame of the source has: the transfer is the source."""
    source = bending_tube(0.0, 0.3, 0.6, 0.9)
    planned = plan_transfer(source, bending_tube(-0.8))
    assert planned.turned == pytest.approx(np.degrees(0.8), abs=4)
    moved = np.concatenate(list(planned.blocks(workers=serial_executor)))
    assert max(similarity_residuals(a[None], b)[0] for a, b in zip(moved, source.points, strict=True)) < 0.04
    assert similarity_residuals(bent(TUBE[0], -0.8)[None], TUBE[0])[0] > 0.2  # what would be off throughout


def test_limbs_are_not_turned_where_poses_are_alike_or_a_frame_is_more_alike() -> None:
    for target in (bending_tube(-0.1), bending_tube(0.9)):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", MixseqWarning)
            planned = plan_transfer(bending_tube(0.0, 0.3, 0.6, 0.9), target)
        assert not planned.turned
        assert np.array_equal(planned.target, target.points[0])


def test_markers_are_registered_in_the_frame_that_is_most_like_the_target() -> None:
    source = prepare_source(bending_tube(1.4, 0.7, 0.0))
    markers = Markers.from_pairs(np.repeat(np.arange(0, 240, 24)[:, None], 2, axis=1))
    assert np.array_equal(_most_similar_pose(source, bent(TUBE[0], 1.2), markers), source.rest)
    assert np.array_equal(_most_similar_pose(source, bent(TUBE[0], 0.1), markers), source.points[2:][0])
