"""What is shown when."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.errors import SettingsError
from mixseq.pictures.scene import Scene, SceneItem
from mixseq.sequence.sequence import MeshSequence, frame_store
from mixseq.signals.model import Model
from tests.meshes import bar


@pytest.fixture(scope="module")
def sequence() -> MeshSequence:
    return bar(sides=3, rings=5, frames=5)  # at 10 frames per second


def test_poses_of_a_sequence_are_its_nearest_frames(sequence: MeshSequence) -> None:
    item = SceneItem("bar", frame_store(sequence))
    for elapsed, frame in ((0.0, 0), (0.04, 0), (0.06, 1), (0.4, 4), (9.0, 4)):
        pose = item.pose(elapsed)
        assert pose.dtype == np.float32
        np.testing.assert_array_equal(pose, sequence.points[frame].astype(np.float32))


def test_poses_of_a_model_are_at_any_time(bar_model: Model) -> None:
    item = SceneItem("bar", bar_model)
    for elapsed, time in ((0.0, 0.0), (0.123, 0.123), (0.3, 0.3), (9.0, 0.3)):
        np.testing.assert_array_equal(item.pose(elapsed), bar_model(time).astype(np.float32))


def test_frames_of_the_longest(sequence: MeshSequence) -> None:
    short = SceneItem("short", frame_store(bar(sides=3, rings=5, frames=2)))
    scene = Scene((short, SceneItem("long", frame_store(sequence))))
    assert (scene.count, scene.fps) == (5, 10)
    assert [scene.elapsed(frame) for frame in range(5)] == pytest.approx([0, 0.1, 0.2, 0.3, 0.4])


def test_at_another_rate(sequence: MeshSequence) -> None:
    scene = Scene((SceneItem("bar", frame_store(sequence)),), rate=30)
    assert (scene.count, scene.fps) == (15, 30)
    with pytest.raises(SettingsError, match="frames per second"):
        _ = Scene(scene.items, rate=1).count


@pytest.mark.parametrize(
    ("elapsed", "frame"), [(0.0, 0), (0.26, 3), (0.24, 2), (-1.0, 0), (7.0, 4), (1e308, 4), (-1e308, 0)]
)
def test_the_frame_at_a_time(sequence: MeshSequence, elapsed: float, frame: int) -> None:
    assert Scene((SceneItem("bar", frame_store(sequence)),)).frame_at(elapsed) == frame


def test_another_motion_of_one_of_the_meshes(sequence: MeshSequence, bar_model: Model) -> None:
    scene = Scene((SceneItem("a", frame_store(sequence)), SceneItem("b", frame_store(sequence))), rate=20)
    other = scene.with_item(1, bar_model)
    assert other.items[0] is scene.items[0]
    assert (other.items[1].name, other.items[1].motion, other.rate) == ("b", bar_model, 20)
    assert scene.items[1].motion is not bar_model


@pytest.mark.parametrize(("most", "frames"), [(1, [0]), (2, [0, 4]), (3, [0, 2, 4]), (99, [0, 1, 2, 3, 4])])
def test_frames_spread_over_a_shot(sequence: MeshSequence, most: int, frames: list[int]) -> None:
    assert list(Scene((SceneItem("bar", frame_store(sequence)),)).samples(most)) == frames
