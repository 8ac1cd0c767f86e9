"""The motion of one body on another: key poses, and shapes exchanged for those of another mesh."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mixseq
from mixseq.errors import MixseqWarning, SettingsError
from mixseq.operations import exaggerate_part, key_poses, with_body
from mixseq.retargeting.sources import prepare_source
from mixseq.retargeting.transfer import TransferSettings, plan_transfer
from mixseq.sequence.sequence import join_blocks
from mixseq.signals.curve import Curve
from mixseq.types import Float
from tests.meshes import coarse_walk

pytestmark = [
    pytest.mark.filterwarnings("ignore:.*corrections of part poses, up to .* are left out"),
    pytest.mark.filterwarnings("ignore:.*own key poses give the motion back within"),
]

STRETCH = np.array([1.0, 1.5, 1.0])


@pytest.fixture(scope="module")
def model() -> mixseq.Model:
    return mixseq.fit(coarse_walk(frames=8), rank=4)


def on_other_body(keys: mixseq.MeshSequence) -> mixseq.MeshSequence:
    """The same poses of a taller body, whose vertices are in another order."""
    order = np.random.default_rng(0).permutation(keys.vertex_count)
    place = np.argsort(order)
    return mixseq.MeshSequence.from_arrays(keys.points[:, order] * STRETCH, place[keys.faces], fps=1.0)


def test_key_poses_are_frames_as_many_as_key_shapes(model: mixseq.Model) -> None:
    keys = key_poses(model)
    assert keys.frame_count == len(model.shapes) == 5
    assert np.isin(keys.times, model.times).all()
    correction = replace(model.correction, values=np.zeros_like(model.correction.values))
    wanted = replace(model, correction=correction).sample(keys.times).points
    np.testing.assert_allclose(keys.points, wanted, atol=1e-9 * model.space.scale)
    weights, of_keys = (model.pose.weights(model.time(times)) for times in (model.times, keys.times))
    assert np.abs(weights @ np.linalg.inv(of_keys)).max() < 4, "key poses are spread widely"


def test_knots_stand_for_frames_that_were_cut_away() -> None:
    """Of one frame that is left, and of its path to the next; edits that need no other key shapes have fewer."""
    whole = mixseq.fit(coarse_walk(frames=8), rank=4)
    one = replace(whole, header=whole.header.with_times([0.0]))
    assert key_poses(one).frame_count == 5
    time, placement, correction = (
        Curve(curve.times, np.repeat(curve.values[:1], len(curve.times), axis=0)) for curve in whole.curves
    )
    still = whole.edited(time=time, placement=placement, correction=correction)
    assert key_poses(still).frame_count == 1
    again = with_body(still, key_poses(still), "again").body("again")
    np.testing.assert_allclose(again.sample().points, still.sample().points, atol=3e-3 * whole.space.scale)


def test_own_key_poses_give_the_own_motion_back() -> None:
    walk = coarse_walk(frames=6)
    for model, accuracy in ((mixseq.fit(walk, exact=True), 1e-6), (mixseq.fit(walk), 1e-3)):
        again = with_body(model, key_poses(model), "again").body("again")
        np.testing.assert_allclose(again.sample().points, model.sample().points, atol=accuracy * model.space.scale)


def test_a_body_with_the_same_triangles_keeps_parts_and_correction(model: mixseq.Model) -> None:
    """Also what edits of single parts have put into it."""
    raised = exaggerate_part(model, int(np.flatnonzero(model.mixed.articulation.parents >= 0)[0]), 1.5)
    again = with_body(raised, key_poses(raised), "again").body("again")
    np.testing.assert_array_equal(again.parts, model.parts)
    np.testing.assert_allclose(again.sample().points, raised.sample().points, atol=5e-3 * model.space.scale)


def test_losses_are_told(model: mixseq.Model) -> None:
    keys = key_poses(model)
    with pytest.warns(MixseqWarning, match="corrections of part poses, up to .* diagonals, are left out"):
        with_body(model, on_other_body(keys), "tall")
    with pytest.warns(MixseqWarning, match="its own key poses give the motion back within"):
        with_body(model, keys, "again")


@pytest.mark.parametrize("has_parts", [False, True])
def test_another_body_moves_by_the_same_signals(model: mixseq.Model, has_parts: bool) -> None:
    """With parts given, it also has the correction; its key poses are those that were given, wherever its body is."""
    wanted = on_other_body(key_poses(model))
    other = with_body(model, wanted, "tall", model.parts if has_parts else None).body("tall")
    assert other.time is model.time
    assert other.pose is model.pose
    assert other.correction.values.any() == has_parts
    np.testing.assert_allclose(key_poses(other).points, wanted.points, atol=1e-3 * other.space.scale)


def test_names_are_unique(model: mixseq.Model) -> None:
    with pytest.raises(SettingsError, match="two bodies have the same name"):
        with_body(model, key_poses(model), model.header.name)


def test_every_key_pose_needs_a_frame(model: mixseq.Model) -> None:
    with pytest.raises(SettingsError, match=r"has 4 frames; 5 are expected"):
        with_body(model, coarse_walk(frames=4), "other")


def test_spaces_without_parts_are_refused() -> None:
    walk = coarse_walk(frames=4)
    with pytest.raises(SettingsError, match="has no parts"):
        with_body(mixseq.fit(walk, exact=True, space="vertex"), walk, "other")


@pytest.mark.realdata
@pytest.mark.exhaustive
def test_six_keys_of_the_elephant_gallop_as_the_horse(data: Path) -> None:
    horse, elephant = (mixseq.read(data / "npz" / f"{name}_gallop.npz") for name in ("horse", "elephant"))
    model = mixseq.fit(horse, rank=5)
    frames = np.searchsorted(model.times, key_poses(model).times)
    keys = mixseq.MeshSequence.from_arrays(elephant.points[frames], elephant.faces, fps=1.0)
    made = with_body(model, keys, "elephant").body("elephant").sample().points.astype(np.float64)
    unit = np.linalg.norm(np.ptp(elephant.points[0], axis=0))
    assert _aligned_error(made, elephant.points.astype(np.float64)) <= 0.0098 * unit


@pytest.mark.realdata
@pytest.mark.exhaustive
@pytest.mark.filterwarnings("ignore:marker .* seem exchanged")
def test_a_body_moves_as_if_all_frames_had_been_transferred(data: Path) -> None:
    """As docs/transfer.md says; the wolf's body turns, and stands elsewhere than the horse's."""
    horse = mixseq.read(data / "npz" / "q_horse_gallop.npz")
    wolf = mixseq.fit(data / "npz" / "q_wolf_gallop.npz")
    whole = plan_transfer(wolf, horse)
    motion = prepare_source(key_poses(wolf), wolf.sample(frames=[0]), wolf.parts)
    keys = plan_transfer(motion, horse, TransferSettings(mapping=whole.correspondence))
    assert keys.method.parts is not None
    herd = with_body(wolf, join_blocks(keys.header, keys.blocks()), "horse", keys.method.parts.labels)
    made, wanted = herd.body("horse"), np.concatenate(list(whole.blocks()))
    distances = np.linalg.norm(made.sample().points - wanted, axis=2) / made.space.scale
    assert np.sqrt(np.square(distances).mean()) < 5e-5


def _aligned_error(made: Float, wanted: Float) -> float:
    """Root mean square distance after every frame is moved rigidly onto the wanted one."""
    from mixseq.mesh.rigid import kabsch, transform_points

    moved = [transform_points(x, *kabsch(x, y)) for x, y in zip(made, wanted, strict=True)]
    return float(np.sqrt(np.square(np.array(moved) - wanted).sum(axis=2).mean()))
