"""Damaged files of all readers: an error of mixseq or sound values, and nothing else (docs/security.md).

Cases follow from the seed. Every defect is printed at once with the command that repeats it, and at the end a table of
what became of all. The last damaged file stays in out/fuzz/work, and what was printed in out/fuzz/log.
"""

from __future__ import annotations

import argparse
import os
import random
import re
import shutil
import signal
import sys
import warnings
import zipfile
from collections import Counter
from collections.abc import Sequence
from contextlib import closing
from itertools import product
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from scripts.fuzzing.damage import NOT_POSSIBLE, Damage, damage_bytes
from scripts.fuzzing.readers import CHECKED, OUT, READERS
from scripts.fuzzing.sandbox import Ended, Sandbox

FOLDER = Path("out/fuzz").absolute()
WORK, LOG = FOLDER / "work", FOLDER / "log"
MAX_MEGABYTES = 2048
TRIES = 20
"""Damages that are tried until one changes the file."""

Kind = Literal["same", "sound", "refused", "traceback", "signal", "hang", "memory", "silent change", "escape"]
KINDS: tuple[Kind, ...] = get_args(Kind)
GOOD: tuple[Kind, ...] = ("same", "sound", "refused")

Found = Literal["same", "differs", "invalid", "nothing"]

_ERROR = re.compile(r"^mixseq: error: \S", re.MULTILINE)
_CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="scripts/fuzz", description="Damage files of every reader.")
    parser.add_argument("--cases", type=int, default=20, help="how many of each reader")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--reader", action="append", choices=READERS, help="only this one; may be given again")
    parser.add_argument("--case", metavar="SEED:READER:INDEX", help="the case that is to be repeated")
    options = parser.parse_args(arguments)
    readers = [options.case.split(":")[1]] if options.case else options.reader or list(READERS)
    cases = [f"{options.seed}:{reader}:{index}" for index, reader in product(range(options.cases), readers)]
    counts: Counter[tuple[str, str]] = Counter()
    FOLDER.mkdir(parents=True, exist_ok=True)
    with closing(Sandbox(_serve, LOG)) as sandbox:
        for reader in readers:
            prepare(reader, sandbox)
        for case in [options.case] if options.case else cases:
            kind, damage, text = run(case, sandbox)
            _, reader, _ = case.split(":")
            _, way, *_ = damage.split()
            counts.update([(reader, kind), (way, kind)])
            if kind not in GOOD or options.case:
                print(f"{kind}: scripts/fuzz --case {case}\n    {damage}\n    {text.strip()[-200:]!a}", flush=True)
    print(table(counts))
    return int(any(kind not in GOOD for _, kind in counts))


def prepare(reader: str, sandbox: Sandbox) -> None:
    """Make and use the samples of a reader that are not there yet; keep what is found in them, to compare with."""
    for number, sample in enumerate(READERS[reader].samples):
        folder = _folder(reader, number)
        if not folder.with_suffix(".found").exists():
            shutil.rmtree(folder, ignore_errors=True)
            ended = sandbox.run(f"make:{reader}:{number}")
            if ended.code:
                raise RuntimeError(f"{sample.argument} of {reader} cannot be made or read:\n{ended.text}")
            (WORK / OUT).rename(folder.with_suffix(".found"))


def run(name: str, sandbox: Sandbox) -> tuple[Kind, str, str]:
    """Make a case, ``SEED:READER:INDEX``, and use it; return its class, the damage, and what was printed."""
    _, reader_name, _ = name.split(":")
    reader, rng = READERS[reader_name], random.Random(name)
    number = rng.randrange(len(reader.samples))
    folder = _folder(reader_name, number)
    _copy(folder)
    file = rng.choice(sorted(file for file in WORK.glob(reader.samples[number].damaged) if file.is_file()))
    damage = damage_file(file, reader.damages, rng)
    ended = sandbox.run(f"use:{reader_name}:{number}")
    found = compare(WORK / OUT, folder.with_suffix(".found")) if ended.code == 0 else "nothing"
    noticed = reader_name in CHECKED and f" {damage_bytes.__name__} " in damage
    return classify(ended, found, noticed), damage, ended.text


def damage_file(file: Path, damages: Sequence[Damage], rng: random.Random) -> str:
    """Damage a file in WORK; return its name, the way, and what was changed."""
    name, sound = file.relative_to(WORK), file.read_bytes()
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        for _ in range(TRIES):
            damage = rng.choice(damages)
            try:
                label, damaged = damage(rng, sound)
            except NOT_POSSIBLE:
                continue
            if damaged != sound:
                file.write_bytes(damaged)
                return f"{name} {damage.__name__} {ascii(label)[:400]}"
    return f"{name} none"


def _serve(name: str) -> int:
    """Use the damaged files in WORK, ``use:READER:NUMBER``, or make a sample and use it, ``make:READER:NUMBER``."""
    step, reader, number = name.split(":")
    sample, folder = READERS[reader].samples[int(number)], _folder(reader, int(number))
    if step == "make":
        file = folder / sample.argument
        file.parent.mkdir(parents=True)
        sample.make(file)
        _copy(folder)
    os.chdir(WORK)
    return READERS[reader].use(Path(sample.argument))


def _folder(reader: str, number: int) -> Path:
    return FOLDER / "samples" / f"{reader}-{number}"


def _copy(folder: Path) -> None:
    """Copy the files of a sample to WORK, which stays, as the folder of processes that read files."""
    WORK.mkdir(exist_ok=True)
    for old in WORK.iterdir():
        shutil.rmtree(old) if old.is_dir() else old.unlink()
    shutil.copytree(folder, WORK, dirs_exist_ok=True)


def classify(ended: Ended, found: Found, noticed: bool) -> Kind:
    """Return the class of a case, given what it found, and whether any change must be noticed."""
    if ended.code == -signal.SIGPROF:
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
    try:
        ours, theirs = _arrays(out), _arrays(expected)
    except (ValueError, OSError, zipfile.BadZipFile):
        return "invalid"
    points = ours.get("points")
    if points is not None and not (points.size and np.isfinite(points).all()):
        return "invalid"
    same = ours.keys() == theirs.keys() and all(
        ours[name].dtype == theirs[name].dtype and np.array_equal(ours[name], theirs[name]) for name in ours
    )
    return "same" if same else "differs"


def _arrays(file: Path) -> dict[str, NDArray[Any]]:
    """Return what a use wrote: arrays by name, but where a sequence is from, as that is another folder every time."""
    if not zipfile.is_zipfile(file):
        return {"text": np.array(file.read_bytes())}
    with np.load(file) as archive:
        return {name: archive[name] for name in archive.files if "origin" not in name}


def table(counts: Counter[tuple[str, str]]) -> str:
    """Return a row for every reader and every way of damage, a column for every class."""
    ways = sorted({title for title, _ in counts if title not in READERS})
    lines = [f"| reader, way | cases | {' | '.join(KINDS)} |", "|---" + "|---:" * (len(KINDS) + 1) + "|"]
    for title, members in [*((each, [each]) for each in (*READERS, *ways)), ("all", ways)]:
        row = [sum(counts[each, kind] for each in members) for kind in KINDS]
        if any(row):
            lines.append(f"| {title} | {sum(row)} | {' | '.join(map(str, row))} |")
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
