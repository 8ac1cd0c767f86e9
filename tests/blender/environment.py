"""Run the modules of this folder that need bpy, in an environment that has it."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest


def python() -> str:
    """Return the Python that has bpy."""
    return os.environ["MIXSEQ_BLENDER"]


needs_blender = pytest.mark.skipif(
    "MIXSEQ_BLENDER" not in os.environ, reason="MIXSEQ_BLENDER names no Python that has bpy"
)


def run(module: str, *arguments: object) -> None:
    """Run a module in Blender; what Blender says is only shown where it fails."""
    words = [python(), "-m", f"tests.blender.{module}", *map(str, arguments)]
    done = subprocess.run(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    if done.returncode:
        raise SystemExit(f"Blender failed in {module}:\n{done.stdout[-2000:]}")


def show(jobs: Sequence[dict[str, Any]], folder: Path) -> None:
    """Let Blender show files, see `showing.py`."""
    path = folder / "jobs.json"
    path.write_text(json.dumps(jobs))
    run("showing", path)
