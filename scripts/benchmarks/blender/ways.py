"""How results are written over their originals, and come back into Blender."""

from __future__ import annotations

import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scripts.benchmarks.blender.shot import BASE
from scripts.benchmarks.blender.tasks import Task


@dataclass(frozen=True)
class Way:
    """A format, and a way back.

    Attributes
    ----------
    name : str
        Of the row in the table.
    extension : str
        Of the original and of the result.
    onto : bool
        Whether the original is named, as the result of an edit does not know it.
    cache : bool
        Whether the original is imported, and its modifiers are pointed at the result.
    whole_stage : bool
        Whether all else in the scene can be retimed, too.
    velocities : bool
        Whether the format has a place for them.
    keeps_times : bool
        Whether frames have the numbers that they had; animations of glTF begin at 0.
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
