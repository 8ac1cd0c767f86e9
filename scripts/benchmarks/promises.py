"""The promises of fit, compress, exact and verify, on sequences that try to break them and on animations.

Usage: scripts/bench promises [NAME ...]   (by default all of scripts/benchmarks/common/adversarial.py, and the
animations of $MIXSEQ_DATA/npz)
"""

from __future__ import annotations

import json
import os
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from scripts.benchmarks.common.adversarial import SEQUENCES
from scripts.benchmarks.common.promises import KINDS, WAYS, Outcome, attempts

ADVERSARIAL = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
ANIMATIONS = (1e-3, 1e-5)
"""Fewer, because `scripts/bench tolerance` and `scripts/bench compress` have others."""

SOUND = ("kept", "refused")


def main() -> int:
    outcomes = []
    for outcome in _outcomes(sys.argv[1:]):
        outcomes.append(outcome)
        words = outcome.words or f"{outcome.error:.3g}"
        print(f"{outcome.sequence}, {outcome.way} {outcome.bound:g}: {outcome.kind}: {words}", flush=True)
    if not outcomes:
        print("no sequence has such a name", file=sys.stderr)
        return 2
    Path("out").mkdir(exist_ok=True)
    Path("out/promises.json").write_text(json.dumps([asdict(outcome) for outcome in outcomes], indent=1))
    for row in _table(outcomes):
        print("| " + " | ".join(row) + " |")
    return 0 if all(outcome.kind in SOUND for outcome in outcomes) else 1


def _outcomes(names: Sequence[str]) -> Iterator[Outcome]:
    for name, make in SEQUENCES.items():
        if not names or name in names:
            yield from attempts(name, *make(), ADVERSARIAL)
    for path in sorted(Path(os.environ.get("MIXSEQ_DATA", ""), "npz").glob("*.npz")):
        if not names or path.stem in names:
            with np.load(path) as arrays:
                yield from attempts(path.stem, arrays["points"], arrays["faces"], ANIMATIONS)


def _table(outcomes: Sequence[Outcome]) -> Iterator[tuple[str, ...]]:
    """Yield rows: of sequences and ways, how many promises became what."""
    yield "sequences", "way", "promises", *KINDS, "largest error / promise"
    yield tuple((4 + len(KINDS)) * ["---"])
    for title, own in (("adversarial", True), ("animations", False)):
        for way in WAYS:
            some = [each for each in outcomes if each.way == way and (each.sequence in SEQUENCES) == own]
            counts = Counter(each.kind for each in some)
            worst = max((each.error / each.bound for each in some if each.error is not None), default=0.0)
            if some:
                yield title, way, str(len(some)), *(str(counts[kind]) for kind in KINDS), f"{worst:.3g}"


if __name__ == "__main__":
    sys.exit(main())
