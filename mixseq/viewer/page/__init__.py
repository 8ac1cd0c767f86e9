"""Read the scripts of pages; those that exported pages share with `mixseq.web` are in ``web/page``."""

from __future__ import annotations

import json
from functools import cache
from importlib.resources import files
from typing import Any

from mixseq.web import read_module

CHART_SCRIPTS = (
    "chart_pane.js",
    "chart_axes.js",
    "chart_marks.js",
    "chart_layout.js",
    "chart_coefficients.js",
    "charts.js",
)
"""Scripts of charts, in loading order; they need ``frame_numbers.js``."""


@cache
def read_script(name: str) -> str:
    """Return the text of a file in the folder ``page``, such as ``"charts.js"``, here or of `mixseq.web`."""
    here = files("mixseq.viewer.page").joinpath(name)
    return here.read_text(encoding="utf-8") if here.is_file() else read_module(f"page/{name}")


def chart_scripts() -> str:
    """Return the scripts of editable charts as one text."""
    return "\n".join(map(read_script, ("frame_numbers.js", *CHART_SCRIPTS, "chart_retiming.js")))


def script_json(value: Any) -> str:
    """Return a value as JSON for a script element, with ``<`` escaped because it could end the element."""
    return json.dumps(value, ensure_ascii=False, allow_nan=False).replace("<", "\\u003c")
