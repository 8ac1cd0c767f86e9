"""Little address space, as after ``ulimit -v``: one thread then, and a floor.

The libraries in C that mixseq works with, and the stacks and arenas of their threads, take address space by the hundred
megabytes before any work begins. Where they do not get it they crash, abort or never end, none of which Python can
catch. So they are not even loaded below a floor, and start no threads of their own where there is a limit.
"""

from __future__ import annotations

import os

from mixseq.errors import SettingsError

FLOOR = 2000 << 20
"""Bytes: small files take up to 1.8 GB with one thread, measured, of which libraries use a sixth."""

_THREADS = ("MIXSEQ_THREADS", "OPENBLAS_NUM_THREADS", "RAYON_NUM_THREADS")

_SIGNS = ("can't start new thread", "failed to map segment", "Cannot allocate memory", "libllvmlite")
"""What errors say that are for want of memory, whatever they are called."""


def make_do() -> None:
    """Ask libraries that are not loaded yet for one thread, if the address space is limited."""
    limit = _limit()
    if limit is None:
        return
    if limit < FLOOR:
        raise SettingsError(
            f"the address space is limited to {limit >> 20} MiB (ulimit -v), and the libraries that mixseq works with "
            f"need {FLOOR >> 20} MiB before they begin; raise the limit"
        )
    for name in _THREADS:
        os.environ.setdefault(name, "1")


def is_short_of_memory(error: Exception) -> bool:
    """Whether an error of another kind is for want of memory, where that is limited."""
    return _limit() is not None and any(sign in str(error) for sign in _SIGNS)


def _limit() -> int | None:
    try:
        import resource
    except ImportError:  # Windows
        return None
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    return None if limit == resource.RLIM_INFINITY else limit
