"""Rows about models that are live in Blender: what `living.py` saw, beside what mixseq decodes here."""

from __future__ import annotations

import os
import subprocess
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import mixseq
from mixseq.blender.extension import RELEASES, this_platform, write_extension
from mixseq.blender.motion import Motion, Placement
from mixseq.creature import walk_cycle
from mixseq.mesh.surface import CornerValues, Surface
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.model import Model
from tests.blender.environment import python

FPS = 24
PIXELS = 16
"""Per unit, of the camera that looks at the sheet."""

SINGLE = 4 * float(np.finfo(np.float32).eps)
"""What single precision may be off by, in diagonals: of a point, and of a frame's number."""

BYTE = 0.5 / 255 * 2.4 / 1.055
"""Half a byte of sRGB near white, as a linear number."""

LIVING = Path(__file__).with_name("living.py")

SHUTTER = 9
"""The frame that is rendered."""

Seen = Callable[[str], dict[str, Any]]
"""What Blender showed in a task of `living.py`, by its name."""


@dataclass(frozen=True)
class LiveRow:
    """What was measured, and how much it may be, or must be at least."""

    what: str
    value: float
    limit: float
    unit: str = "diagonals"
    at_least: bool = False

    @property
    def passed(self) -> bool:
        """Whether it is as it should be."""
        return self.value >= self.limit if self.at_least else self.value <= self.limit

    def __str__(self) -> str:
        sign, passed = "at least" if self.at_least else "at most", "yes" if self.passed else "**no**"
        return f"| {self.what} | {self.value:.2g} | {sign} {self.limit:.2g} {self.unit} | {passed} |"


def live_rows(folder: Path, data: Path | None) -> Iterator[LiveRow]:
    """Have Blender show models, and compare; `data` is the folder of real animations, for the large cache."""
    models = _models(folder, data)
    write_extension(folder / "extension.zip", this_platform(), RELEASES["4.2"])
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    environment["BLENDER_USER_RESOURCES"] = str(folder / "user")
    words = [python(), "-P", str(LIVING), str(folder)]
    done = subprocess.run(words, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    if done.returncode:
        raise SystemExit(f"Blender failed in {LIVING.name}:\n{done.stdout[-2000:]}")
    for rows in (_positions, _coloured, _rendered, _others):
        yield from rows(models, lambda name: dict(np.load(folder / f"{name}.npz")))
    yield LiveRow("tracebacks in the console", done.stdout.count("Traceback"), 0, "lines")


def _models(folder: Path, data: Path | None) -> dict[str, Model]:
    """Make the models and keep them; each is returned as it is read."""
    walk = walk_cycle(24)
    mixseq.save(folder / "signals.h5", mixseq.fit(walk))
    mixseq.save(folder / "compressed.h5", mixseq.compress(walk, max_error=1e-3))
    mixseq.save(folder / "slide.h5", mixseq.fit(_slide(), space="vertex", exact=True))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of colours beyond white
        for suffix in (".glb", ".usdc"):
            mixseq.write(folder / f"slide{suffix}", _slide())
    names = ["signals", "compressed", "slide"]
    if data is not None:
        large = mixseq.read(data / "npz" / "elephant_gallop.npz")
        mixseq.save(folder / "large.h5", mixseq.compress(large, kg=0.1))
    return {name: mixseq.load(folder / f"{name}.h5") for name in names}


def _slide() -> MeshSequence:
    """A square of half a unit that slides along x, faster and faster, with colours of corners, some beyond white."""
    corners = np.array([[-0.25, -0.25, 0], [0.25, -0.25, 0], [0.25, 0.25, 0], [-0.25, 0.25, 0]])
    time = np.arange(20) / 19
    moved = corners + (2 * time**2 - 1)[:, None, None] * [1.0, 0, 0]
    slide = MeshSequence.from_arrays(moved, [[0, 1, 2], [0, 2, 3]], fps=FPS, up_axis="Z")
    colours = CornerValues(np.linspace(0, 2, 24, dtype=np.float32).reshape(6, 4), np.arange(6))
    return replace(slide, surface=Surface(colours=colours))


def _off(model: Model, frames: Any, seen: Any) -> float:
    """Return how far vertices are from where a model is at frames, in diagonals of its first one."""
    motion = Motion(model, Placement.from_header(model.header))
    expected = np.array([motion.points(float(frame) / FPS) for frame in frames], dtype=np.float64)
    diagonal = float(np.linalg.norm(np.ptp(expected[0], axis=0)))
    return float(np.abs(np.asarray(seen, dtype=np.float64) - expected).max()) / diagonal


def _positions(models: dict[str, Model], seen: Seen) -> Iterator[LiveRow]:
    several, retimed, reopened, baked = map(seen, ("several", "retimed", "reopened", "baked"))
    moments = several["moments"]
    yield LiveRow("frames and sub-frames, signals", _off(models["signals"], moments, several["signals"]), SINGLE)
    later = _off(models["compressed"], moments - 3, several["compressed"])
    yield LiveRow("a second object, compressed, 3 frames later", later, SINGLE)
    size = np.ptp(several["compressed"][-1], axis=0)
    yield LiveRow("its bounds", float(np.abs(several["size"] - size).max()), 1e-5, "units")
    for what, name in (("retimed by a curve", "curve"), ("retimed by a strip", "strip")):
        yield LiveRow(what, _off(models["compressed"], retimed[f"{name}_frames"], retimed[name]), SINGLE)
    astray = float(np.abs(retimed["strip_frames"] - retimed["meant"]).max())
    yield LiveRow("frames of the strip, compared with its curve", astray, 1e-3, "frames")
    yield LiveRow("after saving, moving and opening", _off(models["signals"], moments, reopened["points"]), SINGLE)
    absolute = sum(not path.startswith("//") for path in reopened["paths"].tolist())
    yield LiveRow("absolute paths", absolute, 0, "paths")
    for what, name in (("baked to Alembic", "alembic"), ("baked to shape keys", "keys")):
        yield LiveRow(what, _off(models["compressed"], baked["moments"], baked[name]), SINGLE)


def _coloured(models: dict[str, Model], seen: Seen) -> Iterator[LiveRow]:
    found, colours = seen("coloured"), models["slide"].header.surface.colours
    assert colours is not None
    for what, name in (("colours of corners", "model"), ("colours, after saving and opening", "opened")):
        yield LiveRow(what, float(np.abs(found[name] - colours.at_corners).max()), 0, "of 1")
    white = np.minimum(colours.at_corners, 1)
    off = np.abs(found["glb"] - white).max()
    yield LiveRow("colours of glTF, in sRGB's bytes", float(off), BYTE, "of 1")
    off = np.abs(found["usdc"] - colours.at_corners)[:, :3].max()
    yield LiveRow("colours of USD, without alpha", float(off), 0, "of 1")


def _rendered(models: dict[str, Model], seen: Seen) -> Iterator[LiveRow]:
    slide, found = models["slide"], seen("rendered")
    frames = found["step_frames"]
    yield LiveRow("times while the shutter is open", len(np.unique(frames)), 5, "moments", at_least=True)
    yield LiveRow("vertices at these times", _off(slide, frames, found["steps"]), SINGLE)
    yield LiveRow("vertices after the render", _off(slide, [SHUTTER], found["after"]), SINGLE)
    before, now, after = (slide((SHUTTER + step) / FPS)[0, 0] for step in (-1, 0, 1))
    vectors = found["vectors"]
    expected = PIXELS * np.array([before - now, 0, now - after, 0])
    inside = np.abs(vectors).max(axis=-1) > 0
    yield LiveRow("pixels that move", int(inside.sum()), 0.9 * (PIXELS / 2) ** 2, "pixels", at_least=True)
    error = float(np.abs(vectors[inside] - expected).max()) if inside.any() else np.inf
    yield LiveRow(f"their motion vectors, of {abs(expected[0]):.1f} and {abs(expected[2]):.1f}", error, 1e-3, "pixels")


def _others(models: dict[str, Model], seen: Seen) -> Iterator[LiveRow]:
    *wrong, none = seen("told")["messages"].tolist()
    silent = sum(not message for message in wrong) + bool(none)
    yield LiveRow("missing and false error messages", silent, 0, "messages")
    if rates := seen("scrubbed"):
        what = f"scrubbing {rates['vertices']:,} vertices"
        for kept, rate in zip(("decoded", "kept"), rates["rates"].tolist(), strict=True):
            yield LiveRow(f"{what}, {kept}", rate, 15, "frames per second of one core", at_least=True)
