""""""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from mixseq.choices import SPACES, SegmentationName, SpaceName
from mixseq.errors import ReconstructionError, SegmentationError, SettingsError
from mixseq.mesh.measures import edge_lengths
from mixseq.mesh.topology import Topology
from mixseq.operations.interpolation import interpolate, segment
from mixseq.segmentation.methods import METHODS, segment_by_labels
from mixseq.segmentation.motion import MotionSettings
from mixseq.sequence.sequence import MeshSequence
from mixseq.shells.fitting import ShellSettings
from mixseq.signals.detail import EncodedSequence, encode_sequence
from mixseq.signals.fitting import CANDIDATE_SHARES, MIN_VALIDATION_FRAMES, _interpolated_vectors, fit, select_share
from mixseq.spaces.edge import EdgeSettings, EdgeSpace
from mixseq.spaces.making import MixedSettings, make_space
from mixseq.spaces.mixed.mixed_space import MixedSpace, Projection
from mixseq.spaces.temporal import FrameWeights
from mixseq.types import Float
from tests.meshes import bar, joined, tube
from tests.motions import MESH, moving

SMALL: MeshSequence = bar(sides=5, rings=15, frames=3)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"placement": "loose"}, r"placement is 'loose'; 'anchored' or 'free' is expected"),
        ({"parts": 0}, r"parts is 0; a whole number from 1 to 150"),
        ({"parts": 151}, r"parts is 151; a whole number from 1 to 150"),
        ({"joint_width": 0}, r"joint_width is 0; at least 1"),
        ({"exact": True, "rank": 2}, r"leave out tolerance, rank and knots"),
        ({"tolerance": 1e-3, "knots": 2}, r"tolerance chooses rank and knots"),
        ({"knots": 2, "cuts": [2]}, r"smooth everywhere; leave out between and cuts, or knots"),
        ({"tolerance": 0.0}, r"tolerance is 0.0; a positive number"),
        ({"tolerance": np.nan}, r"tolerance is nan; a positive number"),
        ({"rank": -1}, r"rank is -1; a whole number of shape modes, zero or more"),
        ({"space": "polar"}, r"space is 'polar'; one of mixed, vertex, gradient, lri, edge is expected"),
        ({"space": "vertex", "parts": 2}, r"the vertex space has no use for parts; .* space='mixed'"),
        ({"space": "lri", "parts": np.zeros(150, dtype=int)}, r"the lri space has no use for parts"),
        ({"space": "edge", "placement": "free"}, r"the edge space has no use for placement"),
        ({"space": "gradient", "joint_width": 2}, r"the gradient space has no use for joint_width"),
        ({"space": "edge", "segmentation": "silhouettes"}, r"the edge space has no use for segmentation"),
        ({"segmentation": "skin"}, r"segmentation is 'skin'; one of motion, silhouettes, spanning-tree"),
        ({"space": "gradient", "shell": ShellSettings()}, r"for shell; .* space='edge'"),
        ({"placement": "free", "shell": ShellSettings()}, r"the mixed space has no use for shell"),
        ({"projection": "dso"}, r"the mixed space has no use for projection; .* space='edge'"),
        ({"settling_from": 0.1, "rank": 1}, r"there is no setting settling_from"),
        ({"shrinkage": 1}, r"there is no setting shrinkage; settings of spaces are joint_width, "),
        ({"knots": 1}, r"knots is 1; 3 frames allow 0 to 0 inner knots"),
    ],
)
def test_settings_are_checked(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        fit(SMALL, **settings)


@pytest.mark.parametrize("labels", [np.zeros(149, dtype=int), np.zeros((150, 1), dtype=int), np.zeros(150)])
def test_labels_are_checked(labels: Any) -> None:
    with pytest.raises(SegmentationError, match="one whole number for each of the 150 triangles"):
        fit(SMALL, parts=labels)


def test_labels_are_used() -> None:
    labels = np.arange(150) % 3
    model = fit(SMALL, exact=True, parts=labels)
    expected = segment_by_labels(labels, Topology(SMALL.faces, SMALL.vertex_count))
    np.testing.assert_array_equal(model.decomposition.part_of_face, expected)
    np.testing.assert_allclose(model.sample().points, SMALL.points, atol=1e-9)


@pytest.mark.parametrize("parts", [1, 3, np.int64(4)])
def test_the_number_of_parts_is_used(parts: int) -> None:
    assert len(fit(SMALL, parts=parts).decomposition.parts) == parts


def test_placement_and_details_are_used() -> None:
    model = fit(SMALL, placement="free", joint_width=2, segmentation=MotionSettings(bend=200.0))
    assert model.mixed.placement == "free"
    assert len(model.decomposition.parts) == 1
    assert fit(SMALL, joint_width=1).decomposition.widths.max() == 1


@pytest.mark.parametrize("face", [24, 45])
def test_the_free_placement_names_triangles_that_lose_their_area(face: int) -> None:
    points, (a, b, c) = SMALL.points.copy(), SMALL.faces[face]
    points[2, c] = (points[2, a] + points[2, b]) / 2
    collapsing = SMALL.with_points(points)
    cause = rf"triangle {face} has no area in frame 2, .*; give placement='anchored', or a larger tolerance"
    with pytest.raises(ReconstructionError, match=cause):
        fit(collapsing, exact=True, placement="free", parts=3)
    space = fit(collapsing, exact=True, parts=3).mixed
    assert not space.joint_faces[face]
    np.testing.assert_allclose(space.decode(space.encode(points)), points, atol=1e-9 * space.scale)


def test_triangles_that_never_have_area_are_placed_freely() -> None:
    points, (a, b, c) = SMALL.points.copy(), SMALL.faces[24]
    points[:, c] = (points[:, a] + points[:, b]) / 2
    model = fit(SMALL.with_points(points), exact=True, placement="free", parts=3)
    np.testing.assert_allclose(model.sample().points, points, atol=1e-9 * model.space.scale)


def test_fitting_twice_gives_the_same_model() -> None:
    first, second = fit(SMALL), fit(SMALL)
    np.testing.assert_array_equal(first.vectors, second.vectors)
    np.testing.assert_array_equal(first.mixed.shapes, second.mixed.shapes)


def test_progress_is_told() -> None:
    told: list[tuple[int, int, str]] = []
    fit(SMALL, progress=lambda *step: told.append(step))
    assert told[-1][0] == told[-1][1]
    assert [done for done, _, _ in told] == sorted(done for done, _, _ in told)
    assert "finding parts" in {what for _, _, what in told}


LONGER: MeshSequence = bar(sides=4, rings=9, frames=8)


@pytest.mark.parametrize("space", SPACES)
@pytest.mark.parametrize("settings", [{"exact": True}, {"rank": 7, "knots": 4}, {"tolerance": 1e-2}, {}], ids=str)
def test_all_spaces_keep_what_they_promise(space: SpaceName, settings: dict[str, Any]) -> None:
    model = fit(LONGER, space=space, **settings)
    assert model.space.name == space
    error = np.linalg.norm(model.sample().points - LONGER.points, axis=2).max() / LONGER.diagonal
    exact = "tolerance" not in settings and settings
    assert error < (1e-9 if exact else settings.get("tolerance", 5e-4))
    assert exact or len(model.shapes) < 8


@pytest.mark.parametrize("space", SPACES)
def test_all_spaces_move(space: SpaceName) -> None:
    """Velocities are the derivative of the points, whatever the space."""
    model, step, time = fit(LONGER, exact=True, space=space), 1e-4, 0.23
    ahead, behind = model(time + step), model(time - step)
    ((_, velocities),) = model.moving_blocks([time])
    np.testing.assert_allclose(velocities[0], (ahead - behind) / (2 * step), atol=0.02)


def test_settings_of_the_edge_space_are_used() -> None:
    shell = ShellSettings(bending=0.7)
    space = fit(SMALL, exact=True, space="edge", shell=shell, projection="dso").space
    assert isinstance(space, EdgeSpace)
    assert (space.shell, space.settings) == (shell, EdgeSettings("dso", shell=shell))


@pytest.mark.parametrize("space", ["vertex", "gradient", "lri", "edge"])
def test_other_spaces_have_no_parts(space: SpaceName) -> None:
    with pytest.raises(SettingsError, match=f"the {space} space has no parts; fit a model with space='mixed'"):
        _ = fit(SMALL, rank=1, space=space).decomposition


@pytest.mark.parametrize("method", METHODS)
def test_parts_are_found_by_any_method(method: SegmentationName) -> None:
    by_name = fit(SMALL, segmentation=method, rank=1)
    by_settings = fit(SMALL, segmentation=METHODS[method].settings(), rank=1)
    labels = segment(SMALL, method)
    for model in (by_name, by_settings):
        assert isinstance(model.space, MixedSpace)
        np.testing.assert_array_equal(model.space.decomposition.part_of_face, labels)


# What is chosen by leaving frames out: how poses are predicted, and how much lengths and angles count


@cache
def curling(frames: int = 9) -> MeshSequence:
    """A tube that curls up evenly: angles between frames are means, and vertices are not."""
    points, faces = tube(8, 41, length=10.0)
    x, y, z = points.T
    made = []
    for share in np.linspace(0.0, 1.6, frames):
        angle = np.maximum(share * np.pi * z / 10.0, 1e-9)
        radius = z / angle
        spot = np.stack([x, radius * (np.cos(angle) - 1), radius * np.sin(angle)], axis=1)
        made.append(spot + np.stack([0 * x, y * np.cos(angle), y * np.sin(angle)], axis=1))
    return MeshSequence.from_arrays(np.stack(made), faces)


def encoded_of(sequence: MeshSequence, parts: int, everywhere: bool = True) -> EncodedSequence:
    """With lengths and angles of all faces, or of none."""
    space = make_space(sequence, "mixed", MixedSettings(parts=parts))
    assert isinstance(space, MixedSpace)
    faces = np.full(len(sequence.faces), everywhere)
    return encode_sequence(sequence, replace(space, joint_faces=faces, projection=Projection()))


def share_of(encoded: EncodedSequence) -> float:
    assert isinstance(encoded.space, MixedSpace)
    return encoded.space.projection.share


def test_lengths_and_angles_count_where_they_are_right_between_frames() -> None:
    sequence = curling()
    assert share_of(select_share(encoded_of(sequence, 1), sequence.points)) >= 0.75


@pytest.mark.parametrize("block", ["lengths", "angles"])
def test_lengths_and_angles_do_not_count_where_they_are_noise(block: str) -> None:
    sequence = curling()
    encoded = encoded_of(sequence, 1)
    space, rng = encoded.space, np.random.default_rng(0)
    assert isinstance(space, MixedSpace)
    shapes = np.array(encoded.shapes[:])
    edges, hinges = space.block_sizes[:2]
    columns = slice(0, edges) if block == "lengths" else slice(edges, edges + hinges)
    size = shapes[:, columns].mean() if block == "lengths" else 1.0
    shapes[:, columns] += 0.5 * size * rng.normal(size=shapes[:, columns].shape)
    assert share_of(select_share(replace(encoded, shapes=shapes), sequence.points)) == 0.0


def test_two_frames_are_blended_as_poses() -> None:
    """A tube that curls up by 160 degrees at once, whose parts would be torn apart on straight ways."""
    frames = curling()
    two = MeshSequence.from_arrays(frames.points[[0, 5]], frames.faces)
    parts = np.repeat(np.arange(4), len(two.faces) // 4)
    model = fit(two, parts=parts)
    assert isinstance(model.space, MixedSpace) and model.space.projection.steps
    (middle,) = model.sample([two.times.mean()]).points
    blended = interpolate(two, [0.5, 0.5], parts=parts)
    assert np.abs(middle - blended).max() < 1e-3 * two.diagonal
    edges = model.space.topology.edges
    expected = edge_lengths(two.points, edges).mean(axis=0)
    assert np.abs(edge_lengths(middle, edges) / expected - 1).max() < 0.05


def test_nothing_else_of_the_space_changes() -> None:
    sequence = curling()
    encoded = encoded_of(sequence, 1)
    found = select_share(encoded, sequence.points)
    assert share_of(found) in CANDIDATE_SHARES
    assert isinstance(found.space, MixedSpace) and isinstance(encoded.space, MixedSpace)
    assert replace(found.space.projection, share=0.0) == encoded.space.projection
    assert found.shapes is encoded.shapes and found.placement is encoded.placement
    assert found.space.dim == encoded.space.dim


def test_where_there_are_no_joints_no_share_is_chosen() -> None:
    sequence = bar(frames=9)
    encoded = encoded_of(sequence, 2, everywhere=False)
    assert select_share(encoded, sequence.points).space is encoded.space


def test_where_steps_are_taken_no_share_is_chosen() -> None:
    sequence = curling()
    space = encoded_of(sequence, 2).space
    assert isinstance(space, MixedSpace)
    stepping = replace(space, projection=Projection(share=1.0, steps=6))
    assert select_share(encode_sequence(sequence, stepping), sequence.points).space is stepping


def test_other_spaces_placements_and_short_sequences_stay_as_they_are() -> None:
    sequence = bar(sides=4, rings=9, frames=9)
    short = MeshSequence.from_arrays(sequence.points[:3], sequence.faces)
    for frames, name, settings in (
        (sequence, "vertex", None),
        (sequence, "mixed", MixedSettings(placement="free")),
        (short, "mixed", None),
    ):
        encoded = encode_sequence(frames, make_space(frames, name, settings))  # type: ignore[arg-type]
        assert select_share(encoded, frames.points) is encoded


def test_few_frames_of_large_meshes_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Evenly spread inner frames, interpolated from other frames only."""
    found: list[FrameWeights] = []

    def spy(encoded: EncodedSequence, space: MixedSpace, weights: FrameWeights) -> Float:
        found.append(weights)
        return _interpolated_vectors(encoded, space, weights)

    monkeypatch.setattr("mixseq.signals.fitting._interpolated_vectors", spy)
    sequence = curling(25)
    encoded = encoded_of(sequence, 1)
    select_share(encoded, sequence.points)
    monkeypatch.setattr("mixseq.signals.fitting.MAX_VALIDATION_VERTICES", 100)
    select_share(encoded, sequence.points)
    assert [len(weights.frame_ids) for weights in found] == [16, MIN_VALIDATION_FRAMES]
    left_out = [np.setdiff1d(np.arange(25), frame_ids) for frame_ids in found[0].frame_ids]
    assert all(len(frames) == 1 and 0 < frames[0] < 24 for frames in left_out)
    assert len(np.unique(left_out)) == 16
    np.testing.assert_allclose(found[0].weights.sum(axis=1), 1.0)


def test_cuts_are_found_chosen_or_left_out() -> None:
    points = moving(np.arange(16.0))
    points[9:] += 50
    shot = MeshSequence.from_arrays(points, MESH[1], fps=10)
    found = fit(shot, exact=True)
    np.testing.assert_allclose(found.sample().points, points, atol=1e-8)
    before, after = found(0.8499), found(0.8501)
    assert np.abs(before - points[8]).max() < 1 < 48 < (after - before).min()
    np.testing.assert_array_equal(fit(shot, exact=True, cuts=[9]).vectors, found.vectors)
    smooth = fit(shot, exact=True, cuts="none")
    assert 20 < (smooth(0.85) - points[8]).mean() < 30
    assert np.abs(fit(shot)(0.8501) - after).max() < 0.05  # also with few knots
    unknown: Any
    for unknown in ([0], [16], [1.5]):
        with pytest.raises(SettingsError, match="first frames after cuts are expected, whole numbers from 1 to 15"):
            fit(shot, cuts=unknown)
    with pytest.raises(SettingsError, match="between is 'fast'; auto, smooth, linear, hold, vertices are possible"):
        fit(shot, between="fast")  # type: ignore[arg-type]


@pytest.mark.parametrize("space", SPACES)
def test_poses_on_twos_are_kept_or_made_smooth(space: SpaceName) -> None:
    frames = np.floor(np.arange(20) / 2) * 2
    shot = MeshSequence.from_arrays(moving(frames), MESH[1], fps=20)
    kept, smooth = (fit(shot, exact=True, space=space, between=between) for between in ("auto", "smooth"))
    np.testing.assert_allclose(kept.sample().points, shot.points, atol=1e-8)
    np.testing.assert_allclose(kept(0.17), shot.points[3], atol=1e-5)
    assert smooth.times.tolist() == shot.times.tolist()
    at = np.arange(4.0, 14)
    np.testing.assert_allclose(smooth.sample(times=at / 20).points, moving(at), atol=0.01)
    assert np.abs(kept.sample(times=at / 20).points - moving(at)).max() > 0.05


@pytest.mark.parametrize(("space", "apart"), [("mixed", 1.05), ("mixed", 4.0), ("vertex", 4.0)])
def test_cuts_and_pops_of_a_component_leave_the_others_smooth(space: SpaceName, apart: float) -> None:
    """Two tubes, of which one is moved far away, or is a point in some frames."""
    frames, count, faces = np.arange(36.0), len(MESH[0]), joined(MESH, (MESH[0] + [apart, 0, 0], MESH[1]))[1]

    def shot(at: Float, event: str) -> Float:
        other = moving(at) + np.array([apart, 0, 0])
        if event == "cut":
            other += 25.0 * (at > 20.5)[:, None, None]
        is_point = (event == "blink") & (at > 15.5) & (at < 18.5)
        centres = np.repeat(other.mean(axis=1, keepdims=True), count, axis=1)
        return np.concatenate([moving(at), np.where(is_point[:, None, None], centres, other)], axis=1)

    at = np.sort(np.concatenate([frames[:-1] + 0.25, frames[:-1] + 0.75]))

    def errors(event: str) -> tuple[Float, Float]:
        sequence = MeshSequence.from_arrays(shot(frames, event), faces, fps=24)
        model = fit(sequence, exact=True, space=space, parts=faces[:, 0] // count if space == "mixed" else None)
        found = np.linalg.norm(model.sample(times=at / 24).points - shot(at, event), axis=2)
        return found[:, :count].max(axis=1), found[:, count:].max(axis=1)

    smooth, _ = errors("none")
    for event, waiting in (("cut", []), ("blink", [15.25, 15.75, 18.25, 18.75])):
        others, own = errors(event)
        assert (others <= smooth + 2e-4).all(), event
        is_smooth = ~np.isin(at, waiting)  # a component that appears waits until half-way
        assert own[is_smooth].max() < 0.02, event
