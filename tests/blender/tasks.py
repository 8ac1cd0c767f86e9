"""What mixseq is asked for, which moment of the walk every frame of the answer shows, and how it gets into Blender."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mixseq.operations import Retiming
from mixseq.types import Float
from tests.blender.gait import BASE, FIRST, LAST

MIXSEQ = (str(Path(sys.executable).with_name("mixseq")),)

START, END = FIRST / BASE, LAST / BASE

Commands = Sequence[Sequence[str]]
"""Command lines, one after the other."""


@dataclass(frozen=True)
class Task:
    """One thing to ask for; times are seconds.

    Frames ``(T,)`` of the answer by number, the moment of the walk that each must show, and how fast the walk goes
    there. `commands` are made from the original, the answer, its options for writing, and a folder for other files.
    """

    name: str
    fps: int
    frames: Float
    source: Float
    speed: Float
    commands: Callable[[Path, Path, Sequence[str], Path], Commands]

    @property
    def times(self) -> Float:
        """When the frames of the answer are."""
        return self.frames / self.fps

    @property
    def retimed(self) -> bool:
        """Whether its frames show other times than their own."""
        return not np.allclose(self.times, self.source)


def _resample(*options: str) -> Callable[[Path, Path, Sequence[str], Path], Commands]:
    def commands(original: Path, answer: Path, writing: Sequence[str], work: Path) -> Commands:
        return [[*MIXSEQ, "resample", str(original), str(answer), *options, *writing]]

    return commands


def _frames(first: float, last: float, fps: int) -> Float:
    """Return the numbers of the frames from one time to another."""
    return np.arange(np.ceil(first * fps - 1e-3), np.floor(last * fps + 1e-3) + 1)


def sixty() -> Task:
    """Another frame rate."""
    frames = _frames(START, END, 60)
    return Task("24 -> 60", 60, frames, frames / 60, np.ones(len(frames)), _resample("--fps", "60"))


def slow() -> Task:
    """Four times as long."""
    frames = _frames(START, START + 4 * (END - START), BASE)
    source = START + (frames / BASE - START) / 4
    return Task("x4 slow motion", BASE, frames, source, np.full(len(frames), 0.25), _resample("--speed", "0.25"))


def section() -> Task:
    """Forty frames from the middle."""
    frames = np.arange(1021.0, 1061.0)
    command = _resample("--frames", "1021-1060")
    return Task("section 1021-1060", BASE, frames, frames / BASE, np.ones(len(frames)), command)


RAMP = np.array([[0.0, 0.0], [1.0, 1.0], [3.0, 1.5], [4.0, 2.5]])
"""Seconds from the first frame on, of the answer and of the walk: at its speed, at a quarter, at its speed."""


def ramp() -> Task:
    """Slower in the middle."""
    keys = START + RAMP
    retiming = Retiming.through(keys[:, 0], keys[:, 1])
    frames = _frames(keys[0, 0], keys[-1, 0], BASE)

    def commands(original: Path, answer: Path, writing: Sequence[str], work: Path) -> Commands:
        table = work / "ramp.csv"
        table.write_text("output,source\n" + "".join(f"{float(o)!r},{float(s)!r}\n" for o, s in keys))
        return _resample("--retime", str(table))(original, answer, writing, work)

    times = frames / BASE
    return Task("ramp", BASE, frames, retiming(times), retiming.slope(times), commands)


LOOP = """
[[edit]]
operation = "cut"
start = {start!r}
end = {end!r}

[[edit]]
operation = "loop"
travel = true
"""


def loop() -> Task:
    """One stride made a loop that travels on: the walk repeats itself, so that nothing changes."""
    frames = np.arange(FIRST, FIRST + BASE + 1.0)

    def commands(original: Path, answer: Path, writing: Sequence[str], work: Path) -> Commands:
        script, model = work / "loop.toml", work / f"{original.stem}{original.suffix}.h5"
        script.write_text(LOOP.format(start=START, end=START + 1))
        return [
            [*MIXSEQ, "encode", str(original), str(model), "--exact"],
            [*MIXSEQ, "edit", str(model), str(answer), "--script", str(script), *writing],
        ]

    return Task("loop of a stride", BASE, frames, frames / BASE, np.ones(len(frames)), commands)


TASKS = (sixty, slow, section, ramp, loop)


@dataclass(frozen=True)
class Way:
    """A format, and a way back.

    With `onto` the original is named, as the result of an edit does not know it; with `cache` the original is imported,
    and its modifiers are pointed at the result. Animations of glTF begin at 0: they do not keep their times.
    """

    name: str
    extension: str
    onto: bool = False
    cache: bool = False
    whole_stage: bool = False
    velocities: bool = True
    keeps_times: bool = True

    def original(self, folder: Path) -> Path:
        """Return what Blender exported, for mixseq."""
        return folder / f"walker{BASE}.{self.extension}"

    def opening(self, answer: Path, fps: int, folder: Path) -> dict[str, Any]:
        """Return how Blender opens the result."""
        if self.cache:
            return {"file": str(self.original(folder)), "fps": fps, "cache": str(answer.resolve())}
        return {"file": str(answer), "fps": fps}


WAYS = (
    Way("USD, layer", "usdc", whole_stage=True),
    Way("Alembic, --onto", "abc", onto=True),
    Way("Alembic, cache modifier", "abc", onto=True, cache=True),
    Way("glTF, --onto", "glb", onto=True, velocities=False, keeps_times=False),
)


def made(task: Task, way: Way, folder: Path) -> tuple[Path, list[str]]:
    """Run a task's commands; return where the result is if none failed, and what they said."""
    original = way.original(folder)
    words = "-".join(word for word in task.name.split() if word.isalnum())
    answer = folder / f"{way.extension}-{words}.{way.extension}"
    answer.unlink(missing_ok=True)
    writing = ["--velocities"] if way.velocities else []
    writing += ["--set", f"onto={original}"] if way.onto else []
    writing += ["--whole-stage"] if way.whole_stage and task.retimed else []
    said: list[str] = []
    for command in task.commands(original, answer, writing, folder):
        done = subprocess.run(command, capture_output=True, text=True)
        said += [line for line in done.stderr.splitlines() if line]
        if done.returncode:
            said.append(f"ended with {done.returncode}: {' '.join(command[1:])}")
            break
    return answer, said
