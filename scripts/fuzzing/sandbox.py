"""Run a function in a process of its own, with limits of memory, processor time and wall-clock time.

The process is forked from one that has imported what it needs already, so that it starts in milliseconds. It leads a
group of processes, which is killed as a whole when it has ended or its time is over.
"""

from __future__ import annotations

import os
import resource
import select
import signal
import sys
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

CPU_SECONDS = 60
WALL_SECONDS = 240
MORE_MEMORY = 4 << 30
"""Bytes of address space beyond those of the process that forks."""


@dataclass(frozen=True)
class Ended:
    """How a process ended.

    Attributes
    ----------
    code : int
        Exit code; negative for the signal that ended it.
    hung : bool
        Whether its time was over.
    text : str
        What it printed.
    seconds : float
        Wall-clock time.
    megabytes : float
        How much the largest process grew beyond the one that forked.
    """

    code: int
    hung: bool
    text: str
    seconds: float
    megabytes: float


def forked(function: Callable[[], int], log: Path, seconds: float = WALL_SECONDS) -> Ended:
    """Call a function in a forked process, which ends with what it returns; `log` is a file for what it prints."""
    before = _megabytes_now()
    sys.stdout.flush()
    sys.stderr.flush()
    start = time.monotonic()
    process = os.fork()
    if process == 0:
        _run(function, log)
    ended = os.pidfd_open(process)
    try:
        ready, _, _ = select.select([ended], [], [], seconds)
    finally:
        os.close(ended)
    with suppress(ProcessLookupError):
        os.killpg(process, signal.SIGKILL)
    _, status, usage = os.wait4(process, 0)
    text = log.read_text(encoding="utf-8", errors="surrogateescape")
    grown = max(0.0, usage.ru_maxrss / 1024 - before)
    hung = not ready or os.waitstatus_to_exitcode(status) == -signal.SIGXCPU
    return Ended(os.waitstatus_to_exitcode(status), hung, text, time.monotonic() - start, grown)


def _run(function: Callable[[], int], log: Path) -> None:
    code = 70
    try:
        os.setsid()
        _limit()
        printed = os.open(log, os.O_CREAT | os.O_WRONLY | os.O_TRUNC, 0o644)
        nothing = os.open(os.devnull, os.O_RDONLY)
        os.dup2(nothing, 0)
        os.dup2(printed, 1)
        os.dup2(printed, 2)
        sys.stdout = os.fdopen(1, "w", encoding="utf-8", errors="surrogateescape")
        sys.stderr = os.fdopen(2, "w", encoding="utf-8", errors="surrogateescape")
        code = function()
    except SystemExit as left:
        code = left.code if isinstance(left.code, int) else int(left.code is not None)
    except BaseException:
        traceback.print_exc()
    finally:
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError):
                stream.flush()
        os._exit(code)


def _limit() -> None:
    size = _status("VmSize")
    resource.setrlimit(resource.RLIMIT_AS, (size + MORE_MEMORY,) * 2)
    resource.setrlimit(resource.RLIMIT_CPU, (CPU_SECONDS, CPU_SECONDS + 5))
    resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 30,) * 2)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _megabytes_now() -> float:
    return _status("VmRSS") / 2**20


def _status(field: str) -> int:
    """A size in bytes that the system tells of this process."""
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return next(int(line.split()[1]) << 10 for line in lines if line.startswith(f"{field}:"))
