"""A hook of hatchling that puts compiled functions into the wheel, so that they need not be compiled at first use.

They are compiled where MIXSEQ_COMPILED_WHEEL is set, with the Python and numba that build the wheel, for processors of
the level x86-64-v3, by `mixseq warm-up`. Other machines compile at first use, as with a wheel without them.

Usage: MIXSEQ_COMPILED_WHEEL=1 pip wheel --no-build-isolation --no-deps .
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

PACKAGES = {"mixseq": "mixseq", "io/mixseq_io": "mixseq_io"}


class CompiledWheel(BuildHookInterface[Any]):
    """Compile in a temporary folder, and add what is in it to the ``__pycache__`` beside the sources."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile before the wheel is built."""
        if version == "editable" or not os.environ.get("MIXSEQ_COMPILED_WHEEL"):
            return
        from numba.core.caching import _CacheLocator

        root = Path(self.root)
        self._folder = TemporaryDirectory(prefix="mixseq-")
        settings = {
            "NUMBA_CACHE_DIR": self._folder.name,
            "NUMBA_CPU_NAME": "x86-64-v3",
            "NUMBA_CPU_FEATURES": "",
            "PYTHONPATH": os.pathsep.join((str(root), str(root / "io"))),
        }
        subprocess.run([sys.executable, "-m", "mixseq", "warm-up"], env=os.environ | settings, cwd=root, check=True)
        for source, package in PACKAGES.items():
            for folder in sorted({path.parent for path in (root / source).rglob("*.py")}):
                kept = _CacheLocator.get_suitable_cache_subpath(str(folder / "module.py"))  # type: ignore[no-untyped-call]
                target = Path(package, folder.relative_to(root / source), "__pycache__")
                for file in sorted(Path(self._folder.name, kept).glob("*.nb?")):
                    build_data["force_include"][str(file)] = (target / file.name).as_posix()

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove the temporary folder once the wheel is built."""
        if hasattr(self, "_folder"):
            self._folder.cleanup()
