"""Damaged files of all readers, each in a process of its own: an error of ours or sound values, and nothing else.

Usage: scripts/fuzz --minutes N [--seed S] [--reader R ...] [--cases K] [--workers W]
       scripts/fuzz --case SEED:READER:INDEX

Cases follow from the seed. Every defect is printed at once with the command that repeats it, and at the end a table of
what became of all. They are in out/fuzz/SEED.jsonl, from which the same command goes on; delete it to begin anew.
`--case` leaves the damaged file in out/fuzz/case/work.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import shutil
import sys
import time
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from importlib import import_module
from pathlib import Path
from pkgutil import walk_packages

import mixseq
import mixseq_io
from scripts.fuzzing.canary import lay_out
from scripts.fuzzing.cases import Name, Outcome, prepare, run
from scripts.fuzzing.readers import READERS
from scripts.fuzzing.verdict import GOOD, KINDS
from scripts.fuzzing.workers import fork_workers

OUT = Path("out/fuzz").absolute()
CORPUS = OUT / "corpus"


def main(arguments: Sequence[str] | None = None) -> int:
    options = _options(arguments)
    _import_readers()
    gc.freeze()  # memory that nobody writes to is not copied
    fork_workers()
    if options.case:
        return _again(Name.of(options.case))
    readers = options.reader or list(READERS)
    prepare(readers, CORPUS, OUT / "room-0")
    log = OUT / f"{options.seed}.jsonl"
    known = {outcome.case for outcome in _outcomes(log)}
    end = time.monotonic() + 60 * options.minutes
    foremen = []
    for number in range(options.workers):
        process = os.fork()
        if process == 0:
            every = (
                Name(options.seed, readers[count % len(readers)], count // len(readers))
                for count in range(number, options.cases, options.workers)
            )
            _work((name for name in every if str(name) not in known), OUT / f"room-{number}", log, end)
            os._exit(0)
        foremen.append(process)
    for process in foremen:
        os.waitpid(process, 0)
    outcomes = _outcomes(log)
    print(table(outcomes))
    return int(any(outcome.kind not in GOOD for outcome in outcomes))


def _outcomes(log: Path) -> list[Outcome]:
    lines = log.read_text().splitlines() if log.exists() else []
    return [Outcome(**json.loads(line)) for line in lines]


def _work(names: Iterable[Name], room: Path, log: Path, end: float) -> None:
    """Run one case after the other until the time is over, in a folder of its own."""
    canary = lay_out(room / "canary")
    for name in names:
        if time.monotonic() > end:
            break
        outcome = run(name, CORPUS, room, canary)
        with log.open("a") as file:
            file.write(json.dumps(asdict(outcome)) + "\n")
        if outcome.kind not in GOOD:
            last = (outcome.text.strip().splitlines() or [""])[-1].encode("unicode_escape").decode("ascii")
            print(
                f"{outcome.kind}: scripts/fuzz --case {name}\n    {outcome.damage}\n    {last[:200]}",
                flush=True,
            )
    shutil.rmtree(room, ignore_errors=True)


def _again(name: Name) -> int:
    room = OUT / "case"
    prepare([name.reader], CORPUS, room)
    outcome = run(name, CORPUS, room, lay_out(room / "canary"))
    print(json.dumps(asdict(outcome), indent=1))
    return int(outcome.kind not in GOOD)


def table(outcomes: Iterable[Outcome]) -> str:
    """A row for every reader, a column for every class."""
    counts = Counter((outcome.reader, outcome.kind) for outcome in outcomes)
    readers = [reader for reader in READERS if any(reader == each for each, _ in counts)]
    lines = [f"| reader | cases | {' | '.join(KINDS)} |", "|---" + "|---:" * (len(KINDS) + 1) + "|"]
    for title, members in [*((reader, [reader]) for reader in readers), ("all", readers)]:
        row = [sum(counts[reader, kind] for reader in members) for kind in KINDS]
        lines.append(f"| {title} | {sum(row)} | {' | '.join(map(str, row))} |")
    return "\n".join(lines)


def _import_readers() -> None:
    """Import what reads files, so that forked processes need not."""
    for package, left_out in ((mixseq_io, ()), (mixseq, ("viewing", "plots", "scene", "blender.addon"))):
        for module in walk_packages(package.__path__, f"{package.__name__}."):
            if not any(name in module.name for name in left_out):
                import_module(module.name)


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="scripts/fuzz", description="Damage files of every reader.")
    parser.add_argument("--minutes", type=float, default=600, help="how long at most")
    parser.add_argument("--cases", type=int, default=10**9, help="how many at most")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--reader", action="append", choices=READERS, help="only this one; may be given again"
    )
    parser.add_argument("--workers", type=int, default=1, help="how many cases at a time")
    parser.add_argument("--case", metavar="SEED:READER:INDEX", help="the case that is to be repeated")
    return parser.parse_args(arguments)


if __name__ == "__main__":
    sys.exit(main())
