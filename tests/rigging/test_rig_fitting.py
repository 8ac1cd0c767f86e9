"""Skins and morphs fitted to sequences, held against bars whose bones and weights are known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mixseq
from mixseq.errors import InvalidSequenceError, MixseqWarning, SegmentationError, SettingsError
from mixseq.rigging.decomposition import bone_distances
from mixseq.rigging.fitting import fit_morph, fit_skin
from mixseq.rigging.rigs import Skeleton, Skin, rotation_matrices
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import Float
from mixseq_io.rig_arrays import order_parents_first
from tests.formats.conftest import lossy
from tests.formats.rig_maker import carried, hinge
from tests.meshes import SEQUENCES, bar, bent, coarse_walk, joined, rotation, tetrahedron, tube

pytestmark = pytest.mark.slow


MIDDLE, BLEND = 2.0, 0.8


def skinned_bar(frames: int = 7) -> MeshSequence:
    """A bar that two bones skin exactly; the upper one turns, and all of it wanders off."""
    points, faces = tube(8, 21)
    poses = []
    for t in np.linspace(0, 1, frames):
        turned = bent(points, 1.4 * t, MIDDLE, BLEND) @ rotation((0.2 * t, t, 3 * t)).T
        poses.append(turned + np.array([t, -2 * t, 0.5]))
    return MeshSequence.from_arrays(np.stack(poses), faces, fps=10)


def largest_error(sequence: MeshSequence, fitted: object) -> float:
    return mixseq.compare(sequence, fitted).max_error  # type: ignore[arg-type]


def test_a_bar_of_two_bones_is_recovered() -> None:
    sequence = skinned_bar()
    skin = fit_skin(sequence, 2, rounds=400)
    assert skin.bone_count == 2
    np.testing.assert_allclose(skin.points(), sequence.points, atol=1e-6)
    points = tube(8, 21)[0]
    upper = skin.influences[np.argmax(points[:, 2]), 0]
    weight = np.sum(np.where(skin.influences == upper, skin.weights, 0.0), axis=1)
    expected = np.clip((points[:, 2] - MIDDLE) / BLEND + 0.5, 0, 1)
    off_axis = np.hypot(points[:, 1], points[:, 2] - MIDDLE) > 1e-9  # on the axis both bones move alike
    np.testing.assert_allclose(weight[off_axis], expected[off_axis], atol=5e-6)
    # The upper bone against the lower one, from the first frame to the last: the angle of the bend.
    first, last = (rotation_matrices(skin.rotations[frame]) for frame in (0, -1))
    relative = last[1 - upper].T @ last[upper] @ first[upper].T @ first[1 - upper]
    assert np.arccos((np.trace(relative) - 1) / 2) == pytest.approx(1.4, abs=1e-6)


def test_a_rigid_sequence_has_one_bone_that_is_exact() -> None:
    points, faces = tetrahedron()
    frames = [points @ rotation((0.3, 0, 3 * t)).T + [t, 0, 9] for t in np.linspace(0, 1, 6)]
    sequence = MeshSequence.from_arrays(np.stack(frames), faces)
    skin = fit_skin(sequence)
    assert skin.bone_count == 1
    assert largest_error(sequence, skin) < 1e-7
    np.testing.assert_array_equal(skin.weights, np.tile([1.0, 0, 0, 0], (4, 1)))
    assert (np.sum(skin.rotations[1:] * skin.rotations[:-1], axis=2) > 0).all()  # over more than half a turn


@pytest.mark.parametrize("name", SEQUENCES)
def test_weights_are_those_of_a_skin(name: str) -> None:
    skin = fit_skin(SEQUENCES[name](), rounds=10)
    assert skin.influences.shape == skin.weights.shape == (skin.header.vertex_count, 4)
    assert (skin.weights >= 0).all()
    np.testing.assert_allclose(skin.weights.sum(axis=1), 1, atol=1e-12)
    assert (skin.influences[skin.weights == 0] == 0).all()
    for vertex in range(skin.header.vertex_count):  # no bone twice
        used = skin.influences[vertex, skin.weights[vertex] > 0]
        assert len(set(used.tolist())) == len(used)


def test_more_bones_are_more_accurate_down_to_fewer_than_components() -> None:
    body = bar(frames=6)
    moon = 0.3 * tetrahedron()[0] + np.linspace(0, 1, 6)[:, None, None] * [2.0, 0, 1] + [3, 0, 0]
    points = np.concatenate([body.points, moon], axis=1)
    faces = joined((body.points[0], body.faces.astype(np.int64)), tetrahedron())[1]
    sequence = MeshSequence.from_arrays(points, faces)
    skins = [fit_skin(sequence, count) for count in (1, 3, 8)]
    assert [skin.bone_count for skin in skins] == [1, 3, 8]
    measure_errors = [mixseq.compare(sequence, skin).kg_percent for skin in skins]
    assert measure_errors[0] > 2 * measure_errors[1] > 4 * measure_errors[2]


def test_bones_start_from_labels() -> None:
    sequence = skinned_bar()
    height = tube(8, 21)[0][sequence.faces, 2].mean(axis=1)
    skin = fit_skin(sequence, np.where(height > MIDDLE, 7, -3), rounds=400)
    assert skin.bone_count == 2
    assert largest_error(sequence, skin) < 1e-6


def test_the_same_input_gives_the_same_skin() -> None:
    first, second = fit_skin(bar(), 4, rounds=10), fit_skin(bar(), 4, rounds=10)
    for name in ("rest", "rotations", "translations", "influences", "weights"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))


def test_skins_move_with_the_sequence() -> None:
    """The fit does not depend on where the sequence is, nor on its unit."""
    sequence = bar()
    moved = sequence.with_points(100 * sequence.points + [5.0, -300, 20])
    first, second = fit_skin(sequence, 3, rounds=10), fit_skin(moved, 3, rounds=10)
    np.testing.assert_allclose(100 * first.points() + [5.0, -300, 20], second.points(), atol=1e-4)


@pytest.mark.parametrize("bound", [5e-3, 1e-3, 1e-4])
def test_correctives_reach_their_bound(bound: float) -> None:
    sequence = bar(frames=9)
    bare = fit_skin(sequence, 2)
    assert largest_error(sequence, bare) > 5e-3
    skin = fit_skin(sequence, 2, correctives=bound)
    assert largest_error(sequence, skin) <= bound
    assert 0 < len(skin.targets) <= 9
    np.testing.assert_array_equal(skin.weights, bare.weights)
    assert np.abs(skin.target_weights).max(axis=0) == pytest.approx(1)


def test_correctives_mend_what_collapses() -> None:
    """A bar folded by half a turn: at its middle the mean of both bones' rotations has no inverse."""
    points, faces = tube(8, 21)
    round_bend = [bent(points, angle) + 0.2 * angle * np.sin(points[:, :1]) for angle in np.linspace(0, np.pi, 7)]
    sequence = MeshSequence.from_arrays(np.stack(round_bend), faces)
    skin = fit_skin(sequence, 2, correctives=1e-3)
    assert largest_error(sequence, skin) <= 1e-3
    assert np.abs(skin.targets).max() < sequence.diagonal


def test_correctives_that_are_not_needed_are_not_made() -> None:
    assert len(fit_skin(skinned_bar(), 2, correctives=1e-3).targets) == 0


def test_a_bound_that_is_not_reached_is_told() -> None:
    with pytest.warns(MixseqWarning, match=r"^1 targets reach an error of .*, not the 0.0001 of correctives"):
        skin = fit_skin(bar(frames=9), 2, correctives=1e-4, max_targets=1)
    assert len(skin.targets) == 1


@pytest.mark.parametrize("name", SEQUENCES)
def test_a_morph_of_full_rank_is_exact(name: str) -> None:
    sequence = SEQUENCES[name]()
    morph = fit_morph(sequence)
    assert len(morph.targets) <= max(sequence.frame_count - 1, 0)
    assert largest_error(sequence, morph) < 1e-6


def test_a_morph_takes_as_few_targets_as_its_error_asks() -> None:
    sequence = bar(frames=12)
    counts = [len(fit_morph(sequence, bound).targets) for bound in (1e-1, 1e-2, 1e-4)]
    assert counts == sorted(set(counts))
    for bound, count in zip((1e-1, 1e-2, 1e-4), counts, strict=True):
        assert largest_error(sequence, fit_morph(sequence, bound)) <= bound
        with pytest.warns(MixseqWarning, match="of max_error; allow more max_targets"):
            fewer = fit_morph(sequence, bound, max_targets=count - 1)
        assert largest_error(sequence, fewer) > bound


def test_two_shapes_are_one_target() -> None:
    points, faces = tube(6, 9)
    other = points + np.sin(points[:, ::-1])
    mix = np.array([0.0, 0.2, 0.9, 0.4])[:, None, None]
    sequence = MeshSequence.from_arrays((1 - mix) * points + mix * other, faces)
    morph = fit_morph(sequence)
    assert len(morph.targets) == 1
    np.testing.assert_allclose(morph.points(), sequence.points, atol=1e-12)
    direction = (other - points).reshape(-1)
    cosine = morph.targets[0].reshape(-1) @ direction
    assert abs(cosine) == pytest.approx(np.linalg.norm(morph.targets) * np.linalg.norm(direction))


def test_frames_may_stream() -> None:
    sequence = bar()

    class Streaming:
        header = sequence.header
        blocks = sequence.blocks

    np.testing.assert_array_equal(fit_skin(Streaming(), 2).points(), fit_skin(sequence, 2).points())
    np.testing.assert_array_equal(fit_morph(Streaming()).points(), fit_morph(sequence).points())


def test_progress_is_told() -> None:
    told: list[tuple[int, int]] = []
    fit_skin(bar(), 2, correctives=1e-2, progress=lambda done, total, _: told.append((done, total)))
    assert told == sorted(told)
    assert all(done <= total for done, total in told)


def test_progress_of_a_search_names_the_number_of_bones() -> None:
    told: list[tuple[int, int, str]] = []
    skin = fit_skin(bar(), max_error=1e-2, progress=lambda done, total, what: told.append((done, total, what)))
    assert all(done <= total and what.startswith("searching") for done, total, what in told)
    assert f"searching for the fewest bones, fitting {skin.bone_count}" in {what for _, _, what in told}


@pytest.mark.parametrize("bones", [0, -1, 10**6])
def test_numbers_of_bones_that_cannot_be_are_refused(bones: int) -> None:
    with pytest.raises(SettingsError, match=f"bones is {bones}; a number from 1 to"):
        fit_skin(bar(), bones)


@pytest.mark.parametrize("labels", [[0, 1], np.zeros(bar().faces.shape[0])])
def test_labels_that_do_not_fit_are_refused(labels: object) -> None:
    with pytest.raises(SegmentationError, match="labels of bones have shape"):
        fit_skin(bar(), labels)  # type: ignore[arg-type]


@pytest.mark.parametrize("bound", [0.0, -1e-3, np.nan, np.inf])
def test_errors_that_are_not_positive_are_refused(bound: float) -> None:
    with pytest.raises(SettingsError, match=r"correctives is .* a positive number of diagonals"):
        fit_skin(bar(), 2, correctives=bound)
    with pytest.raises(SettingsError, match=r"max_error is .* a positive number of diagonals"):
        fit_morph(bar(), bound)


def test_negative_numbers_of_targets_are_refused() -> None:
    with pytest.raises(SettingsError, match="max_targets is -1"):
        fit_skin(bar(), 2, correctives=1e-3, max_targets=-1)
    with pytest.raises(SettingsError, match="max_targets is -1"):
        fit_morph(bar(), max_targets=-1)


def test_negative_numbers_of_rounds_are_refused() -> None:
    with pytest.raises(SettingsError, match="rounds is -1"):
        fit_skin(bar(), 2, rounds=-1)


@pytest.mark.parametrize("fit", [fit_skin, fit_morph])
def test_what_is_no_sequence_is_refused(fit: object) -> None:
    with pytest.raises(TypeError, match="sequence is of type int; MeshSequence or an open reader is expected"):
        fit(3)  # type: ignore[operator]


@pytest.mark.realdata
@pytest.mark.exhaustive
def test_a_wolf_is_skinned_better_than_by_dem_bones(data: Path) -> None:
    """py-dem-bones 0.13.1 with as many bones leaves 1.1 %."""
    sequence = mixseq.read(data / "npz" / "q_wolf_gallop.npz")
    assert mixseq.compare(sequence, fit_skin(sequence, 20)).kg_percent < 0.6


# Skins of a skeleton that is given, held against skins whose weights and motions are known


def played(skin: Skin) -> MeshSequence:
    return MeshSequence.from_header(skin.header, skin.points())


def bound(skin: Skin, **header: object) -> MeshSequence:
    """The mesh of a skin at rest."""
    still = {"times": [0.0], "fps": 24.0, **header}
    return MeshSequence.from_header(replace(skin.header, **still), skin.rest[None])  # type: ignore[arg-type]


def every(step: int, sequence: MeshSequence) -> MeshSequence:
    """Fewer frames of a sequence, which are as good for weights and quicker to fit."""
    return MeshSequence.from_header(sequence.header.with_times(sequence.times[::step]), sequence.points[::step])


def weights_of(skin: Skin) -> Float:
    found = np.zeros((len(skin.weights), skin.bone_count))
    np.add.at(found, (np.arange(len(found))[:, None], skin.influences), skin.weights)
    return found


def same_motion(found: Skin, true: Skin, atol: float) -> None:
    np.testing.assert_allclose(found.translations, true.translations, atol=atol)
    np.testing.assert_allclose(rotation_matrices(found.rotations), rotation_matrices(true.rotations), atol=atol)


def test_distances_end_at_joints_and_go_on_at_the_last() -> None:
    pivots, parents = np.array([[0.0, 0, 0], [0, 0, 2], [0, 0, 3]]), np.array([-1, 0, 1])
    points = np.array([[1.0, 0, 1], [0, 0, -2], [0, 0, 2.5], [1, 0, 3.5], [0, 0, 9]])
    expected = [
        [1, np.sqrt(2), np.sqrt(5)],
        [2, 4, 5],
        [0.5, 0, 0.5],
        [np.hypot(1, 1.5), np.hypot(1, 0.5), 1],
        [7, 6, 5],
    ]
    np.testing.assert_allclose(bone_distances(points, pivots, parents), expected, atol=1e-12)
    np.testing.assert_allclose(bone_distances(points, pivots[:1], parents[:1])[:, 0], np.linalg.norm(points, axis=1))


def test_weights_and_motions_of_a_hinge_are_found() -> None:
    true = hinge(7)
    skin = fit_skin(played(true), skeleton=true.skeleton, bind_pose=bound(true))
    assert skin.skeleton.names == ("lower", "upper")
    np.testing.assert_array_equal(skin.skeleton.parents, true.skeleton.parents)
    np.testing.assert_array_equal(skin.skeleton.axes, true.skeleton.axes)
    np.testing.assert_allclose(skin.pivots, true.pivots, atol=1e-12)
    np.testing.assert_allclose(skin.rest, true.rest, atol=1e-12)
    same_motion(skin, true, 1e-3)
    np.testing.assert_allclose(skin.points(), true.points(), atol=1e-3)
    off_axis = np.hypot(true.rest[:, 1], true.rest[:, 2] - 2) > 1e-9  # on the axis both bones move alike
    np.testing.assert_allclose(weights_of(skin)[off_axis], weights_of(true)[off_axis], atol=2e-3)


def test_of_bones_that_move_alike_vertices_follow_the_nearest() -> None:
    true = hinge(5)
    still = replace(
        true, rotations=np.tile(true.rotations[:1], (5, 1, 1)), translations=np.tile(true.pivots, (5, 1, 1))
    )
    skin = fit_skin(played(still), skeleton=true.skeleton, bind_pose=bound(true))
    above = true.rest[:, 2] > 2 + 1e-9
    np.testing.assert_array_equal(skin.influences[:, 0], np.where(above, 1, 0))
    np.testing.assert_array_equal(skin.weights[:, 0], 1)


def test_the_first_frame_is_the_bind_pose_if_there_is_no_other() -> None:
    true = hinge(7)
    skin = fit_skin(played(true), skeleton=true.skeleton)
    np.testing.assert_allclose(skin.rest, true.points()[0], atol=1e-12)
    same_motion(skin, true, 1e-3)


def test_bones_keep_their_lengths() -> None:
    true = hinge(5)
    _, translations = fit_skin(played(true), skeleton=true.skeleton, bind_pose=bound(true)).local_motion()
    np.testing.assert_allclose(translations[:, 1], np.tile([0.0, 0, 2], (5, 1)), atol=1e-9)


def test_the_character_may_be_anywhere() -> None:
    true = carried(hinge(5))
    skin = fit_skin(played(true), skeleton=true.skeleton, bind_pose=bound(true))
    np.testing.assert_allclose(skin.points(), true.points(), atol=1e-6)
    np.testing.assert_allclose(skin.translations[:, 0], true.translations[:, 0], atol=1e-6)


def test_bones_that_move_nothing_keep_their_names_and_stay_to_their_parents() -> None:
    true = hinge(5)
    names, parents = (*true.skeleton.names, "glove", "finger"), np.array([-1, 0, 1, 2])
    pivots = np.concatenate([true.pivots, [[0.0, 0, 5.5], [0, 0, 5.6]]])
    axes = np.concatenate([true.skeleton.axes, true.skeleton.axes])
    skin = fit_skin(played(true), skeleton=Skeleton(names, parents, pivots, axes), bind_pose=bound(true), rounds=3)
    assert skin.skeleton.names == names
    assert not np.isin(skin.influences[skin.weights > 0], [2, 3]).any()
    motion, rest = skin.local_motion(), skin.skeleton.local_rest()
    for bone in (2, 3):
        turned, at_rest = (rotation_matrices(rotations) for rotations in (motion[0][:, bone], rest[0][bone]))
        np.testing.assert_allclose(turned, [at_rest] * 5, atol=1e-9)
        np.testing.assert_allclose(motion[1][:, bone], [rest[1][bone]] * 5, atol=1e-9)


def test_unit_and_up_axis_are_those_of_the_sequence() -> None:
    true = hinge(5)
    skin = fit_skin(played(true), skeleton=true.skeleton, bind_pose=bound(true))
    sequence = mixseq.convert_units(played(true), up_axis="Z", units="cm")
    turned = fit_skin(sequence, skeleton=true.skeleton, bind_pose=bound(true))
    np.testing.assert_allclose(turned.pivots, 100 * skin.pivots[:, [0, 2, 1]] * [1, -1, 1], atol=1e-9)
    axes = rotation_matrices(skin.skeleton.axes)
    np.testing.assert_allclose(
        rotation_matrices(turned.skeleton.axes), axes[:, [0, 2, 1]] * [[1], [-1], [1]], atol=1e-9
    )
    np.testing.assert_allclose(turned.points(), sequence.points, atol=0.1)


def test_correctives_go_on_top() -> None:
    true = hinge(5, targets=1)
    sequence = played(replace(true, target_weights=0.3 * true.target_weights))
    skin = fit_skin(sequence, skeleton=true.skeleton, bind_pose=bound(true), correctives=1e-3)
    assert len(skin.targets)
    assert mixseq.compare(sequence, skin).max_error <= 1e-3


def test_files_take_the_place_of_skeleton_and_bind_pose(tmp_path: Path) -> None:
    true = hinge(4, up_axis="Y", metres_per_unit=1.0)
    with lossy():
        mixseq.write_rig(tmp_path / "hinge.glb", true)
    file = str(tmp_path / "hinge.glb")
    skin = fit_skin(mixseq.read(file), skeleton=file, bind_pose=file)
    assert skin.skeleton.names == ("lower", "upper")
    mixseq.write_rig(tmp_path / "again.usdc", skin)
    assert mixseq.read_skeleton(tmp_path / "again.usdc").names == ("lower", "upper")
    assert mixseq.compare(mixseq.read(file), mixseq.read(tmp_path / "again.usdc")).max_error < 1e-3


def test_what_does_not_fit_is_refused() -> None:
    true = hinge(3)
    sequence, skeleton = played(true), true.skeleton
    with pytest.raises(SettingsError, match=r"bones and skeleton both choose the bones; give one"):
        fit_skin(sequence, 3, skeleton=skeleton)
    with pytest.raises(SettingsError, match=r"skeleton and kg both choose"):
        fit_skin(sequence, skeleton=skeleton, kg=1)
    with pytest.raises(SettingsError, match=r"bind_pose is the mesh that is bound to a skeleton; give the skeleton"):
        fit_skin(sequence, bind_pose=bound(true))
    with pytest.raises(SettingsError, match=r"kg is -1; a positive number of percent, such as 0.5, is expected"):
        fit_skin(sequence, kg=-1)
    with pytest.raises(
        InvalidSequenceError, match=r"the bind pose has 4 vertices, the sequence has \d+; give the same"
    ):
        few = MeshSequence.from_arrays([np.eye(4, 3)], [[0, 1, 2]])
        fit_skin(sequence, skeleton=skeleton, bind_pose=few)
    with pytest.raises(SettingsError, match=r"edges of the bind pose are 100 times as long as those of the first"):
        large = mixseq.convert_units(bound(true), units="cm")
        fit_skin(sequence, skeleton=skeleton, bind_pose=bound(true).with_points(large.points))
    with pytest.raises(SettingsError, match=r"1 of 2 joints are outside of the mesh in the first frame; give"):
        fit_skin(sequence, skeleton=replace(skeleton, pivots=10 * skeleton.pivots))


@pytest.mark.parametrize("bind", [False, True])
@pytest.mark.parametrize(
    ("scale", "shift", "message"),
    [
        (100, 0, r"1 of 2 joints are outside of the "),
        (39.37, 0, r"1 of 2 joints are outside of the "),
        (1 / 39.37, 0, r"the skeleton is 0\.012 times as large as the "),
        (0.01, 0, r"the skeleton is 0\.0048 times as large as the "),
        (1, 12, r"2 of 2 joints are outside of the "),
    ],
)
def test_other_units_and_places_are_refused(bind: bool, scale: float, shift: float, message: str) -> None:
    true = hinge(3)
    skeleton = replace(true.skeleton, pivots=scale * true.pivots + [shift, 0, 0])
    expected = "bind pose; export both together" if bind else r"mesh in the first frame; give"
    with pytest.raises(SettingsError, match=message + expected):
        fit_skin(played(true), skeleton=skeleton, bind_pose=bound(true) if bind else None)


@pytest.mark.parametrize("bones", [1, 3])
def test_our_own_skins_of_few_bones_are_taken(bones: int) -> None:
    walk = coarse_walk(frames=6)
    own = fit_skin(walk, bones, rounds=10)
    for bind_pose in (bound(own), None):
        again = fit_skin(played(own), skeleton=own.skeleton, bind_pose=bind_pose, rounds=3)
        assert again.bone_count == own.bone_count


@pytest.mark.realdata
@pytest.mark.parametrize(
    ("file", "options", "step", "apart"),
    [("usd/RiggedFigure.usdz", {}, 1, 0.7), ("gltf/KhronosFox.glb", {"animation": "Survey"}, 4, 0.16)],
)
def test_vertices_stay_with_their_own_of_bones_that_hardly_move(
    data: Path, file: str, options: dict[str, Any], step: int, apart: float
) -> None:
    """As weights in the file tell, which the fit does not see; two is the most that they can be apart."""
    sequence = every(step, mixseq.read(data / file, **options))
    skin = fit_skin(sequence, skeleton=data / file, bind_pose=data / file)
    with mixseq.open_sequence(data / file, **options) as reader:
        skinning = reader.markings().skinning
    assert skinning is not None
    order = order_parents_first([skinning.joints.index(parent) if parent else -1 for parent in skinning.parents])
    own = np.asarray(skinning.weights.todense())[:, order]
    assert np.abs(weights_of(skin) - own).sum(axis=1).mean() < apart


@pytest.mark.realdata
@pytest.mark.parametrize(("file", "kg"), [("gltf/CesiumMan.glb", 0.1), ("usd/RiggedSimple.usdz", 0.01)])
def test_characters_move_on_their_own_skeletons(data: Path, file: str, kg: float) -> None:
    sequence = every(6, mixseq.read(data / file))
    skin = fit_skin(sequence, skeleton=data / file, bind_pose=data / file)
    assert skin.skeleton.names == mixseq.read_skeleton(data / file).names
    assert mixseq.compare(sequence, skin).kg_percent < kg
