"""Interpolation methods of others beside those of the paper: w = 1/4, 1/2 and 3/4, volume, time, turned poses."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

import numpy as np

from mixseq.mesh.measures import signed_volume
from mixseq.mesh.rotations import rotvec_to_matrix
from mixseq.types import Index
from scripts.benchmarks.common.harness import cpu_timed, markdown_table
from scripts.paper_study.common.baselines import BASELINES, SEGMENTS, THICKNESS, TOLERANCE, turned
from scripts.paper_study.common.damage import placement_noise
from scripts.paper_study.common.errors import errors, folds, sections, text
from scripts.paper_study.common.methods import METHODS, Method
from scripts.paper_study.common.pictures import Panel, gallery
from scripts.paper_study.common.poses import PAPER, Poses, apart, between
from scripts.paper_study.common.record import Json, Results, Say, named, ratio_range

MESHES = PAPER
WEIGHTS = (0.25, 0.5, 0.75)
TURN = np.radians(150) * np.array([2.0, -1.0, 2.0]) / 3
"""Rotation vector that turns the second pose."""

NOISE, SEEDS = 0.01, (0, 1, 2)
OURS = "MixIT"
OTHERS = ("ARAP", "skin", "NRIC", "geodesic")
BESIDE = ("MSGI", "DSO", "MixIT, whole joints", "MixIT, free", OURS)
"""Methods of the other pages."""

GEODESIC_VERTICES = 10_000  # largest number for geodesics, whose systems have nine times as many unknowns


def measure(poses: Poses, folder: Path, say: Say) -> Json:
    methods = BASELINES | {name: METHODS[name] for name in BESIDE}
    if poses.topology.vertex_count > GEODESIC_VERTICES:
        methods.pop("geodesic")
    found = compared(poses, methods, folder / f"baselines-{poses.mesh}.png", say)
    placed = np.mean([placement_noise(poses, NOISE, seed) for seed in SEEDS], axis=0).tolist()
    return {"title": poses.title, "methods": found, "placed": placed}


def compared(poses: Poses, methods: Mapping[str, Callable[[Poses, Index], Method]], picture: Path, say: Say) -> Json:
    """Blend by all methods; return errors, volumes, processor seconds, and how far blends move with the turn."""
    labels, rotation = poses.segmented(), rotvec_to_matrix(TURN)
    found: Json = {}
    volumes = np.array([signed_volume(x - x.mean(axis=0), poses.topology.faces) for x in poses.points])
    panels = [Panel("first pose", poses.points[0]), Panel("second pose", poses.points[1])]
    for name, make in methods.items():
        moved = None
        if name != "geodesic":
            moved = make(turned(poses, rotation), labels).at(between(0.5)).points  # first: compiled loops are loaded
        method = make(poses.moved(poses.points), labels)
        prepared, _ = cpu_timed(method.prepare)
        timed = [cpu_timed(partial(method.at, between(w))) for w in WEIGHTS]
        found[name] = {"seconds": [prepared, float(np.median([seconds for seconds, _ in timed]))], "at": {}}
        for w, (_, blend) in zip(WEIGHTS, timed, strict=True):
            volume = signed_volume(blend.points - blend.points.mean(axis=0), poses.topology.faces)
            found[name]["at"][f"{w:g}"] = {
                **errors(poses, between(w), blend.points).summary(),
                "volume": float(volume / (between(w) @ volumes) - 1),
            }
        middle = timed[1][1].points
        panels.append(Panel(name, middle))
        if moved is not None:
            found[name]["turned"] = float(np.sqrt(np.mean(apart(moved, middle) ** 2))) / poses.diagonal
        say(f"{name}: {text(found[name]['at']['0.5']['lengths'])}, {text(found[name]['seconds'])} s")
    rows = [panels[:2], *(panels[k : k + 5] for k in range(2, len(panels), 5))]
    gallery(picture, poses, rows, f"{poses.title}, w = 0.5")
    return found


def page(results: Results) -> list[str]:
    slow = {mesh: r["methods"]["geodesic"]["seconds"][0] for mesh, r in results.items() if "geodesic" in r["methods"]}
    took = f"All its blends take {ratio_range(slow.values())} seconds on {named(slow)}. " if slow else ""
    blocks = [
        "What the paper does not compare with, written from the papers in `scripts/paper_study/common/baselines.py`: "
        "*vertices* (registered), *ARAP* (Alexa, Cohen-Or and Levin 2000, for the faces of a surface), a *skin* fitted "
        "to the animation whose bones are blended, and *NRIC* (Sassen, Heeren, Hildebrandt and Rumpf 2020), whose "
        f"shells are {THICKNESS:g} diagonals thick, which we chose; the search starts from *DSO*. A time-discrete "
        f"*geodesic* in the space of such shells (Heeren, Rumpf, Wardetzky and Wirth 2012) has {SEGMENTS} segments. "
        "Their elastic energies are minimised over all shapes between them at once, from *DSO*, until a step predicts "
        f"less than {TOLERANCE:.1%} of the energy. It does not aim at the blended lengths and angles. {took}Meshes of "
        f"more than {GEODESIC_VERTICES:,} vertices do not have it.",
        "Errors are against the blended lengths and angles, which *NRIC* and *DSO* minimise, each with weights of its "
        "own. Volume is that of the blend over the blended volume, minus one. Seconds are of the processor, on one "
        "thread, for what is done once for two poses (a first blend in S_e and S_m, all blends of the geodesic) and "
        "for one blend. Turned: how far the blend moves, in diagonals (rms, registered), if the second pose is turned "
        f"by {np.degrees(np.linalg.norm(TURN)):.0f} degrees; the geodesic registers both poses first.",
    ]
    placed = [(mesh, *(text([each]) for each in result["placed"])) for mesh, result in results.items()]
    return [
        *blocks,
        *sections(results, "baselines", "The middle by all methods", table),
        "## Where a mesh is",
        "The paper places a mesh by its first face and its barycentre (Section 2.3), mixseq by registered bodies. How "
        f"far noise of {NOISE:.0%} of an edge moves a pose that is placed like that, rms in mean edge lengths, mean of "
        f"{len(SEEDS)} seeds:",
        markdown_table(("mesh", "first face", "median of all faces", "registered"), placed),
        "## What it shows",
        *verdict(results),
        folds(
            results, lambda r: {f"{n}, {w}": at for n, found in r["methods"].items() for w, at in found["at"].items()}
        ),
    ]


def table(result: Json) -> str:
    """Return what `compared` found, with a row for every weight."""
    rows: list[tuple[str, ...]] = []
    for name, found in result["methods"].items():
        ends = [text([s]) for s in found["seconds"]] + [text([found["turned"]]) if "turned" in found else ""]
        for w, at in found["at"].items():
            head, *end = (name, *ends) if w == "0.25" else ("",) * 4
            rows.append((head, w, text(at["lengths"]), text(at["degrees"]), f"{at['volume']:+.1%}", *end))
    columns = ("method", "w", "lengths, 99 / 99.9 / 100 %", "degrees", "volume", "once, s", "a blend, s", "turned")
    return markdown_table(columns, rows)


def verdict(results: Results) -> list[str]:
    lines = []
    for other in OTHERS:
        known = [r["methods"] for r in results.values() if other in r["methods"]]
        if not known:
            continue
        pairs = [(m[OURS]["at"][f"{w:g}"], m[other]["at"][f"{w:g}"]) for m in known for w in WEIGHTS]
        of = {kind: [a[kind][0] / b[kind][0] for a, b in pairs] for kind in ("lengths", "degrees")}
        own, others = (max(abs(pair[k]["volume"]) for pair in pairs) for k in (0, 1))
        times = [sum(m[other]["seconds"]) / sum(m[OURS]["seconds"]) for m in known]
        meshes = named(mesh for mesh, r in results.items() if other in r["methods"])
        lines.append(
            f"Errors at 99 % of *{OURS}* over those of *{other}* on {meshes}: lengths {ratio_range(of['lengths'])}, "
            f"angles {ratio_range(of['degrees'])}; volumes are off by up to {own:.1%} ({others:.1%}); *{other}* takes "
            f"{ratio_range(times)} times the seconds for two poses and one blend."
        )
    return lines
