"""What fitting and decoding of one animation cost, in a process of its own: prints JSON.

Usage: python -m scripts.benchmarks.common.cost NAME [subdivided]
"""

from __future__ import annotations

import json
import sys
from typing import Any

import numpy as np

import mixseq
from scripts.benchmarks.common.animations import animation, header_of, subdivided
from scripts.benchmarks.common.timing import repeated

RANK = 20


def main() -> int:
    name, *more = sys.argv[1:]
    sequence = animation(name)
    if more:
        points, faces = subdivided(sequence)
        header = header_of(faces, points.shape[1], len(points))
        sequence = mixseq.MeshSequence.from_header(header, points)
    print(json.dumps(cost(sequence)))
    return 0


def cost(sequence: mixseq.MeshSequence) -> dict[str, Any]:
    """Return sizes, and seconds per frame of fitting and of decoding."""
    mixseq.fit(small(sequence), rank=2).sample()  # compiles, or loads what was compiled
    fitting, model = repeated(lambda: mixseq.fit(sequence, rank=RANK), 3, 15.0)
    decoding, _ = repeated(lambda: list(model.blocks(model.times)), 5, 15.0, warm=True)
    free = [int(joint.free.sum()) for joint in model.decomposition.joints]
    return {
        "vertices": sequence.vertex_count,
        "frames": len(sequence),
        "parts": len(model.decomposition.parts),
        "free": sum(free),
        "largest": max(free, default=0),
        "encode": [seconds / len(sequence) for seconds in fitting.runs],
        "decode": [seconds / len(sequence) for seconds in decoding.runs],
    }


def small(sequence: mixseq.MeshSequence) -> mixseq.MeshSequence:
    """Return the first frames: something quick that runs the same code."""
    frames = np.arange(min(3, len(sequence)))
    return mixseq.MeshSequence.from_header(sequence.header.with_times(frames / 24), sequence.points[frames])


if __name__ == "__main__":
    sys.exit(main())
