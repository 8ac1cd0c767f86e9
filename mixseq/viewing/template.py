"""Scripts and styles of the pages, which are part of the package, and their assembly into one self-contained page.

A page is a small document that unpacks itself: its first stream, deflated, has style, body, decoder, scripts and
description, separated by NUL; the others belong to the meshes. `mixseq.viewing.packing` encodes them as text.
"""

from __future__ import annotations

import json
import re
import zlib
from collections.abc import Mapping, Sequence
from functools import cache
from html import escape
from importlib.resources import files
from typing import Any

from mixseq.viewing.packing import BYTE_ORDER_MARK, ENCODING, as_text
from mixseq.web.bundle import bundled, stripped

CHART_SCRIPTS = (
    "frame_numbers.js",
    "chart_pane.js",
    "chart_axes.js",
    "chart_marks.js",
    "chart_layout.js",
    "chart_coefficients.js",
    "charts.js",
)
"""Scripts of charts, in loading order."""

EDITING_SCRIPTS = ("chart_retiming.js",)
"""Additional scripts of editable charts."""

PLAYER_SCRIPTS = (
    "clock.js",
    "camera.js",
    "shaders.js",
    "programs.js",
    "topology.js",
    "mesh.js",
    "stage.js",
    "pose_source.js",
    "player.js",
)
"""Scripts of the player of meshes."""

POSE_SCRIPTS = ("normals.js", "topology.js", "measures.js", "poses.js")
"""Scripts that decode streams to poses, with the decoder."""


@cache
def script(name: str) -> str:
    """Return a file of the folder ``page`` as text, such as ``"charts.js"``."""
    return files("mixseq.viewing").joinpath("page", name).read_text(encoding="utf-8")


def chart_scripts() -> str:
    """Return all scripts of editable charts as one text, for one script element."""
    return "\n".join(map(script, (*CHART_SCRIPTS, *EDITING_SCRIPTS)))


def page_text(description: Mapping[str, Any], data: Sequence[bytes]) -> bytes:
    """Return a page as bytes."""
    charts = any(item["signals"] for item in description["items"])
    parts = (
        _plain(script("player.css")),
        _plain(script("player.html")),
        decoder_script(),
        page_scripts(charts),
        json.dumps(description, ensure_ascii=False, allow_nan=False, separators=(",", ":")),
    )
    code = zlib.compress("\0".join(parts).encode(), 9)
    title, loader = escape(description["title"]), stripped(script("loader.js"))
    shell = _plain(script("page.html")).replace("<title>mixseq</title>", f"<title>{title}</title>")
    before, after = shell.replace('<script src="loader.js"></script>', f"<script>{loader}</script>").split(
        _DATA
    )
    elements = [_element(each) for each in (code, *data)]
    return BYTE_ORDER_MARK + b"".join([before.encode(ENCODING), *elements, after.encode(ENCODING)])


@cache
def decoder_script() -> str:
    """Return the script that decodes streams to poses, for a worker or a script element."""
    decoder = re.sub(r"^export const ?{.*}=(\w+);$", r"return \1;", bundled(), flags=re.MULTILINE)
    return f"var mixseqDecoder = (() => {{\n{decoder}}})();\n" + "".join(
        stripped(script(name)) for name in POSE_SCRIPTS
    )


@cache
def page_scripts(charts: bool) -> str:
    """Return the scripts of a page, with charts or without."""
    names = (*CHART_SCRIPTS[: None if charts else 1], *PLAYER_SCRIPTS)
    return "".join(stripped(script(name)) for name in names)


_DATA = "<!-- data -->"


def _plain(text: str) -> str:
    """Return HTML or CSS without indentation and comments, except for the place of the data."""
    return re.sub(r"\n\s*", "\n", re.sub(r"<!--(?! data).*?-->|/\*.*?\*/", "", text))


def _element(data: bytes) -> bytes:
    opened, closed = f'<script type="text/plain" data-size="{len(data)}">', "</script>\n"
    return opened.encode(ENCODING) + as_text(data) + closed.encode(ENCODING)


def script_json(value: Any) -> str:
    """Return JSON without ``<``, which could end its script element."""
    return json.dumps(value, ensure_ascii=False, allow_nan=False).replace("<", "\\u003c")
