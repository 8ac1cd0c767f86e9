"""Commands that are ended at random moments: files there are old or new, and whole, and nothing stays behind.

Every command writes over outputs of an earlier run. It gets SIGKILL, SIGTERM or SIGINT; then every file in its folder
must be what it was before or what the command makes of it, the exit code must be 137, 143 or 130, no process of it may
go on, and there is no traceback. Temporary files may be left by SIGKILL only, and the next run takes them away.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import mixseq
from mixseq.creature import walk_cycle

OUT = Path("out/kills").absolute()
IN, WORK, TEMPORARY, LOG = (OUT / name for name in ("in", "work", "tmp", "log"))
MIXSEQ = str(Path(sys.executable).with_name("mixseq"))
ENVIRONMENT = {**os.environ, "TMPDIR": str(TEMPORARY), "MIXSEQ_THREADS": "2"}

MAX_SECONDS = 60.0
"""Time until a command must have ended that got a signal."""

SIGNALS = {signal.SIGKILL: (-9,), signal.SIGTERM: (143, -15), signal.SIGINT: (130, -2)}
"""Exit codes; a process that has no handlers yet dies of the signal itself, which shells tell as the same number."""

COMMANDS = (
    "encode {in}/walk.npz out.h5",
    "encode {in}/walk.npz out.h5 --max-error 1e-3",
    "decode {in}/model.h5 out.npz --fps 240",
    "decode {in}/model.h5 out.usdc --fps 240 --flatten",
    "decode {in}/model.h5 out.usdc --fps 96 --flatten --set clips=8",
    "decode {in}/model.h5 out.abc --fps 240",
    "decode {in}/model.h5 out.glb --flatten",
    "decode {in}/model.h5 out_####.obj",
    "decode {in}/model.h5 out.pc2 --fps 240",
    "convert {in}/walk.usdc out.h5",
    "convert {in}/walk.npz out.usdz",
    "batch encode {in}/walk.npz {in}/short.npz --out models --overwrite",
)


@dataclass(frozen=True)
class Prepared:
    """A command, contents of the files that it writes over and of those that it makes, and how long it takes."""

    words: list[str]
    old: dict[str, bytes]
    new: dict[str, bytes]
    seconds: float


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="scripts/fuzz kills", description="End commands at random moments.")
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    # In the background of a shell Ctrl-C is ignored, by us and by what we start.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    _make_inputs()
    rng = random.Random(options.seed)
    prepared = [_prepare(command) for command in COMMANDS[: options.count]]
    wrong = 0
    for number in range(options.count):
        command = prepared[number % len(prepared)]
        sent = list(SIGNALS)[number // len(prepared) % len(SIGNALS)]
        moment = rng.uniform(0, command.seconds)
        defects = _kill(command, sent, moment)
        wrong += bool(defects)
        for defect in defects:
            print(f"{' '.join(command.words[1:])}, {sent.name} after {moment:.2f} s: {defect}", flush=True)
    print(f"{options.count} kills of {len(prepared)} commands, {wrong} wrong")
    return int(wrong > 0)


def _make_inputs() -> None:
    if not (IN / "model.h5").exists():
        IN.mkdir(parents=True, exist_ok=True)
        walk = walk_cycle(10)
        mixseq.write(IN / "walk.npz", walk)
        mixseq.write(IN / "short.npz", walk_cycle(4))
        mixseq.write(IN / "walk.usdc", walk, flatten=True)
        mixseq.save(IN / "model.h5", mixseq.fit(walk))


def _prepare(command: str) -> Prepared:
    """Run a command for what it makes."""
    words = [MIXSEQ, *command.replace("{in}", str(IN)).split(), "-q"]
    _empty_folders()
    start = time.monotonic()
    _run(words).check_returncode()
    seconds = time.monotonic() - start
    new = _contents()
    # What was there before is told apart by what follows it.
    old = {file: data if _is_read(file) else data + b"\0older" for file, data in new.items()}
    return Prepared(words, old, new, seconds)


def _run(words: Sequence[str]) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run(words, cwd=WORK, env=ENVIRONMENT, capture_output=True)


def _kill(command: Prepared, sent: signal.Signals, moment: float) -> list[str]:
    """Run a command, end it, and return what is wrong then."""
    _empty_folders()
    for file, data in command.old.items():
        (WORK / file).parent.mkdir(exist_ok=True)
        (WORK / file).write_bytes(data)
    with LOG.open("w") as log:
        running = subprocess.Popen(
            command.words, cwd=WORK, env=ENVIRONMENT, stdout=log, stderr=log, start_new_session=True
        )
    with suppress(subprocess.TimeoutExpired):
        running.wait(moment)
    with suppress(ProcessLookupError):  # Ctrl-C is for all processes of a terminal
        (os.killpg if sent == signal.SIGINT else os.kill)(running.pid, sent)
    with suppress(subprocess.TimeoutExpired):
        running.wait(MAX_SECONDS)
    code, text, wrong = running.returncode, LOG.read_text(), []
    if code not in (*SIGNALS[sent], 0) or "Traceback" in text:
        wrong.append(f"exit code {code}: {text[-300:]}")
    if not _is_gone(running.pid):
        wrong.append("a process of it goes on")
        with suppress(ProcessLookupError):
            os.killpg(running.pid, signal.SIGKILL)
        running.wait()
    found = _contents()
    wrong += [f"{file} is gone" for file in command.old if file not in found]
    for file in sorted(found.keys() & command.old.keys()):
        is_whole = _is_read(file) or found[file] in (command.old[file], command.new[file])
        if not is_whole and _run([MIXSEQ, "info", file]).returncode:
            wrong.append(f"{file} is neither old nor new")
    if sent == signal.SIGKILL and _left(command):
        _run(command.words).check_returncode()
    return wrong + [f"{file} was left" for file in _left(command)]


def _is_read(file: str) -> bool:
    """Whether a command reads a file that it also writes: reports of batches, and the mesh of a point cache."""
    return Path(file).suffix in (".md", ".json") or file == "out.obj"


def _left(command: Prepared) -> list[str]:
    every = {str(file.relative_to(WORK)) for file in WORK.rglob("*") if not file.is_dir() or file.name[0] == "."}
    return sorted(every - command.old.keys()) + [f"TMPDIR/{file.name}" for file in TEMPORARY.iterdir()]


def _is_gone(group: int) -> bool:
    """Whether all processes of a group end within five seconds."""
    for _ in range(50):
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.1)
    return False


def _contents() -> dict[str, bytes]:
    return {str(file.relative_to(WORK)): file.read_bytes() for file in WORK.rglob("*") if file.is_file()}


def _empty_folders() -> None:
    for folder in (WORK, TEMPORARY):
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)


if __name__ == "__main__":
    sys.exit(main())
