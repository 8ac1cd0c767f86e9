"""Figure 1: half-way between two poses by vertices, deformation gradients, lengths and angles, and MixIT."""

from __future__ import annotations

from pathlib import Path

from mixseq.choices import SpaceName
from mixseq.operations.interpolation import PoseInterpolator
from mixseq.types import Float
from scripts.paper_study.common.errors import error_table, errors, folds, sections
from scripts.paper_study.common.methods import METHODS
from scripts.paper_study.common.pictures import Panel, gallery
from scripts.paper_study.common.poses import PAPER, Poses, between
from scripts.paper_study.common.record import Json, Results, Say

MESHES = PAPER
SPACES: dict[str, SpaceName] = {"vertices, S_v": "vertex", "gradients, S_f": "gradient"}
"""Spaces that need no optimisation."""

OURS = "MixIT, S_m"


def measure(poses: Poses, folder: Path, say: Say) -> Json:
    half, labels = between(0.5), poses.segmented()
    blends: dict[str, Float] = {
        name: PoseInterpolator.from_poses(poses.sequence, space, pose_ids=poses.frames).blend(half)
        for name, space in SPACES.items()
    }
    for name, space_name in (("DSO", "lengths and angles, S_e"), ("MixIT", OURS)):
        blends[space_name] = METHODS[name](poses, labels).at(half).points
    found = {name: errors(poses, half, points).summary() for name, points in blends.items()}
    given = [Panel("first pose", poses.points[0]), Panel("second pose", poses.points[1])]
    shown = [Panel(f"{name}, w = 0.5", points) for name, points in blends.items()]
    rows = [given, shown[:2], shown[2:]]
    gallery(folder / f"figure-1-{poses.mesh}.png", poses, rows, poses.title)
    say(", ".join(f"{name} {each['lengths'][1]:.2g}" for name, each in found.items()))
    return {"title": poses.title, "methods": found}


def page(results: Results) -> list[str]:
    return [
        "Half-way between two poses, which the paper's first figure shows for one pair. Errors are of lengths "
        "(relative) and angles (degrees) against the means of the two poses.",
        *sections(results, "figure-1", "Blends in four shape spaces", lambda r: error_table("space", r["methods"])),
        folds(results),
    ]


def verdict(results: Results) -> list[str]:
    gains = []
    for name in SPACES:
        each = [r["methods"][name]["lengths"][1] / r["methods"][OURS]["lengths"][1] for r in results.values()]
        gains.append(f"{min(each):.1f} to {max(each):.1f} times as large in {name}")
    return [f"Length errors at 99.9 % half-way are {', '.join(gains)}, as in S_m. The paper shows pictures only."]
