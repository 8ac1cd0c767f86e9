"""Node.js for tests of our JavaScript: the one that comes with playwright, or that of the machine."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path
from typing import Protocol

import pytest

import mixseq
from scripts.benchmarks.common.node import node_executable

WEB = Path(mixseq.__file__).parent / "web"

_OURS = re.compile(r' from "(?=\w+/)')

PATIENCE = 120
"""Seconds that a busy machine may take for anything."""


class Node(Protocol):
    """Runs the text of a module in Node.js with arguments, and returns what it prints."""

    def __call__(self, source: str, *arguments: str | Path) -> str: ...


@pytest.fixture
def node(tmp_path: Path) -> Node:
    """Runs scripts; ``from "decoder/sequence.js"`` in them is from the folder ``mixseq/web``."""
    executable = node_executable()
    if executable is None:
        pytest.skip("there is no Node.js: neither playwright's nor one on the PATH")

    def run(source: str, *arguments: str | Path) -> str:
        script = tmp_path / "script.mjs"
        script.write_text(_OURS.sub(f' from "{WEB.as_uri()}/', source), encoding="utf-8")
        result = subprocess.run(
            [executable, script, *map(str, arguments)], capture_output=True, text=True, timeout=PATIENCE
        )
        assert result.returncode == 0, result.stderr
        return result.stdout

    return run
