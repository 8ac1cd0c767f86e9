"""Figure 9: six poses, each with weight 1/6."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from scripts.paper_study.common.errors import error_table, errors, text
from scripts.paper_study.common.methods import METHODS
from scripts.paper_study.common.pictures import Panel, gallery
from scripts.paper_study.common.poses import ALL, PAPER, Poses
from scripts.paper_study.common.record import Json, Results, Say

MESHES = PAPER


def measure(poses: Poses, folder: Path, say: Say) -> Json:
    six = poses.only(*ALL[poses.mesh].six)
    weights = np.full(6, 1 / 6)
    labels = six.segmented()
    found: Json = {}
    blends = []
    for name, make in METHODS.items():
        blend = make(six, labels).at(weights).points
        found[name] = errors(six, weights, blend).summary()
        blends.append(Panel(name, blend))
        say(f"{name}: {text(found[name]['lengths'])}")
    given = [Panel(f"frame {frame}", x) for frame, x in zip(six.frames, six.points, strict=True)]
    rows = [given[:3], given[3:], blends[:4], blends[4:]]
    gallery(folder / f"figure-9-{poses.mesh}.png", six, rows, f"{six.title}, weights 1/6")
    return {"title": six.title, "methods": found}


def page(results: Results) -> list[str]:
    blocks = [
        "Six poses in the two upper rows, their blends with equal weights below. Errors are against the "
        "means of all six lengths and angles; the paper shows pictures only."
    ]
    for mesh, result in results.items():
        blocks += [
            f"## {mesh}: {result['title']}",
            f"![Six poses and their blends, {mesh}](figure-9-{mesh}.png)",
            error_table("method", result["methods"]),
        ]
    return [*blocks, "## What it shows", *verdict(results)]


def verdict(results: Results) -> list[str]:
    lines = []
    for kind, share in (("lengths", 1), ("degrees", 0)):
        found = [
            f"{mesh} {text([result['methods']['MixIT'][kind][share]])} "
            f"({text([result['methods']['DSO'][kind][share]])})"
            for mesh, result in results.items()
        ]
        lines.append(f"{kind} at {('99 %', '99.9 %')[share]} {', '.join(found)}")
    readings = [
        f"{mesh} {r['methods']['MixIT, whole joints']['lengths'][1] / r['methods']['MixIT, printed']['lengths'][1]:.2f}"
        for mesh, r in results.items()
    ]
    return [
        f"Errors of a blend of six poses by MixIT (by DSO): {'; '.join(lines)}.",
        "Whole joints change the errors of lengths at 99.9 % of the paper's MixIT, as printed, by factors of "
        f"{', '.join(readings)}.",
    ]
