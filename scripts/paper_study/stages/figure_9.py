"""Figure 9: six poses, each with weight 1/6."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from scripts.paper_study.common.errors import error_table, errors, folds, sections, text
from scripts.paper_study.common.methods import METHODS
from scripts.paper_study.common.pictures import Panel, gallery
from scripts.paper_study.common.poses import ALL, PAPER, Poses
from scripts.paper_study.common.record import Json, Results, Say, by_mesh

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
    return [
        "Six poses in the two upper rows, their blends with equal weights below. Errors are against the "
        "means of all six lengths and angles; the paper shows pictures only.",
        *sections(results, "figure-9", "Six poses and their blends", lambda r: error_table("method", r["methods"])),
        "## What it shows",
        *verdict(results),
        folds(results),
    ]


def verdict(results: Results) -> list[str]:
    def of(kind: str, quantile: int) -> str:
        pairs = {
            mesh: [text([r["methods"][name][kind][quantile]]) for name in ("MixIT", "DSO")]
            for mesh, r in results.items()
        }
        return ", ".join(f"{mesh} {mixed} ({edge})" for mesh, (mixed, edge) in pairs.items())

    def change(r: Json) -> str:
        whole, printed = (r["methods"][f"MixIT, {name}"]["lengths"][1] for name in ("whole joints", "printed"))
        return f"{whole / printed:.2f}"

    return [
        f"Errors of a blend of six poses by MixIT (by DSO): lengths at 99.9 % {of('lengths', 1)}; degrees at 99 % "
        f"{of('degrees', 0)}.",
        "Whole joints change the errors of lengths at 99.9 % of the paper's MixIT, as printed, by factors of "
        f"{by_mesh(results, change)}.",
    ]
