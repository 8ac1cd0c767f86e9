"""The command line, ``mixseq`` or ``python -m mixseq``; Ctrl-C is handled even during imports."""

from __future__ import annotations

import atexit
import gc
import os
import signal
import sys
from contextlib import suppress
from types import FrameType
from typing import NoReturn

LARGE_BLOCK_BYTES = 4 << 20
"""Size of arrays whose memory is returned at once; smaller sizes cost more time (docs/benchmarks.md)."""

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD, _M_ARENA_MAX = -1, -3, -8
_THRESHOLD_VARIABLE = "MALLOC_MMAP_THRESHOLD_"

_VARIABLES = {
    _THRESHOLD_VARIABLE: str(LARGE_BLOCK_BYTES),
    "MALLOC_ARENA_MAX": "1",  # heaps of threads are seldom returned
    # rslab has an allocator of its own, which would keep the memory of factors.
    **{"MIMALLOC_ABANDONED_PAGE_PURGE": "1", "MIMALLOC_ARENA_EAGER_COMMIT": "0"},
}


def _exit(number: int, frame: FrameType | None) -> NoReturn:
    """Exit at once, as no work has begun."""
    if number == signal.SIGINT:
        os.write(2, b"mixseq: interrupted\n")
    os._exit(128 + number)


def exit_on_signals() -> None:
    """Let Ctrl-C exit at once, until work begins."""
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) != signal.SIG_IGN:  # signals are ignored in the background of a shell
            signal.signal(number, _exit)


def return_large_blocks() -> None:
    """Let C libraries, here and in new processes, return freed blocks of `LARGE_BLOCK_BYTES` to the system at once.

    glibc would keep blocks of up to 32 MB for new arrays, so that large meshes take up to twice the memory.
    """
    if sys.platform != "linux" or _THRESHOLD_VARIABLE in os.environ:
        return
    import ctypes  # slow to import

    os.environ.update(_VARIABLES | os.environ)
    with suppress(OSError, AttributeError):  # other C libraries have no such setting
        ctypes.CDLL(None).mallopt(_M_MMAP_THRESHOLD, LARGE_BLOCK_BYTES)
        ctypes.CDLL(None).mallopt(_M_TRIM_THRESHOLD, 4 * LARGE_BLOCK_BYTES)
        ctypes.CDLL(None).mallopt(_M_ARENA_MAX, 1)


def main() -> None:
    """Run the command line."""
    exit_on_signals()
    return_large_blocks()
    atexit.register(gc.freeze)  # Python would collect everything that was imported, for 0.3 s after a fit
    from mixseq.cli import main as run

    run()


if __name__ == "__main__":
    main()
