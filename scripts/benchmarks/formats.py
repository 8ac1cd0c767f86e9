"""Writing and reading in every format: time, size, error, and memory as the sequence grows.

A waving sheet of 22 500 vertices is made frame by frame, written, and read again, each in a process of its own, with
FRAMES and with 4 FRAMES. Memory is the growth of the peak of both processes, the reader's worker included, over what
they need before the first frame.

Usage: scripts/bench formats [FRAMES]   (100 by default)
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

import mixseq
from mixseq.mesh.polygons import Polygons
from mixseq.sequence.header import SequenceHeader
from mixseq.types import FloatArray
from scripts.benchmarks.common.harness import markdown_table, run

SIDE = 150
BLOCK = 16
TARGETS: dict[str, dict[str, Any]] = {
    "walk.usdc": {"flatten": True},
    "walk.usd": {"flatten": True, "clips": 100},
    "walk.usdz": {"flatten": True},
    "walk.glb": {"flatten": True},
    **{
        name: {}
        for name in (
            "walk.abc", "walk.h5", "walk.npz", "walk.pc2", "walk.mdd", "walk_####.obj", "walk_####.ply",
            "walk_####.stl", "walk_####.off",
        )
    },
}  # fmt: skip


def main() -> int:
    arguments = sys.argv[1:]
    if len(arguments) == 4:
        step, name, folder, count = arguments
        print(json.dumps(writing(name, folder, int(count)) if step == "write" else reading(name, folder)))
        return 0
    frames = int(arguments[0]) if arguments else 100
    columns = ("file", "bytes per vertex and frame", "write ms/frame", "read ms/frame", "max error/diag")
    memory = [f"{step} MB, {count} frames" for step in ("write", "read") for count in (frames, 4 * frames)]
    print(markdown_table((*columns, *memory), []))
    for name in TARGETS:
        print(f"| {' | '.join(row(name, frames))} |", flush=True)
    return 0


def row(name: str, frames: int) -> tuple[str, ...]:
    """Write and read one format at both lengths."""
    few, many = (once(name, count) for count in (frames, 4 * frames))
    return (
        name,
        f"{many['bytes'] / (4 * frames * SIDE**2):.1f}",
        *(f"{1e3 * many[f'{step}_seconds'] / (4 * frames):.1f}" for step in ("write", "read")),
        f"{many['error']:.1e}",
        *(f"{result[f'{step}_megabytes']:.0f}" for step in ("write", "read") for result in (few, many)),
    )


def once(name: str, frames: int) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as folder:
        return child("write", name, folder, frames) | child("read", name, folder, frames)


def child(*arguments: object) -> dict[str, Any]:
    result: dict[str, Any] = json.loads(run(sys.executable, "-m", "scripts.benchmarks.formats", *arguments).output)
    return result


def writing(name: str, folder: str, frames: int) -> dict[str, Any]:
    header = sheet(frames)
    warm_up(name)
    before = peak_megabytes()
    start = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        mixseq.write_blocks(Path(folder, name), header, waves(frames), **TARGETS[name])
    return {
        "write_seconds": time.perf_counter() - start,
        "write_megabytes": peak_megabytes() - before,
        "bytes": sum(file.stat().st_size for file in Path(folder).rglob("*") if file.is_file()),
    }


def reading(name: str, folder: str) -> dict[str, Any]:
    warm_up(name)
    before = peak_megabytes()
    start = time.perf_counter()
    error, frame = 0.0, 0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with mixseq.open_sequence(Path(folder, name)) as reader:
            welded = reader.header.vertex_count != SIDE**2 or name.endswith(".stl")
            for block in reader.blocks(BLOCK):
                if not welded:
                    error = max(error, float(np.abs(block[0] - wave(frame, block.dtype)).max()))
                frame += len(block)
            seconds = time.perf_counter() - start
            # The worker still lives, so that its peak can be read.
            return {"read_seconds": seconds, "read_megabytes": peak_megabytes() - before, "error": error}


def warm_up(name: str) -> None:
    """Import what the format needs, and start the reader's worker."""
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        mixseq.write_blocks(Path(folder, name), sheet(2), waves(2), **TARGETS[name])
        with mixseq.open_sequence(Path(folder, name)) as reader:
            list(reader.blocks())


def sheet(frames: int) -> SequenceHeader:
    corner = np.arange(SIDE**2).reshape(SIDE, SIDE)[:-1, :-1].reshape(-1, 1)
    quads = corner + np.array([0, 1, SIDE + 1, SIDE])
    return SequenceHeader(
        polygons=Polygons(np.full(len(quads), 4), quads.reshape(-1)), vertex_count=SIDE**2, times=np.arange(frames) / 24
    )


def waves(frames: int) -> Iterator[FloatArray]:
    for start in range(0, frames, BLOCK):
        yield np.stack([wave(frame) for frame in range(start, min(start + BLOCK, frames))])


def wave(frame: int, dtype: Any = np.float32) -> FloatArray:
    """Return the sheet ``(V, 3)`` in a frame, about one unit large."""
    x, y = np.meshgrid(np.linspace(0, 0.7, SIDE), np.linspace(0, 0.7, SIDE))
    z = 0.1 * np.sin(9 * x + frame / 5) * np.cos(7 * y - frame / 9)
    points = np.stack([x + 0.1 * z, y, z], axis=2).reshape(-1, 3).astype(np.float32)
    return np.asarray(points.astype(dtype))


def peak_megabytes() -> float:
    """Return the largest memory that this process and its children had, without mapped files."""
    processes = [os.getpid(), *map(int, Path(f"/proc/self/task/{os.getpid()}/children").read_text().split())]
    return sum(_peak(process) for process in processes)


def _peak(process: int) -> float:
    fields = dict(
        line.split(":", 1) for line in Path(f"/proc/{process}/status").read_text().splitlines() if ":" in line
    )
    # Files that are mapped into memory come and go as the system likes.
    mapped = int(fields["RssFile"].split()[0])
    return (int(fields["VmHWM"].split()[0]) - mapped) / 1e3


if __name__ == "__main__":
    sys.exit(main())
