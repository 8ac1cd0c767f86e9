"""Table 3: joints of width 3, 5 and 9."""

from __future__ import annotations

from pathlib import Path

from scripts.paper_study.common.errors import folded
from scripts.paper_study.common.methods import Strips, strips
from scripts.paper_study.common.poses import ALL, PAPER, Poses, between
from scripts.paper_study.common.printed import TABLE_1, TABLE_2, TABLE_3, Variant
from scripts.paper_study.common.record import Json, Results, Say, by_mesh, ratio_range
from scripts.paper_study.common.variants import measured_row, printed_row, row_of, table

MESHES = PAPER
WIDTHS = (3, 5, 9)


def measure(poses: Poses, folder: Path, say: Say) -> Json:
    labels = poses.segmented()
    Strips(poses, strips(poses, labels, 1)).at(between(0.5))  # compiles
    return {str(width): row_of(Strips(poses, strips(poses, labels, width, full=True))) for width in WIDTHS}


def page(results: Results) -> list[str]:
    rows = []
    for mesh, result in results.items():
        name = ALL[mesh].printed
        for width in WIDTHS:
            printed = TABLE_3.get((name, width))
            if width == 3 and name in TABLE_1:
                one = TABLE_1[name]
                steps = (one.align, one.init, one.interpolation, one.stitching, one.total)
                printed = Variant(*steps, TABLE_2[name].mixed)
            if printed:
                rows.append(printed_row(mesh, f"width {width}", "", "", printed))
            rows.append(measured_row(mesh, f"width {width}", result[str(width)]))
    return [
        "*MixIT, free* with strips as joints: times in milliseconds and errors at w = 0.5, with joints of full width "
        "around every boundary. (By default a joint is only as wide as it bends, and the width is a limit.)",
        table(rows),
        "## Differences",
        "- Our width counts the strips on each side of a boundary, the paper's those of a joint. So ours at "
        "5 is about as wide as the paper's at 9; and a part keeps a third of its vertices whatever the "
        "width, so where parts are small joints stop growing.\n"
        "- The paper finds the errors insensitive to the width (its Figure 13). Ours at 99.9 % "
        f"with width 9 are {ratio_range(r['9']['lengths'][1] / r['3']['lengths'][1] for r in results.values())} of "
        "those with width 3, in lengths.\n"
        "- " + folded({f"width {w} on {mesh}": r[str(w)] for mesh, r in results.items() for w in WIDTHS}),
    ]


def verdict(results: Results) -> list[str]:
    def change(r: Json) -> str:
        (few, narrow), (many, wide) = ((r[width]["lengths"][1], r[width]["total"]) for width in ("3", "9"))
        return f"{few:.2g} to {many:.2g} for {wide / narrow:.1f} times the time"

    return [f"Length errors at 99.9 % from width 3 to width 9: {by_mesh(results, change, '; ')}."]
