"""Warming up: what is compiled ahead is all that first use needs, and nothing is compiled twice."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

CALLED = """
import gc, json
from numba.core.dispatcher import Dispatcher

ours = [each for each in gc.get_objects() if isinstance(each, Dispatcher) and "mixseq" in each.py_func.__module__]
names = [f"{each.py_func.__module__}.{each.py_func.__name__}" for each in ours]
print(json.dumps({name: list(map(str, each.overloads)) for name, each in zip(names, ours)}))
"""
"""Tells what was called, and with which types; whether it was compiled or kept from an earlier run."""

COARSE = """
from mixseq import creature

creature.CELL_METRES = 0.04
"""
"""Makes the fox one of 1,614 vertices."""

WARM_UP = """
from mixseq.cli import main

main(["warm-up"], standalone_mode=False)
"""

FIRST_USE = """
import mixseq
from mixseq.creature import walk_cycle

walk = walk_cycle(frames=4)
mixseq.save("walk.h5", mixseq.compress(walk, kg=2.0))
mixseq.load("walk.h5")(0.1)
mixseq.fit(walk).sample()
mesh = mixseq.MeshSequence.from_arrays(walk.points[:1, ::-1], walk.points.shape[1] - 1 - walk.faces)
mixseq.transfer(walk, mesh, [(vertex, walk.points.shape[1] - 1 - vertex) for vertex in range(0, 1600, 100)])
"""


def run(code: str, folder: Path) -> tuple[list[str], dict[str, list[str]]]:
    """What is printed, and the types with which compiled functions were called."""
    result = subprocess.run([sys.executable, "-c", COARSE + code + CALLED], capture_output=True, text=True, cwd=folder)
    assert result.returncode == 0, result.stderr
    *told, called = result.stdout.splitlines()
    return told, json.loads(called)


def kinds_of(name: str, types: list[str]) -> set[str]:
    """Types with which a function was called; complex steps of projections count as real numbers."""
    stepped = name.startswith(("mixseq.spaces.mixed.", "mixseq.shells.face_frames."))
    return {each.replace("complex128", "float64") if stepped else each for each in types}


def test_nothing_is_left_to_compile_and_nothing_is_compiled_twice(tmp_path: Path) -> None:
    [told], ready = run(WARM_UP, tmp_path)
    assert told.startswith("ready after ")
    assert sum(map(bool, ready.values())) > 30
    # arrays that may be written, or are of int32 once and int64 elsewhere
    assert not {name: types for name, types in ready.items() if len(kinds_of(name, types)) > 1}
    _, used = run(FIRST_USE, tmp_path)
    assert sum(map(bool, used.values())) > 30
    assert not {name: types for name, types in used.items() if not set(types) <= set(ready.get(name, []))}
    assert [each.name for each in tmp_path.iterdir()] == ["walk.h5"]
