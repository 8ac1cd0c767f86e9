"""Long, dense sequences on the command line: memory, time against frames, cost of a vertex against their number."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from scripts.benchmarks.common.child import MIXSEQ, Child, run, run_module
from scripts.benchmarks.common.section import Line, Say, Section, Table, at_most
from scripts.benchmarks.common.timing import Timing

NAME = "elephant_gallop"
FRAMES = (30, 60, 120, 240)
ENCODE = ("--rank", "20", "--quiet")
MEMORY = 2500.0
BENT = 0.1
"""Times are linear in frames if none is further than this from the line through them."""

SIZES = (
    ("q_wolf_gallop",),
    ("q_man_run",),
    ("horse_gallop",),
    ("elephant_gallop",),
    ("elephant_gallop", "subdivided"),
)
STEPS = ("encode", "decode")


def measure(say: Say) -> Section:
    """Measure both; everything large happens in processes of their own."""
    section = Section("Scale")
    _frames(section, say)
    _vertices(section, say)
    return section


def _frames(section: Section, say: Say) -> None:
    """Encode and decode sequences of growing length."""
    columns = ("frames", "file MB", "encode s", "MB", "model MB", "decode s", "MB", "decoded MB")
    rows: list[tuple[str, ...]] = []
    section.tables.append(
        Table(
            f"{NAME}, subdivided once and repeated; `mixseq encode {' '.join(ENCODE[:2])}` from HDF5, `mixseq decode` "
            "to USD. MB after the seconds: peak of resident memory.",
            columns,
            rows,
        )
    )
    found: dict[str, list[Child]] = {step: [] for step in STEPS}
    for frames in FRAMES:
        with tempfile.TemporaryDirectory() as folder:
            source, model, target = (Path(folder, name) for name in ("long.h5", "model.h5", "again.usdc"))
            say(f"{frames} frames: write the sequence")
            run_module("common.looped", NAME, frames, source)
            say(f"{frames} frames: encode")
            found["encode"].append(run(*MIXSEQ, "encode", source, model, *ENCODE))
            say(f"{frames} frames: decode")
            found["decode"].append(run(*MIXSEQ, "decode", model, target, "--quiet"))
            sizes = [file.stat().st_size / 1e6 for file in (source, model, target)]
        encoded, decoded = (found[step][-1] for step in STEPS)
        rows.append(
            (
                str(frames),
                f"{sizes[0]:.0f}",
                f"{encoded.seconds:.1f}",
                f"{encoded.megabytes:.0f}",
                f"{sizes[1]:.0f}",
                f"{decoded.seconds:.1f}",
                f"{decoded.megabytes:.0f}",
                f"{sizes[2]:.0f}",
            )
        )
    for step in STEPS:
        seconds = [child.seconds for child in found[step]]
        slope, start, bent = line(FRAMES, seconds)
        peak = max(child.megabytes for child in found[step])
        section.notes.append(f"{step}: {start:.1f} s + {1e3 * slope:.0f} ms per frame.")
        section.targets.extend(
            [
                at_most(f"{step}, {FRAMES[-1]} frames: peak of memory", peak, MEMORY, " MB"),
                at_most(f"{step}: largest deviation from linear growth", 100 * bent, 100 * BENT, " %"),
            ]
        )
        megabytes = [child.megabytes for child in found[step]]
        section.figures.append({"step": step, "frames": FRAMES, "seconds": seconds, "megabytes": megabytes})


def line(x: tuple[int, ...], y: list[float]) -> tuple[float, float, float]:
    """Return slope and start of the straight line through points, and how far, relatively, they are from it."""
    # Weighted by 1 / y, so that short sequences count as much as long ones.
    slope, start = np.polyfit(x, y, 1, w=1.0 / np.asarray(y))
    bent = np.abs((slope * np.asarray(x) + start) / y - 1.0).max()
    return float(slope), float(start), float(bent)


def _vertices(section: Section, say: Say) -> None:
    """Fit and decode animations of growing meshes."""
    columns = (
        "sequence",
        "V",
        "parts",
        "free vertices",
        "largest joint",
        "encode us per vertex and frame",
        "decode us per vertex and frame",
        "decode us per free vertex and frame",
        "exponent, encode",
        "exponent, decode",
    )
    rows: list[tuple[str, ...]] = []
    section.tables.append(Table("Cost per vertex, rank 20, anchored, all threads.", columns, rows))
    points: dict[str, list[tuple[float, float]]] = {step: [] for step in STEPS}
    for words in SIZES:
        say(f"{' '.join(words)}: cost of a vertex")
        found: dict[str, Any] = json.loads(run_module("common.cost", *words).output.strip().splitlines()[-1])
        seconds = {step: Timing(tuple(found[step])) for step in STEPS}
        for step in STEPS:
            points[step].append((found["vertices"], 1e6 * seconds[step].median / found["vertices"]))
        free = max(found["free"], 1)
        rows.append(
            (
                " ".join(words),
                str(found["vertices"]),
                str(found["parts"]),
                f"{found['free']} ({100 * found['free'] / found['vertices']:.0f} %)",
                str(found["largest"]),
                *(seconds[step].text(1e6 / found["vertices"]) for step in STEPS),
                f"{1e6 * seconds['decode'].median / free:.3g}",
                *(_exponent(points[step]) for step in STEPS),
            )
        )
        section.figures.append({"sequence": " ".join(words), **found})
    section.lines.extend(Line(step, points[step]) for step in STEPS)
    section.notes.append(
        "The exponent is the growth of the total cost from the previous mesh in the table: 1 is linear in the number "
        "of vertices. It is below 1 if constant costs per frame (calls, poses) dominate, and above 1 if sparse "
        "factorisations dominate, which grow as n^1.5, or if meshes exceed the processor's cache."
    )


def _exponent(points: list[tuple[float, float]]) -> str:
    """How the total cost has grown since the point before, as a power of the number of vertices."""
    if len(points) < 2:
        return ""
    (v, each), (more, each_of_more) = points[-2:]
    return f"{np.log(more * each_of_more / (v * each)) / np.log(more / v):.2f}"
