"""Playback of a scene: a clock, a cache of frames decoded in the background, and a thread that passes them to a stage.

Frames that are not decoded in time are dropped, and a frame is sent when the stage has drawn the one before, so that
the displayed time is right at any speed of machine and network. The newest requested frame is decoded first; idle
threads decode the frames after it.
"""

from __future__ import annotations

from collections import OrderedDict, deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from threading import Condition, Thread
from time import monotonic
from traceback import print_exception
from typing import Generic, Protocol, Self, TypeVar

from mixseq.errors import MixseqError, MixseqWarning, ReconstructionError
from mixseq.pictures.scene import Scene, SceneItem
from mixseq.runtime.parallel import one_blas_thread
from mixseq.types import Single


@dataclass(frozen=True)
class Clock:
    """The current frame over time."""

    count: int  # frames of the period
    fps: float  # frames per second at the speed 1
    speed: float = 1.0  # how many times as fast it runs
    frame: float = 0.0  # where it was, in frames, when it was started or stopped
    since: float | None = None  # when it was started, in seconds of the time of day; None while it stands

    @property
    def runs(self) -> bool:
        """Whether the clock is running."""
        return self.since is not None

    def at(self, now: float) -> int:
        """Return the current frame ``0 .. count - 1``."""
        return int(self._place(now) + 1e-6) % self.count

    def next_at(self, now: float) -> float:
        """Return the seconds until the next frame is due."""
        place = self._place(now) + 1e-6
        return (int(place) + 1 - place) / (self.fps * self.speed)

    def started(self, now: float) -> Clock:
        """Return the clock running from its current time."""
        return replace(self, frame=self._place(now) % self.count, since=now)

    def stopped(self, now: float) -> Clock:
        """Return the clock stopped at its current frame."""
        return replace(self, frame=float(self.at(now)), since=None)

    def sought(self, frame: float, now: float) -> Clock:
        """Return the clock at another frame, running if it ran."""
        inside = float(min(max(frame, 0), self.count - 1))
        return replace(self, frame=inside, since=None if self.since is None else now)

    def paced(self, speed: float, now: float) -> Clock:
        """Return the clock at another speed, with the same current time."""
        since = None if self.since is None else now
        return replace(self, frame=self._place(now) % self.count, since=since, speed=speed)

    def over(self, count: int, fps: float, now: float) -> Clock:
        """Return the clock over another period, with the same current time as far as possible."""
        elapsed = (self._place(now) % self.count) / self.fps
        frame = elapsed * fps if self.runs else round(min(elapsed * fps, count - 1))
        return replace(self, count=count, fps=fps).sought(frame, now)

    def _place(self, now: float) -> float:
        return self.frame if self.since is None else self.frame + (now - self.since) * self.fps * self.speed


Job = TypeVar("Job")


class Background:
    """Runs work on threads of its own until it is closed, at the latest by the end of a ``with`` block."""

    def __init__(self, work: Callable[[], None], threads: int = 1) -> None:
        self._closed = False
        self._changed = Condition()
        self._threads = [Thread(target=work, daemon=True) for _ in range(threads)]
        for thread in self._threads:
            thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the threads after their current work."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        for thread in self._threads:
            thread.join()


class Jobs(Background, Generic[Job]):
    """Runs jobs in order until it is closed."""

    def __init__(self, failed: Callable[[str, Exception], None], jobs: Iterable[Job] = ()) -> None:
        self._failed = failed
        self._jobs = deque(jobs)
        super().__init__(self._work)

    def _do(self, job: Job) -> None:
        """Run a job, and report its failure."""
        raise NotImplementedError

    def _add(self, job: Job, needless: Callable[[Job], bool]) -> None:
        """Add a job to the queue, and drop the needless ones before it."""
        with self._changed:
            self._jobs = deque(each for each in self._jobs if not needless(each))
            self._jobs.append(job)
            self._changed.notify_all()

    def _work(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._jobs or self._closed)
                if self._closed:
                    return
                job = self._jobs.popleft()
            self._do(job)

    def _fail(self, what: str, error: Exception) -> None:
        if not isinstance(error, MixseqError | MixseqWarning):  # a bug, but the work goes on
            print_exception(error)
        try:
            self._failed(what, error)
        except Exception as again:
            print_exception(again)


MEMORY = 1 << 30
"""Size of the cache, in bytes."""

Key = tuple[SceneItem, float]


class FrameCache(Background):
    """Frames of scenes, decoded in the background."""

    def __init__(self, ready: Callable[[], None], threads: int = 2, memory: int = MEMORY) -> None:
        self._ready = ready
        self._memory = memory
        self._kept: OrderedDict[Key, Single | MixseqError] = OrderedDict()
        self._size = 0
        self._busy: set[Key] = set()
        self._wish: tuple[Scene, int, bool] | None = None  # a frame, and whether those after it are wanted
        super().__init__(self._decode, threads)

    def want(self, scene: Scene, frame: int, ahead: bool = True) -> tuple[Single, ...] | None:
        """Request a frame, and return its poses ``(V, 3)``, None if they are not decoded yet."""
        elapsed = scene.elapsed(frame)
        with self._changed:
            self._wish = scene, frame, ahead
            self._changed.notify_all()
            poses = []
            for item in scene.items:
                key = item, elapsed
                pose = self._kept.get(key)
                if pose is None:
                    return None
                if isinstance(pose, MixseqError):
                    del self._kept[key]  # another try may do better, and should be possible
                    raise pose
                self._kept.move_to_end(key)
                poses.append(pose)
            return tuple(poses)

    def _decode(self) -> None:
        while True:
            with self._changed:
                while (key := self._next()) is None and not self._closed:
                    self._changed.wait()
                if self._closed or key is None:
                    return
                self._busy.add(key)
            item, elapsed = key
            found: Single | MixseqError
            try:
                with one_blas_thread():
                    found = item.pose(elapsed)
            except MixseqError as error:
                found = error
            except Exception as error:  # a bug, or no memory: this frame cannot be shown, others may be
                print_exception(error)
                found = ReconstructionError(f"{type(error).__name__}: {error}")
            with self._changed:
                self._busy.discard(key)
                self._keep(key, found)
            self._ready()

    def _next(self) -> Key | None:
        """Return the next pose to decode: a requested one, or the first missing one after it."""
        if self._wish is None:
            return None
        scene, first, ahead = self._wish
        for step in range(self._horizon(scene) if ahead else 1):
            elapsed = scene.elapsed((first + step) % scene.count)
            for item in scene.items:
                key = item, elapsed
                if key not in self._kept and key not in self._busy:
                    return key
        return None

    def _horizon(self, scene: Scene) -> int:
        """Return the number of frames in three quarters of the memory."""
        size = sum(12 * item.header.vertex_count for item in scene.items)
        return max(1, min(scene.count, 3 * self._memory // (4 * size)))

    def _keep(self, key: Key, found: Single | MixseqError) -> None:
        self._kept[key] = found
        self._size += _bytes(found)
        while self._size > self._memory and len(self._kept) > 1:
            self._size -= _bytes(self._kept.popitem(last=False)[1])


def _bytes(found: Single | MixseqError) -> int:
    return 0 if isinstance(found, MixseqError) else found.nbytes


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

        def started(clock: Clock, now: float) -> Clock:
            at_end = not clock.runs and clock.at(now) == clock.count - 1
            return (clock.sought(0, now) if at_end else clock).started(now)

        self._set(started)

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
        self._set(lambda clock, now: clock.sought(frame, now))

    def pace(self, speed: float) -> None:
        """Set the speed."""
        self._set(lambda clock, now: clock.paced(speed, now))

    def _set(self, change: Callable[[Clock, float], Clock]) -> None:
        with self._changed:
            self._clock = change(self._clock, monotonic())
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
            except Exception as error:
                # scales of colours look at frames of their own; or a bug, but playing goes on
                if not isinstance(error, MixseqError):
                    print_exception(error)
                self.pause()
                self._failed(error)
            with self._changed:
                # whether it was asked for again while it was sent, maybe in the colours of before
                self._shown = None if self._stale else (scene, frame)
                self._changed.notify_all()
            awaited = None
