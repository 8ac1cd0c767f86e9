"""The viewer without its browser: how many frames of a model are there in time, and what a frame takes to be sent.

Usage: scripts/bench view [NAME ...]   (animations of $MIXSEQ_DATA/npz)

Every sequence becomes a model of the default tolerance, which plays three times at its own rate on a stage that draws
at once. Frames that were not decoded in time are left out. Then milliseconds to send a frame: scene and colours of
viser, with no page open. Last, poses per second of CPU time of one core while a vertex is dragged by a tenth of the
diagonal, with three vertices pinned, decoded and sent in one colour.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from io import StringIO

import numpy as np

import mixseq
from mixseq.operations.handles import DraggedPose, Handle
from mixseq.pictures.colours import SceneColours
from mixseq.pictures.scene import Scene, SceneItem
from mixseq.runtime.parallel import one_blas_thread, thread_count
from mixseq.sequence.sequence import MeshSequence, load_frames
from mixseq.signals.model import Model
from mixseq.viewer.live import ViewSettings
from mixseq.viewer.live.stage import LiveStage
from mixseq.viewer.playback import Moment, Playback
from mixseq.viewer.posing import PosedModel
from scripts.benchmarks.common.harness import animation, print_table
from scripts.benchmarks.pose import farthest_vertices

SHEET = "sheet, not a model"
NAMES = ("q_wolf_gallop", "horse_gallop", "elephant_gallop", SHEET)
ROUNDS = 3
COLOURS = ("clay", "strain", "curvature")
SIDE = 245  # vertices of the side of the sheet: 60 025 in all


class Watch:
    """A stage that only takes notes."""

    is_busy = False

    def __init__(self) -> None:
        self.shown: list[tuple[float, int]] = []

    def show(self, moment: Moment) -> None:
        self.shown.append((time.monotonic(), moment.frame))


COLUMNS = (
    "sequence",
    "vertices",
    "frames/s",
    *(f"round {number + 1}" for number in range(ROUNDS)),
    *COLOURS,
    "dragged",
)


def rows(name: str) -> Iterator[tuple[str, ...]]:
    """Play an animation or the sheet, and measure what sending takes."""
    if name == SHEET:
        item, shares = SceneItem(name, load_frames(sheet())), ROUNDS * [""]
    else:
        item = SceneItem(name, mixseq.fit(animation(name)))
        shares = rounds(Scene((item,)))
    times = (f"{1000 * sending(item, colour):.1f} ms" for colour in COLOURS)
    posed = "" if item.model is None else f"{dragging(item, item.model):.0f}/s"
    yield item.name, f"{item.header.vertex_count:,}".replace(",", " "), f"{item.header.fps:g}", *shares, *times, posed


def rounds(scene: Scene) -> list[str]:
    """Play a scene and return the share of its frames that was seen in every round."""
    watch, period = Watch(), scene.count / scene.fps
    with Playback(scene, watch, lambda error: None, threads=thread_count()) as playback:
        playback.wait_until_shown(60.0)
        begin = time.monotonic()
        playback.play()
        time.sleep(ROUNDS * period)
    seen = [{frame for at, frame in watch.shown if 0 <= at - begin - k * period < period} for k in range(ROUNDS)]
    return [f"{len(frames)} of {scene.count}" for frames in seen]


@contextmanager
def stage_of(scene: Scene) -> Iterator[LiveStage]:
    """Show a scene on a server without pages."""
    from viser import ViserServer

    with redirect_stdout(StringIO()):
        server = ViserServer("127.0.0.1", 8500, verbose=False)
        yield LiveStage(server, SceneColours(scene), ViewSettings(), lambda moment: None)
        server.stop()


def dragging(item: SceneItem, model: Model) -> float:
    """Return the poses per second that are found, decoded and sent while a vertex is dragged."""
    frame, steps = model.header.frame_count // 2, 40
    time_of_pose = float(model.times[frame])
    points, scene = model(time_of_pose), Scene((item,))
    clock: list[float] = []
    ids, shift = farthest_vertices(points, 4).tolist(), np.array([0.1, 0.1, 0.0]) * model.space.scale / np.sqrt(2)
    dragged = DraggedPose(model, [Handle(time_of_pose, points[ids[0]], ids[0])], ids[1:])
    with stage_of(scene) as stage, one_blas_thread():
        for step in range(steps + 1):  # the first one is not counted
            found = dragged.points((points[ids[0]] + step / steps * shift)[None])
            posed = scene.with_item(0, PosedModel.from_model(model, time_of_pose, found))
            stage.show(Moment(posed, frame, (posed.items[0].pose(posed.elapsed(frame)),)))
            clock.append(time.process_time())
    return steps / (clock[-1] - clock[0])


def sending(item: SceneItem, colour: str) -> float:
    """Return the seconds that the scene takes for a frame, the median of some."""
    scene = Scene((item,))
    with stage_of(scene) as stage:
        stage.set_colour(colour)
        moments = [Moment(scene, frame, (item.pose(scene.elapsed(frame)),)) for frame in scene.sample_frames(24)]
        stage.show(moments[0])  # works out the colours
        seconds = []
        for moment in moments:
            begin = time.perf_counter()
            stage.show(moment)
            seconds.append(time.perf_counter() - begin)
    return float(np.median(seconds))


def sheet(frames: int = 24) -> MeshSequence:
    """Return a sheet of 60 025 vertices with a wave running through it."""
    x, z = (each.ravel() for each in np.meshgrid(*2 * [np.linspace(-2, 2, SIDE)]))
    phase = 2 * np.pi * np.arange(frames)[:, None] / frames
    y = 0.4 * np.sin(phase + 2 * x)
    points = np.stack([np.broadcast_to(x, y.shape), y, np.broadcast_to(z, y.shape)], axis=2)
    corner = np.arange(SIDE * SIDE).reshape(SIDE, SIDE)
    a, b, c, d = (each.ravel() for each in (corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return MeshSequence.from_arrays(points, faces, fps=24)


if __name__ == "__main__":
    sys.exit(print_table(COLUMNS, rows, NAMES))
