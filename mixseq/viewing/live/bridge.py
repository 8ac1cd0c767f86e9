"""Our scripts in viser's page, and what they say to Python.

What is written with ``add_html`` runs no scripts, but the document of an ``iframe`` does, and may add ours to the page.
To Python they talk through a text input that nobody sees: its callback runs on viser's event loop, in order.
"""

from __future__ import annotations

from collections.abc import Callable
from html import escape
from typing import Any

from mixseq.viewing.messages import Message, message_of
from mixseq.viewing.template import chart_scripts, script, script_json


def add_bridge(server: Any, heard: Callable[[Message], None]) -> None:
    """Add our scripts to the page of a server, where its controls are added now."""
    line = server.gui.add_text("mixseq", "", visible=False)

    @line.on_update  # type: ignore[untyped-decorator]
    async def _(event: Any) -> None:
        message = message_of(line.value)
        if message is not None:
            heard(message)

    server.gui.add_html(_frame(line._impl.uuid))


def _frame(line: str) -> str:
    """Return an element that brings our scripts into the page that it is in."""
    source = "\n".join([chart_scripts(), script("live_window.js"), script("live.js")])
    start = f"""<script>
const text = {script_json(source)};
if (!parent.mixseqLive) {{
  const script = parent.document.createElement("script");
  script.textContent = text;
  parent.document.head.append(script);
}}
parent.mixseqLive.connect({script_json(line)});
</script>"""
    return f'<iframe style="display: none" title="mixseq" srcdoc="{escape(start, quote=True)}"></iframe>'
