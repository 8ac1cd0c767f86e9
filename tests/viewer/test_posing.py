"""Poses by handles in the viewer: pins and handles, the preview of a pose, and the edit that it becomes."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest

import mixseq
from mixseq import operations
from mixseq.errors import SettingsError
from mixseq.operations import Handle, key_poses, pose, with_body
from mixseq.operations.script import Readers, read_script
from mixseq.pictures.colours import SceneColours
from mixseq.pictures.scene import Scene, SceneItem
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.fitting import fit
from mixseq.signals.model import Model
from mixseq.types import Float
from mixseq.viewer.live import ViewSettings
from mixseq.viewer.playback import Moment
from mixseq.viewer.posing import PoseTool
from tests.meshes import tetrahedron
from tests.operations.chains import MESH, chain
from tests.viewer.staged import eventually
from tests.viewer.test_session import Room

pytest.importorskip("viser", reason="the extra viewer is not installed")

from mixseq.viewer.live.stage import LiveStage

TIP, BASE = int(MESH[0][:, 2].argmax()), 0
TIME, FADE = 0.3, 0.2


def target(amount: float = 0.7, model: Model | None = None, time: float = TIME) -> Float:
    """Where the tip is dragged to."""
    return np.asarray((model or chain())(time)[TIP] + amount * np.array([0.05, 0.1, 0.0]))


@cache
def resting() -> Model:
    """The first frame alone."""
    return fit(MeshSequence.from_arrays(chain()(0.0)[None], MESH[1], fps=10), exact=True, parts=chain().parts)


class Posing:
    """A session of models, and the tool that poses the first one."""

    def __init__(self, *models: Model) -> None:
        self.room = Room(*models)
        self.tool = PoseTool(self.room.session)

    def shown(self, index: int = 1) -> Model:
        model = self.room.shown(index)
        assert isinstance(model, Model)
        return model

    def follows(self, place: Float, time: float = TIME, slack: float = 0.009) -> None:
        """Wait until the tip is shown near a place."""
        eventually(lambda: np.linalg.norm(self.shown()(time)[TIP] - place) < slack * self.shown().space.scale)


@pytest.fixture
def opened() -> Iterator[Callable[..., Posing]]:
    made: list[Posing] = []

    def start(*models: Model) -> Posing:
        made.append(Posing(*models))
        return made[-1]

    yield start
    for posing in made:
        posing.room.close()


def test_a_click_pins_a_vertex_and_another_one_frees_it(opened: Callable[..., Posing]) -> None:
    tool = opened(chain()).tool
    assert (str(tool.pending), tool.cancel()) == ("", False)
    tool.toggle(BASE)
    tool.toggle(5)
    assert (tool.pending.pins, str(tool.pending)) == ([BASE, 5], "2 pins")
    tool.toggle(BASE)
    tool.drag(TIP, target(), TIME)
    assert (tool.pending.pins, str(tool.pending)) == ([5], "1 handle, 1 pin")
    tool.drag(5, np.zeros(3), TIME)
    assert (tool.pending.pins, str(tool.pending)) == ([], "2 handles")
    assert list(tool.pending.targets) == [5, TIP], "balls would change places in the middle of a drag"


def test_the_body_follows_at_the_time_of_the_drag_and_no_edit_is_made(opened: Callable[..., Posing]) -> None:
    posing = opened(chain())
    posing.tool.toggle(BASE)
    for amount in (0.2, 0.5, 0.7):
        posing.tool.drag(TIP, target(amount), TIME)
    posing.follows(target())
    shown = posing.shown()
    assert np.linalg.norm(shown(TIME)[BASE] - chain()(TIME)[BASE]) < 0.02 * shown.space.scale
    np.testing.assert_array_equal(shown(0.5), chain()(0.5))
    assert posing.room.session.model is chain()
    assert posing.tool.cancel()
    eventually(lambda: posing.shown() is chain())


def test_a_pose_becomes_the_edit_of_a_script(opened: Callable[..., Posing]) -> None:
    posing = opened(chain())
    posing.tool.toggle(BASE)
    posing.tool.drag(TIP, target(), TIME)
    posing.follows(target())
    preview = posing.shown()(TIME)
    posing.tool.apply(FADE)
    posing.room.done(1)
    assert not posing.room.told.failures
    model = posing.room.session.model
    expected = pose(chain(), [Handle(TIME, target(), TIP)], keep=[BASE], fade=FADE)
    np.testing.assert_array_equal(model.time.values, expected.time.values)
    assert np.abs(model(TIME) - preview).max() < 0.01 * model.space.scale
    posing.tool.apply(FADE)  # nothing is pending any more
    assert [step.name for step in posing.room.session.history.states] == ["", "pose"]
    posing.room.session.undo()
    eventually(lambda: posing.room.session.model is chain())


@pytest.mark.parametrize("still", [False, True])
def test_a_script_of_all_edits_gives_the_same_model(opened: Callable[..., Posing], tmp_path: Path, still: bool) -> None:
    opened_model = resting() if still else chain()
    posing = opened(opened_model)
    session, room = posing.room.session, posing.room
    count = 1
    if not still:
        plane = chain().plane
        to = chain().embedding([0.5], plane)[0] + 0.01
        session.edit("drag", partial(operations.drag, time=0.5, to=tuple(to), reach=0.2, plane=plane))
        session.edit("drag", partial(operations.drag, time=0.2, to=tuple(to), reach=0.1, plane=plane))
        session.edit("hold", partial(operations.hold, part=1, time=0.5, start=0.1, end=0.4))
        session.edit("reverse", operations.reverse)
        session.retime([(0.0, 0.0), (0.9, 0.8)])
        count = 6
        room.done(5)
    time = 0.0 if still else TIME
    posing.tool.toggle(BASE)
    posing.tool.drag(TIP, target(0.3, session.model, time), time)
    posing.tool.apply(FADE)
    room.done(count)
    session.undo()
    session.redo()
    room.done(count + 2)
    assert not room.told.failures
    session.save(tmp_path / "edits.toml")
    eventually(lambda: room.written)
    (tmp_path / "edits.toml").write_text(str(room.written[0][1]))
    edited = opened_model
    for edit in read_script(tmp_path / "edits.toml", Readers(mixseq.load, mixseq.read)):
        edited = edit(edited)
    np.testing.assert_array_equal(edited.sample().points, session.model.sample().points)


def test_a_script_without_edits_is_refused(opened: Callable[..., Posing], tmp_path: Path) -> None:
    room = opened(chain()).room
    room.session.save(tmp_path / "edits.toml")
    eventually(lambda: room.told.failures == [("save", "there are no edits yet; make one")])


def test_exact_handles_are_where_the_pointer_is(opened: Callable[..., Posing]) -> None:
    posing = opened(chain())
    far = target(16.0)
    posing.tool.drag(TIP, far, TIME)
    eventually(lambda: posing.shown() is not chain())
    assert np.linalg.norm(posing.shown()(TIME)[TIP] - far) > 0.1
    posing.tool.set_exact(True)
    posing.follows(far, slack=1e-9)
    posing.tool.apply(FADE)
    posing.room.done(1)
    np.testing.assert_allclose(posing.room.session.model(TIME)[TIP], far, atol=1e-6)
    assert posing.tool.pending.is_exact


def test_a_pose_of_another_time_comes_first(opened: Callable[..., Posing]) -> None:
    tool = opened(chain()).tool
    tool.drag(TIP, target(), TIME)
    with pytest.raises(SettingsError, match=r"the pose at 0\.3 s is not applied yet; press Enter or Esc first"):
        tool.drag(BASE, np.zeros(3), 0.5)
    assert list(tool.pending.targets) == [TIP]


def test_a_pending_pose_is_shown_again_after_another_edit(opened: Callable[..., Posing]) -> None:
    posing = opened(chain())
    posing.tool.drag(TIP, target(), TIME)
    posing.follows(target())
    posing.room.session.discard_preview()  # as another page does that is closed
    eventually(lambda: posing.shown() is chain())
    posing.tool.show()
    posing.follows(target())


def test_a_still_becomes_another_still(opened: Callable[..., Posing]) -> None:
    still = resting()
    posing, place = opened(still), target(model=still, time=0.0)
    posing.tool.toggle(BASE)
    posing.tool.drag(TIP, place, 0.0)
    posing.follows(place, 0.0)
    posing.tool.apply(FADE)
    posing.room.done(1)
    model = posing.room.session.model
    assert len(model.times) == 1
    assert np.linalg.norm(model(0.0)[TIP] - place) < 0.02 * model.space.scale


@pytest.mark.filterwarnings("ignore:.*own key poses give the motion back within")
def test_other_bodies_follow(opened: Callable[..., Posing]) -> None:
    keys = key_poses(chain())
    both = with_body(chain(), keys.with_points(2.0 * keys.points), "large")
    posing = opened(both, both.body("large"))
    posing.tool.drag(TIP, target(), TIME)
    posing.follows(target())
    large = posing.shown(2)
    assert large.header.name == "large"
    moves = large(TIME) - both.body("large")(TIME), posing.shown()(TIME) - both(TIME)
    assert np.abs(moves[1]).max() > 0.05
    np.testing.assert_allclose(moves[0], 2.0 * moves[1], atol=0.02)


def test_models_that_cannot_be_posed_are_refused(opened: Callable[..., Posing]) -> None:
    opened(chain()).tool.check()
    with pytest.raises(SettingsError, match="no parts"):
        opened(fit(chain().sample(), space="vertex")).tool.check()


# Dragging on the stage ------------------------------------------------------------------------------------


@pytest.fixture
def stage() -> LiveStage:
    """A tetrahedron, Z up, at rest."""
    points, faces = tetrahedron()
    still = MeshSequence.from_arrays(points[None], faces, up_axis="Z")
    scene = Scene((SceneItem("still", still).with_random_access(),))
    server = MagicMock()
    server.scene.add_icosphere.side_effect = lambda *_, **__: MagicMock()
    shown = LiveStage(server, SceneColours(scene, None), ViewSettings(), MagicMock())
    shown.show(Moment(scene, 0, (scene.items[0].pose(0.0),)))
    return shown


def drag(callback: Callable[[Any], Any], start: Float, *ends: Float) -> None:
    """Press at a place in the scene, move the pointer to others, and let go."""
    phases = ["start", *["update"] * (len(ends) - 1), "end"]
    for phase, end in zip(phases, (start, *ends), strict=True):
        event = SimpleNamespace(phase=phase, client_id=1, start_position=tuple(start), end_position=tuple(end))
        asyncio.run(callback(event))


def placed(stage: LiveStage, points: Float) -> Float:
    return np.asarray(stage.arrangement.place(0, stage.arrangement.to_local(0, points)))


def test_a_drag_of_the_mesh_moves_the_nearest_vertex_by_as_much(stage: LiveStage) -> None:
    seen: list[tuple[int, int, Float]] = []

    def take(*dragged: Any) -> bool:
        seen.append(dragged)
        return True

    callback = stage._drag_callback(0, None)
    place = placed(stage, tetrahedron()[0])[2] + 0.01
    drag(callback, place, place + 1.0)
    assert not seen, "the camera turns as long as nothing is set"
    stage.set_dragging(take)
    shift = np.array([0.1, 0.2, -0.3])
    drag(callback, place, place + 0.5 * shift, place + shift)
    assert [(index, vertex) for index, vertex, _ in seen] == [(0, 2)] * 3
    in_scene = placed(stage, np.array([each for _, _, each in seen]))
    expected = placed(stage, tetrahedron()[0])[2] + np.outer([0, 0.5, 1], shift)
    np.testing.assert_allclose(in_scene, expected, atol=1e-5)
    stage.set_dragging(lambda *_: False)
    seen.clear()
    drag(callback, place, place + shift)
    stage.set_dragging(take)
    asyncio.run(callback(SimpleNamespace(phase="update", client_id=1, end_position=tuple(place))))
    assert not seen, "a drag went on that was refused"


def test_balls_are_grabbed_nearby_and_clicked(stage: LiveStage) -> None:
    seen: list[int] = []
    clicked: list[int] = []

    def take(mesh: int, vertex: int, target: Float) -> bool:
        seen.append(vertex)
        return True

    stage.set_dragging(take)
    stage.set_handles(0, {3: (1, 2, 3), 1: (4, 5, 6)}, clicked.append)
    points = placed(stage, tetrahedron()[0])
    local = stage.arrangement.to_local(0, tetrahedron()[0])
    assert [tuple(ball.position) for ball in stage._handle_balls] == [tuple(local[3]), tuple(local[1])]
    drag(stage._drag_callback(None, 1), points[1] + 0.02, points[1])
    drag(stage._drag_callback(0, None), points[3] + 0.02, points[3])
    assert seen == [1, 1, 3, 3]
    stage._handle_balls[1].on_click.call_args.args[0](None)
    assert clicked == [1]
    stage.set_handles(0, {}, clicked.append)
    assert not any(ball.visible for ball in stage._handle_balls)
