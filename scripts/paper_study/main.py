"""Regenerate the paper's tables and figures on our data.

Usage: scripts/paper --out FOLDER [NAME ...] [--mesh MESH ...], all of them without names, on all meshes without meshes.
What else is in the folder stays as it is. --pages writes the pages again from what was measured before.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
import traceback
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Protocol, cast

from mixseq.runtime.parallel import one_blas_thread
from scripts.benchmarks.common.harness import markdown_table
from scripts.paper_study.common.poses import ALL, Poses
from scripts.paper_study.common.record import Json, Results, Say, load, origins, save, stamped

STAGES = {
    "table-1": "times of MSGI, DSO and MixIT",
    "table-2": "dimensions of S_e and S_m",
    "table-3": "joint width 3, 5, 9",
    "table-4": "numbers of parts",
    "figure-1": "what becomes of legs in four shape spaces",
    "figure-9": "six poses",
    "figures-10-12": "errors over the weight",
    "baselines": "methods of others",
    "figure-14": "a segmentation with too few parts",
    "figure-15": "segmentation methods",
    "figure-16": "vertex noise, local self-intersections",
    "figure-17": "two far poses of the cat",
    "local-minima": "random starts",
    "figure-18": "LRI and S_m in the three-signal representation",
}
"""All tables and figures, modules of stages/, and what each shows."""


class Stage(Protocol):
    """A module of stages/."""

    MESHES: tuple[str, ...]
    measure: Callable[[Poses, Path, Say], Json]  # measure one mesh; pictures go to the folder
    page: Callable[[Results], list[str]]  # the blocks of the page in Markdown
    verdict: Callable[[Results], list[str]]  # what it shows, in sentences for the index


def main() -> int:
    parser = argparse.ArgumentParser(prog="scripts/paper", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(STAGES))
    parser.add_argument("--out", type=Path, required=True, help="folder of pages, pictures and results")
    parser.add_argument("--mesh", action="append", choices=ALL, default=[])
    parser.add_argument("--pages", action="store_true", help="only write the pages again")
    given = parser.parse_args()
    unknown = [name for name in given.names if name not in STAGES]
    if unknown:
        parser.error(f"there is no {unknown[0]}; there are {', '.join(STAGES)}")
    if not (given.pages or os.environ.get("MIXSEQ_DATA")):
        parser.error("set MIXSEQ_DATA to the folder with the animations")
    failures = 0
    for name in given.names or STAGES:
        meshes = () if given.pages else (given.mesh or stage(name).MESHES)
        failures += sum(not measured(given.out, name, mesh) for mesh in meshes if mesh in stage(name).MESHES)
        write(given.out, name)
    write_index(given.out)
    say(f"see {given.out / 'index.md'}" + (f"; {failures} measurements failed" if failures else ""))
    return 1 if failures else 0


def stage(name: str) -> Stage:
    """Return the module of a table or figure."""
    module = import_module(f"scripts.paper_study.stages.{name.replace('-', '_')}")
    return cast(Stage, module)


def measured(out: Path, name: str, mesh: str) -> bool:
    """Measure a table or figure on a mesh and keep the result; return whether that went well."""
    say(f"{name}, {mesh} ...")
    out.mkdir(parents=True, exist_ok=True)
    start = time.perf_counter()
    try:
        with one_blas_thread():  # or last digits of blends would depend on the number of threads
            result = stage(name).measure(Poses.of(mesh), out, lambda text: say(f"{name}, {mesh}: {text}"))
    except Exception:
        traceback.print_exc()
        say(f"{name}, {mesh} FAILED; what was there before stays")
        return False
    results = {**load(out, name), mesh: stamped(result, time.perf_counter() - start)}
    save(out, name, {known: results[known] for known in ALL if known in results})
    return True


def write(out: Path, name: str) -> None:
    """Write the page of a table or figure from its results."""
    results = load(out, name)
    if results:
        title = name.replace("-", " ").capitalize().replace("s 10 12", "s 10 to 12")
        blocks = [f"# {title}: {STAGES[name]}", *stage(name).page(results), *origins(results)]
        (out / f"{name}.md").write_text("\n\n".join([*blocks, "[All tables and figures](index.md)"]) + "\n")


def write_index(out: Path) -> None:
    """Write the page that leads to all others, with what they show."""
    known: Mapping[str, Results] = {name: load(out, name) for name in STAGES if load(out, name)}
    rows = [(f"[{name}]({name}.md)", STAGES[name], ", ".join(results)) for name, results in known.items()]
    intro = (Path(__file__).with_name("intro.md")).read_text().strip()
    shown = [f"- **{name}**: {text}" for name in known for text in stage(name).verdict(known[name])]
    blocks = [intro, markdown_table(("page", "shows", "measured on"), rows), "## What came out", "\n".join(shown)]
    out.mkdir(parents=True, exist_ok=True)
    (out / "index.md").write_text("\n\n".join(blocks) + "\n")


def say(text: str) -> None:
    """Print a line with the time of day."""
    print(f"{time.strftime('%H:%M:%S')} {text}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
