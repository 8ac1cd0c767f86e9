"""Playback of a scene: a thread that passes the current frame to a stage, which draws it.

Frames that are not decoded in time are dropped, and a frame is sent when the stage has drawn the one before, so that
the displayed time is right at any speed of machine and network.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from time import monotonic
from traceback import print_exception
from typing import Protocol

from mixseq.arrays import Single
from mixseq.errors import MixseqError
from mixseq.scene.items import Scene
from mixseq.viewing.background import Background
from mixseq.viewing.clock import Clock
from mixseq.viewing.frame_cache import MEMORY, FrameCache

PATIENCE = 0.25
"""Seconds after which a frame counts as drawn without confirmation."""

IDLE = 0.5
"""Seconds after which an idle stage is polled."""


class Stage(Protocol):
    """Draws moments of a scene."""

    @property
    def busy(self) -> bool:
        """Whether it is still drawing the last moment; it calls `Playback.drawn` afterwards."""

    def show(self, moment: Moment) -> None:
        """Draw a moment."""


@dataclass(frozen=True, eq=False)
class Moment:
    """The scene at a time."""

    scene: Scene  # what is shown
    frame: int  # which frame of it
    poses: tuple[Single, ...]  # the points of its items


class Playback(Background):
    """Plays a scene on a stage."""

    def __init__(
        self,
        scene: Scene,
        stage: Stage,
        failed: Callable[[Exception], None],
        threads: int = 2,
        memory: int = MEMORY,
    ) -> None:
        self._shot = scene
        self._stage = stage
        self._failed = failed
        self._clock = Clock(scene.count, scene.fps)
        self._settled = True
        self._shown: tuple[Scene, int] | None = None
        self._stale = False
        self._sent = 0.0
        self._frames = FrameCache(self.drawn, threads, memory)
        super().__init__(self._run)

    def close(self) -> None:
        """End the threads."""
        super().close()
        self._frames.close()

    @property
    def scene(self) -> Scene:
        """The current scene."""
        return self._shot

    @property
    def plays(self) -> bool:
        """Whether it is playing."""
        return self._clock.runs

    @property
    def frame(self) -> int:
        """The current frame."""
        return self._clock.at(monotonic())

    def play(self) -> None:
        """Play, from the start if it is at the end."""
        with self._changed:
            if not self._clock.runs and self._clock.at(monotonic()) == self._clock.count - 1:
                self._clock = self._clock.sought(0, monotonic())
            self._clock = self._clock.started(monotonic())
            self._changed.notify_all()

    def pause(self) -> None:
        """Stop at the frame that was shown last."""
        with self._changed:
            if not self._clock.runs:
                return
            now = monotonic()
            frame = self._shown[1] if self._shown and self._shown[0] is self._shot else self._clock.at(now)
            self._clock = self._clock.stopped(now).sought(frame, now)
            self._changed.notify_all()

    def seek(self, frame: int) -> None:
        """Go to a frame."""
        with self._changed:
            self._clock = self._clock.sought(frame, monotonic())
            self._changed.notify_all()

    def pace(self, speed: float) -> None:
        """Set the speed."""
        with self._changed:
            self._clock = self._clock.paced(speed, monotonic())
            self._changed.notify_all()

    def rate(self, fps: float) -> None:
        """Set the frames per second: models at all of them, sequences at the nearest frames."""
        with self._changed:
            self.change(replace(self._shot, rate=fps))

    def change(self, scene: Scene, settled: bool = True) -> None:
        """Show another scene at the same time."""
        with self._changed:
            self._clock = self._clock.over(scene.count, scene.fps, monotonic())
            self._shot, self._settled = scene, settled
            self._changed.notify_all()

    def refresh(self) -> None:
        """Show the current moment again, in other colours."""
        with self._changed:
            self._shown, self._stale = None, True
            self._changed.notify_all()

    def caught_up(self, patience: float) -> bool:
        """Wait some seconds until the current scene was sent to the stage, and return whether it was."""
        with self._changed:
            return self._changed.wait_for(
                lambda: self._closed or (self._shown is not None and self._shown[0] is self._shot), patience
            )

    def drawn(self) -> None:
        """Wake the thread: the stage is ready, or a frame was decoded."""
        with self._changed:
            self._changed.notify_all()

    def _run(self) -> None:
        awaited: tuple[Scene, int] | None = None
        while True:
            with self._changed:
                if self._closed:
                    return
                now = monotonic()
                if self._stage.busy and now - self._sent < PATIENCE:
                    self._changed.wait(PATIENCE - (now - self._sent))
                    continue
                # a frame that took long is shown late rather than never
                if awaited is None or awaited[0] is not self._shot or not self._clock.runs:
                    awaited = self._shot, self._clock.at(now)
                if awaited == self._shown:
                    awaited = None
                    self._changed.wait(self._clock.next_at(now) if self._clock.runs else IDLE)
                    continue
                scene, frame = awaited
                ahead = self._settled
                try:
                    poses = self._frames.want(scene, frame, ahead)
                except MixseqError as error:
                    self._clock = self._clock.stopped(now)
                    self._shown, awaited = (scene, frame), None
                    failure: MixseqError | None = error
                else:
                    failure = None
                    if poses is None:
                        self._changed.wait(IDLE)
                        continue
                    self._stale = False
            if failure is not None:
                self._failed(failure)
                continue
            assert poses is not None
            self._sent = monotonic()
            try:
                self._stage.show(Moment(scene, frame, poses))
            except (
                Exception
            ) as error:  # scales of colours look at frames of their own; or a bug, but playing goes on
                if not isinstance(error, MixseqError):
                    print_exception(error)
                self.pause()
                self._failed(error)
            with self._changed:
                # whether it was asked for again while it was sent, maybe in the colours of before
                self._shown = None if self._stale else (scene, frame)
                self._changed.notify_all()
            awaited = None
