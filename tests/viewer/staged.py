"""Scenes that are decoded when a test says so, a stage without a screen, and time that stands still."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from threading import Event, Lock
from typing import Any

import numpy as np

from mixseq.errors import ReconstructionError
from mixseq.pictures.scene import Scene, SceneItem
from mixseq.sequence.sequence import MeshSequence, load_frames
from mixseq.types import Single
from mixseq.viewer.playback import Moment, Playback
from tests.meshes import tetrahedron

PATIENCE = 30.0
"""Seconds that a busy machine may take for anything."""

FPS = 10


def eventually(holds: Callable[[], Any]) -> None:
    """Wait until something holds."""
    until = time.monotonic() + PATIENCE
    while not holds():
        assert time.monotonic() < until, "it never came"
        time.sleep(0.001)


@dataclass(frozen=True, eq=False)
class Watched(SceneItem):
    """A mesh of which is known what was decoded, by the number of the frame.

    Attributes
    ----------
    decoded : list of int
        Frames whose decoding began, in this order.
    held : dict
        Frames that are decoded only after something happens.
    broken : set of int
        Frames that cannot be decoded.
    """

    decoded: list[int] = field(default_factory=list)
    held: dict[int, Event] = field(default_factory=dict)
    broken: set[int] = field(default_factory=set)

    def pose(self, elapsed: float) -> Single:
        """Return points that are all at the number of the frame."""
        frame = round(elapsed * FPS)
        self.decoded.append(frame)
        if frame in self.held:
            assert self.held[frame].wait(PATIENCE)
        if frame in self.broken:
            raise ReconstructionError(f"frame {frame} is broken")
        return np.full((4, 3), frame, dtype=np.float32)


def watched(frames: int = 10, name: str = "mesh") -> Watched:
    """A mesh of four vertices, so of 48 bytes in every frame."""
    points, faces = tetrahedron()
    still = MeshSequence.from_arrays(np.repeat(points[None], frames, axis=0), faces, fps=FPS)
    return Watched(name, load_frames(still))


def scene_of(*items: SceneItem, rate: float | None = None) -> Scene:
    return Scene(items, rate)


class Stage:
    """Keeps what it was shown, and is busy as long as it is told to be."""

    def __init__(self) -> None:
        self.is_busy = False
        self.moments: list[Moment] = []
        self.on_show: Callable[[Moment], None] = lambda moment: None

    def show(self, moment: Moment) -> None:
        """Show a moment."""
        self.moments.append(moment)
        self.on_show(moment)

    @property
    def frames(self) -> list[int]:
        """The frames that were shown."""
        return [moment.frame for moment in self.moments]


class Standing:
    """A time of the day that goes on when it is told to."""

    def __init__(self, now: float = 1000.0) -> None:
        self._now = now
        self._reads = 0
        self._lock = Lock()

    def __call__(self) -> float:
        with self._lock:
            self._reads += 1
            return self._now

    def pass_by(self, seconds: float, playback: Playback) -> None:
        """Let time pass, and wait until a playback has done what it does at that time."""
        with self._lock:
            self._now += seconds
            until = self._reads + 3

        def noticed() -> bool:
            playback.wake()
            return self._reads >= until

        eventually(noticed)
