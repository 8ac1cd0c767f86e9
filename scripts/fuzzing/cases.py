"""A case: a copy of a sample is damaged, used in a process of its own, and what became of it is told."""

from __future__ import annotations

import os
import random
import shutil
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import cast

from scripts.fuzzing.canary import MARK, Canary
from scripts.fuzzing.case import Case, Damage, NotMadeError
from scripts.fuzzing.corpus import make
from scripts.fuzzing.damage.of_bytes import damage_bytes
from scripts.fuzzing.damage.of_h5 import damage_h5
from scripts.fuzzing.damage.of_usd import damage_usd
from scripts.fuzzing.readers import READERS, Reader, Sample
from scripts.fuzzing.sandbox import forked
from scripts.fuzzing.uses import OUT
from scripts.fuzzing.verdict import Found, Kind, classify, compare, tells

_TRIES = 20
_WITH_LIBRARIES = (damage_h5, damage_usd)
"""Damages that are done in a process of their own, as libraries in C++ write the files."""

_EXPECTED = "expected"


@dataclass(frozen=True)
class Name:
    """What repeats a case."""

    seed: int
    reader: str
    index: int

    def __str__(self) -> str:
        return f"{self.seed}:{self.reader}:{self.index}"

    @classmethod
    def of(cls, text: str) -> Name:
        """Read ``SEED:READER:INDEX``."""
        seed, reader, index = text.split(":")
        return cls(int(seed), reader, int(index))


@dataclass(frozen=True)
class Outcome:
    """What became of a case: class, sample, damage, exit code, seconds, megabytes, and the end of what was printed."""

    case: str
    kind: Kind
    sample: str
    damage: str
    code: int
    seconds: float
    megabytes: float
    text: str

    @property
    def reader(self) -> str:
        """Whose case it is."""
        return self.case.split(":")[1]


def prepare(readers: Iterable[str], corpus: Path, room: Path) -> None:
    """Make the samples of some readers, and find what is in them, to compare with.

    Raises
    ------
    RuntimeError
        If one cannot be made or read.
    """
    (corpus / _EXPECTED).mkdir(parents=True, exist_ok=True)
    room.mkdir(parents=True, exist_ok=True)
    every = [(READERS[name], sample) for name in readers for sample in READERS[name].samples]
    made = forked(lambda: make(corpus, {sample.folder: None for _, sample in every}), room / "log", 600)
    if made.code:
        raise RuntimeError(f"samples cannot be made:\n{made.text}")
    for reader, sample in every:
        if not _expected(corpus, sample).exists():
            work = _copy(corpus, sample, room)
            ended = forked(lambda: _use(reader, sample, work, None), room / "log")  # noqa: B023
            if ended.code:
                raise RuntimeError(f"{sample} cannot be read:\n{ended.text}")
            (work / OUT).rename(_expected(corpus, sample))


def run(name: Name, corpus: Path, room: Path, canary: Canary) -> Outcome:
    """Make a case and use it. The damaged file stays in ``room/work`` until the next one."""
    reader = READERS[name.reader]
    rng = random.Random(str(name))
    sample = rng.choice(reader.samples)
    work = _copy(corpus, sample, room)
    file = rng.choice(sorted(file for file in work.glob(sample.damaged) if file.is_file()))
    others = [corpus / each.folder / file.name for each in reader.samples if each.folder != sample.folder]
    sound = file.read_bytes()
    damages, often = zip(*reader.damages, strict=True)
    done = ""
    for number in range(_TRIES):
        damage = rng.choices(damages, often)[0]
        own = random.Random(f"{name}:{number}")
        case = Case(own, file, [each for each in others if each.is_file()], canary.paths)
        if done := _damaged(damage, case, room):
            break
        file.write_bytes(sound)
    canary.opened()
    ended = forked(lambda: _use(reader, sample, work, _expected(corpus, sample)), room / "log")
    verdict = room / "verdict"
    found = cast(Found, verdict.read_text()) if verdict.exists() else "nothing"
    opened = [] if reader.follows else canary.opened()
    noticed = reader.checksums and done.startswith(damage_bytes.__name__)
    kind = classify(ended, found, opened, tells(ended, work), noticed)
    return Outcome(
        *(str(name), kind, sample.folder, f"{file.relative_to(work)}: {done}"[:400], ended.code),
        *(round(ended.seconds, 2), round(ended.megabytes), ended.text[-2000:]),
    )


def _damaged(damage: Damage, case: Case, room: Path) -> str:
    """Damage a file, and return how; nothing if it cannot be done, or changes nothing."""
    sound = case.file.read_bytes()

    def done() -> str:
        with suppress(NotMadeError):
            label = damage(case)
            data = case.file.read_bytes()
            if data != sound and MARK.encode() not in data:  # one may read what another one linked to
                return f"{damage.__name__}: {label}".encode("unicode_escape").decode("ascii")
        return ""

    if damage not in _WITH_LIBRARIES:
        return done()

    def tell() -> int:
        print(done())
        return 0

    ended = forked(tell, room / "log")
    return ended.text.strip() if ended.code == 0 else ""


def _copy(corpus: Path, sample: Sample, room: Path) -> Path:
    work = room / "work"
    shutil.rmtree(work, ignore_errors=True)
    (room / "verdict").unlink(missing_ok=True)
    shutil.copytree(corpus / sample.folder, work)
    return work


def _use(reader: Reader, sample: Sample, work: Path, expected: Path | None) -> int:
    os.chdir(work)
    code = reader.use(Path(sample.argument))
    if code == 0 and expected is not None:
        (work.parent / "verdict").write_text(compare(work, expected))
    return code


def _expected(corpus: Path, sample: Sample) -> Path:
    return corpus / _EXPECTED / f"{sample.folder}-{sample.argument.replace('/', '-')}"
