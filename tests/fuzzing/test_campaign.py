"""A fixed set of damaged files of every reader, each read in a process of its own; and classes of cases."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from scripts.fuzzing.campaign import MAX_MEGABYTES, Found, Kind, classify, compare
from scripts.fuzzing.sandbox import Ended

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform != "linux", reason="limits of processes are Linux's"),
]

ROOT = Path(__file__).parents[2]
LIMITS = {"MIXSEQ_READER_MEMORY": "1", "MIXSEQ_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


def run_code(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    path = os.pathsep.join([str(ROOT), str(ROOT / "io")])
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=folder,
        env=os.environ | LIMITS | {"PYTHONPATH": path},
        capture_output=True,
        text=True,
    )


READERS = ("h5", "usdc", "abc", "npz", "pc2", "obj", "stl", "markers", "retiming")
"""One of a kind, whose samples are made quickly."""


def test_damaged_files_are_refused_or_sound(tmp_path: Path) -> None:
    chosen = [word for reader in READERS for word in ("--reader", reader)]
    done = run_code(tmp_path, "-m", "scripts.fuzzing.campaign", "--seed", "7", "--cases", "9", *chosen)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "| all | 9 |" in done.stdout


def test_a_case_can_be_repeated(tmp_path: Path) -> None:
    twice = "from scripts.fuzzing.campaign import main\nfor _ in range(2): main(['--case', '7:contacts:3'])"
    told = run_code(tmp_path, "-c", twice).stdout.splitlines()
    once, again = (line for line in told if "contacts.json" in line)
    assert ": contacts.json damage_" in once
    assert once == again
    assert (tmp_path / "out/fuzz/work/contacts.json").exists()


WELL = Ended(0, False, "wrote out.npz\n", 10)
REFUSED = replace(WELL, code=2, text="mixseq: error: walk.npz is damaged\n")


@pytest.mark.parametrize(
    ("ended", "found", "kind"),
    [
        (WELL, "same", "same"),
        (WELL, "differs", "sound"),
        (WELL, "invalid", "silent change"),
        (WELL, "nothing", "silent change"),
        (REFUSED, "nothing", "refused"),
        (replace(REFUSED, text="Killed\n"), "nothing", "traceback"),
        (replace(WELL, code=1), "same", "traceback"),
        (replace(REFUSED, text="Traceback (most recent call last):\n"), "nothing", "traceback"),
        (replace(WELL, code=-11), "nothing", "signal"),
        (replace(WELL, code=-9, is_hung=True), "nothing", "hang"),
        (replace(REFUSED, megabytes=MAX_MEGABYTES + 1), "nothing", "memory"),
        (replace(REFUSED, text=REFUSED.text + "\x1b[2J"), "nothing", "escape"),
    ],
)
def test_classes(ended: Ended, found: Found, kind: Kind) -> None:
    assert classify(ended, found, noticed=False) == kind


def test_damage_under_a_checksum_must_be_noticed() -> None:
    assert classify(WELL, "differs", noticed=True) == "silent change"
    assert classify(WELL, "same", noticed=True) == "same"


def test_what_was_found_is_compared(tmp_path: Path) -> None:
    expected, out = tmp_path / "expected", tmp_path / "out.npz"
    points = np.ones((1, 3, 3))
    with expected.open("wb") as file:
        np.savez(file, points=points)
    assert compare(out, expected) == "nothing"
    for other, found in ((points, "same"), (points * 2, "differs"), (points * np.nan, "invalid")):
        np.savez(out, points=other)
        assert compare(out, expected) == found
