"""Scripts and styles of the pages, which come with the package, and all of them as one page that needs nothing else."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from functools import cache, partial
from html import escape
from importlib.resources import files
from typing import Any

from mixseq.viewing.packing import Packer

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


_STYLE = re.compile(r'<link rel="stylesheet" href="([\w.-]+)" ?/?>')
_SCRIPT = re.compile(r'<script src="([\w.-]+)"></script>')
_DATA = "<!-- data -->"


def page_around_data(description: Mapping[str, Any]) -> tuple[str, str]:
    """Return what stands in the page before and after its streams.

    Parameters
    ----------
    description : mapping
        The ``title`` of the page, and what is in the streams, as JSON takes it.
    """
    page = script("player.html").replace(
        "<title>mixseq</title>", f"<title>{escape(description['title'])}</title>"
    )
    page = _STYLE.sub(partial(_inlined, "<style>\n{}</style>".format), page)
    page = _SCRIPT.sub(partial(_inlined, "<script>\n{}</script>".format), page)
    before, after = page.split(_DATA)
    return (
        f'{before}<script type="application/json" id="description">{script_json(description)}</script>\n',
        after,
    )


def tags_around(stream: Packer) -> tuple[bytes, bytes]:
    """Return what stands before and after the text of a stream, when all its rows are there."""
    before = (
        f'<script type="application/octet-stream" data-rows="{stream.rows}" data-width="{stream.width}" '
        f'data-bytes="{stream.dtype.itemsize}">\n'
    )
    return before.encode(), b"</script>\n"


def script_json(value: Any) -> str:
    """Return JSON that can stand in a script: there is no ``<`` in it, so nothing ends the script too early."""
    return json.dumps(value, ensure_ascii=False, allow_nan=False).replace("<", "\\u003c")


def _inlined(around: Callable[[str], str], match: re.Match[str]) -> str:
    return around(script(match[1]))
