"""Rate and distortion: bits per vertex and frame, without connectivity, of `mixseq.compress` and of its peers.

Everything is encoded for real and decoded again; errors are those of the decoded points. NAME is an animation of
$MIXSEQ_DATA/npz; `NAME xN` repeats it N times with variation. Leaves out/compress.json and out/compress.md. Ends with 1
if a target is missed or a coder failed.

Usage: scripts/bench compress [NAME ...] [--only CODER,CODER] [--plots FOLDER] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
import time
import traceback
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Any

import mixseq
from mixseq.creature import walk_cycle
from scripts.benchmarks.common.animations import animation
from scripts.benchmarks.common.rate_report import Measured, sequence_section, summary
from scripts.benchmarks.common.rates import Point, errors
from scripts.benchmarks.common.report import origin
from scripts.benchmarks.common.timing import repeated
from scripts.benchmarks.peers.bones import Bones
from scripts.benchmarks.peers.caches import Cache
from scripts.benchmarks.peers.coder import Coder
from scripts.benchmarks.peers.differences import Differences
from scripts.benchmarks.peers.draco import Draco
from scripts.benchmarks.peers.ours import Ours
from scripts.benchmarks.peers.pca import Pca

NAMES = (
    "horse_gallop",
    "elephant_gallop",
    "q_man_run",
    "q_wolf_gallop",
    "cat_poses",
    "fox_survey",
    "robotexpressive_dance",
    "q_horse_eating",
    "abc_dembones_bone",
    "horse_gallop x10",
    "q_wolf_gallop x10",
)

CODERS: tuple[Coder, ...] = (
    Ours(),
    Pca("trajectory"),
    Pca("shape"),
    Draco(),
    Differences(),
    Bones(),
    Cache("usd", "USD as it is, all bytes", "cache.usdc"),
    Cache("alembic", "Alembic as it is, all bytes", "cache.abc", ("alembic3d",)),
)

RUNS, BUDGET = 3, 1.0
"""How often a setting is run for its seconds, and after how many seconds not once more."""


def main() -> int:
    options = _options()
    coders = _installed([coder for coder in CODERS if coder.name in options.only])
    if not os.environ.get("MIXSEQ_DATA"):
        print("no animations: set MIXSEQ_DATA to the folder that holds npz/", file=sys.stderr)
        return 2
    coders, failures = _warmed(coders)
    titles = {coder.name: coder.title for coder in coders}
    found: list[Measured] = []
    sections: list[str] = []
    for name in _names(options.names):
        measured, failed = measure(name, coders)
        failures += failed
        found.append(measured)
        sections.append(sequence_section(measured, titles).markdown())
        print(f"\n{sections[-1]}\n", flush=True)
        _save(options.json, found, failures)
    short = summary(found)
    if short.tables:
        sections.append(short.markdown())
        print(f"\n{sections[-1]}\n")
    options.json.with_suffix(".md").write_text("\n\n".join(sections) + "\n")
    if options.plots:
        from scripts.benchmarks.common.curves import draw_curves

        draw_curves(found, titles, options.plots)
    print("\n".join(failures))
    return 1 if failures or not all(target.met for target in short.targets) else 0


def measure(name: str, coders: Iterable[Coder]) -> tuple[Measured, list[str]]:
    """Run all coders on a sequence; those that fail are named, with the reason."""
    sequence = animation(name)
    points: dict[str, list[Point]] = {}
    failures = []
    for coder in coders:
        start = time.perf_counter()
        try:
            points[coder.name] = operating_points(coder, sequence)
        except Exception as error:
            traceback.print_exc()
            failures.append(f"{coder.name} failed on {name}: {type(error).__name__}: {error}")
        print(f"{name}, {coder.name}: {time.perf_counter() - start:.1f} s", file=sys.stderr, flush=True)
    return Measured(name, sequence.vertex_count, len(sequence), points), failures


def operating_points(coder: Coder, sequence: mixseq.MeshSequence) -> list[Point]:
    """Encode and decode with every setting of a coder."""
    return [operating_point(coder, sequence, setting) for setting in coder.settings(sequence)]


def operating_point(coder: Coder, sequence: mixseq.MeshSequence, setting: Any) -> Point:
    """Encode, decode, and compare."""
    encoding, data = repeated(lambda: coder.encode(sequence, setting), RUNS, BUDGET)
    # A decoder is given the faces alone: what it works out from them is part of its seconds.
    decoding, decoded = repeated(lambda: coder.decode(_mesh(sequence), data), RUNS, BUDGET)
    kg, largest = errors(sequence.points, decoded, sequence.diagonal)
    signals = coder.signals(_mesh(sequence), data)
    text = " ".join(map(str, setting)) if isinstance(setting, tuple) else str(setting)
    bits = 8 * signals / (sequence.vertex_count * len(sequence))
    return Point(text, signals, len(data), bits, kg, largest, encoding.runs, decoding.runs)


def _mesh(sequence: mixseq.MeshSequence) -> mixseq.Topology:
    return mixseq.Topology(sequence.faces, sequence.vertex_count)


def _names(words: Sequence[str]) -> list[str]:
    """Join `NAME xN`, whether that was one word or two."""
    return re.sub(r"\s+(?!x\d+\b)", "\n", " ".join(words)).split("\n")


def _installed(coders: Iterable[Coder]) -> list[Coder]:
    ready = []
    for coder in coders:
        missing = [package for package in coder.packages if not _there(package)]
        if missing:
            print(f"{coder.name} is left out: pip install {' '.join(missing)}", file=sys.stderr)
        else:
            ready.append(coder)
    return ready


def _there(package: str) -> bool:
    try:
        distribution(package)
    except PackageNotFoundError:
        return False
    return True


def _warmed(coders: Iterable[Coder]) -> tuple[list[Coder], list[str]]:
    """Run each coder on something small, which compiles and imports; one that cannot even do that is left out."""
    walk = walk_cycle(frames=6)
    walk = walk.with_points(walk.points.astype("float32"))
    ready, failures = [], []
    for coder in coders:
        try:
            setting = next(iter(coder.settings(walk)))
            coder.decode(_mesh(walk), coder.encode(walk, setting))
            ready.append(coder)
        except Exception as error:
            failures.append(f"{coder.name} is left out: {type(error).__name__}: {error}")
            print(failures[-1], file=sys.stderr)
    return ready, failures


def _save(path: Path, found: Sequence[Measured], failures: Sequence[str]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    sequences = [
        {
            **each._asdict(),
            "points": {name: [asdict(point) for point in points] for name, points in each.points.items()},
        }
        for each in found
    ]
    path.write_text(json.dumps({**origin(), "failures": list(failures), "sequences": sequences}, indent=1))


def _options() -> argparse.Namespace:
    known = tuple(coder.name for coder in CODERS)

    def only(text: str) -> tuple[str, ...]:
        names = tuple(text.split(","))
        if not set(names) <= set(known):
            raise argparse.ArgumentTypeError(f"{text}: coders are {', '.join(known)}")
        return names

    parser = argparse.ArgumentParser(prog="scripts/bench compress", description=__doc__)
    parser.add_argument("names", nargs="*", default=NAMES, metavar="NAME")
    parser.add_argument("--only", type=only, default=known, metavar="CODER,CODER", help=f"of {', '.join(known)}")
    parser.add_argument("--plots", type=Path, metavar="FOLDER", help="draw the curves into two pictures")
    parser.add_argument("--json", type=Path, metavar="FILE", default=Path("out", "compress.json"))
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
