"""Warming up: what is compiled ahead is all that first use needs, and nothing is compiled twice."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

WARM_UP = """
import gc
from mixseq.cli import main
from numba.core.dispatcher import Dispatcher

main(["warm-up"], standalone_mode=False)
ours = [each for each in gc.get_objects() if isinstance(each, Dispatcher) and "mixseq" in each.py_func.__module__]
print(sum(len(each.overloads) == 1 for each in ours))
for each in ours:
    if len(each.overloads) > 1:
        print(each.py_func.__module__, each.py_func.__name__, *each.overloads, sep="\\n")
"""

FIRST_USE = """
import mixseq
from mixseq.creature import walk_cycle
from numba.core.event import install_recorder

with install_recorder("numba:compile") as compiled:
    walk = walk_cycle(frames=8)
    mixseq.save("walk.h5", mixseq.compress(walk, kg=0.5))
    mixseq.load("walk.h5")(0.1)
    mixseq.fit(walk).sample()
print(*(event.data["dispatcher"] for _, event in compiled.buffer))
"""


def run(code: str, folder: Path) -> str:
    result = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        cwd=folder,
        env=os.environ | {"NUMBA_CACHE_DIR": str(folder / "kept")},
    )
    assert result.returncode == 0, result.stderr
    return result.stdout


def test_nothing_is_left_to_compile_and_nothing_is_compiled_twice(tmp_path: Path) -> None:
    told, count, *twice = run(WARM_UP, tmp_path).splitlines()
    assert told.startswith("ready after ")
    assert int(count) > 30
    assert not twice  # arrays that may be written, or are of int32 once and int64 elsewhere
    assert not run(FIRST_USE, tmp_path).strip()
    assert [each.name for each in tmp_path.iterdir() if each.name not in ("kept", "walk.h5")] == []
