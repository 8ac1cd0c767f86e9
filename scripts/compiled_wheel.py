"""A hook of hatchling that puts compiled functions into the wheel, so that they need not be compiled at first use.

MIXSEQ_COMPILED_WHEEL names the folder to compile in, which is empty or of an earlier build of the same sources. Without
it the wheel has no compiled functions. They are those of `mixseq warm-up`, for the Python and numba that build the
wheel and processors of the level x86-64-v3. Other machines compile at first use.

Usage: MIXSEQ_COMPILED_WHEEL=$(mktemp -d) pip wheel --no-build-isolation --no-deps .
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

PACKAGES = {"mixseq": "mixseq", "io/mixseq_io": "mixseq_io"}


class CompiledWheel(BuildHookInterface[Any]):
    """Add compiled functions to the ``__pycache__`` beside their sources."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile before the wheel is built."""
        compiled = os.environ.get("MIXSEQ_COMPILED_WHEEL")
        if version == "editable" or not compiled:
            return
        from numba.core.caching import _CacheLocator

        root = Path(self.root)
        settings = {
            "NUMBA_CACHE_DIR": compiled,
            "NUMBA_CPU_NAME": "x86-64-v3",
            "NUMBA_CPU_FEATURES": "",
            "PYTHONPATH": os.pathsep.join((str(root), str(root / "io"))),
        }
        subprocess.run([sys.executable, "-m", "mixseq", "warm-up"], env=os.environ | settings, cwd=root, check=True)
        for source, package in PACKAGES.items():
            for folder in sorted({path.parent for path in (root / source).rglob("*.py")}):
                kept = _CacheLocator.get_suitable_cache_subpath(str(folder / "module.py"))  # type: ignore[no-untyped-call]
                target = Path(package, folder.relative_to(root / source), "__pycache__")
                for file in sorted(Path(compiled, kept).glob("*.nb?")):
                    build_data["force_include"][str(file)] = (target / file.name).as_posix()
