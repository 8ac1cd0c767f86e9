"""Damaged files of all readers: an error of ours or sound values, and nothing else.

Usage: scripts/fuzz [--minutes N] [--cases K] [--seed S] [--reader R ...]
       scripts/fuzz --case SEED:READER:INDEX

Cases follow from the seed. Every defect is printed at once with the command that repeats it, and at the end a table of
what became of all. The last damaged file stays in out/fuzz/work.
"""

from __future__ import annotations

import argparse
import os
import random
import re
import shutil
import sys
import time
import warnings
from collections import Counter
from collections.abc import Sequence
from contextlib import closing
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from mixseq.errors import MixseqWarning
from scripts.fuzzing.damage import NotDamagedError, damage_bytes
from scripts.fuzzing.readers import OUT, READERS, Reader
from scripts.fuzzing.samples import Sample
from scripts.fuzzing.sandbox import Ended, Sandbox

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
_WAY = re.compile(" damage_[a-z0-9]+|$")
_CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="scripts/fuzz", description="Damage files of every reader.")
    parser.add_argument("--minutes", type=float, default=600, help="how long at most")
    parser.add_argument("--cases", type=int, default=10**9, help="how many of each reader at most")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--reader", action="append", choices=READERS, help="only this one; may be given again")
    parser.add_argument("--case", metavar="SEED:READER:INDEX", help="the case that is to be repeated")
    options = parser.parse_args(arguments)
    readers = [options.case.split(":")[1]] if options.case else options.reader or list(READERS)
    FOLDER.mkdir(parents=True, exist_ok=True)
    with closing(Sandbox(_serve, LOG)) as sandbox:
        for reader in readers:
            prepare(reader, sandbox)
        if options.case:
            kind, damage, ended = run(options.case, sandbox)
            print(f"{kind}: {damage}\n{ended}")
            return int(kind not in GOOD)
        return _campaign(readers, options.seed, options.cases, 60 * options.minutes, sandbox)


def _campaign(readers: list[str], seed: int, cases: int, seconds: float, sandbox: Sandbox) -> int:
    counts: Counter[tuple[str, str]] = Counter()
    end = time.monotonic() + seconds
    for index, reader in product(range(cases), readers):
        if time.monotonic() > end:
            break
        name = f"{seed}:{reader}:{index}"
        kind, damage, ended = run(name, sandbox)
        way = _WAY.search(damage)
        assert way, "it also matches the end"
        counts.update({(reader, kind): 1, (way[0], kind): 1})
        if kind not in GOOD:
            last = ascii((ended.text.strip().splitlines() or [""])[-1][:200])
            print(f"{kind}: scripts/fuzz --case {name}\n    {damage}\n    {last}", flush=True)
    print(table(counts))
    return int(any(kind not in GOOD for _, kind in counts))


def prepare(reader: str, sandbox: Sandbox) -> None:
    """Make the samples of a reader that are not there yet, and find what is in them, to compare with."""
    for number, sample in enumerate(READERS[reader].samples):
        folder = _folder(reader, number)
        if folder.with_suffix(".found").exists():
            continue
        for step in ("make", "use"):
            ended = sandbox.run(f"{step}:{reader}:{number}")
            if ended.code:
                raise RuntimeError(f"{sample.argument} of {reader} cannot be made or read:\n{ended.text}")
        (WORK / OUT).rename(folder.with_suffix(".found"))


def run(name: str, sandbox: Sandbox) -> tuple[Kind, str, Ended]:
    """Make a case, ``SEED:READER:INDEX``, and use it; return its class, the damage, and how the process ended."""
    for file in (FOUND, DAMAGE):
        file.unlink(missing_ok=True)
    ended = sandbox.run(name)
    damage = DAMAGE.read_text() if DAMAGE.exists() else ""
    found: Any = FOUND.read_text() if FOUND.exists() else "nothing"
    noticed = READERS[name.split(":")[1]].has_checksums and f" {damage_bytes.__name__} " in damage
    return classify(ended, found, noticed), damage, ended


def _serve(name: str) -> int:
    """Run ``make:READER:NUMBER`` or ``use:READER:NUMBER`` for a sample, or a case ``SEED:READER:INDEX``."""
    step, reader_name, number = name.split(":")
    reader = READERS[reader_name]
    if step == "make":
        return _make(reader.samples[int(number)], _folder(reader_name, int(number)))
    rng = None if step == "use" else random.Random(name)
    chosen = int(number) if rng is None else rng.randrange(len(reader.samples))
    sample, folder = reader.samples[chosen], _folder(reader_name, chosen)
    WORK.mkdir(exist_ok=True)  # it stays, as the folder of processes that read files
    os.chdir(WORK)
    for old in WORK.iterdir():
        shutil.rmtree(old) if old.is_dir() else old.unlink()
    shutil.copytree(folder, WORK, dirs_exist_ok=True)
    if rng is None:
        return reader.use(Path(sample.argument))
    file = rng.choice(sorted(file for file in WORK.glob(sample.damaged) if file.is_file()))
    DAMAGE.write_text(_damaged(reader, file, rng))
    code = reader.use(Path(sample.argument))
    if code == 0:
        FOUND.write_text(compare(WORK / OUT, folder.with_suffix(".found")))
    return code


def _make(sample: Sample, folder: Path) -> int:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MixseqWarning)
        sample.make(folder)
    return 0


def _folder(reader: str, number: int) -> Path:
    return FOLDER / "samples" / f"{reader}-{number}"


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
    ours, theirs = _arrays(out), _arrays_of_sample(expected)
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


_arrays_of_sample = cache(_arrays)


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


def table(counts: Counter[tuple[str, str]]) -> str:
    """Return a row for every reader and every way of damage, a column for every class."""
    ways = sorted({title for title, _ in counts if title not in READERS})
    lines = [f"| reader, way | cases | {' | '.join(KINDS)} |", "|---" + "|---:" * (len(KINDS) + 1) + "|"]
    for title, members in [*((each, [each]) for each in (*READERS, *ways)), ("all", ways)]:
        row = [sum(counts[each, kind] for each in members) for kind in KINDS]
        if any(row):
            lines.append(f"| {title.strip() or 'none'} | {sum(row)} | {' | '.join(map(str, row))} |")
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
