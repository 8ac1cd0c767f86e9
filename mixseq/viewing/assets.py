"""Scripts and styles of the pages, which come with the package."""

from __future__ import annotations

from functools import cache
from importlib.resources import files

CHART_SCRIPTS = (
    "chart_pane.js",
    "chart_axes.js",
    "chart_marks.js",
    "chart_layout.js",
    "chart_coefficients.js",
    "chart_retiming.js",
    "charts.js",
)
"""What charts are made of, in the order in which a page loads it."""


@cache
def script(name: str) -> str:
    """Return the text of a file of the folder ``page``, such as ``"charts.js"``."""
    return files("mixseq.viewing").joinpath("page", name).read_text(encoding="utf-8")


def chart_scripts() -> str:
    """Return all of `CHART_SCRIPTS` as one text, for one script element of a page."""
    return "\n".join(script(name) for name in CHART_SCRIPTS)
