"""What is known so far: a JSON file for each table or figure, from which its page and the index are written again.

A run may regenerate one table on one mesh; everything else stays as it was, with what it was measured on.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from scripts.benchmarks.common.harness import markdown_table
from scripts.benchmarks.common.origin import origin

Json = dict[str, Any]
Say = Callable[[str], None]
Results = dict[str, Json]
"""Measurements by mesh."""


def load(out: Path, name: str) -> Results:
    """Return the results of a table or figure in a folder, by mesh."""
    file = _file(out, name)
    results: Results = json.loads(file.read_text()) if file.exists() else {}
    return results


def save(out: Path, name: str, results: Results) -> None:
    """Write the results of a table or figure into a folder."""
    file = _file(out, name)
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(results, indent=1) + "\n")


def _file(out: Path, name: str) -> Path:
    return out / "results" / f"{name}.json"


def stamped(result: Json, seconds: float) -> Json:
    """Add when and on what something was measured."""
    now, load = time.strftime("%Y-%m-%d %H:%M"), os.getloadavg()[0]
    return {**result, "seconds": seconds, "measured": now, "load": load, **origin()}


def ratio_range(values: Iterable[float]) -> str:
    """Return the smallest and the largest value, with two digits: ``0.6 to 1.2``."""
    known = list(values)
    low, high = (f"{value:.2g}" if value < 99.5 else f"{value:.0f}" for value in (min(known), max(known)))
    return low if low == high else f"{low} to {high}"


def named(meshes: Iterable[str]) -> str:
    """Return the names of meshes: ``lion, cat``."""
    return ", ".join(meshes) or "none"


def by_mesh(results: Results, show: Callable[[Json], str], separator: str = ", ") -> str:
    """Say something of every mesh: ``lion 1.2, cat 0.9``."""
    return separator.join(f"{mesh} {show(result)}" for mesh, result in results.items())


def origins(results: Results) -> list[str]:
    """Return the end of a page: when and on what everything was measured."""
    machine_of = {mesh: ", ".join(" ".join(each) for each in r["machine"].items()) for mesh, r in results.items()}
    machines = list(dict.fromkeys(machine_of.values()))
    rows = [
        (mesh, r["measured"], f"{r['seconds']:.0f}", f"{r['load']:.1f}", r["commit"], f"{1 + machines.index(machine)}")
        for (mesh, r), machine in zip(results.items(), machine_of.values(), strict=True)
    ]
    table = markdown_table(("mesh", "measured", "s", "load", "commit", "machine"), rows)
    note = (
        "Load is the number of programs that wanted a core. Times in tables are of the processor; where load is above "
        "the number of cores they are longer than on a quiet machine, as caches are shared."
    )
    return ["## Measured on", table, note, *(f"Machine {n}: {m}." for n, m in enumerate(machines, start=1))]
