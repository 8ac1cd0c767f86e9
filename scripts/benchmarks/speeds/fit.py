"""Fitting a sequence, against the skinning decomposition of py-dem-bones with as many bones as we have parts."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any

import mixseq
from scripts.benchmarks.common.animations import animation
from scripts.benchmarks.common.child import ChildError, run, run_module
from scripts.benchmarks.common.section import Bar, Say, Section, Table, at_least, at_most
from scripts.benchmarks.common.timing import Timing, repeated

NAMES = {"horse_gallop": 5, "q_man_run": 5, "elephant_gallop": None}
"""How many times faster a fit should be; None: for information."""

FITS: dict[str, dict[str, Any]] = {"rank=20": {"rank": 20}, "default": {}}
PEERS = Path("out", "peers")
INSTALL = f"pip install --no-deps --target {PEERS} py-dem-bones==0.13.1"


def measure(say: Say) -> Section:
    """Measure all animations.

    Raises
    ------
    ChildError
        If py-dem-bones is not installed.
    """
    _check_installed()
    columns = ("sequence", "method", "parts or bones", "s", "KG %", "max error/diag", "py-dem-bones / this")
    rows: list[tuple[str, ...]] = []
    section = Section("Fitting", [Table("", columns, rows)])
    for name, target in NAMES.items():
        _measure(section, rows, name, target, say)
    section.notes.append(
        "`fit` includes parts, joints, registration and signals; with the default tolerance also the search for the "
        "necessary detail. py-dem-bones: 30 iterations, 4 weights per vertex; only its solver is timed. If its own "
        "clustering stops early, it is restarted from k-means labels, which are not timed."
    )
    return section


def _measure(section: Section, rows: list[tuple[str, ...]], name: str, target: int | None, say: Say) -> None:
    sequence = animation(name)
    fits = {}
    for which, settings in FITS.items():
        say(f"{name}: fit, {which}")
        timing, model = repeated(lambda: mixseq.fit(sequence, **settings), 3, 40.0, warm=True)  # noqa: B023
        fits[which] = timing, mixseq.compare(sequence, model.sample())
    bones = len(model.decomposition.parts)
    say(f"{name}: py-dem-bones, {bones} bones")
    theirs = _dem_bones(name, bones)
    for which, (timing, error) in fits.items():
        ratio = Timing(tuple(theirs["seconds"])).median / timing.median
        rows.append(
            (
                name,
                f"fit, {which}",
                str(bones),
                timing.text(),
                f"{error.kg_percent:.3g}",
                f"{error.max_error:.2g}",
                f"{ratio:.3g}",
            )
        )
        section.figures.append(
            {"sequence": name, "method": which, "seconds": timing.runs, "kg_percent": error.kg_percent}
        )
        if target is not None:
            section.targets.extend(
                [
                    at_least(f"{name}, fit {which}: speed relative to py-dem-bones", ratio, target),
                    at_most(
                        f"{name}, fit {which}: KG below py-dem-bones'",
                        error.kg_percent,
                        theirs["kg_percent"],
                        " %",
                    ),
                ]
            )
            section.bars.append(Bar(f"{name}, fit {which}", ratio, target))
    rows.append(
        (
            name,
            f"py-dem-bones, {theirs['start']}",
            str(theirs["bones"]),
            Timing(tuple(theirs["seconds"])).text(),
            f"{theirs['kg_percent']:.3g}",
            f"{theirs['max_error']:.2g}",
            "",
        )
    )
    section.figures.append({"sequence": name, "method": "py-dem-bones", **theirs})


def _dem_bones(name: str, bones: int) -> dict[str, Any]:
    """What py-dem-bones does in a process of its own."""
    output = run_module("common.dembones", name, bones, environment=_peers()).output
    found: dict[str, Any] = json.loads(output.strip().splitlines()[-1])
    return found


def _check_installed() -> None:
    """Without what we are compared with, nothing is measured: the section fails, before it takes its time."""
    try:
        run(sys.executable, "-c", "import py_dem_bones", environment=_peers())
    except ChildError as error:
        raise ChildError(f"py-dem-bones is not installed: {INSTALL}") from error


def _peers() -> dict[str, str]:
    """Return the environment in which py-dem-bones is found."""
    return {"PYTHONPATH": os.pathsep.join([str(PEERS), os.environ.get("PYTHONPATH", "")]).strip(os.pathsep)}
