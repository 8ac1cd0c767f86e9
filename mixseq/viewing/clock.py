"""The clock of playback: the current frame of a repeated period, at any speed."""

from __future__ import annotations

from dataclasses import dataclass, replace


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

    def sought(self, frame: int, now: float) -> Clock:
        """Return the clock at another frame, running if it ran."""
        inside = float(min(max(frame, 0), self.count - 1))
        return replace(self, frame=inside, since=None if self.since is None else now)

    def paced(self, speed: float, now: float) -> Clock:
        """Return the clock at another speed, with the same current time."""
        return replace(
            self, frame=self._place(now) % self.count, since=None if self.since is None else now, speed=speed
        )

    def over(self, count: int, fps: float, now: float) -> Clock:
        """Return the clock over another period, with the same current time as far as possible."""
        elapsed = (self._place(now) % self.count) / self.fps
        frame = min(elapsed * fps, count - 1)
        if self.since is None:
            frame = float(round(frame))
        return replace(self, count=count, fps=fps, frame=frame, since=None if self.since is None else now)

    def _place(self, now: float) -> float:
        return self.frame if self.since is None else self.frame + (now - self.since) * self.fps * self.speed
