"""Whether a promise is kept: a sequence is fitted or compressed, saved, loaded and decoded, and measured on its own.

Errors are measured in extended precision (where the machine has it), by none of mixseq's code.
"""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

import mixseq
from mixseq.errors import MixseqError
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.detail import EXACT_TOLERANCE
from mixseq.types import FloatArray, Index
from mixseq_io.verification import read_compressed

Way = Literal["fit", "compress", "exact"]
WAYS: tuple[Way, ...] = ("fit", "compress", "exact")

Kind = Literal["kept", "refused", "broken", "verify wrong", "traceback"]
"""Refused is a typed error."""


@dataclass(frozen=True)
class Outcome:
    """What became of a promise: the measured error in diagonals, and what an error or `verify` said."""

    way: Way
    bound: float
    kind: Kind
    error: float | None
    words: str


def attempts(points: FloatArray, faces: Index, bounds: tuple[float, ...]) -> Iterator[Outcome]:
    """Try all ways with all bounds; exact models once."""
    for way in WAYS:
        for bound in (EXACT_TOLERANCE,) if way == "exact" else bounds:
            yield Outcome(way, bound, *_attempt(points, faces, way, bound))


def _attempt(points: FloatArray, faces: Index, way: Way, bound: float) -> tuple[Kind, float | None, str]:
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("error")  # numbers that overflow are no way to keep a promise
        warnings.filterwarnings("ignore", "there are no in-betweens")
        file = Path(folder, "model.h5")
        try:
            sequence = MeshSequence.from_arrays(points, faces)
            if way == "compress":
                mixseq.save(file, mixseq.compress(sequence, max_error=bound))
            else:
                exact = way == "exact"
                mixseq.save(file, mixseq.fit(sequence, exact=exact, tolerance=None if exact else bound))
            error = distance(points, mixseq.load(file).sample().points)
            wrong = "" if way != "compress" else "; ".join(_lies(file, sequence, bound))
        except MixseqError as refusal:
            return "refused", None, str(refusal)
        except Exception as other:  # a traceback is what is looked for
            return "traceback", None, f"{type(other).__name__}: {other}"
    if not error <= bound:
        return "broken", error, ""
    return ("verify wrong" if wrong else "kept"), error, wrong


def distance(points: FloatArray, others: FloatArray) -> float:
    """Return the largest distance of a vertex, in diagonals: of the first frame, or the largest if it is a point."""
    x, y = points.astype(np.longdouble), others.astype(np.longdouble)
    diagonals = np.sqrt(np.square(x.max(axis=1) - x.min(axis=1)).sum(axis=1))
    return float(np.sqrt(np.square(x - y).sum(axis=2).max()) / (diagonals[0] or diagonals.max() or 1))


def _lies(file: Path, sequence: MeshSequence, bound: float) -> Iterator[str]:
    """Yield what `verify` says wrongly: of the file, and of others that hold less than they promise."""
    coded = read_compressed(file)

    def wrong(case: str, original: MeshSequence) -> Iterator[str]:
        promised = read_compressed(file).parameters.max_error
        error = distance(original.points, mixseq.load(file).sample().points)
        found = mixseq.verify(file, original)
        if found.holds != (error <= promised):
            yield f"{case}: verify says {found.max_error} for {promised:g}, and it is {error:g}"

    yield from wrong("the file", sequence)
    finer = replace(coded.parameters, max_error=bound / 1e3)
    coarser = replace(coded.parameters, step=1.5 * coded.parameters.step)
    for case, parameters in (("another bound", finer), ("another step", coarser)):
        mixseq.save(file, replace(coded, parameters=parameters))
        yield from wrong(case, sequence)
    mixseq.save(file, coded)
    moved = sequence.points.astype(np.float64)
    moved[-1, -1, 1] += 3 * bound * (sequence.diagonal or 1.0)
    yield from wrong("a vertex elsewhere", sequence.with_points(moved))
    data = bytearray(file.read_bytes())
    data[-len(data) // 3] ^= 4
    file.write_bytes(data)
    with suppress(MixseqError):  # as it should
        yield from wrong("damage", sequence)
