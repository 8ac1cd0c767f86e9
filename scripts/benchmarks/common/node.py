"""Node.js: the one that comes with playwright, or that of the machine."""

from __future__ import annotations

import shutil
from pathlib import Path


def node_executable() -> str | None:
    """Return the path of Node.js, if there is one."""
    try:
        from playwright._impl._driver import compute_driver_executable
    except ImportError:
        return shutil.which("node")
    executable = compute_driver_executable()
    found = executable[0] if isinstance(executable, tuple) else executable
    return found if Path(found).exists() else shutil.which("node")
