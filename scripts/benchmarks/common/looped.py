"""Write a long, dense sequence: an animation subdivided once (unless plain) and repeated. In a process of its own.

Usage: python -m scripts.benchmarks.common.looped NAME FRAMES FILE [plain]
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import mixseq
from mixseq.types import FloatArray
from scripts.benchmarks.common.animations import animation, header_of, subdivided

BLOCK = 8


def main() -> int:
    name, frames, file, *plain = sys.argv[1:]
    sequence = animation(name)
    points, faces = (sequence.points, sequence.faces) if plain else subdivided(sequence)
    header = header_of(faces, points.shape[1], int(frames))
    mixseq.write_blocks(Path(file), header, _looped(points, int(frames)))
    return 0


def _looped(points: FloatArray, frames: int) -> Iterator[FloatArray]:
    for start in range(0, frames, BLOCK):
        numbers = range(start, min(start + BLOCK, frames))
        yield points[[number % len(points) for number in numbers]]


if __name__ == "__main__":
    sys.exit(main())
