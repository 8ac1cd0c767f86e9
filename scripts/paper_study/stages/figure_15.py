"""Figure 15: MixIT on the parts that different segmentation methods find."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from mixseq.mesh.topology import split_labels
from mixseq.segmentation.methods import METHODS, adjusted_rand_index, segment
from mixseq.types import Index
from scripts.benchmarks.common.harness import markdown_table
from scripts.paper_study.common.errors import errors, text
from scripts.paper_study.common.methods import Clock, Free, Strips, strips
from scripts.paper_study.common.pictures import Panel, gallery, held
from scripts.paper_study.common.poses import MESHES as ALL
from scripts.paper_study.common.poses import Poses, between
from scripts.paper_study.common.printed import FIGURE_15
from scripts.paper_study.common.record import Json, Results, ratio_range
from scripts.paper_study.common.variants import row_of

MESHES = tuple(mesh for mesh in ALL if mesh != "horse_gallop")


def measure(poses: Poses, folder: Path, say: Callable[[str], None]) -> Json:
    found: Json = {}
    rows: list[list[Panel]] = [[], [], []]
    by_motion: Index | None = None
    for name in METHODS:
        clock = Clock()
        labels = segment(poses.telling, poses.topology, name)
        seconds = clock.lap()
        by_motion = labels if by_motion is None else by_motion
        cut = strips(poses, labels)
        methods = {"strips": Strips(poses, cut), "free": Free(poses, cut)}
        colours = held(cut.part_of_face, methods["free"].rigid)
        rows[0].append(Panel(f"{name}, {labels.max() + 1} parts", poses.points[0], colours))
        found[name] = {
            "segmentation": seconds,
            "valid": valid(poses, labels),
            "agreement": adjusted_rand_index(labels, by_motion),
        }
        for number, (kind, method) in enumerate(methods.items(), start=1):
            blend = method.at(between(0.5)).points
            found[name][kind] = row_of(method, runs=2)
            rows[number].append(Panel("w = 0.5, strips" if number == 1 else "w = 0.5, free", blend))
            say(f"{name}, {kind}: {text(errors(poses, between(0.5), blend).summary()['lengths'])}")
    gallery(folder / f"figure-15-{poses.mesh}.png", poses, rows, poses.title)
    return {"title": poses.title, "methods": found}


def valid(poses: Poses, labels: Index) -> bool:
    """Whether every face has a part, parts are numbered without gaps, and each is connected across edges."""
    faces = len(poses.sequence.faces)
    if labels.shape != (faces,) or not np.array_equal(np.unique(labels), np.arange(labels.max() + 1)):
        return False
    return bool(split_labels(poses.topology, labels).max() == labels.max())


def page(results: Results) -> list[str]:
    blocks = [
        "The same poses blended by MixIT on the parts of every method: segmentation over the whole "
        "animation, parts and joints (red) of *MixIT, free* in the first row, blends at w = 0.5 with strips as "
        "joints and of *MixIT, free* below. The paper shows silhouettes, spanning tree, and parts drawn by hand, "
        f"which we have not; ours by motion is in their place. It prints {FIGURE_15['silhouettes']}, "
        f"{FIGURE_15['spanning-tree']} and {FIGURE_15['manual']} ms."
    ]
    for mesh, result in results.items():
        rows = []
        for name, f in result["methods"].items():
            for kind, shown in (("strips", "MixIT, free, strips"), ("free", "MixIT, free")):
                r = f[kind]
                rows.append(
                    (name, shown, str(r["parts"]), str(r["joints"]), f"{f['segmentation']:.1f}",
                     "yes" if f["valid"] else "**no**", f"{f['agreement']:.2f}", f"{r['total']:.0f}",
                     f"{sum(r['ms'][2:]):.0f}", text(r["lengths"]), text(r["degrees"]))
                )  # fmt: skip
        blocks += [
            f"## {mesh}: {result['title']}",
            f"![Segmentations and blends, {mesh}](figure-15-{mesh}.png)",
            markdown_table(
                (
                    "segmentation",
                    "method",
                    "p",
                    "q",
                    "segmentation, s",
                    "valid",
                    "adjusted Rand index with motion",
                    "Total, ms",
                    "without Init.",
                    "lengths, 99 / 99.9 / 100 %",
                    "degrees",
                ),
                rows,
            ),
        ]
    worst: dict[str, list[float]] = {"strips": [], "free": []}
    times = []
    for result in results.values():
        found = list(result["methods"].values())
        for kind, ratios in worst.items():
            errors_of = [f[kind]["lengths"][1] for f in found]
            ratios.append(max(errors_of) / min(errors_of))
        total = [f["free"]["total"] for f in found]
        times.append(max(total) / min(total))
    return [
        *blocks,
        "The paper finds the blends visually similar, and equally fast. Here the slowest blend of *MixIT, free* takes "
        f"{ratio_range(times)} times the time of the fastest, and the largest error of lengths at 99.9 % is "
        f"{ratio_range(worst['free'])} times the smallest. With strips as joints the segmentation matters more: "
        f"{ratio_range(worst['strips'])} times.",
    ]


def verdict(results: Results) -> list[str]:
    fine = all(f["valid"] for result in results.values() for f in result["methods"].values())
    spread = [
        f"{mesh} {', '.join(format(f['free']['lengths'][1], '.2g') for f in result['methods'].values())}"
        for mesh, result in results.items()
    ]
    return [
        f"{'Every segmentation is valid' if fine else '**Not every segmentation is valid**'}. Length errors "
        f"at 99.9 % of MixIT on parts by {', '.join(METHODS)}: {'; '.join(spread)}."
    ]
