"""Rows of Tables 3 and 4: times, dimension and errors of MixIT on one segmentation."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from scripts.benchmarks.common.harness import markdown_table
from scripts.paper_study.common.errors import errors, text
from scripts.paper_study.common.methods import Mixed, steps_of
from scripts.paper_study.common.poses import between
from scripts.paper_study.common.printed import Variant
from scripts.paper_study.common.record import Json

COLUMNS = (
    "mesh", "", "p", "q", "Align.", "Init.", "Interp.", "Stitch.", "Settle", "Total", "dim S_m",
    "lengths, 99 / 99.9 / 100 %", "degrees",
)  # fmt: skip


def row_of(method: Mixed, runs: int = 3) -> Json:
    """Return milliseconds (the fastest run), dimension as defined, errors at w = 0.5."""
    poses, cut = method.poses, method.decomposition
    fresh = [replace(method, poses=poses.moved(poses.points)) for _ in range(runs)]
    best, blend = min(map(steps_of, fresh), key=lambda each: sum(each[0][1:]))
    return {
        "parts": len(cut.parts),
        "joints": len(cut.joints),
        "ms": [1e3 * each for each in best],
        "total": 1e3 * sum(best[1:]),
        "dimension": cut.paper_dimension,
        **errors(poses, between(0.5), blend.points).summary(),
    }


def measured_row(mesh: str, what: str, row: Json) -> tuple[str, ...]:
    """Return a row of the table."""
    return (
        mesh, what, str(row["parts"]), str(row["joints"]), *(f"{ms:.0f}" for ms in row["ms"]), f"{row['total']:.0f}",
        f"{row['dimension']:,}", text(row["lengths"]), text(row["degrees"]),
    )  # fmt: skip


def printed_row(mesh: str, what: str, parts: str, joints: str, row: Variant) -> tuple[str, ...]:
    """Return a row that the paper prints."""
    steps = (row.align, row.init, row.interpolation, row.stitching)
    return (
        f"**{mesh}**", f"{what}, the paper", parts, joints, *map(str, steps), "", str(row.total),
        f"{row.dimension:,}", "", "",
    )  # fmt: skip


def table(rows: Iterable[tuple[str, ...]]) -> str:
    """Return the table in Markdown."""
    return markdown_table(COLUMNS, rows)
