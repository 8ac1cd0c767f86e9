"""The viewer without its browser: how many frames of a model are there in time, and what a frame takes to be sent.

Usage: scripts/bench view [NAME ...]   (animations of $MIXSEQ_DATA/npz)

Every sequence becomes a model of the default tolerance, which plays three times at its own rate on a stage that draws
at once. Frames that were not decoded in time are left out. Then milliseconds to send a frame: scene and colours of
viser, with no page open.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import redirect_stdout
from io import StringIO

import numpy as np

import mixseq
from mixseq.pictures.colours import SceneColours
from mixseq.pictures.scene import Scene, SceneItem
from mixseq.runtime.parallel import thread_count
from mixseq.sequence.sequence import MeshSequence, load_frames
from mixseq.viewer.live import ViewSettings
from mixseq.viewer.live.stage import LiveStage
from mixseq.viewer.playback import Moment, Playback
from scripts.benchmarks.common.harness import animation, print_table

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


COLUMNS = ("sequence", "vertices", "frames/s", *(f"round {number + 1}" for number in range(ROUNDS)), *COLOURS)


def rows(name: str) -> Iterator[tuple[str, ...]]:
    """Play an animation or the sheet, and measure what sending takes."""
    if name == SHEET:
        item, shares = SceneItem(name, load_frames(sheet())), ROUNDS * [""]
    else:
        item = SceneItem(name, mixseq.fit(animation(name)))
        shares = rounds(Scene((item,)))
    times = (f"{1000 * sending(item, colour):.1f} ms" for colour in COLOURS)
    yield item.name, f"{item.header.vertex_count:,}".replace(",", " "), f"{item.header.fps:g}", *shares, *times


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


def sending(item: SceneItem, colour: str) -> float:
    """Return the seconds that the scene takes for a frame, the median of some."""
    from viser import ViserServer

    scene = Scene((item,))
    with redirect_stdout(StringIO()):
        server = ViserServer("127.0.0.1", 8500, verbose=False)
        stage = LiveStage(server, SceneColours(scene), ViewSettings(), lambda moment: None)
        stage.set_colour(colour)
        moments = [Moment(scene, frame, (item.pose(scene.elapsed(frame)),)) for frame in scene.sample_frames(24)]
        stage.show(moments[0])  # works out the colours
        seconds = []
        for moment in moments:
            begin = time.perf_counter()
            stage.show(moment)
            seconds.append(time.perf_counter() - begin)
        server.stop()
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
