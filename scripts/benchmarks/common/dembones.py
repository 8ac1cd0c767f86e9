"""py-dem-bones on an animation: ``python -m scripts.benchmarks.common.dembones NAME BONES`` prints its errors as JSON.

In a process of its own, so that its libraries are in nobody's way; null if it is not installed.
"""

from __future__ import annotations

import json
import sys
from typing import Any, NamedTuple

import numpy as np

from mixseq.types import Float
from scripts.benchmarks.common.harness import animation, cpu_timed, run


class Peer(NamedTuple):
    """Number of bones, KG error in percent, largest error in diagonals, and CPU seconds of the solver's runs."""

    bones: int
    kg_percent: float
    max_error: float
    seconds: tuple[float, ...]


def fit_peer(name: str, bones: int) -> Peer | None:
    """Fit bones to an animation (30 iterations, 4 weights a vertex); None if py-dem-bones is not installed."""
    found = json.loads(
        run(sys.executable, "-m", "scripts.benchmarks.common.dembones", name, bones).output.strip().splitlines()[-1]
    )
    return None if found is None else Peer(**found)


def main() -> int:
    try:
        import py_dem_bones  # noqa: F401
    except ImportError:
        print("null")
        return 0
    name, bones = sys.argv[1], int(sys.argv[2])
    sequence = animation(name)
    points = sequence.points.astype(np.float64)
    points = (points - points[0].mean(axis=0)) / sequence.diagonal
    seconds, (weights, transforms) = _solve(points, sequence.faces, bones, None)
    if len(weights) < bones:  # where its own clustering stops early, from labels of k-means
        seconds, (weights, transforms) = _solve(points, sequence.faces, bones, _clusters(points, bones))
    away = points - _skinned(points[0], weights, transforms)
    spread = points - points.mean(axis=1, keepdims=True)
    kg = float(100 * np.linalg.norm(away) / np.linalg.norm(spread))
    largest = float(np.sqrt((away**2).sum(axis=2)).max())
    print(json.dumps(Peer(len(weights), kg, largest, seconds)._asdict()))
    return 0


def _solve(points: Float, faces: Any, bones: int, start: Float | None) -> tuple[tuple[float, ...], tuple[Float, Float]]:
    """Return seconds of the solver, of up to three runs, weights ``(B, V)`` and transforms ``(T, B, 4, 4)``."""
    from py_dem_bones.portable import _prepare_solver, _read_skinning_result

    runs: list[float] = []
    while not runs or (len(runs) < 3 and sum(runs) < 30.0):
        solver = _prepare_solver(points[0], points, bones, faces=faces.tolist(), max_influences=4, iterations=30)
        if start is not None:
            solver.set_weights(start)
        runs.append(cpu_timed(solver.compute)[0])
        result = _read_skinning_result(solver)
        if len(result.weights) < bones and start is None:
            break  # it stopped early and is started again
    return tuple(runs), (np.asarray(result.weights), np.asarray(result.transforms))


def _clusters(points: Float, bones: int) -> Float:
    """Weights of vertices by clusters of their trajectories."""
    from scipy.cluster.vq import kmeans2

    paths = points - points.mean(axis=1, keepdims=True)
    features = paths.transpose(1, 0, 2).reshape(points.shape[1], -1)
    _, labels = kmeans2(features, bones, seed=0, minit="++")
    return np.asarray(labels == np.arange(bones)[:, None], dtype=np.float64)


def _skinned(rest: Float, weights: Float, transforms: Float) -> Float:
    """Linear blend skinning: the sum over bones of ``w (R x + t)``, frame by frame."""
    homogeneous = np.concatenate([rest, np.ones((len(rest), 1))], axis=1)
    blended = (np.einsum("bv,bij->vij", weights, frame[:, :3]) for frame in transforms)
    return np.stack([np.einsum("vij,vj->vi", matrices, homogeneous) for matrices in blended])


if __name__ == "__main__":
    sys.exit(main())
