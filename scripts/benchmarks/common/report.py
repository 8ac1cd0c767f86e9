"""The report of several measurements: JSON, from which a later run goes on, Markdown, and the plot."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from scripts.benchmarks.common.charts import draw
from scripts.benchmarks.common.machine import machine
from scripts.benchmarks.common.section import Section, markdown_table

OUT = Path("out")
JSON, MARKDOWN, PLOT = (OUT / f"speed.{kind}" for kind in ("json", "md", "png"))

Results = dict[str, dict[str, Any]]
"""A section as plain data, with the seconds it took and when that was, for each measurement."""


def last() -> Results:
    """Return the results of the last run."""
    if not JSON.exists():
        return {}
    results: Results = json.loads(JSON.read_text())["results"]
    return results


def save(results: Results) -> None:
    """Write all three files."""
    OUT.mkdir(exist_ok=True)
    here = machine()
    sections = [Section.from_dict(result) for result in results.values()]
    JSON.write_text(json.dumps({"machine": here, "results": results}, indent=1))
    times = [(name, result["measured"], f"{result['seconds']:.0f}") for name, result in results.items()]
    chapters = [
        "Machine: " + ", ".join(f"{key} {value}" for key, value in here.items()) + ".",
        *(section.markdown() for section in sections),
        "### Time of the measurements",
        markdown_table(("measurement", "when", "s"), times),
    ]
    MARKDOWN.write_text("\n\n".join(chapters) + "\n")
    draw(sections, PLOT)
