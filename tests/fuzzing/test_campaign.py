"""A fixed set of damaged files of every reader, each read in a process of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform != "linux", reason="limits and watched files are Linux's"),
]

ROOT = Path(__file__).parents[2]
LIMITS = {"MIXSEQ_READER_MEMORY": "1", "MIXSEQ_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


def fuzz(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    path = os.pathsep.join([str(ROOT), str(ROOT / "io")])
    return subprocess.run(
        [sys.executable, "-m", "scripts.fuzzing.campaign", *arguments],
        cwd=folder,
        env=os.environ | LIMITS | {"PYTHONPATH": path},
        capture_output=True,
        text=True,
    )


READERS = (
    *("h5", "usd", "usdz", "abc", "npz", "pc2", "mdd", "obj", "ply", "stl", "off"),
    *("markers", "maps", "contacts", "retiming"),
)
"""Those whose samples are made quickly."""


def test_damaged_files_are_refused_or_sound(tmp_path: Path) -> None:
    chosen = [word for reader in READERS for word in ("--reader", reader)]
    done = fuzz(tmp_path, "--seed", "7", "--cases", "45", *chosen)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "| all | 45 |" in done.stdout


def test_a_case_can_be_repeated(tmp_path: Path) -> None:
    done = fuzz(tmp_path, "--case", "7:contacts:3")
    assert done.returncode == 0, done.stdout + done.stderr
    assert '"damage": "contacts.json: damage_' in done.stdout
    assert (tmp_path / "out/fuzz/case/work/contacts.json").exists()
