"""Commands that are ended at random moments: files there are old or new, and whole, and nothing stays behind.

Usage: scripts/fuzz kills [--count N] [--seed S] [--command C ...]

Every command writes over outputs of an earlier run. It gets SIGKILL, SIGTERM or SIGINT; then every file in its folder
must be what it was before or what the command makes of it, the exit code must be 137, 143 or 130 (the viewer ends by
Ctrl-C with 0), no process of it may go on, and there is no traceback. Temporary files may be left by SIGKILL only, and
the next run takes them away.
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
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import mixseq
from mixseq.creature import walk_cycle

ROOT = Path(__file__).parents[2]
OUT = ROOT / "out" / "kills"
MIXSEQ = str(Path(sys.executable).with_name("mixseq"))
PATIENCE = 60.0
"""Seconds until a command must have ended that got a signal."""

SIGNALS = {signal.SIGKILL: (-9,), signal.SIGTERM: (143, -15), signal.SIGINT: (130, -2)}
"""Exit codes; a process that has no handlers yet dies of the signal itself, which shells tell as the same number."""

COMMANDS: dict[str, tuple[str, ...]] = {
    "encode": ("encode", "{in}/walk.npz", "out.h5", "-q"),
    "compress": ("encode", "{in}/walk.npz", "out.h5", "--max-error", "1e-3", "-q"),
    "decode to npz": ("decode", "{in}/model.h5", "out.npz", "--fps", "240", "-q"),
    "decode to usdc": ("decode", "{in}/model.h5", "out.usdc", "--fps", "240", "--flatten", "-q"),
    "decode to clips": (
        "decode",
        "{in}/model.h5",
        "out.usdc",
        "--fps",
        "96",
        "--flatten",
        "--clips",
        "8",
        "-q",
    ),
    "decode to abc": ("decode", "{in}/model.h5", "out.abc", "--fps", "240", "-q"),
    "decode to glb": ("decode", "{in}/model.h5", "out.glb", "--flatten", "-q"),
    "decode to obj": ("decode", "{in}/model.h5", "out_####.obj", "-q"),
    "decode to pc2": ("decode", "{in}/model.h5", "out.pc2", "--fps", "240", "-q"),
    "resample": ("resample", "{in}/walk.npz", "out.npz", "--fps", "120", "-q"),
    "convert from usd": ("convert", "{in}/walk.usdc", "out.h5", "-q"),
    "convert to usdz": ("convert", "{in}/walk.npz", "out.usdz", "-q"),
    "batch": ("batch", "{in}/walk.npz", "{in}/short.npz", "--out", "models", "--overwrite", "-q"),
    "view": ("{in}/model.h5", "out.h5"),
}


@dataclass(frozen=True)
class Prepared:
    """A command, contents of the files that it writes over and of those that it makes, and how long it takes."""

    name: str
    words: tuple[str, ...]
    old: dict[str, bytes]
    new: dict[str, bytes]
    seconds: float


def main(arguments: Sequence[str] | None = None) -> int:
    options = _options(arguments)
    # In the background of a shell Ctrl-C is ignored, by us and by what we start.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    inputs = _inputs()
    rng = random.Random(options.seed)
    prepared = [_prepare(name, inputs) for name in options.command or COMMANDS]
    counts: Counter[tuple[str, str]] = Counter()
    with suppress(KeyboardInterrupt):  # which ends it with what there is
        for number in range(options.count):
            each = prepared[number % len(prepared)]
            sent = list(SIGNALS)[number // len(prepared) % len(SIGNALS)]
            moment = rng.uniform(0, each.seconds)
            wrong = _killed(each, sent, moment)
            counts[each.name, "well" if not wrong else "wrong"] += 1
            for what in wrong:
                print(f"{each.name}, {sent.name} after {moment:.2f} s: {what}", flush=True)
    print("| command | kills | wrong |\n|---|---:|---:|")
    for name in [*(each.name for each in prepared), "all"]:
        well, wrong_ones = (
            sum(count for (which, how), count in counts.items() if how == kind and name in (which, "all"))
            for kind in ("well", "wrong")
        )
        print(f"| {name} | {well + wrong_ones} | {wrong_ones} |")
    return int(any(how == "wrong" for _, how in counts))


def _inputs() -> Path:
    folder = OUT / "in"
    if not folder.is_dir():
        making = OUT / "making"
        shutil.rmtree(making, ignore_errors=True)
        making.mkdir(parents=True)
        walk = walk_cycle(10)
        mixseq.write(making / "walk.npz", walk)
        mixseq.write(making / "short.npz", walk_cycle(4))
        mixseq.write(making / "walk.usdc", walk, flatten=True)
        mixseq.save(making / "model.h5", mixseq.fit(walk))
        making.rename(folder)
    return folder


def _prepare(name: str, inputs: Path) -> Prepared:
    """Run a command for what it makes."""
    program = (sys.executable, "-m", "scripts.fuzzing.saving") if name == "view" else (MIXSEQ,)
    words = (*program, *(word.replace("{in}", str(inputs)) for word in COMMANDS[name]))
    work = _empty(OUT / "work")
    start = time.monotonic()
    _run(words, name, work)
    seconds = time.monotonic() - start
    new = _contents(work)
    # What was there before is told apart by what follows it.
    old = {file: data if _is_read(file) else data + b"\0older" for file, data in new.items()}
    return Prepared(name, words, old, new, seconds)


def _run(words: Sequence[str], name: str, work: Path) -> None:
    """Run a command to its end; the viewer until it has saved."""
    if name != "view":
        subprocess.run(words, cwd=work, check=True, env=_environment(), stdout=subprocess.DEVNULL)
        return
    out = work / "out.h5"
    before = out.stat().st_mtime_ns if out.exists() else 0
    running = subprocess.Popen(words, cwd=work, env=_environment(), stdout=subprocess.DEVNULL)
    try:
        end = time.monotonic() + PATIENCE
        while (not out.exists() or out.stat().st_mtime_ns == before) and time.monotonic() < end:
            time.sleep(0.1)
        running.send_signal(signal.SIGINT)
        running.wait(PATIENCE)
    finally:
        running.kill()


def _killed(each: Prepared, sent: signal.Signals, moment: float) -> list[str]:
    """Run a command, end it, and return what is wrong then."""
    work = _empty(OUT / "work")
    for file, data in each.old.items():
        (work / file).parent.mkdir(exist_ok=True)
        (work / file).write_bytes(data)
    log = OUT / "log"
    with log.open("w") as printed:
        running = subprocess.Popen(
            each.words, cwd=work, env=_environment(), stdout=printed, stderr=printed, start_new_session=True
        )
        with suppress(subprocess.TimeoutExpired):
            running.wait(moment)
        # Ctrl-C is for all processes of a terminal
        with suppress(ProcessLookupError):
            (os.killpg if sent == signal.SIGINT else os.kill)(running.pid, sent)
        try:
            code = running.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            os.killpg(running.pid, signal.SIGKILL)
            running.wait()
            return ["it does not end"]
    wrong = []
    allowed = (*SIGNALS[sent], 0) if sent != signal.SIGKILL else (-9, 0)
    if code not in allowed:
        wrong.append(f"exit code {code}: {log.read_text()[-300:]}")
    if "Traceback" in log.read_text():
        wrong.append(f"a traceback: {log.read_text()[-300:]}")
    if not _gone(running.pid):
        wrong.append("a process of it goes on")
        with suppress(ProcessLookupError):
            os.killpg(running.pid, signal.SIGKILL)
    found = _contents(work)
    wrong += [f"{file} is neither old nor new" for file in found if not _sound(each, file, found[file])]
    wrong += [f"{file} is gone" for file in each.old if file not in found]
    if sent == signal.SIGKILL and _left(each, work):
        _run(each.words, each.name, work)
    return wrong + [f"{file} was left" for file in _left(each, work)]


def _sound(each: Prepared, file: str, data: bytes) -> bool:
    """Whether a file is old or new; of a file that is never the same, whether it can be read."""
    if file not in each.old:
        return True  # told as left over
    return data in (each.old[file], each.new[file]) or _is_read(file) or _readable(file)


def _is_read(file: str) -> bool:
    """Whether a command reads a file that it also writes: reports of batches, and the mesh of a point cache."""
    return Path(file).suffix in (".md", ".json") or file == "out.obj"


def _readable(file: str) -> bool:
    return (
        subprocess.run(
            [MIXSEQ, "info", file], cwd=OUT / "work", env=_environment(), capture_output=True
        ).returncode
        == 0
    )


def _left(each: Prepared, work: Path) -> list[str]:
    temporary = [f"TMPDIR/{file.name}" for file in (OUT / "tmp").iterdir()]
    every = [
        str(file.relative_to(work))
        for file in work.rglob("*")
        if not file.is_dir() or file.name.startswith(".")
    ]
    return sorted(set(every) - each.old.keys()) + temporary


def _gone(group: int) -> bool:
    """Whether all processes of a group end soon."""
    for _ in range(50):
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.1)
    return False


def _contents(folder: Path) -> dict[str, bytes]:
    return {
        str(file.relative_to(folder)): file.read_bytes()
        for file in sorted(folder.rglob("*"))
        if file.is_file()
    }


def _empty(folder: Path) -> Path:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    shutil.rmtree(OUT / "tmp", ignore_errors=True)
    (OUT / "tmp").mkdir()
    return folder


def _environment() -> dict[str, str]:
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    return {**os.environ, "TMPDIR": str(OUT / "tmp"), "MIXSEQ_THREADS": "2", "PYTHONPATH": path}


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="scripts/fuzz kills", description="End commands at random moments.")
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--command", action="append", choices=COMMANDS, help="only this one; may be given again"
    )
    return parser.parse_args(arguments)


if __name__ == "__main__":
    sys.exit(main())
