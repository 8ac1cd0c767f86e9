"""A very long sequence and a very large one on the command line: processor time and memory of every step."""

from __future__ import annotations

import tempfile
from pathlib import Path

from scripts.benchmarks.common.child import MIXSEQ, Child, run, run_module
from scripts.benchmarks.common.section import Say, Section, Table, at_most

SOURCES = {"long": "100 vertices, 10,000 frames", "large": "1,000,000 vertices, 3 frames"}

STEPS = {
    "long": {
        "encode": ("encode", "{source}", "model.h5"),
        "encode --exact": ("encode", "{source}", "model.h5", "--exact"),
    },
    "large": {
        "encode": ("encode", "{source}", "model.h5"),
        "encode --max-error 0.001": ("encode", "{source}", "small.h5", "--max-error", "0.001"),
        "verify": ("verify", "small.h5", "{source}"),
        "convert to GLB": ("convert", "{source}", "large.glb"),
    },
}
"""What is run; a step may need a file of the one before."""

BEFORE = {
    ("long", "encode"): (258.0, 4250.0),
    ("large", "encode"): (69.0, 3130.0),
    ("large", "encode --max-error 0.001"): (313.0, 3960.0),
    ("large", "verify"): (70.0, 1890.0),
    ("large", "convert to GLB"): (19.6, 1350.0),
}
"""CPU seconds and MB before anything was done about them (issue 21, 2026-11-22)."""

SHARE = 1 / 3
"""So much of that they may take now."""


def measure(say: Say) -> Section:
    """Run all steps, each in a process of its own."""
    section = Section("Extremes")
    columns = ("sequence", "step", "CPU s", "MB", "before: CPU s", "MB")
    rows: list[tuple[str, ...]] = []
    section.tables.append(
        Table("CPU seconds of all threads and processes; MB: peak of resident memory.", columns, rows)
    )
    for name, what in SOURCES.items():
        with tempfile.TemporaryDirectory() as folder:
            source = Path(folder, f"{name}.npz")
            say(f"{name}: write the sequence")
            run_module("common.extreme", name, source)
            for step, words in STEPS[name].items():
                say(f"{name}: {step}")
                paths = [word.format(source=source) for word in words]
                found = run(*MIXSEQ, *(Path(folder, p) if p.endswith((".h5", ".glb")) else p for p in paths))
                before = BEFORE.get((name, step))
                rows.append((what, step, *_texts(found.cpu, found.megabytes), *_texts(*before or ())))
                section.figures.append({"sequence": name, "step": step, **_figures(found)})
                if before is not None:
                    cpu, megabytes = (round(SHARE * each, 1) for each in before)
                    section.targets.append(at_most(f"{name}, {step}: CPU", found.cpu, cpu, " s"))
                    section.targets.append(at_most(f"{name}, {step}: memory", found.megabytes, megabytes, " MB"))
    return section


def _texts(*values: float) -> tuple[str, ...]:
    return tuple(f"{value:.3g}" if value < 1000 else f"{value:.0f}" for value in values) or ("", "")


def _figures(child: Child) -> dict[str, float]:
    return {"seconds": child.seconds, "cpu": child.cpu, "megabytes": child.megabytes}
