"""Skins and morphs fitted to sequences, held against bars whose bones and weights are known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mixseq
from mixseq.errors import MixseqWarning, SegmentationError, SettingsError
from mixseq.rigging.fitting import fit_morph, fit_skin
from mixseq.rigging.rigs import Skin, rotation_matrices
from mixseq.sequence.sequence import MeshSequence
from tests.meshes import SEQUENCES, bar, bent, joined, rotation, tetrahedron, tube

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
    skin = fit_skin(SEQUENCES[name]())
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
    errors = [mixseq.compare(sequence, skin).kg_percent for skin in skins]
    assert errors[0] > 2 * errors[1] > 4 * errors[2]


def test_bones_start_from_labels() -> None:
    sequence = skinned_bar()
    height = tube(8, 21)[0][sequence.faces, 2].mean(axis=1)
    skin = fit_skin(sequence, np.where(height > MIDDLE, 7, -3), rounds=400)
    assert skin.bone_count == 2
    assert largest_error(sequence, skin) < 1e-6


def test_the_same_input_gives_the_same_skin() -> None:
    first, second = fit_skin(bar(), 4), fit_skin(bar(), 4)
    for name in ("rest", "rotations", "translations", "influences", "weights"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))


def test_skins_move_with_the_sequence() -> None:
    """The fit does not depend on where the sequence is, nor on its unit."""
    sequence = bar()
    moved = sequence.with_points(100 * sequence.points + [5.0, -300, 20])
    first, second = fit_skin(sequence, 3), fit_skin(moved, 3)
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
    round_bend = [
        bent(points, angle) + 0.2 * angle * np.sin(points[:, :1]) for angle in np.linspace(0, np.pi, 7)
    ]
    sequence = MeshSequence.from_arrays(np.stack(round_bend), faces)
    skin = fit_skin(sequence, 2, correctives=1e-3)
    assert largest_error(sequence, skin) <= 1e-3
    assert np.abs(skin.targets).max() < sequence.diagonal


def test_correctives_that_are_not_needed_are_not_made() -> None:
    assert len(fit_skin(skinned_bar(), 2, correctives=1e-3).targets) == 0


def test_a_bound_that_is_not_reached_is_told() -> None:
    with pytest.warns(
        MixseqWarning, match=r"^1 targets reach an error of .*, not 0.0001 as correctives asks"
    ):
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
        with pytest.warns(MixseqWarning, match="as max_error asks; allow more max_targets"):
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


@pytest.mark.parametrize("bones", [0, -1, 10**6])
def test_numbers_of_bones_that_cannot_be_are_refused(bones: int) -> None:
    with pytest.raises(SettingsError, match=f"{bones} bones are asked for; a number from 1 to"):
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
    with pytest.raises(
        TypeError, match="sequence is of type int; MeshSequence or an open reader is expected"
    ):
        fit(3)  # type: ignore[operator]


@pytest.mark.realdata
@pytest.mark.parametrize(("name", "bones", "kg"), [("q_wolf_gallop", 20, 0.6), ("cat_poses", 10, 3.0)])
def test_animals_are_skinned_better_than_by_dem_bones(data: Path, name: str, bones: int, kg: float) -> None:
    """py-dem-bones 0.13.1 with as many bones leaves 1.1 % and 4.3 %."""
    sequence = mixseq.read(data / "npz" / f"{name}.npz")
    skin: Skin = fit_skin(sequence, bones)
    assert mixseq.compare(sequence, skin).kg_percent < kg
