"""Table 1: times of one interpolated frame, w = 0.5, by MSGI, DSO and MixIT."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from mixseq.types import Index
from scripts.benchmarks.common.harness import cpu_timed, markdown_table
from scripts.paper_study.common.methods import METHODS, STEPS, Method, steps_of
from scripts.paper_study.common.poses import ALL, Poses
from scripts.paper_study.common.printed import TABLE_1
from scripts.paper_study.common.record import Json, Results, Say, by_mesh, ratio_range

MESHES = tuple(ALL)
RUNS, BUDGET = 5, 25.0  # largest number of runs, of which times are medians, and seconds that end them

EDGE = ("MSGI", "DSO, from a pose", "DSO", "S_e, steps")
MIXED = ("MixIT, printed", "MixIT, whole joints", "MixIT, free", "MixIT")


def measure(poses: Poses, folder: Path, say: Say) -> Json:
    warm = Poses.of("lion")  # compiles
    parts = warm.segmented()
    for make in METHODS.values():
        steps_of(make(warm, parts))
    seconds, labels = cpu_timed(poses.segmented)
    result: Json = {"segmentation": 1e3 * seconds, "faces": len(poses.sequence.faces)}
    for name, make in METHODS.items():
        result[name] = timed(make, poses, labels)
        say(f"{name}: {result[name]['total']:.0f} ms")
    return result


def timed(make: Callable[[Poses, Index], Method], poses: Poses, labels: Index) -> Json:
    """Return medians in milliseconds; the total is without the alignment, which the initialisation does too."""
    rows: list[list[float]] = []
    while not rows or (len(rows) < RUNS and sum(map(sum, rows)) < BUDGET):
        seconds, blend = steps_of(make(poses.moved(poses.points), labels))  # nothing is known of them yet
        rows.append(seconds)
    medians = 1e3 * np.median(rows, axis=0)
    return {
        **dict(zip(STEPS, medians.tolist(), strict=True)),
        "total": float(medians[1:].sum()),
        "iterations": sum(report.iterations for report in blend.reports),
        "runs": len(rows),
    }


def page(results: Results) -> list[str]:
    edge: list[tuple[str, ...]] = []
    mixed: list[tuple[str, ...]] = []
    for mesh, result in results.items():
        p = TABLE_1.get(ALL[mesh].printed)
        if p and mesh != "horse_gallop":
            msgi = (p.msgi_init, p.msgi_interpolation, "", "", p.msgi_total)
            dso = ("", "", p.dso_iterations, p.dso_iteration, p.dso_total)
            steps = (p.align, p.init, p.interpolation, p.stitching, "", p.total, p.speed_up)
            edge += [
                (f"**{mesh}**", f"{name}, the paper", *map(str, row)) for name, row in (("MSGI", msgi), ("DSO", dso))
            ]
            mixed.append((f"**{mesh}**", "the paper", *map(str, steps), f"{p.dso_total / p.total:.0f}", "", ""))
        for name in EDGE:
            row = result[name]
            init, blend, total = (f"{row[key]:.0f}" for key in ("init", "interpolation", "total"))
            each = f"{row['interpolation'] / max(row['iterations'], 1):.0f}"
            edge.append(
                (mesh, name, init, blend, *(("", "") if name == "MSGI" else (str(row["iterations"]), each)), total)
            )
        for name in MIXED:
            row = result[name]
            gains = (f"{result[other]['total'] / row['total']:.1f}" for other in EDGE)
            mixed.append((mesh, name, *(f"{row[key]:.0f}" for key in (*STEPS, "total")), *gains))
    fine = [
        f" *{mesh}* is {ALL[mesh].animation} with every triangle split into four ({r['faces']:,} faces), beside the "
        f"paper's {ALL[mesh].printed} ({TABLE_1[ALL[mesh].printed].faces:,})."
        for mesh, r in results.items()
        if ALL[mesh].fine
    ]
    heads = ("Align.", "Init.", "Interp.", "Stitch.", "Settle", "Total")
    return [
        f"Milliseconds of the processor for one frame between two poses, w = 0.5; medians of up to {RUNS} runs, the "
        f"last of which starts within {BUDGET:g} seconds. Init. is everything that is done once for two poses: "
        "analysis and factors of the systems, encoding, registration of the parts. Align. is the registration alone; "
        "it is part of Init., and not added again. As in the paper the segmentation is not part of the times."
        + "".join(fine),
        "## In S_e",
        markdown_table(("mesh", "method", "Init.", "Interp.", "iterations", "per iteration", "Total"), edge),
        "## MixIT",
        markdown_table(("mesh", "method", *heads, *(f"{e} / this" for e in EDGE)), mixed),
        "The segmentation by motion takes "
        + ", ".join(f"{result['segmentation']:.0f} ms on {mesh}" for mesh, result in results.items())
        + ", over all frames of the animation.",
        "## Differences",
        f"- The paper's DSO takes {ratio_range(r.dso_iterations for r in TABLE_1.values())} iterations of "
        f"{ratio_range(r.dso_iteration / 1e3 for r in TABLE_1.values())} seconds. Ours solves the same systems with a "
        "sparse direct solver whose pattern is analysed once, and takes "
        f"{ratio_range(r['DSO']['iterations'] for r in results.values())} iterations from the linear start. *DSO, from "
        f"a pose* takes {ratio_range(r['DSO, from a pose']['total'] / r['MixIT']['total'] for r in results.values())} "
        f"times as long as *MixIT* here, {ratio_range(r.dso_total / r.total for r in TABLE_1.values())} in the paper, "
        "which says that its DSO is slower than the original one (Section 3).\n"
        "- Interp. of *MixIT, free* is the mesh from frames of faces, Settle the steps from there; of *MixIT* Interp. "
        "is all. *MixIT, printed* and *whole joints* have the paper's steps.\n"
        f"- Our Init. takes {ratio_range(r['MixIT']['init'] / r['MixIT']['interpolation'] for r in results.values())} "
        "times as long as the interpolation of *MixIT*: fitting skinning weights, and sparse matrices. It is done once "
        "for any number of frames.",
    ]


def verdict(results: Results) -> list[str]:
    printed = [TABLE_1[ALL[mesh].printed] for mesh in results]

    def gains(name: str) -> str:
        return by_mesh(results, lambda r: " / ".join(f"{r[edge]['total'] / r[name]['total']:.1f}" for edge in EDGE))

    fine = " (the armadillo is about as large as our fine elephant)" if "elephant_fine" in results else ""
    return [
        "Times of MSGI / DSO from a pose / DSO from the linear start / S_e in steps over that of "
        + "; ".join(f"{name}: {gains(name)}" for name in MIXED)
        + f". The paper prints {ratio_range(r.speed_up for r in printed)} for MSGI and "
        f"{ratio_range(r.dso_total / r.total for r in printed)} for DSO on these meshes{fine}."
    ]
