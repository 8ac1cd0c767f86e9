"""Speed and scale: everything that is measured about how fast mixseq is, with its targets, in one run.

Each measurement runs in a process of its own; if one fails the others go on. Leaves out/speed.json, out/speed.md and
out/speed.png. With names, only those are measured, and replaced in what the last run has left. Ends with 1 if a target
is not met or a measurement failed.

Usage: scripts/bench speed [NAME ...]
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from importlib import import_module
from pathlib import Path
from typing import Any

from scripts.benchmarks.common.report import MARKDOWN, Results, last, origin, save
from scripts.benchmarks.common.section import Section

LIMITS = {
    "interpolation": 600,
    "playback": 240,
    "fit": 420,
    "scale": 900,
    "extremes": 1800,
    "threads": 240,
    "startup": 180,
    "cluster": 240,
}
"""The measurements, modules of speeds/, and after how many seconds each is given up."""


def main() -> int:
    names = sys.argv[1:]
    if len(names) == 3 and names[0] == "--one":
        return measure(names[1], Path(names[2]))
    if not set(names) <= set(LIMITS) or not os.environ.get("MIXSEQ_DATA"):
        print(f"usage: MIXSEQ_DATA=FOLDER scripts/bench speed [{' | '.join(LIMITS)}] ...", file=sys.stderr)
        return 2
    results: Results = last() if names else {}
    for name in names or LIMITS:
        results[name] = measured(name)
        save({known: results[known] for known in LIMITS if known in results})
    targets = [target for result in results.values() for target in Section.from_dict(result).targets]
    met = sum(target.met for target in targets)
    broken = [name for name, result in results.items() if "failure" in result]
    say(f"{met} of {len(targets)} targets met, {len(broken)} measurements failed; see {MARKDOWN}")
    return 0 if met == len(targets) and not broken else 1


def measured(name: str) -> dict[str, Any]:
    """Run one measurement in a process of its own; a failure is a result too."""
    say(f"{name} ...")
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "result.json")
        command = [sys.executable, "-m", "scripts.benchmarks.speed", "--one", name, str(file)]
        # A session of its own, so that whatever it starts can be ended with it; a folder for whatever it writes.
        process = subprocess.Popen(command, start_new_session=True, env={**os.environ, "TMPDIR": folder})
        try:
            code = process.wait(LIMITS[name])
            result = failed(name, f"ended with {code}") if code else json.loads(file.read_text())
        except subprocess.TimeoutExpired:
            result = failed(name, f"given up after {LIMITS[name]} s")
        finally:
            stop(process)
    if "failure" in result:
        say(f"{name} FAILED: {result['failure']}")
    seconds, now = time.perf_counter() - start, time.strftime("%Y-%m-%d %H:%M")
    return {**result, "seconds": seconds, "measured": now, **origin()}


def measure(name: str, file: Path) -> int:
    """Run one measurement in this process, and leave its result in a file."""
    module = import_module(f"scripts.benchmarks.speeds.{name}")
    try:
        section: Section = module.measure(lambda text: say(f"{name}: {text}"))
        result = section.as_dict()
    except Exception as error:
        traceback.print_exc()
        result = failed(name, f"{type(error).__name__}: {error}")
    file.write_text(json.dumps(result))
    return 0


def failed(name: str, why: str) -> dict[str, Any]:
    """Return what is reported of a measurement that failed."""
    section = Section(name.capitalize(), notes=[f"This measurement failed: {why}"])
    return {**section.as_dict(), "failure": why}


def stop(process: subprocess.Popen[bytes]) -> None:
    """End whatever a measurement has started and left running."""
    try:
        os.killpg(process.pid, signal.SIGKILL)
    except ProcessLookupError:
        pass
    finally:
        process.wait()


def say(text: str) -> None:
    """Print a line with the time of day."""
    print(f"{time.strftime('%H:%M:%S')} {text}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
