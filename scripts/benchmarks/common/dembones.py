"""py-dem-bones on an animation, in a process of its own: prints seconds, KG error and largest error as JSON.

Usage: python -m scripts.benchmarks.common.dembones NAME BONES     (null if py-dem-bones is not installed)
"""

from __future__ import annotations

import json
import sys
from typing import Any, NamedTuple

import numpy as np

from mixseq.types import Float
from scripts.benchmarks.common.animations import animation
from scripts.benchmarks.common.timing import Timing, repeated

ITERATIONS = 30
INFLUENCES = 4


def main() -> int:
    try:
        import py_dem_bones  # noqa: F401
    except ImportError:
        print("null")
        return 0
    print(json.dumps(decompose(sys.argv[1], int(sys.argv[2]))))
    return 0


def decompose(name: str, bones: int) -> dict[str, Any]:
    """Decompose an animation, in diagonals."""
    sequence = animation(name)
    points = sequence.points.astype(np.float64)
    points = (points - points[0].mean(axis=0)) / sequence.diagonal
    found = skinning(points, sequence.faces, bones)
    away = points - skinned(points[0], found.weights, found.transforms)
    spread = points - points.mean(axis=1, keepdims=True)
    return {
        "start": found.start,
        "bones": len(found.weights),
        "seconds": found.timing.runs,
        "kg_percent": float(100 * np.linalg.norm(away) / np.linalg.norm(spread)),
        "max_error": float(np.sqrt((away**2).sum(axis=2)).max()),
    }


class Skinning(NamedTuple):
    """Weights ``(B, V)``, transforms ``(T, B, 4, 4)``, seconds of the solver, and how it started."""

    weights: Float
    transforms: Float
    timing: Timing
    start: str


def skinning(points: Float, faces: Any, bones: int, runs: int = 3) -> Skinning:
    """Fit bones to points ``(T, V, 3)``; where its own clustering stops early, from k-means labels."""
    timing, (weights, transforms) = _solve(points, faces, bones, None, runs)
    if len(weights) == bones:
        return Skinning(weights, transforms, timing, "own clustering")
    timing, (weights, transforms) = _solve(points, faces, bones, _clusters(points, bones), runs)
    return Skinning(weights, transforms, timing, "k-means")


def _solve(points: Float, faces: Any, bones: int, start: Float | None, most: int) -> tuple[Timing, tuple[Float, Float]]:
    """Weights and transforms; only the solver is timed, up to `most` times."""
    from py_dem_bones.portable import _prepare_solver, _read_skinning_result

    runs: list[float] = []
    while not runs or (len(runs) < most and sum(runs) < 30.0):
        solver = _prepare_solver(
            points[0], points, bones, faces=faces.tolist(), max_influences=INFLUENCES, iterations=ITERATIONS
        )
        if start is not None:
            solver.set_weights(start)
        timing, _ = repeated(solver.compute, 1)
        runs += timing.runs
        result = _read_skinning_result(solver)
        if len(result.weights) < bones and start is None:
            break  # it stopped early and is started again
    return Timing(tuple(runs)), (np.asarray(result.weights), np.asarray(result.transforms))


def _clusters(points: Float, bones: int) -> Float:
    """Weights of vertices by clusters of their trajectories."""
    from scipy.cluster.vq import kmeans2

    paths = points - points.mean(axis=1, keepdims=True)
    features = paths.transpose(1, 0, 2).reshape(points.shape[1], -1)
    _, labels = kmeans2(features, bones, seed=0, minit="++")
    return np.asarray(labels == np.arange(bones)[:, None], dtype=np.float64)


def skinned(rest: Float, weights: Float, transforms: Float) -> Float:
    """Linear blend skinning: the sum over bones of ``w (R x + t)``, frame by frame."""
    homogeneous = np.concatenate([rest, np.ones((len(rest), 1))], axis=1)
    frames = []
    for frame in transforms:
        blended = np.einsum("bv,bij->vij", weights, frame[:, :3])
        frames.append(np.einsum("vij,vj->vi", blended, homogeneous))
    return np.stack(frames)


if __name__ == "__main__":
    sys.exit(main())
