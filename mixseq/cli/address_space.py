"""Limited address space, as after ``ulimit -v``: one thread, and a minimum.

C libraries, with the stacks and arenas of their threads, take address space by the hundred megabytes before any work
begins. Without it they crash, abort or hang, none of which Python can catch. So they are not loaded below a minimum,
and start no threads under a limit.
"""

from __future__ import annotations

import os

from mixseq.errors import SettingsError

FLOOR = 2000 << 20
"""Smallest address space in bytes: small files take up to 1.8 GB on one thread (measured), libraries a sixth of it."""

_THREADS = ("MIXSEQ_THREADS", "OPENBLAS_NUM_THREADS", "RAYON_NUM_THREADS")

_SIGNS = ("can't start new thread", "failed to map segment", "Cannot allocate memory", "libllvmlite")
"""Parts of error messages that signal a lack of memory."""


def make_do() -> None:
    """Set libraries that are not loaded yet to one thread, if the address space is limited."""
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
    """Return whether an error of another kind is due to limited memory."""
    return _limit() is not None and any(sign in str(error) for sign in _SIGNS)


def _limit() -> int | None:
    try:
        import resource
    except ImportError:  # Windows
        return None
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    return None if limit == resource.RLIM_INFINITY else limit
