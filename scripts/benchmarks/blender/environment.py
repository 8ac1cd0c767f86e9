"""Run the modules of this folder that need bpy, in an environment that has it."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

VERSION = "5.0.1"
PYTHON = "python3.11"
"""What this version of Blender is built for; it runs in no other one."""

HOME = Path("out/blender")


@cache
def python() -> str:
    """Return what MIXSEQ_BLENDER names, or else a Python with bpy in `HOME`, which is made if it is not there."""
    if "MIXSEQ_BLENDER" in os.environ:
        return os.environ["MIXSEQ_BLENDER"]
    program = HOME / "bin" / "python"
    if not (HOME / "installed").exists():
        base = sys.executable if sys.version_info[:2] == (3, 11) else shutil.which(PYTHON)
        if base is None:
            raise SystemExit(
                f"Blender {VERSION} needs {PYTHON}; install it, or name a Python that has bpy in MIXSEQ_BLENDER"
            )
        print(f"setting up {HOME} with Blender {VERSION} ...", file=sys.stderr)
        subprocess.run([base, "-m", "venv", "--clear", HOME], check=True)
        subprocess.run([program, "-m", "pip", "install", "--quiet", f"bpy=={VERSION}"], check=True)
        (HOME / "installed").touch()
    return str(program)


def run(module: str, *arguments: object) -> None:
    """Run a module in Blender; what Blender says is only shown where it fails."""
    words = [python(), "-m", f"scripts.benchmarks.blender.{module}", *map(str, arguments)]
    done = subprocess.run(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    if done.returncode:
        raise SystemExit(f"Blender failed in {module}:\n{done.stdout[-2000:]}")


def show(jobs: Sequence[dict[str, Any]], folder: Path) -> None:
    """Let Blender show files, see `showing.py`."""
    path = folder / "jobs.json"
    path.write_text(json.dumps(jobs))
    run("showing", path)
