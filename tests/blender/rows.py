"""Rows of the table: a task in a format, and what came of it in Blender, beside the scene itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from mixseq.types import Float, Index
from tests.blender.environment import show
from tests.blender.gait import BASE, FIRST, LAST, RATES
from tests.blender.seen import Seen, Surface, root_mean_square
from tests.blender.tasks import Task, Way

POSITIONS, VELOCITIES, CAMERA = 1e-4, 0.01, 1e-4
"""Largest errors: rms in diagonals, rms as a share of the truth's, and of any entry of the camera's matrix."""

BY_ITSELF = f"Blender's own at {max(RATES)}"


STEP = 1 / 480
"""Seconds between the poses whose differences are velocities."""

SHOT = np.array([FIRST, (FIRST + LAST) // 2, LAST])
"""Frames at which vertices of the originals are found."""


@dataclass(frozen=True, eq=False)
class Truth:
    """The scene at the moments of a task, velocities ``(T, V, 3)`` there per second, and the scene at `SHOT`."""

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
        show([{"open": scene, "frames": (times * fine).tolist(), "output": str(path)} for times, path in jobs], folder)
        now, before, after, shot = map(Seen.read, outputs)
        return cls(now, (after.together("points") - before.together("points")) / (2 * STEP), shot)


@dataclass
class Row:
    """What became of a task: errors in diagonals, velocities as a share, checks by name, and what commands said."""

    way: str
    task: str
    frames: int = 0
    rms: float | None = None
    largest: float | None = None
    velocities: float | None = None
    checks: dict[str, bool] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    @property
    def passed(self) -> bool:
        """Whether there is a result, and all that was looked at is as it should be."""
        return bool(self.checks) and all(self.checks.values())

    def check(self, name: str, holds: bool, otherwise: str = "") -> None:
        """Enter whether something is as it should be, and a note if it is not."""
        self.checks[name] = holds
        if not holds and otherwise:
            self.notes.append(otherwise)


def measured(task: Task, way: Way, answer: Path, truth: Truth, folder: Path) -> Row:
    """Import a result and its original, and compare both with the scene; Blender leaves files in `folder`."""
    first = {"file": str(way.original(folder)), "fps": BASE}
    shift = 0.0 if way.keeps_times else task.frames[0]
    jobs = {
        "shown": (way.opening(answer, task.fps, folder), task.frames - shift),
        "same-times": (first, task.times * BASE),
        "same-moments": (first, task.source * BASE),
        "shot": (first, SHOT),
    }
    show(_described(jobs, folder), folder)
    seen, times, moments, shot = (Seen.read(folder / name) for name in jobs)
    row = Row(way.name, task.name, len(task.frames))
    if not seen.has_meshes:
        row.check("positions", False, f"meshes in Blender: {sorted(seen.names['meshes'])}")
        return row
    surface = Surface.found(seen, truth.task)
    _positions(row, surface, truth.task)
    if way.velocities:
        _velocities(row, seen, truth.velocities[:, surface.vertices] * task.speed[:, None, None])
    original = Surface.found(shot, truth.shot)
    row.check("materials", surface.has_materials_of(original))
    row.check("UVs", surface.has_uvs_of(original))
    others = sorted({*seen.objects} ^ {*shot.objects})
    row.check("paths", not others, f"objects here or there only: {', '.join(others)}")
    _camera(row, seen, moments if way.whole_stage else times)
    if not way.cache:  # Blender leaves the range alone when a modifier is pointed at another file
        _range(row, seen.scene_range if way.keeps_times else seen.action_range, task.frames[[0, -1]] - shift)
    return row


def by_itself(way: Way, folder: Path) -> Row:
    """Compare Blender's own file at the finer rate with the scene: how near anything can come this way."""
    fine = max(RATES)
    frames = np.arange(FIRST * fine // BASE, LAST * fine // BASE + 1)
    jobs: dict[str, tuple[dict[str, Any], Index]] = {
        "scene": ({"file": str(folder / f"walker{fine}.blend"), "fps": fine}, frames),
        "shown": ({"file": str(folder / f"walker{fine}.{way.extension}"), "fps": fine}, frames),
    }
    show(_described(jobs, folder), folder)
    scene, seen = (Seen.read(folder / name) for name in jobs)
    row = Row(way.name.partition(",")[0], BY_ITSELF, len(frames))
    _positions(row, Surface.found(seen, scene), scene)
    return row


def _described(jobs: Mapping[str, tuple[dict[str, Any], Float | Index]], folder: Path) -> list[dict[str, Any]]:
    return [
        {"open": opened, "frames": frames.tolist(), "output": str(folder / name)}
        for name, (opened, frames) in jobs.items()
    ]


def _positions(row: Row, surface: Surface, truth: Seen) -> None:
    expected = truth.together("points")
    diagonal = float(np.linalg.norm(np.ptp(expected[0], axis=0)))
    errors = (surface.seen.together("points") - expected[:, surface.vertices]) / diagonal
    row.rms, row.largest = root_mean_square(errors), float(np.linalg.norm(errors, axis=-1).max())
    row.check("positions", row.rms <= POSITIONS)
    missing = expected.shape[1] - len(np.unique(surface.vertices))
    row.check("vertices", not missing, f"{missing} vertices are not there")


def _velocities(row: Row, seen: Seen, expected: Float) -> None:
    if not seen.has_velocities:
        row.check("velocities", False, "no velocities in Blender")
        return
    row.velocities = root_mean_square(seen.together("velocities") - expected) / root_mean_square(expected)
    row.check("velocities", row.velocities <= VELOCITIES)


def _camera(row: Row, seen: Seen, original: Seen) -> None:
    if seen.names["lenses"] != original.names["lenses"]:
        lenses = f"{seen.names['lenses']}, of the original {original.names['lenses']}"
        row.check("camera", False, f"focal lengths of cameras: {lenses}")
        return
    error = float(np.abs(seen.camera - original.camera).max())
    row.check("camera", error <= CAMERA, f"the camera is off by {error:.2g}")


def _range(row: Row, found: tuple[float, float], asked: Float) -> None:
    row.check("range", np.allclose(found, asked, atol=1e-2), f"frames {found}, {asked.tolist()} were asked for")
