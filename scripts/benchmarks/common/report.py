"""The report of several measurements: JSON, from which a later run goes on, Markdown, and the plot."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

from scripts.benchmarks.common.charts import draw
from scripts.benchmarks.common.machine import machine
from scripts.benchmarks.common.section import Section, markdown_table

OUT = Path("out")
JSON, MARKDOWN, PLOT = (OUT / f"speed.{kind}" for kind in ("json", "md", "png"))

Results = dict[str, dict[str, Any]]
"""A section as plain data, with the seconds it took and when that was, for each measurement."""


UNKNOWN = "not known"

HOW_OFTEN = (
    "Seconds with a range are the median of several runs, with the fastest and the slowest run: `0.12 (0.11-0.15, 5 "
    "runs)`. The cost per vertex in `scale`, ratios and targets are based on these medians. All other seconds, and "
    "memory, are of a single run, marked `(1 run)` or not: `scale` by frames, `cluster`, and the runs of `startup` "
    "that compile. Errors, iterations and hashes of mixseq are equal in every run."
)


def origin() -> dict[str, Any]:
    """Return the machine and the commit that a section was measured on, and whether files had changed since."""
    return {"machine": machine(), "commit": _commit()}


def _commit() -> str:
    try:
        found = [
            subprocess.run(["git", *words], check=True, capture_output=True, text=True).stdout.strip()
            for words in (
                ("rev-parse", "--short=12", "HEAD"),
                ("status", "--porcelain", "--untracked-files=no"),
            )
        ]
    except (OSError, subprocess.CalledProcessError):
        return UNKNOWN
    return f"{found[0]} with changes" if found[1] else found[0]


def _on(result: dict[str, Any]) -> str:
    return ", ".join(f"{key} {value}" for key, value in result.get("machine", {}).items()) or UNKNOWN


def last() -> Results:
    """Return the results of the last run."""
    if not JSON.exists():
        return {}
    stored = json.loads(JSON.read_text())
    results: Results = stored["results"]
    if "machine" in stored:  # earlier reports named one for all
        results = {name: {"machine": stored["machine"], **result} for name, result in results.items()}
    return results


def save(results: Results) -> None:
    """Write all three files; every section tells its own `origin`, as a run may replace only some."""
    OUT.mkdir(exist_ok=True)
    sections = [Section.from_dict(result) for result in results.values()]
    JSON.write_text(json.dumps({"results": results}, indent=1))
    machines = list(dict.fromkeys(_on(result) for result in results.values()))
    origins = [
        (
            name,
            result["measured"],
            f"{result['seconds']:.0f}",
            str(result.get("commit", UNKNOWN)),
            str(1 + machines.index(_on(result))),
        )
        for name, result in results.items()
    ]
    chapters = [
        *(section.markdown() for section in sections),
        "### Origin of the figures",
        HOW_OFTEN,
        markdown_table(("measurement", "when", "s", "commit", "machine"), origins),
        *(f"Machine {number}: {each}." for number, each in enumerate(machines, start=1)),
    ]
    MARKDOWN.write_text("\n\n".join(chapters) + "\n")
    draw(sections, PLOT)
