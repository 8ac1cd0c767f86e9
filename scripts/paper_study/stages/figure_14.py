"""Figure 14: a segmentation that misses joints, and a good one."""

from __future__ import annotations

from operator import itemgetter
from pathlib import Path

from scripts.paper_study.common.errors import error_table, errors, folds, sections
from scripts.paper_study.common.methods import Free, Strips, strips
from scripts.paper_study.common.pictures import BRIGHTEST, Panel, gallery, held, length_errors
from scripts.paper_study.common.poses import PAPER, Poses, between
from scripts.paper_study.common.record import Json, Results, Say, by_mesh, ratio_range

MESHES = PAPER
FEW = 3


def measure(poses: Poses, folder: Path, say: Say) -> Json:
    few, usual = poses.segmented(FEW), poses.segmented()
    methods = {
        f"strips, {FEW} parts": Strips(poses, strips(poses, few)),
        "strips, found parts": Strips(poses, strips(poses, usual)),
        f"MixIT, free, {FEW} parts": Free(poses, strips(poses, few)),
        "MixIT, free, found parts": Free(poses, strips(poses, usual)),
    }
    found: Json = {}
    rows: list[list[Panel]] = [[], [], []]
    for name, method in methods.items():
        decomposition = method.decomposition
        blend = method.at(between(0.5)).points
        found[name] = {
            "parts": len(decomposition.parts),
            "joints": len(decomposition.joints),
            **errors(poses, between(0.5), blend).summary(),
        }
        rows[0].append(Panel(name, poses.points[0], held(decomposition.part_of_face, method.rigid)))
        rows[1].append(Panel("w = 0.5", blend))
        rows[2].append(Panel("length errors", blend, length_errors(poses, blend)))
    gallery(folder / f"figure-14-{poses.mesh}.png", poses, rows, poses.title)
    return {"title": poses.title, "methods": found}


def page(results: Results) -> list[str]:
    columns = {"p": itemgetter("parts"), "q": itemgetter("joints")}
    blocks = [
        f"Motion segmentations with {FEW} parts, which miss most joints, and with as many as are found. Below "
        f"the blends at w = 0.5: errors of lengths, from violet (0) to yellow ({BRIGHTEST:.0%} and more). The "
        "paper shows the armadillo."
    ]
    growth: list[list[float]] = [[], []]
    for result in results.values():
        few, usual, few_free, usual_free = (found["lengths"][1] for found in result["methods"].values())
        growth[0].append(few / usual)
        growth[1].append(few_free / usual_free)
    return [
        *blocks,
        *sections(results, "figure-14", "Segmentations and blends", lambda r: error_table("", r["methods"], columns)),
        f"With {FEW} parts, errors of lengths at 99.9 % are {ratio_range(growth[0])} times those with the found parts "
        "where only strips are joints: as in the paper, a segmentation that misses joints leads to artefacts. Where "
        f"all faces are joints that are wrong half-way, they are {ratio_range(growth[1])} times: a missed joint is "
        "inside a part, and found there.",
        folds(results),
    ]


def verdict(results: Results) -> list[str]:
    def values(r: Json) -> str:
        return "{:.2g} and {:.2g} ({:.2g} and {:.2g})".format(*(f["lengths"][1] for f in r["methods"].values()))

    return [
        f"Length errors at 99.9 % with {FEW} parts and with those found, strips as joints (joints also inside "
        f"parts): {by_mesh(results, values, '; ')}."
    ]
