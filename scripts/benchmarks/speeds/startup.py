"""Start-up: the help, the import, and the pause of the first run that compiles."""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path
from typing import Any

from scripts.benchmarks.common.child import MIXSEQ, run, run_module
from scripts.benchmarks.common.section import Say, Section, Table, at_least, at_most
from scripts.benchmarks.common.timing import Timing

RUNS = 10
HELP, IMPORT, SHOWN, FIRST = 0.3, 0.5, 0.6, 15.0

COMPRESS = """
import sys, mixseq
from mixseq.creature import walk_cycle
mixseq.save(sys.argv[1], mixseq.compress(walk_cycle(frames=24), kg=0.1))
"""
FRAME = "import sys, mixseq; mixseq.load(sys.argv[1])(0.0)"


def measure(say: Say) -> Section:
    """Measure all of it in new processes."""
    say("help and import")
    nothing = _timed(sys.executable, "-c", "")
    help_ = _timed(*MIXSEQ, "--help")
    import_ = _timed(sys.executable, "-c", "import mixseq")
    all_ = _timed(sys.executable, "-c", "import mixseq; mixseq.read, mixseq.fit, mixseq.save")
    with tempfile.TemporaryDirectory() as folder:
        say("first frame of a compressed file")
        file = Path(folder) / "walk.h5"
        run(sys.executable, "-c", COMPRESS, file)
        frame = _timed(sys.executable, "-c", FRAME, file)
    with tempfile.TemporaryDirectory() as cache:
        say("first run, with nothing compiled")
        cold = _first_use(cache)
        say("second run")
        warm = _first_use(cache)
    first = sum(cold["first"]) - sum(warm["first"])
    compiled = len(warm["compiled"])
    rows = [
        ("Python alone", nothing.text()),
        ("`mixseq --help`", help_.text()),
        ("`import mixseq`", import_.text()),
        ("`import mixseq` with the modules of `read`, `fit` and `save`", all_.text()),
        ("first frame of a compressed walk of 24 frames, import and all", frame.text()),
        (
            "first run, without compiled functions: fit, decode with velocities, both placements, float32 and float64",
            f"{sum(cold['first']):.3g}",
        ),
        ("second run, a new process", f"{sum(warm['first']):.3g}"),
        ("repeated in that process", f"{sum(warm['again']):.3g}"),
    ]
    return Section(
        "Start-up",
        [Table("Each run is a new process.", ("what", "s"), rows)],
        [
            at_most("`mixseq --help`", help_.median, HELP, " s"),
            at_most("`import mixseq`, Python's own start included", import_.median, IMPORT, " s"),
            at_most("first frame of a compressed file", frame.median, SHOWN, " s"),
            at_most("compilation time of the first run (first minus second run)", first, FIRST, " s"),
            at_least("functions compiled in the first run", len(cold["compiled"]), 1),
            at_most("functions compiled in later runs", compiled, 0),
        ],
        notes=[
            "Help and import are medians; runs that compile are single runs. Compiled functions are counted, since "
            "differences of times depend on other work on the machine."
            + (f" Compiled again: {', '.join(sorted(set(warm['compiled'])))}." if compiled else "")
        ],
        figures=[
            {
                "help": help_.runs,
                "import": import_.runs,
                "all": all_.runs,
                "frame": frame.runs,
                "python": nothing.runs,
                "cold": cold,
                "warm": warm,
            }
        ],
    )


def _timed(*command: object) -> Timing:
    run(*command)  # files are read into memory once
    return Timing(tuple(run(*command).seconds for _ in range(RUNS)))


def _first_use(cache: str) -> dict[str, Any]:
    output = run_module("common.first_use", environment={"NUMBA_CACHE_DIR": cache}).output
    told: dict[str, Any] = json.loads(output.strip().splitlines()[-1])
    return told
