"""The files of ``page/`` as one: a page that needs nothing but itself."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from functools import partial
from html import escape
from typing import Any

from mixseq.viewing.assets import script
from mixseq.viewing.packing import Packer

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
