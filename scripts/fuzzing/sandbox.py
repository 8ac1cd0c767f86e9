"""Run cases in a forked process, with limits of memory, processor time and wall-clock time.

If a case ends the process or runs out of time, the next case gets another process. The process leads a group, which is
killed as a whole.
"""

from __future__ import annotations

import os
import re
import resource
import signal
import sys
import traceback
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.context import ForkProcess
from pathlib import Path

CPU_SECONDS = 60
WALL_SECONDS = 240
MAX_ADDED_BYTES = 4 << 30
"""Address space beyond that of the parent process."""

MAX_CASES = 1000
"""Cases per process, so that no state piles up."""


@dataclass(frozen=True)
class Ended:
    """Exit code, negative for a signal (SIGPROF when time is over), printed text, and growth of memory."""

    code: int
    text: str
    megabytes: float


class Sandbox:
    """Process that calls a function with the name of each case and returns its exit code; `log` has what it prints."""

    def __init__(self, function: Callable[[str], int], log: Path) -> None:
        self._function = function
        self._log = log
        self._process: ForkProcess | None = None
        self._case_count = 0

    def run(self, case: str) -> Ended:
        """Run a case."""
        if self._case_count % MAX_CASES == 0:
            self.close()
        self._case_count += 1
        process = self._process or self._start()
        assert process.ident, "it was started"
        self._pipe.send(case)
        if not self._pipe.poll(WALL_SECONDS):
            os.kill(process.ident, signal.SIGPROF)
        try:
            code, megabytes = self._pipe.recv()
        except EOFError:
            code, megabytes = self.close(), 0.0
        return Ended(code, self._log.read_text(encoding="utf-8", errors="surrogateescape"), megabytes)

    def close(self) -> int:
        """Kill the process with all that it started, and return its exit code."""
        process, self._process = self._process, None
        if process is None or process.ident is None:
            return 0
        with suppress(ProcessLookupError):
            os.killpg(process.ident, signal.SIGKILL)
        process.join()
        return process.exitcode or 0

    def _start(self) -> ForkProcess:
        context = get_context("fork")
        self._pipe, end = context.Pipe()
        self._process = context.Process(target=self._serve, args=(end,))
        self._process.start()
        end.close()
        return self._process

    def _serve(self, pipe: Connection) -> None:
        self._pipe.close()
        os.setsid()
        _, most = resource.getrlimit(resource.RLIMIT_AS)  # Node.js reserves more than it uses, and raises the limit
        resource.setrlimit(resource.RLIMIT_AS, (_kilobytes("self", "VmSize") * 1024 + MAX_ADDED_BYTES, most))
        resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 30,) * 2)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        sys.stdout = sys.stderr = log = self._log.open("a", buffering=1, encoding="utf-8", errors="surrogateescape")
        for number in (1, 2):
            os.dup2(log.fileno(), number)
        with suppress(EOFError):  # the parent has ended
            while True:
                case = pipe.recv()
                log.truncate(0)
                pipe.send(self._measure(case))

    def _measure(self, case: str) -> tuple[int, float]:
        """Run a case within its processor time; return its exit code, and by how many megabytes memory grew."""
        for process in ("self", *_children()):
            with suppress(OSError):  # a process that has just ended
                Path(f"/proc/{process}/clear_refs").write_text("5")  # peaks start again
        before = _kilobytes("self", "VmRSS")
        signal.setitimer(signal.ITIMER_PROF, CPU_SECONDS)  # nothing handles its signal
        try:
            code = self._function(case)
        except BaseException:
            traceback.print_exc()
            code = 70
        signal.setitimer(signal.ITIMER_PROF, 0)
        sys.stdout.flush()
        grown = [_kilobytes("self", "VmHWM") - before, *(_kilobytes(child, "VmHWM") for child in _children())]
        return code, max(grown) / 1024


def _children() -> list[str]:
    return Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()


def _kilobytes(process: str, field: str) -> int:
    """Return a size from the status of a process; 0 if it has ended."""
    with suppress(OSError):
        status = Path(f"/proc/{process}/status").read_text()
        if size := re.search(rf"^{field}:\s*(\d+)", status, re.MULTILINE):
            return int(size[1])
    return 0
