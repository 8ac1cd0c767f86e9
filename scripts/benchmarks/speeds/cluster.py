"""Decoding on a local cluster of two workers, one of which is killed half-way: the same file comes out."""

from __future__ import annotations

import hashlib
import os
import signal
import subprocess
import tempfile
import time
from pathlib import Path

import mixseq
from scripts.benchmarks.common.animations import animation
from scripts.benchmarks.common.child import MIXSEQ, ChildError, run
from scripts.benchmarks.common.section import Say, Section, Table, at_least

NAME = "elephant_gallop"
FPS = 240
"""Ten times the frames of the sequence."""

CLUSTER = ("--cluster", "local:2")


def measure(say: Say) -> Section:
    """Decode alone, on the cluster, and on the cluster with a worker killed half-way."""
    with tempfile.TemporaryDirectory() as folder:
        say(f"{NAME}: fit")
        model = Path(folder, "model.h5")
        mixseq.save(model, mixseq.fit(animation(NAME), rank=20))
        command = (*MIXSEQ, "decode", model, Path(folder, "again.npz"), "--fps", FPS, "--quiet")
        say("decode without a cluster")
        alone = run(*command).seconds
        wanted = _take(folder)
        say("decode on two workers")
        calm = run(*command, *CLUSTER).seconds
        undisturbed = _take(folder)
        say(f"decode on two workers, one is killed after {calm / 2:.0f} s")
        disturbed, killed = _disturbed([str(word) for word in (*command, *CLUSTER)], calm / 2)
        survived = _take(folder)
    rows = [
        ("no cluster", f"{alone:.1f}", wanted[:16]),
        ("2 workers", f"{calm:.1f}", undisturbed[:16]),
        (f"2 workers, one killed after {killed:.1f} s", f"{disturbed:.1f}", survived[:16]),
    ]
    return Section(
        "Cluster",
        [
            Table(
                f"`mixseq decode --fps {FPS} --cluster local:2` of {NAME}.",
                ("decoded by", "s", "sha256"),
                rows,
            )
        ],
        [
            at_least("2 workers: equal file (1 = yes)", float(undisturbed == wanted), 1),
            at_least("one worker killed: equal file (1 = yes)", float(survived == wanted), 1),
        ],
        figures=[{"seconds": [alone, calm, disturbed], "sha256": [wanted, undisturbed, survived]}],
    )


def _take(folder: str) -> str:
    """Return the hash of the decoded file, and remove it."""
    file = Path(folder, "again.npz")
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    file.unlink()
    return digest


def _disturbed(command: list[str], after: float) -> tuple[float, float]:
    """Run a command, kill one of its workers after so many seconds; how long it took, and when it happened."""
    start = time.perf_counter()
    with (
        tempfile.TemporaryFile("w+") as output,
        subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT) as process,
    ):
        time.sleep(after)
        while not (workers := _workers(process.pid)) and process.poll() is None:
            time.sleep(0.1)
        if process.poll() is not None:
            raise ChildError("the command ended before a worker could be killed")
        os.kill(workers[0], signal.SIGKILL)
        killed = time.perf_counter() - start
        code = process.wait()
        seconds = time.perf_counter() - start
        if code:
            output.seek(0)
            raise ChildError(f"with a worker killed the command ended with {code}: {output.read()[-500:]}")
    return seconds, killed


def _workers(process: int) -> list[int]:
    """Processes that a process has spawned to work for it, busiest first."""
    import psutil  # type: ignore[import-untyped]

    spawned = [
        child
        for child in psutil.Process(process).children(recursive=True)
        if any("spawn_main" in word for word in child.cmdline())
    ]
    return [child.pid for child in sorted(spawned, key=lambda child: -sum(child.cpu_times()[:2]))]
