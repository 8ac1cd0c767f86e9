"""Damaged files of all readers, each in a process of its own: an error of ours or sound values, and nothing else.

Usage: scripts/fuzz [--minutes N] [--cases K] [--seed S] [--reader R ...]
       scripts/fuzz --case SEED:READER:INDEX

Cases follow from the seed. Every defect is printed at once with the command that repeats it, and at the end a table of
what became of all. The last damaged file stays in out/fuzz/work.
"""

from __future__ import annotations

import argparse
import gc
import os
import random
import re
import shutil
import sys
import time
import warnings
from collections import Counter
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from pkgutil import walk_packages
from typing import Any, Literal, get_args

import numpy as np

import mixseq
import mixseq_io
from mixseq.errors import MixseqWarning
from scripts.fuzzing.damage import NotDamagedError, damage_bytes
from scripts.fuzzing.readers import OUT, READERS, Reader
from scripts.fuzzing.samples import Sample
from scripts.fuzzing.sandbox import Ended, forked

FOLDER = Path("out/fuzz").absolute()
WORK, LOG, FOUND, DAMAGE = (FOLDER / name for name in ("work", "log", "found", "damage"))
MAX_MEGABYTES = 2048
TRIES = 20
"""Damages that are tried until one changes the file."""

Kind = Literal["same", "sound", "refused", "traceback", "signal", "hang", "memory", "silent change", "escape"]
"""In the file's favour: what was found is what was there before; it differs, but is valid; an error of ours and exit
code 2. Then defects: a traceback or another exit code; death by a signal; no end; too much memory; damage under a
checksum that nobody noticed, or what is no valid sequence; control characters that a terminal obeys."""

KINDS: tuple[Kind, ...] = get_args(Kind)
GOOD: tuple[Kind, ...] = ("same", "sound", "refused")

Found = Literal["same", "differs", "invalid", "nothing"]

_ERROR = re.compile(r"^mixseq: error: \S", re.MULTILINE)
_CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="scripts/fuzz", description="Damage files of every reader.")
    parser.add_argument("--minutes", type=float, default=600, help="how long at most")
    parser.add_argument("--cases", type=int, default=10**9, help="how many at most")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--reader", action="append", choices=READERS, help="only this one; may be given again")
    parser.add_argument("--case", metavar="SEED:READER:INDEX", help="the case that is to be repeated")
    options = parser.parse_args(arguments)
    _import_readers()
    gc.freeze()  # memory that nobody writes to is not copied
    if options.case:
        prepare(options.case.split(":")[1])
        kind, damage, ended = run(options.case)
        print(f"{kind}: {damage}\n{ended}")
        return int(kind not in GOOD)
    readers = options.reader or list(READERS)
    for reader in readers:
        prepare(reader)
    counts: Counter[tuple[str, Kind]] = Counter()
    end = time.monotonic() + 60 * options.minutes
    for number in range(options.cases):
        if time.monotonic() > end:
            break
        reader = readers[number % len(readers)]
        name = f"{options.seed}:{reader}:{number // len(readers)}"
        kind, damage, ended = run(name)
        counts[reader, kind] += 1
        if kind not in GOOD:
            last = ascii((ended.text.strip().splitlines() or [""])[-1][:200])
            print(f"{kind}: scripts/fuzz --case {name}\n    {damage}\n    {last}", flush=True)
    print(table(counts))
    return int(any(kind not in GOOD for _, kind in counts))


def prepare(reader: str) -> None:
    """Make the samples of a reader that are not there yet, and find what is in them, to compare with."""
    for number, sample in enumerate(READERS[reader].samples):
        folder = FOLDER / "samples" / f"{reader}-{number}"
        if folder.with_suffix(".found").exists():
            continue
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        ended = forked(lambda: _make(sample, folder), LOG)  # noqa: B023
        if ended.code == 0:
            _copy(folder)
            ended = forked(lambda: _use(READERS[reader], sample, None, None), LOG)  # noqa: B023
        if ended.code:
            raise RuntimeError(f"{sample.argument} of {reader} cannot be made or read:\n{ended.text}")
        (WORK / OUT).rename(folder.with_suffix(".found"))
        if sample.argument == "model.glb":  # loads the compiled loops, so that forked processes need not
            mixseq.load(folder / sample.argument).sample()


def run(name: str) -> tuple[Kind, str, Ended]:
    """Make a case, ``SEED:READER:INDEX``, and use it; return its class, the damage, and how the process ended."""
    reader_name = name.split(":")[1]
    reader, rng = READERS[reader_name], random.Random(name)
    number = rng.randrange(len(reader.samples))
    folder = FOLDER / "samples" / f"{reader_name}-{number}"
    _copy(folder)
    ended = forked(lambda: _use(reader, reader.samples[number], rng, folder.with_suffix(".found")), LOG)
    damage = DAMAGE.read_text() if DAMAGE.exists() else ""
    found: Any = FOUND.read_text() if FOUND.exists() else "nothing"
    noticed = reader.has_checksums and f" {damage_bytes.__name__} " in damage
    return classify(ended, found, noticed), damage, ended


def classify(ended: Ended, found: Found, noticed: bool) -> Kind:
    """Return the class of a case, given what it found, and whether any change must be noticed."""
    if ended.is_hung:
        return "hang"
    if ended.megabytes > MAX_MEGABYTES or "not enough memory" in ended.text:
        return "memory"
    if ended.code < 0:
        return "signal"
    if "Traceback" in ended.text or ended.code not in (0, 2):
        return "traceback"
    if _CONTROL.search(ended.text):
        return "escape"
    if ended.code == 2:
        return "refused" if _ERROR.search(ended.text) else "traceback"
    if found == "same":
        return "same"
    return "silent change" if noticed or found in ("invalid", "nothing") else "sound"


def compare(out: Path, expected: Path) -> Found:
    """Compare what a use found with what it found in the sound file."""
    if not out.exists():
        return "nothing"
    if out.read_bytes()[:2] != b"PK":
        return "same" if out.read_bytes() == expected.read_bytes() else "differs"
    ours, theirs = _arrays(out), _arrays(expected)
    if "points" in ours and not (ours["points"].size and np.isfinite(ours["points"]).all()):
        return "invalid"
    same = ours.keys() == theirs.keys() and all(
        ours[name].dtype == theirs[name].dtype and np.array_equal(ours[name], theirs[name]) for name in ours
    )
    return "same" if same else "differs"


def _arrays(file: Path) -> dict[str, Any]:
    with np.load(file) as archive:
        # where a sequence is from is another folder every time
        return {name: archive[name] for name in archive.files if "origin" not in name}


def _make(sample: Sample, folder: Path) -> int:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MixseqWarning)
        sample.make(folder)
    return 0


def _copy(folder: Path) -> None:
    shutil.rmtree(WORK, ignore_errors=True)
    shutil.copytree(folder, WORK)
    for file in (FOUND, DAMAGE):
        file.unlink(missing_ok=True)


def _use(reader: Reader, sample: Sample, rng: random.Random | None, expected: Path | None) -> int:
    """Damage a file of a sample, unless there is no generator, use it, and store what was found."""
    os.chdir(WORK)
    if rng is not None:
        file = rng.choice(sorted(file for file in WORK.glob(sample.damaged) if file.is_file()))
        DAMAGE.write_text(_damaged(reader, file, rng))
    code = reader.use(Path(sample.argument))
    if code == 0 and expected is not None:
        FOUND.write_text(compare(WORK / OUT, expected))
    return code


def _damaged(reader: Reader, file: Path, rng: random.Random) -> str:
    sound = file.read_bytes()
    for _ in range(TRIES):
        damage = rng.choice(reader.damages)
        try:
            label = damage(rng, file)
        except NotDamagedError:
            label = ""
        if label and file.read_bytes() != sound:
            return f"{file.relative_to(WORK)} {damage.__name__} {ascii(label)[:400]}"
        file.write_bytes(sound)
    return "nothing"


def table(counts: Counter[tuple[str, Kind]]) -> str:
    """Return a row for every reader, a column for every class."""
    readers = [reader for reader in READERS if any(reader == each for each, _ in counts)]
    lines = [f"| reader | cases | {' | '.join(KINDS)} |", "|---" + "|---:" * (len(KINDS) + 1) + "|"]
    for title, members in [*((reader, [reader]) for reader in readers), ("all", readers)]:
        row = [sum(counts[reader, kind] for reader in members) for kind in KINDS]
        lines.append(f"| {title} | {sum(row)} | {' | '.join(map(str, row))} |")
    return "\n".join(lines)


def _import_readers() -> None:
    """Import what reads files, so that forked processes need not."""
    for package in (mixseq_io, mixseq):
        for module in walk_packages(package.__path__, f"{package.__name__}."):
            if not module.name.startswith(("mixseq.pictures", "mixseq.viewer", "mixseq.blender")):
                import_module(module.name)


if __name__ == "__main__":
    sys.exit(main())
