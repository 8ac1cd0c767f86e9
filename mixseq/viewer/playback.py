"""Play a scene: a clock, a cache of frames decoded in the background, and a thread that sends them to a stage.

A frame is sent only after the stage has drawn the previous frame. Frames that are decoded too late are dropped, which
keeps the playback speed constant on slow machines and networks. The last requested frame is decoded first; idle threads
decode the subsequent frames.
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
    """Immutable map from wall-clock time in seconds to the current frame."""

    count: int  # number of frames of the period
    fps: float  # frames per second at speed 1
    speed: float = 1.0  # playback speed
    frame: float = 0.0  # frame, possibly fractional, at the last start or stop
    started_at: float | None = None  # wall-clock time of the last start, or None if stopped
    section: tuple[int, int] | None = None  # first and last frame that are played, by default all
    loop: bool = True  # whether the section starts again at its end

    @property
    def is_running(self) -> bool:
        """Whether the clock is running."""
        return self.started_at is not None

    def frame_at(self, now: float) -> int:
        """Return the current frame ``0 .. count - 1``."""
        return int(self._position(now) + 1e-6)

    def is_finished(self, now: float) -> bool:
        """Whether the clock has played its section, which it does not start again."""
        return self.is_running and not self.loop and self.frame_at(now) >= self._ends[1]

    def seconds_to_next_frame(self, now: float) -> float:
        """Return the seconds until the next frame."""
        position = self._position(now) + 1e-6
        return (int(position) + 1 - position) / (self.fps * self.speed)

    def start(self, now: float) -> Clock:
        """Return a clock that runs from the current frame, or from the start of the section if that is not in it."""
        position, (first, last) = self._position(now), self._ends
        return replace(self, frame=position if first <= position < last + self.loop else first, started_at=now)

    def stop(self, now: float) -> Clock:
        """Return a clock that is stopped at the current frame."""
        return replace(self, frame=float(self.frame_at(now)), started_at=None)

    def seek(self, frame: float, now: float) -> Clock:
        """Return a clock at another frame, which runs if this clock runs."""
        clamped = float(min(max(frame, 0), self.count - 1))
        return replace(self, frame=clamped, started_at=None if self.started_at is None else now)

    def with_speed(self, speed: float, now: float) -> Clock:
        """Return a clock with another speed and the same current frame."""
        started_at = None if self.started_at is None else now
        return replace(self, frame=self._position(now), started_at=started_at, speed=speed)

    def with_section(self, first: int, last: int) -> Clock:
        """Return a clock that plays the frames from the first to the last, at the same frame."""
        return replace(self, section=None if (first, last) == (0, self.count - 1) else (first, last))

    def with_period(self, count: int, fps: float, now: float) -> Clock:
        """Return a clock with another period and frame rate, at the same elapsed time if the new period contains it."""
        elapsed = self._position(now) / self.fps
        frame = elapsed * fps if self.is_running else round(min(elapsed * fps, count - 1))
        first, last = (min(round(end * fps / self.fps), count - 1) for end in self._ends)
        section = (first, last) if self.section and first < last else None
        return replace(self, count=count, fps=fps, section=section).seek(frame, now)

    @property
    def _ends(self) -> tuple[int, int]:
        return self.section or (0, self.count - 1)

    def _position(self, now: float) -> float:
        if self.started_at is None:
            return self.frame
        position, (first, last) = self.frame + (now - self.started_at) * self.fps * self.speed, self._ends
        excess = position + 1e-6 - (last + 1)
        if excess < 0:
            return position
        return first + excess % (last + 1 - first) if self.loop else float(last)


Job = TypeVar("Job")


class BackgroundWorker:
    """Worker that runs a function on background threads until `close` or the end of a ``with`` block."""

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
        """End each thread after its current call of the function."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        for thread in self._threads:
            thread.join()


class JobQueue(BackgroundWorker, Generic[Job]):
    """Queue of jobs that run in order on a background thread."""

    def __init__(self, on_failure: Callable[[str, Exception], None], jobs: Iterable[Job] = ()) -> None:
        self._on_failure = on_failure
        self._jobs = deque(jobs)
        super().__init__(self._run_jobs)

    def _run_job(self, job: Job) -> None:
        """Run a job, and report its error if it fails."""
        raise NotImplementedError

    def _enqueue(self, job: Job, is_obsolete: Callable[[Job], bool]) -> None:
        """Add a job to the queue, and drop the waiting jobs that are obsolete."""
        with self._changed:
            self._jobs = deque(waiting for waiting in self._jobs if not is_obsolete(waiting))
            self._jobs.append(job)
            self._changed.notify_all()

    def _run_jobs(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._jobs or self._closed)
                if self._closed:
                    return
                job = self._jobs.popleft()
            self._run_job(job)

    def _report_failure(self, action: str, error: Exception) -> None:
        if not isinstance(error, MixseqError | MixseqWarning):  # a bug, which does not stop later jobs
            print_exception(error)
        try:
            self._on_failure(action, error)
        except Exception as callback_error:
            print_exception(callback_error)


DEFAULT_CACHE_BYTES = 1 << 30

Key = tuple[SceneItem, float]


class FrameCache(BackgroundWorker):
    """Cache of poses that are decoded in the background."""

    def __init__(self, on_decoded: Callable[[], None], threads: int = 2, max_bytes: int = DEFAULT_CACHE_BYTES) -> None:
        self._on_decoded = on_decoded
        self._max_bytes = max_bytes
        self._poses: OrderedDict[Key, Single | MixseqError] = OrderedDict()
        self._size = 0
        self._decoding: set[Key] = set()
        self._request: tuple[Scene, int, bool] | None = None  # scene, frame, and whether to decode ahead
        super().__init__(self._decode, threads)

    def request(self, scene: Scene, frame: int, ahead: bool = True) -> tuple[Single, ...] | None:
        """Return the poses ``(V, 3)`` of a frame if they are decoded; otherwise request them and return None."""
        elapsed = scene.elapsed(frame)
        with self._changed:
            self._request = scene, frame, ahead
            self._changed.notify_all()
            poses = []
            for item in scene.items:
                key = item, elapsed
                pose = self._poses.get(key)
                if pose is None:
                    return None
                if isinstance(pose, MixseqError):
                    del self._poses[key]  # so that the pose can be requested again
                    raise pose
                self._poses.move_to_end(key)
                poses.append(pose)
            return tuple(poses)

    def _decode(self) -> None:
        while True:
            with self._changed:
                while (key := self._next_key()) is None and not self._closed:
                    self._changed.wait()
                if self._closed or key is None:
                    return
                self._decoding.add(key)
            item, elapsed = key
            result: Single | MixseqError
            try:
                with one_blas_thread():
                    result = item.pose(elapsed)
            except MixseqError as error:
                result = error
            except Exception as error:  # a bug or lack of memory, which may not affect other frames
                print_exception(error)
                result = ReconstructionError(f"{type(error).__name__}: {error}")
            with self._changed:
                self._decoding.discard(key)
                self._store(key, result)
            self._on_decoded()

    def _next_key(self) -> Key | None:
        """Return the next pose to decode: from the requested frame, else from the first missing frame after it."""
        if self._request is None:
            return None
        scene, first, ahead = self._request
        for step in range(self._frames_ahead(scene) if ahead else 1):
            elapsed = scene.elapsed((first + step) % scene.count)
            for item in scene.items:
                key = item, elapsed
                if key not in self._poses and key not in self._decoding:
                    return key
        return None

    def _frames_ahead(self, scene: Scene) -> int:
        """Return the number of frames that fill three quarters of the cache."""
        size = sum(12 * item.header.vertex_count for item in scene.items)
        return max(1, min(scene.count, 3 * self._max_bytes // (4 * size)))

    def _store(self, key: Key, result: Single | MixseqError) -> None:
        self._poses[key] = result
        self._size += _bytes(result)
        while self._size > self._max_bytes and len(self._poses) > 1:
            self._size -= _bytes(self._poses.popitem(last=False)[1])


def _bytes(result: Single | MixseqError) -> int:
    return 0 if isinstance(result, MixseqError) else result.nbytes


DRAW_TIMEOUT_SECONDS = 0.25
"""Time after which a frame counts as drawn without confirmation."""

POLL_SECONDS = 0.5
"""Interval at which an idle playback thread wakes up."""


class Stage(Protocol):
    """Display that draws moments of a scene."""

    @property
    def is_busy(self) -> bool:
        """Whether the last moment is still being drawn; `Playback.wake` is called afterwards."""

    def show(self, moment: Moment) -> None:
        """Draw a moment."""


@dataclass(frozen=True, eq=False)
class Moment:
    """A frame of a scene with its decoded poses."""

    scene: Scene  # displayed scene
    frame: int  # index of the frame
    poses: tuple[Single, ...]  # points (V, 3) of each item


class Playback(BackgroundWorker):
    """Player that shows a scene on a stage."""

    def __init__(
        self,
        scene: Scene,
        stage: Stage,
        on_failure: Callable[[Exception], None],
        threads: int = 2,
        max_bytes: int = DEFAULT_CACHE_BYTES,
    ) -> None:
        self._scene = scene
        self._stage = stage
        self._on_failure = on_failure
        self._clock = Clock(scene.count, scene.fps)
        self._decode_ahead = True
        self._shown: tuple[Scene, int] | None = None
        self._stale = False
        self._sent_at = 0.0
        self._frames = FrameCache(self.wake, threads, max_bytes)
        super().__init__(self._run)

    def close(self) -> None:
        """End the playback and decoding threads."""
        super().close()
        self._frames.close()

    @property
    def scene(self) -> Scene:
        """The current scene."""
        return self._scene

    @property
    def is_playing(self) -> bool:
        """Whether the scene is playing."""
        return self._clock.is_running

    @property
    def frame(self) -> int:
        """The current frame."""
        return self._clock.frame_at(monotonic())

    def play(self) -> None:
        """Start playback, from the first frame if it was stopped at the last frame."""

        def start(clock: Clock, now: float) -> Clock:
            is_at_end = not clock.is_running and clock.frame_at(now) == clock.count - 1
            return (clock.seek(0, now) if is_at_end else clock).start(now)

        self._update_clock(start)

    def pause(self) -> None:
        """Stop playback at the last shown frame."""
        with self._changed:
            if not self._clock.is_running:
                return
            now = monotonic()
            is_shown = self._shown is not None and self._shown[0] is self._scene
            frame = self._shown[1] if self._shown and is_shown else self._clock.frame_at(now)
            self._clock = self._clock.stop(now).seek(frame, now)
            self._changed.notify_all()

    def seek(self, frame: int) -> None:
        """Go to a frame."""
        self._update_clock(lambda clock, now: clock.seek(frame, now))

    @property
    def section(self) -> tuple[int, int]:
        """First and last frame of the section that is played."""
        return self._clock.section or (0, self._clock.count - 1)

    def set_section(self, first: int, last: int) -> None:
        """Play the frames from the first to the last."""
        self._update_clock(lambda clock, _: clock.with_section(first, last))

    @property
    def is_looping(self) -> bool:
        """Whether the section starts again at its end."""
        return self._clock.loop

    def set_loop(self, on: bool) -> None:
        """Set whether the section starts again at its end."""
        self._update_clock(lambda clock, now: replace(clock.seek(clock.frame_at(now), now), loop=on))

    def set_speed(self, speed: float) -> None:
        """Set the playback speed."""
        self._update_clock(lambda clock, now: clock.with_speed(speed, now))

    def _update_clock(self, change: Callable[[Clock, float], Clock]) -> None:
        with self._changed:
            self._clock = change(self._clock, monotonic())
            self._changed.notify_all()

    def set_frame_rate(self, fps: float) -> None:
        """Set the frames per second; sequences are shown at their nearest frames."""
        with self._changed:
            self.set_scene(replace(self._scene, rate=fps))

    def set_scene(self, scene: Scene, decode_ahead: bool = True) -> None:
        """Show another scene at the same elapsed time; `decode_ahead` is false for previews."""
        with self._changed:
            self._clock = self._clock.with_period(scene.count, scene.fps, monotonic())
            self._scene, self._decode_ahead = scene, decode_ahead
            self._changed.notify_all()

    def refresh(self) -> None:
        """Send the current frame again after a change of colours."""
        with self._changed:
            self._shown, self._stale = None, True
            self._changed.notify_all()

    def wait_until_shown(self, timeout: float) -> bool:
        """Wait until the current scene has been sent to the stage; return False after a timeout in seconds."""
        with self._changed:
            return self._changed.wait_for(
                lambda: self._closed or (self._shown is not None and self._shown[0] is self._scene), timeout
            )

    def wake(self) -> None:
        """Wake the playback thread, after the stage has drawn or a frame has been decoded."""
        with self._changed:
            self._changed.notify_all()

    def _run(self) -> None:
        pending: tuple[Scene, int] | None = None
        while True:
            with self._changed:
                if self._closed:
                    return
                now = monotonic()
                if self._clock.is_finished(now):  # the last frame is sent again, as that of a stopped clock
                    self._clock, self._shown = self._clock.stop(now), None
                if self._stage.is_busy and now - self._sent_at < DRAW_TIMEOUT_SECONDS:
                    self._changed.wait(DRAW_TIMEOUT_SECONDS - (now - self._sent_at))
                    continue
                # a frame that is decoded late is still shown
                if pending is None or pending[0] is not self._scene or not self._clock.is_running:
                    pending = self._scene, self._clock.frame_at(now)
                if pending == self._shown:
                    pending = None
                    self._changed.wait(
                        self._clock.seconds_to_next_frame(now) if self._clock.is_running else POLL_SECONDS
                    )
                    continue
                scene, frame = pending
                ahead = self._decode_ahead
                try:
                    poses = self._frames.request(scene, frame, ahead)
                except MixseqError as error:
                    self._clock = self._clock.stop(now)
                    self._shown, pending = (scene, frame), None
                    failure: MixseqError | None = error
                else:
                    failure = None
                    if poses is None:
                        self._changed.wait(POLL_SECONDS)
                        continue
                    self._stale = False
            if failure is not None:
                self._on_failure(failure)
                continue
            assert poses is not None
            self._sent_at = monotonic()
            try:
                self._stage.show(Moment(scene, frame, poses))
            except Exception as error:
                # colour scales decode further frames, which may fail; any other error is a bug
                if not isinstance(error, MixseqError):
                    print_exception(error)
                self.pause()
                self._on_failure(error)
            with self._changed:
                # a refresh during sending may have come after the colours of this frame were computed
                self._shown = None if self._stale else (scene, frame)
                self._changed.notify_all()
            pending = None
