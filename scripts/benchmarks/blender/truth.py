"""The scene itself, at any moment: what results are compared with."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mixseq.types import Float
from scripts.benchmarks.blender.environment import show
from scripts.benchmarks.blender.seen import Seen
from scripts.benchmarks.blender.shot import BASE, FIRST, LAST, RATES
from scripts.benchmarks.blender.tasks import Task

STEP = 1 / 480
"""Seconds between the poses whose differences are velocities."""

SHOT = np.array([FIRST, (FIRST + LAST) // 2, LAST])
"""Frames at which vertices of the originals are found."""


@dataclass(frozen=True, eq=False)
class Truth:
    """What the scene shows.

    Attributes
    ----------
    task : Seen
        At the moments of a task.
    velocities : (T, V, 3) array
        Of the walk, there, per second.
    shot : Seen
        At `SHOT`.
    """

    task: Seen
    velocities: Float
    shot: Seen

    @classmethod
    def of(cls, task: Task, folder: Path) -> Truth:
        """Let Blender open the scene."""
        fine = max(RATES)
        scene = {"file": str(folder / f"walker{fine}.blend"), "fps": fine}
        moments = (task.source, task.source - STEP, task.source + STEP, SHOT / BASE)
        outputs = [folder / f"truth{number}" for number in range(len(moments))]
        jobs = zip(moments, outputs, strict=True)
        show(
            [{"open": scene, "frames": (times * fine).tolist(), "output": str(path)} for times, path in jobs],
            folder,
        )
        now, before, after, shot = map(Seen.read, outputs)
        return cls(now, (after.together("points") - before.together("points")) / (2 * STEP), shot)
