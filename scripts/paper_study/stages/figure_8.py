"""Figure 8: blends by MixIT at a quarter, half and three quarters of the way."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from scripts.paper_study.common.errors import error_table, errors, text
from scripts.paper_study.common.methods import METHODS
from scripts.paper_study.common.pictures import Panel, gallery
from scripts.paper_study.common.poses import MESHES as ALL
from scripts.paper_study.common.poses import Poses, between
from scripts.paper_study.common.record import Json, Results

MESHES = tuple(ALL)
WEIGHTS = (0.25, 0.5, 0.75)


def measure(poses: Poses, folder: Path, say: Callable[[str], None]) -> Json:
    method = METHODS["MixIT"](poses, poses.segmented())
    method.prepare()
    found: dict[str, Json] = {}
    panels = [Panel("first pose", poses.points[0])]
    for weight in WEIGHTS:
        points = method.at(between(weight)).points
        found[f"{weight:g}"] = errors(poses, between(weight), points).summary()
        panels.append(Panel(f"w = {weight:g}", points))
    panels.append(Panel("second pose", poses.points[1]))
    gallery(folder / f"figure-8-{poses.mesh}.png", poses, [panels[:3], panels[3:]], poses.title)
    say(text(found["0.5"]["lengths"]))
    return {"title": poses.title, "weights": found}


def page(results: Results) -> list[str]:
    blocks = ["Pairs are as on the [other pages](figures-10-12.md), which also tell how far apart they are."]
    for mesh, result in results.items():
        blocks += [
            f"## {mesh}: {result['title']}",
            f"![Blends, {mesh}](figure-8-{mesh}.png)",
            error_table("weight", result["weights"]),
        ]
    return blocks


def verdict(results: Results) -> list[str]:
    worst = [
        f"{mesh} {max(found['lengths'][1] for found in result['weights'].values()):.2g}"
        for mesh, result in results.items()
    ]
    return [f"Length errors of MixIT at 99.9 %, the worst of three weights: {', '.join(worst)}."]
