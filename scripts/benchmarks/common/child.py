"""Run a program and tell how long it took and how much memory it had."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

MIXSEQ = (str(Path(sys.executable).with_name("mixseq")),)
"""The command line of the environment that the benchmark runs in."""


@dataclass(frozen=True)
class Child:
    """A program that has ended well: wall-clock seconds, peak of its resident memory in MB, what it printed, CPU s."""

    seconds: float
    megabytes: float
    output: str
    cpu: float


class ChildError(Exception):
    """A program failed; the message ends with what it said last."""


def run(*command: object, environment: Mapping[str, str] | None = None) -> Child:
    """Run a program to its end.

    The peak is that of the program or of the largest process that it started. A new process inherits the peak of the
    one that starts it, so start large programs from a small one.
    """
    words = [str(word) for word in command]
    with tempfile.TemporaryFile("w+") as output:
        start = time.perf_counter()
        process = subprocess.Popen(
            words, stdout=output, stderr=subprocess.STDOUT, env={**os.environ, **(environment or {})}
        )
        _, status, usage = os.wait4(process.pid, 0)
        seconds = time.perf_counter() - start
        process.returncode = os.waitstatus_to_exitcode(status)  # or it would be waited for again
        output.seek(0)
        text = output.read()
    if process.returncode:
        last = " / ".join(text.strip().splitlines()[-3:])
        raise ChildError(f"{' '.join(words[:4])} ... ended with {process.returncode}: {last}")
    # Linux counts in kilobytes of 1024.
    return Child(seconds, usage.ru_maxrss * 1024 / 1e6, text, usage.ru_utime + usage.ru_stime)


def run_module(name: str, *arguments: object, environment: Mapping[str, str] | None = None) -> Child:
    """Run a module of this folder, ``common.dembones`` say, in a process of its own."""
    return run(sys.executable, "-m", f"scripts.benchmarks.{name}", *arguments, environment=environment)
