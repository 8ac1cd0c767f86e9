"""Where meshes of the viewer stand, and the ground below them."""

from __future__ import annotations

from dataclasses import replace
from unittest.mock import MagicMock

import numpy as np

from mixseq.mesh.surface import CornerValues, Surface
from mixseq.pictures.colours import SceneColours
from mixseq.pictures.scene import Scene, SceneItem
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import Float
from mixseq.viewer.live import ViewSettings
from mixseq.viewer.live.stage import GRID_CELL, LiveStage
from mixseq.viewer.playback import Moment
from tests.meshes import tube

FRAMES = 12


def shown(following: bool) -> tuple[Float, Float]:
    """Middles of a mesh that travels along x ``(T, 3)``, and places of the ground, frame by frame."""
    points, faces = tube(8, 5)
    travel = np.multiply.outer(np.arange(FRAMES), [[5.0, 0, 0]])
    moving = MeshSequence.from_arrays(points + travel, faces)
    scene = Scene((SceneItem("tube", moving).with_random_access(),))
    stage = LiveStage(MagicMock(), SceneColours(scene, None), ViewSettings(following=following), MagicMock())
    middles, grounds = [], []
    for frame in range(FRAMES):
        stage.show(Moment(scene, frame, (scene.items[0].pose(scene.elapsed(frame)),)))
        middles.append(stage._meshes[0].vertices.mean(axis=0))
        grounds.append(stage._ground.position)
    return np.array(middles, dtype=np.float64), np.array(grounds)


def test_own_colours_are_sent_once_as_the_file_has_them() -> None:
    """The page takes linear colours, as those of the mesh are."""
    points, faces = tube(8, 5)
    linear = np.linspace(0, 1, len(points))[:, None] * [1.0, 0.5, 0, 0] + [0, 0, 0, 1.0]
    still = MeshSequence.from_arrays(points[None], faces)
    surface = Surface(colours=CornerValues(linear, still.polygons.indices))
    scene = Scene((SceneItem("tube", replace(still, surface=surface)).with_random_access(),))
    stage = LiveStage(MagicMock(), SceneColours(scene, None), ViewSettings(), MagicMock())
    stage.set_colour("own")
    stage.show(Moment(scene, 0, (scene.items[0].pose(0.0),)))
    sent = np.asarray(stage._colour_clouds[0].colors)
    scale = 255 if sent.dtype == np.uint8 else 1
    np.testing.assert_allclose(sent / scale, linear[:, :3], atol=0.006)


def test_a_body_that_is_followed_stays_and_the_ground_moves() -> None:
    travelled, ground = shown(following=False)
    assert np.ptp(travelled[:, 0]) > 1
    assert np.ptp(ground, axis=0).max() == 0
    followed, ground = shown(following=True)
    np.testing.assert_allclose(followed, followed[:1].repeat(FRAMES, axis=0), atol=1e-5)
    steps = np.diff(ground[:, 0] + travelled[:, 0]) / GRID_CELL
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-5)  # squares look the same after a whole one
