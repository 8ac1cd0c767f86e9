"""A shot through the pipeline and back: Blender exports a walker, mixseq works on it, Blender imports the results.

Blender (bpy) is installed into out/blender, unless MIXSEQ_BLENDER names a Python that has it. Every frame of every
result is compared with the scene itself at that moment, of which 120 frames per second are exported, too. Then rigs
are imported, and the extension shows models, live, installed into a Blender of its own. Leaves out/dcc.json. Ends with
1 if a row fails.

Usage: scripts/bench dcc [--only WORD] [--keep FOLDER] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

from scripts.benchmarks.blender.environment import run
from scripts.benchmarks.blender.live_rows import TITLES, LiveRow, live_rows
from scripts.benchmarks.blender.rig_rows import rig_rows
from scripts.benchmarks.blender.rows import BY_ITSELF, Row, by_itself, measured
from scripts.benchmarks.blender.tasks import TASKS
from scripts.benchmarks.blender.truth import Truth
from scripts.benchmarks.blender.ways import WAYS, made

RIGS, LIVE = "rigs", "live"
"""Names of the rows about rigs and about the extension, for ``--only``."""

COLUMNS = ("positions", "velocities", "materials", "UVs", "paths", "camera", "range")


def main() -> int:
    options = _options()
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.keep or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        if options.only not in (RIGS, LIVE):
            run("exporting", folder)
        print("| way | task | frames | rms | max | " + " | ".join(COLUMNS) + " |")
        print("|" + (5 + len(COLUMNS)) * "---|", flush=True)
        rows = []
        for row in _rows(folder, options.only):
            rows.append(row)
            print(_line(row), flush=True)
        live = []
        for name, kind in ((RIGS, rig_rows), (LIVE, live_rows)):
            if options.only in name:
                print(f"\n| {name} in Blender {TITLES}", flush=True)
                for live_row in kind(folder, _data()):
                    live.append(live_row)
                    print(live_row, flush=True)
    for row in rows:
        for note in row.notes:
            print(f"{row.way}, {row.task}: {note}", file=sys.stderr)
    options.json.parent.mkdir(parents=True, exist_ok=True)
    every: list[Row | LiveRow] = [*rows, *live]
    options.json.write_text(json.dumps([{**asdict(row), "passed": row.passed} for row in every], indent=1))
    failed = sum(not row.passed for row in every)
    print(f"\n{len(every) - failed} of {len(every)} rows pass")
    return 1 if failed or not every else 0


def _data() -> Path | None:
    """Return the folder of real animations, if there is one."""
    return Path(os.environ["MIXSEQ_DATA"]) if "MIXSEQ_DATA" in os.environ else None


def _rows(folder: Path, only: str) -> Iterator[Row]:
    for way in WAYS:
        if not way.cache and only in f"{way.name} {BY_ITSELF}":
            yield by_itself(way, folder)
    for task in (make() for make in TASKS):
        ways = [way for way in WAYS if only in f"{way.name} {task.name}"]
        if not ways:
            continue
        truth = Truth.of(task, folder)
        for way in ways:
            answer, said = made(task, way, folder)
            row = measured(task, way, answer, truth, folder) if answer.exists() else Row(way.name, task.name)
            row.notes[:0] = said
            yield row


def _line(row: Row) -> str:
    def cell(name: str) -> str:
        found = row.checks.get(name)
        word = "—" if found is None else "yes" if found else "**no**"
        return f"{word}, {row.velocities:.2g}" if name == "velocities" and row.velocities is not None else word

    numbers = ["—" if each is None else f"{each:.1e}" for each in (row.rms, row.largest)]
    cells = [row.way, row.task, str(row.frames), *numbers, *map(cell, COLUMNS)]
    return "| " + " | ".join(cells) + " |"


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="only rows whose way and task have this in their names")
    parser.add_argument("--keep", type=Path, help="folder that keeps all files")
    parser.add_argument("--json", type=Path, default=Path("out/dcc.json"))
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
