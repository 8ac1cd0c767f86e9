"""What the figures were measured on."""

from __future__ import annotations

import os
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

PACKAGES = ("mixseq", "numpy", "scipy", "numba", "rslab", "distributed")


def machine() -> dict[str, str]:
    """Return the processor, memory, system, and the versions of what does the work."""
    return {
        "processor": _processor(),
        "cores": str(len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()),
        "memory": f"{os.sysconf('SC_PAGE_SIZE') * os.sysconf('SC_PHYS_PAGES') / 1e9:.0f} GB",
        "system": platform.platform(),
        "Python": platform.python_version(),
        **{name: _version(name) for name in PACKAGES},
        "BLAS": _blas(),
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def _blas() -> str:
    import numpy as np
    import scipy.linalg  # brings its own
    from threadpoolctl import threadpool_info

    del np, scipy
    libraries: list[dict[str, Any]] = threadpool_info()
    found = {
        f"{library['internal_api']} {library['version']} ({library.get('architecture', '?')})"
        for library in libraries
        if library["user_api"] == "blas"
    }
    return ", ".join(sorted(found)) or "unknown"
