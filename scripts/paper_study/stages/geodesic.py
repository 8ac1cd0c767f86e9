"""Time-discrete geodesics in the space of shells, beside discrete shells and MixIT."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from scripts.paper_study.common.baselines import SEGMENTS, THICKNESS, Geodesic
from scripts.paper_study.common.methods import METHODS
from scripts.paper_study.common.poses import Poses
from scripts.paper_study.common.record import Json, Results, ratio_range
from scripts.paper_study.stages.baselines import compared, explained, table

MESHES = ("lion", "cat", "horse")
"""The elephant's systems would have 380,000 unknowns."""

BESIDE = ("DSO", "MixIT")


def measure(poses: Poses, folder: Path, say: Callable[[str], None]) -> Json:
    methods = {"geodesic": lambda poses, _: Geodesic(poses)} | {name: METHODS[name] for name in BESIDE}
    return {"title": poses.title, "methods": compared(poses, methods, folder / f"geodesic-{poses.mesh}.png", say)}


def page(results: Results) -> list[str]:
    blocks = [
        "A time-discrete geodesic (Heeren, Rumpf, Wardetzky and Wirth 2012) minimises the elastic energy of "
        f"{SEGMENTS} segments from pose to pose, over all shapes between them at once. Shells are {THICKNESS:g} "
        "diagonals thick, which we chose. It starts from *DSO*, and does not aim at the blended lengths and angles.",
        *explained(),
    ]
    for mesh, result in results.items():
        picture = f"![The middle by all methods, {mesh}](geodesic-{mesh}.png)"
        blocks += [f"## {mesh}: {result['title']}", picture, table(result["methods"])]
    return [*blocks, "## What it shows", *verdict(results)]


def verdict(results: Results) -> list[str]:
    known = [result["methods"] for result in results.values()]
    times = ratio_range(sum(m["geodesic"]["seconds"]) / sum(m["MixIT"]["seconds"]) for m in known)
    worst = [max(abs(at["volume"]) for m in known for at in m[name]["at"].values()) for name in ("geodesic", "MixIT")]
    return [
        f"The geodesic takes {times} times the seconds of *MixIT*; its volumes differ by up to {worst[0]:.1%} from the "
        f"blended ones, those of *MixIT* by {worst[1]:.1%}."
    ]
