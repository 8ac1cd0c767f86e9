"""The motion of one body on another: key poses, and shapes exchanged for those of another mesh."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mixseq
from mixseq.errors import MixseqWarning, SettingsError
from mixseq.operations import drag, exaggerate_part, key_poses, sculpt, with_shapes
from mixseq.types import Float
from tests.meshes import coarse_walk

pytestmark = [
    pytest.mark.filterwarnings("ignore:.*corrections of part poses, up to .* are left out"),
    pytest.mark.filterwarnings("ignore:.*own key poses give the motion back within"),
]

STRETCH = np.array([1.0, 1.5, 1.0])


@pytest.fixture(scope="module")
def model() -> mixseq.Model:
    return mixseq.fit(coarse_walk(frames=8), rank=4, pose="keys")


def on_other_body(keys: mixseq.MeshSequence) -> mixseq.MeshSequence:
    """The same poses of a taller body, whose vertices are in another order."""
    order = np.random.default_rng(0).permutation(keys.vertex_count)
    place = np.argsort(order)
    return mixseq.MeshSequence.from_arrays(keys.points[:, order] * STRETCH, place[keys.faces], fps=1.0)


def test_key_poses_that_are_frames_are_these_frames(model: mixseq.Model) -> None:
    keys = key_poses(model)
    wanted = model.sample(frames=sorted(model.key_frames.tolist()))
    np.testing.assert_allclose(keys.points, wanted.points, atol=1e-3 * model.space.scale)


def test_own_key_poses_give_the_own_motion_back() -> None:
    exact = mixseq.fit(coarse_walk(frames=6), exact=True, pose="keys")
    again = with_shapes(exact, key_poses(exact))
    np.testing.assert_allclose(again.sample().points, exact.sample().points, atol=1e-6 * exact.space.scale)


def test_a_body_with_the_same_triangles_keeps_parts_and_correction(model: mixseq.Model) -> None:
    """Also what edits of single parts have put into it."""
    raised = exaggerate_part(model, int(np.flatnonzero(model.mixed.articulation.parents >= 0)[0]), 1.5)
    again = with_shapes(raised, key_poses(raised))
    np.testing.assert_array_equal(again.parts, model.parts)
    np.testing.assert_allclose(again.sample().points, raised.sample().points, atol=5e-3 * model.space.scale)


def test_losses_are_told(model: mixseq.Model) -> None:
    keys = key_poses(model)
    with pytest.warns(MixseqWarning, match="corrections of part poses, up to .* diagonals, are left out"):
        with_shapes(model, on_other_body(keys))
    blended = mixseq.fit(coarse_walk(frames=8), rank=4)
    with pytest.warns(MixseqWarning, match="its own key poses give the motion back within"):
        with_shapes(blended, key_poses(blended))


def test_another_body_moves_by_the_same_signals(model: mixseq.Model) -> None:
    other = with_shapes(model, on_other_body(key_poses(model)))
    assert other.time is model.time
    assert other.pose is model.pose
    assert other.header.vertex_count == model.header.vertex_count
    keys = key_poses(other).points
    np.testing.assert_allclose(keys, on_other_body(key_poses(model)).points, atol=0.05 * other.space.scale)


def test_edits_of_one_body_play_on_the_other(model: mixseq.Model) -> None:
    other = with_shapes(model, on_other_body(key_poses(model)))
    edited = drag(model, float(model.times[2]), model.embedding([model.times[5]])[0])
    played = with_shapes(edited, other)
    assert played.time is edited.time
    np.testing.assert_array_equal(played.shapes, other.shapes)


def test_bodies_of_another_pose_signal_are_refused(model: mixseq.Model) -> None:
    other = mixseq.fit(coarse_walk(frames=9), rank=4, pose="keys")
    assert len(other.shapes) == len(model.shapes)
    with pytest.raises(SettingsError, match="another pose signal"):
        with_shapes(model, other)
    grown = sculpt(model, float(model.times[0]), model(float(model.times[0])))
    with pytest.raises(SettingsError, match="another pose signal"):
        with_shapes(model, grown)


def test_every_key_shape_needs_a_frame(model: mixseq.Model) -> None:
    with pytest.raises(SettingsError, match=r"has 4 frames; 5 are expected"):
        with_shapes(model, coarse_walk(frames=4))


def test_spaces_without_parts_are_refused() -> None:
    walk = coarse_walk(frames=4)
    with pytest.raises(SettingsError, match="has no parts"):
        with_shapes(mixseq.fit(walk, exact=True, space="vertex"), walk)


def test_identity_is_kept_in_files(model: mixseq.Model, tmp_path: Path) -> None:
    mixseq.save(tmp_path / "model.h5", model)
    assert mixseq.load(tmp_path / "model.h5").pose.identity == model.pose.identity


@pytest.mark.realdata
@pytest.mark.exhaustive
def test_six_keys_of_the_elephant_gallop_as_the_horse(data: Path) -> None:
    horse, elephant = (mixseq.read(data / "npz" / f"{name}_gallop.npz") for name in ("horse", "elephant"))
    model = mixseq.fit(horse, rank=5, pose="keys")
    frames = elephant.points[model.key_frames]
    keys = mixseq.MeshSequence.from_arrays(frames, elephant.faces, fps=1.0)
    made = with_shapes(model, keys).sample().points.astype(np.float64)
    unit = np.linalg.norm(np.ptp(elephant.points[0], axis=0))
    assert _aligned_error(made, elephant.points.astype(np.float64)) <= 0.017 * unit


def _aligned_error(made: Float, wanted: Float) -> float:
    """Root mean square distance after every frame is moved rigidly onto the wanted one."""
    from mixseq.mesh.rigid import kabsch, transform_points

    moved = [transform_points(x, *kabsch(x, y)) for x, y in zip(made, wanted, strict=True)]
    return float(np.sqrt(np.square(np.array(moved) - wanted).sum(axis=2).mean()))
