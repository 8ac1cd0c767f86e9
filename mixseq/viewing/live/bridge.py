"""Scripts in viser's page, and their messages to Python.

``add_html`` does not run scripts, but the document of an ``iframe`` does, and can add them to the page. They send
messages through a hidden text input, whose callback runs in order on viser's event loop.
"""

from __future__ import annotations

from collections.abc import Callable
from html import escape
from typing import Any

from mixseq.viewing.messages import Message, message_of
from mixseq.viewing.template import chart_scripts, script, script_json


def add_bridge(server: Any, heard: Callable[[Message], None]) -> None:
    """Add the scripts to the page of a server, at the current position of its controls."""
    line = server.gui.add_text("mixseq", "", visible=False)

    @line.on_update  # type: ignore[untyped-decorator]
    async def _(event: Any) -> None:
        message = message_of(line.value)
        if message is not None:
            heard(message)

    server.gui.add_html(_frame(line._impl.uuid))


def _frame(line: str) -> str:
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
