"""Figure 15: MixIT on the parts that different segmentation methods find."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

from mixseq.mesh.topology import split_labels
from mixseq.segmentation.methods import METHODS, adjusted_rand_index, segment
from mixseq.types import Index
from scripts.benchmarks.common.harness import cpu_timed, markdown_table
from scripts.paper_study.common.errors import errors, folded, sections, text
from scripts.paper_study.common.methods import Free, Strips, strips
from scripts.paper_study.common.pictures import Panel, gallery, held
from scripts.paper_study.common.poses import PAPER, Poses, between
from scripts.paper_study.common.printed import FIGURE_15
from scripts.paper_study.common.record import Json, Results, Say, by_mesh, named, ratio_range
from scripts.paper_study.common.variants import row_of

MESHES = PAPER

HAND: dict[str, dict[int, tuple[float, ...]]] = {
    "lion": {
        4910: (0.15, 0.3, 0.45), 4188: (0.1, 0.2, 0.3), 4727: (0.1, 0.2, 0.3), 982: (0.08, 0.19, 0.31),
        1472: (0.08, 0.19, 0.31), 3085: (0.18, 0.26), 186: (0.2,),
    },
    "horse": {
        8319: (0.13, 0.27), 6541: (0.06, 0.17, 0.29), 7552: (0.06, 0.17, 0.29), 2794: (0.06, 0.15, 0.28),
        2129: (0.06, 0.15, 0.28), 4035: (0.17, 0.26, 0.35), 353: (0.2,),
    },
}  # fmt: skip
"""Cuts by hand: walking distances, in diagonals, from tips of tail, legs and head, and last from the rump."""

SMALL = 50  # number of faces of fragments


def measure(poses: Poses, folder: Path, say: Say) -> Json:
    found: Json = {}
    rows: list[list[Panel]] = [[], [], []]
    by_motion: Index | None = None
    makers = {name: partial(segment, poses.sampled_frames, poses.topology, name) for name in METHODS}
    for name, make in (makers | ({"hand": partial(by_hand, poses)} if poses.mesh in HAND else {})).items():
        seconds, labels = cpu_timed(make)
        by_motion = labels if by_motion is None else by_motion
        cut = strips(poses, labels)
        methods = {"strips": Strips(poses, cut), "free": Free(poses, cut)}
        colours = held(cut.part_of_face, methods["free"].rigid)
        rows[0].append(Panel(f"{name}, {labels.max() + 1} parts", poses.points[0], colours))
        found[name] = {"segmentation": seconds, "agreement": adjusted_rand_index(labels, by_motion)}
        for number, (kind, method) in enumerate(methods.items(), start=1):
            blend = method.at(between(0.5)).points
            found[name][kind] = row_of(method, runs=2)
            rows[number].append(Panel("w = 0.5, strips" if number == 1 else "w = 0.5, free", blend))
            say(f"{name}, {kind}: {text(errors(poses, between(0.5), blend).summary()['lengths'])}")
    gallery(folder / f"figure-15-{poses.mesh}.png", poses, rows, poses.title)
    return {"title": poses.title, "methods": found}


def by_hand(poses: Poses) -> Index:
    """Return the part ``(F,)`` of every face by `HAND`: by the nearest tip, and the number of its nearer cuts."""
    cuts = HAND[poses.mesh]
    away = poses.distances(list(cuts))[:, poses.sequence.faces].mean(axis=2)
    labels, start = np.full(away.shape[1], -1), 0
    for own, (distances, nearest) in enumerate(zip(cuts.values(), away == away.min(axis=0), strict=True)):
        number = np.searchsorted(distances, away[own])
        inside = nearest & (number < len(distances))
        labels[inside] = start + number[inside]
        start += len(distances)
    labels = split_labels(poses.topology, np.where(labels < 0, start, labels))
    labels[np.bincount(labels)[labels] < SMALL] = -1
    pairs = np.concatenate([poses.topology.hinge_faces, poses.topology.hinge_faces[:, ::-1]])
    while (labels < 0).any():  # fragments join what is beside them
        reached = pairs[(labels[pairs[:, 0]] < 0) & (labels[pairs[:, 1]] >= 0)]
        labels[reached[:, 0]] = labels[reached[:, 1]]
    return split_labels(poses.topology, labels - labels.min())


def page(results: Results) -> list[str]:
    blocks = [
        "The same poses blended by MixIT on the parts of every method: segmentation over the whole "
        "animation, parts and joints (red) of *MixIT, free* in the first row, blends at w = 0.5 with strips as "
        "joints and of *MixIT, free* below. The paper shows silhouettes, spanning tree, and parts drawn by hand. Ours "
        f"by *hand*, of {named(HAND)}, are cut at walking distances from tips of legs, tail and head, where the animal "
        "bends; their time is that of the cutting. The paper prints "
        f"{FIGURE_15['silhouettes']}, {FIGURE_15['spanning-tree']} and {FIGURE_15['manual']} ms."
    ]
    worst: dict[str, list[float]] = {"strips": [], "free": []}
    slowest = []
    for result in results.values():
        for kind, ratios in worst.items():
            errors_of = [f[kind]["lengths"][1] for f in result["methods"].values()]
            ratios.append(max(errors_of) / min(errors_of))
        total = [f["free"]["total"] for f in result["methods"].values()]
        slowest.append(max(total) / min(total))
    return [
        *blocks,
        *sections(results, "figure-15", "Segmentations and blends", table),
        "The paper finds the blends visually similar, and equally fast. Here the slowest blend of *MixIT, free* takes "
        f"{ratio_range(slowest)} times the time of the fastest, and the largest error of lengths at 99.9 % is "
        f"{ratio_range(worst['free'])} times the smallest. With strips as joints the segmentation matters more: "
        f"{ratio_range(worst['strips'])} times.",
        folded(
            {
                f"{name}, {kind}, on {mesh}": f[kind]
                for mesh, r in results.items()
                for name, f in r["methods"].items()
                for kind in worst
            }
        ),
    ]


def table(result: Json) -> str:
    """Return the rows of a mesh."""
    rows = []
    for name, f in result["methods"].items():
        for kind, shown in (("strips", "MixIT, free, strips"), ("free", "MixIT, free")):
            r = f[kind]
            found = (f"{f['segmentation']:.1f}", f"{f['agreement']:.2f}")
            times = (f"{r['total']:.0f}", f"{sum(r['ms'][2:]):.0f}", text(r["lengths"]), text(r["degrees"]))
            rows.append((name, shown, str(r["parts"]), str(r["joints"]), *found, *times))
    heads = ("segmentation", "method", "p", "q", "segmentation, s", "adjusted Rand index with motion")
    return markdown_table((*heads, "Total, ms", "without Init.", "lengths, 99 / 99.9 / 100 %", "degrees"), rows)


def verdict(results: Results) -> list[str]:
    def spread(r: Json) -> str:
        return ", ".join(f"{name} {text(f['free']['lengths'][1:2])}" for name, f in r["methods"].items())

    return [f"Length errors at 99.9 % of *MixIT, free* on parts by: {by_mesh(results, spread, '; ')}."]
