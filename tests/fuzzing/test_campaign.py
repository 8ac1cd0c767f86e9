"""A fixed set of damaged files of every reader, each read under limits; and classes of cases."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from scripts.fuzzing.campaign import MAX_MEGABYTES, Found, Kind, classify, compare
from scripts.fuzzing.sandbox import Ended, Sandbox

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform != "linux", reason="limits of processes are Linux's"),
]

ROOT = Path(__file__).parents[2]
LIMITS = {"MIXSEQ_READER_MEMORY": "1", "MIXSEQ_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


READERS = ("h5", "usdc", "abc", "npz", "pc2", "obj", "stl", "markers", "retiming")
"""One of a kind, whose samples are made quickly."""

SCRIPT = f"""
from scripts.fuzzing.campaign import main

readers = [word for reader in {READERS} for word in ("--reader", reader)]
assert main(["--seed", "7", "--cases", "1", *readers]) == 0
for _ in range(2):
    main(["--case", "7:contacts:3"])
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("campaign")


@pytest.fixture(scope="module")
def told(folder: Path) -> str:
    """What a campaign, and a case that is repeated, print."""
    path = os.pathsep.join([str(ROOT), str(ROOT / "io")])
    environment = os.environ | LIMITS | {"PYTHONPATH": path}
    done = subprocess.run([sys.executable, "-c", SCRIPT], cwd=folder, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_damaged_files_are_refused_or_sound(told: str) -> None:
    assert "| all | 9 |" in told


def test_a_case_can_be_repeated(told: str, folder: Path) -> None:
    once, again = (line for line in told.splitlines() if "contacts.json" in line)
    assert "contacts.json damage_" in once
    assert once == again
    assert (folder / "out/fuzz/work/contacts.json").exists()


WELL = Ended(0, "wrote out.npz\n", 10)
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
        (replace(WELL, code=-signal.SIGPROF), "nothing", "hang"),
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


def test_a_case_that_ends_the_process_is_told_and_the_next_ones_go_on(tmp_path: Path) -> None:
    def run(case: str) -> int:
        print(case)
        if case == "killed":
            os.kill(os.getpid(), 9)
        return 1 // 0 if case == "wrong" else {"well": 0, "refused": 2}[case]

    with closing(Sandbox(run, tmp_path / "log")) as sandbox:
        found = {case: sandbox.run(case) for case in ("well", "refused", "wrong", "killed", "well")}
    assert [ended.code for ended in found.values()] == [0, 2, 70, -9]
    assert found["well"].text == "well\n"
    assert "ZeroDivisionError" in found["wrong"].text


def test_memory_and_time_are_those_of_a_case(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def spin_or_take(case: str) -> int:
        while case == "spin":
            pass
        time.sleep(10 if case == "sleep" else 0)
        return len(np.ones((200 << 20) // 8)) * 0 if case == "take" else 0

    with closing(Sandbox(spin_or_take, tmp_path / "log")) as sandbox:
        with monkeypatch.context() as limits:
            limits.setattr("scripts.fuzzing.sandbox.CPU_SECONDS", 0.5)
            limits.setattr("scripts.fuzzing.sandbox.WALL_SECONDS", 1.5)
            assert [sandbox.run(case).code for case in ("spin", "sleep")] == [-signal.SIGPROF, -signal.SIGPROF]
        taken, rest = (sandbox.run(case).megabytes for case in ("take", "rest"))
        assert rest < 100 < 190 < taken < 300
