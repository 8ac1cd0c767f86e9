"""Table 4: few and many parts."""

from __future__ import annotations

from pathlib import Path

from scripts.paper_study.common.errors import folded
from scripts.paper_study.common.methods import Strips, strips
from scripts.paper_study.common.poses import ALL, PAPER, Poses, between
from scripts.paper_study.common.printed import TABLE_4
from scripts.paper_study.common.record import Json, Results, Say, ratio_range
from scripts.paper_study.common.variants import measured_row, printed_row, row_of, table

MESHES = PAPER
PARTS = {"lion": (7, 30), "cat": (7, 30), "horse": (7, 30), "elephant_gallop": (7, 18)}


def measure(poses: Poses, folder: Path, say: Say) -> Json:
    result: Json = {}
    for parts in PARTS[poses.mesh]:
        method = Strips(poses, strips(poses, poses.segmented(parts)))
        method.at(between(0.5))  # compiles
        result[str(parts)] = row_of(method)
    return result


def page(results: Results) -> list[str]:
    rows = []
    for mesh, result in results.items():
        for parts in PARTS[mesh]:
            for (name, p, q), printed in TABLE_4.items():
                if name == ALL[mesh].printed and p == parts:
                    rows.append(printed_row(mesh, f"{p} parts", str(p), str(q), printed))
            rows.append(measured_row(mesh, f"{parts} parts", result[str(parts)]))
    gains = [
        many["lengths"][1] / few["lengths"][1]
        for mesh, result in results.items()
        for few, many in [[result[str(parts)] for parts in PARTS[mesh]]]
    ]
    return [
        "*MixIT, free* with strips as joints: times in milliseconds and errors at w = 0.5, with few and many parts "
        "by motion. The paper has no lion in this table.",
        table(rows),
        "## Differences",
        "- As in the paper, joints that touch are one, so there are fewer joints than parts.\n"
        "- The paper gives times only. Errors show what they pay for: with few parts more of what bends is taken for "
        f"rigid. With many, errors of lengths at 99.9 % are {ratio_range(gains)} of those with few.\n"
        "- " + folded({f"{p} parts on {mesh}": r[str(p)] for mesh, r in results.items() for p in PARTS[mesh]}),
    ]


def verdict(results: Results) -> list[str]:
    changes = [
        f"{mesh} " + ", ".join(f"{r[str(p)]['lengths'][1]:.2g} with {r[str(p)]['parts']}" for p in PARTS[mesh])
        for mesh, r in results.items()
    ]
    return [f"Length errors at 99.9 % by the number of parts: {'; '.join(changes)}."]
