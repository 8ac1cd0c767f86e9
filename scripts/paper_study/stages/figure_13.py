"""Figure 13: envelopes of the errors over the weight, with joints of width 3 and 5."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from scripts.benchmarks.common.section import markdown_table
from scripts.paper_study.common.along import along, weights_of
from scripts.paper_study.common.errors import text
from scripts.paper_study.common.methods import Free, Strips, strips
from scripts.paper_study.common.pictures import envelopes
from scripts.paper_study.common.poses import MESHES as ALL
from scripts.paper_study.common.poses import Poses
from scripts.paper_study.common.record import Json, Results

MESHES = tuple(mesh for mesh in ALL if mesh != "horse_gallop")
WIDTHS = (3, 5)


def measure(poses: Poses, folder: Path, say: Callable[[str], None]) -> Json:
    labels = poses.segmented()
    methods: dict[str, Free] = {
        f"MixIT, free, strips, width {width}": Strips(poses, strips(poses, labels, width, full=True))
        for width in WIDTHS
    }
    methods |= {f"MixIT, free, width {width}": Free(poses, strips(poses, labels, width)) for width in WIDTHS}
    results = {name: along(poses, method) for name, method in methods.items()}
    bands = {name: result.bands for name, result in results.items()}
    envelopes(folder / f"figure-13-{poses.mesh}.png", f"Errors, {poses.title}", weights_of(poses), bands)
    return {"title": poses.title, "methods": {name: result.found for name, result in results.items()}}


def page(results: Results) -> list[str]:
    blocks = ["The paper shows the horse with width 3 and 5, and finds little difference."]
    for mesh, result in results.items():
        rows = [
            (name, *(text(found[of][k]) for of in ("middle", "worst") for k in ("lengths", "degrees")))
            for name, found in result["methods"].items()
        ]
        columns = (
            "method",
            "lengths at w = 0.5, 99 / 99.9 / 100 %",
            "degrees",
            "lengths, worst of all w",
            "degrees",
        )
        blocks += [
            f"## {mesh}: {result['title']}",
            f"![Errors, {mesh}](figure-13-{mesh}.png)",
            markdown_table(columns, rows),
        ]
    return blocks


def verdict(results: Results) -> list[str]:
    changes = []
    for mesh, result in results.items():
        three, five = (
            result["methods"][f"MixIT, free, strips, width {width}"]["worst"]["lengths"][1] for width in WIDTHS
        )
        changes.append(f"{mesh} {three:.2g} to {five:.2g}")
    return [f"Length errors at 99.9 %, worst of all weights, from width 3 to 5: {', '.join(changes)}."]
