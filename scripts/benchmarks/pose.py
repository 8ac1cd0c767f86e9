"""Poses by handles: poses left out of a model, and found again from 1, 2, 4, 8 and 16 of their vertices.

Usage: scripts/bench pose [NAME[:STEP] ...]   (animations of $MIXSEQ_DATA/npz, of which every STEP-th frame is taken)

Every method starts from the frame whose handles are nearest, with the same prior and softness: `operations.pose`,
principal components of vertices, and MeshIK (Sumner and others 2005): deformation gradients of all faces, as polar
decompositions, with handles as constraints of their Poisson system. The last two know only the first frame: with the
parts that the motion has, and with as many parts by the shape of the frame.
"""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Callable, Iterator

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

import mixseq
from mixseq.errors import MixseqWarning
from mixseq.mesh.measures import edge_lengths
from mixseq.mesh.rotations import rotvec_to_matrix
from mixseq.operations import Handle, pose
from mixseq.operations.handles import DEFAULT_SOFTNESS, MIN_HANDLES_OF_FREE_BODY, DraggedPose, weight_row
from mixseq.operations.pose_solvers import MIN_DEVIATION_RATIO, PoseSolver, StillSolver
from mixseq.runtime.parallel import one_blas_thread
from mixseq.spaces.gradient import SYMMETRIC_ENTRY_IDS, GradientSpace
from mixseq.types import Float, Index
from scripts.benchmarks.common.harness import animation, print_table

NAMES = ("horse_poses", "cat_poses", "lion_poses", "camel_poses", "horse_gallop:2", "q_man_swordslash")

HANDLE_COUNTS = (1, 2, 4, 8, 16)

MAX_GRADIENT_STEPS = 12
"""Largest number of Gauss-Newton steps of MeshIK."""

GRADIENT_HANDLE_COUNTS = (8,)
"""Numbers of handles that MeshIK is measured with, as it is slow."""

MAX_POSES = 3
"""Largest number of poses of an animation that are left out, one at a time."""

COLUMNS = (
    *("sequence", "handles", "mixseq: rms / strain", "vertices", "MeshIK"),
    *("a still, parts of the motion", "a still", "poses per second", "while dragging"),
)

Solver = Callable[[Index, Float, int], Float]
"""Function of handle vertices ``(n,)``, targets ``(n, 3)`` and a frame to start from; returns points ``(V, 3)``."""


def farthest_vertices(points: Float, count: int) -> Index:
    """Return vertices far from each other: each is the farthest from those before."""
    ids = [int(np.argmax(np.linalg.norm(points - points.mean(axis=0), axis=1)))]
    while len(ids) < count:
        ids.append(int(np.linalg.norm(points[:, None] - points[ids], axis=2).min(axis=1).argmax()))
    return np.array(ids)


def principal_directions(deviations: Float) -> Float:
    """Return standard deviations ``(r, D)`` along the principal directions of deviations ``(T, D)``."""
    _, sizes, axes = np.linalg.svd(deviations / np.sqrt(len(deviations)), full_matrices=False)
    kept = sizes > MIN_DEVIATION_RATIO * sizes[0]
    return np.asarray(sizes[kept, None] * axes[kept])


def vertex_solver(frames: Float) -> Solver:
    """Return the solver in the space of vertices ``(T, V, 3)``, in diagonals."""
    vectors = frames.reshape(len(frames), -1)
    directions = principal_directions(vectors - vectors.mean(axis=0))

    def solve(ids: Index, targets: Float, start: int) -> Float:
        columns = (3 * ids[:, None] + np.arange(3)).reshape(-1)
        slopes = directions[:, columns].T / DEFAULT_SOFTNESS
        misses = (targets - frames[start, ids]).reshape(-1) / DEFAULT_SOFTNESS
        system = slopes.T @ slopes + np.eye(len(directions))
        change = np.linalg.solve(system, slopes.T @ misses) @ directions
        return np.asarray(frames[start] + change.reshape(-1, 3))

    return solve


def gradient_solver(frames: Float, space: GradientSpace) -> Solver:
    """Return the solver in the space of deformation gradients of frames ``(T, V, 3)``, in diagonals: MeshIK."""
    faces, count = len(space.topology.faces), space.vertex_count
    vectors = space.encode(frames * space.scale)[:, : 9 * faces]
    metric = space.weights[: 9 * faces]
    directions = principal_directions((vectors - vectors.mean(axis=0)) * metric) / metric
    sides = space.pieces.vertex_of_row[space.side_rows]
    rows = np.repeat(np.arange(len(sides)), 2)
    incidence = sparse.csr_array((np.tile([-1.0, 1.0], len(sides)), (rows, sides.reshape(-1))), (len(sides), count))
    following, preceding = (np.roll(space.reference_sides, turn, axis=2) for turn in (-1, 1))
    areas = np.linalg.norm(np.cross(space.reference_sides[:, :, 0], space.reference_sides[:, :, 1]), axis=1)
    cotangents = -np.sum(following * preceding, axis=1) / areas[:, None]
    weights = np.maximum(0.5 * cotangents, 1e-3).reshape(-1, 1) / DEFAULT_SOFTNESS**2
    matrix = sparse.csc_array(incidence.T @ (weights * incidence))

    def target_sides(vector: Float) -> Float:
        rotations = rotvec_to_matrix(vector[: 3 * faces].reshape(-1, 3))
        stretches = vector[3 * faces :].reshape(-1, 6)[:, SYMMETRIC_ENTRY_IDS]
        return np.swapaxes(rotations @ stretches @ space.reference_sides, 1, 2).reshape(-1, 3)

    def solve(ids: Index, targets: Float, start: int) -> Float:
        free = np.setdiff1d(np.arange(count), ids)
        tie = sparse.diags_array(np.full(len(free), 1e-9 * matrix.diagonal().mean()))  # for components without handles
        factor = splu(sparse.csc_array(matrix[free][:, free] + tie))
        base, step = frames[start].copy(), 1e-5
        base[ids] = targets

        def fitted(vector: Float) -> tuple[Float, Float]:
            goal, x = target_sides(vector), base.copy()
            x[free] += factor.solve((incidence.T @ (weights * (goal - incidence @ base)))[free])
            return x, np.sqrt(weights) * (incidence @ x - goal)

        def energy(scores: Float) -> float:
            return float(np.square(fitted(vectors[start] + scores @ directions)[1]).sum() + scores @ scores)

        scores = np.zeros(len(directions))
        current = energy(scores)
        for _ in range(MAX_GRADIENT_STEPS):
            vector = vectors[start] + scores @ directions
            misfit = fitted(vector)[1].reshape(-1)
            slopes = np.stack([(fitted(vector + step * row)[1].reshape(-1) - misfit) / step for row in directions])
            change = -np.linalg.solve(slopes @ slopes.T + np.eye(len(scores)), slopes @ misfit + scores)
            lowered = energy(scores + change)
            while lowered > current and np.abs(change).max() > 1e-4:
                change /= 2
                lowered = energy(scores + change)
            if lowered > current:
                break
            scores, current = scores + change, lowered
            if np.abs(change).max() <= 0.01:
                break
        return fitted(vectors[start] + scores @ directions)[0]

    return solve


def rows_of(model: mixseq.Model, ids: Index) -> list[sparse.csr_array]:
    """Return the rows of handles at vertices ``(n,)``."""
    return [weight_row(model.header.vertex_count, ids[[i]], np.ones(1)) for i in range(len(ids))]


def speeds(model: mixseq.Model, ids: Index, targets: Float, start: int) -> tuple[float, float]:
    """Return decoded poses per second on one core: solved from a frame, and dragged along a line in 20 steps."""
    when = float(model.times[start])
    solver = PoseSolver(model, rows_of(model, ids), DEFAULT_SOFTNESS, len(ids) >= MIN_HANDLES_OF_FREE_BODY)
    begin = model(when)[ids]
    solver.solve(when, begin)
    handles = [Handle(when, place, int(vertex)) for vertex, place in zip(ids, begin, strict=True)]
    dragged = DraggedPose(model, handles)
    with one_blas_thread():
        clock = time.process_time()
        solver.points(when, solver.solve(when, targets))
        once, clock = time.process_time() - clock, time.process_time()
        for fraction in np.arange(1, 21) / 20:
            dragged.points(begin + fraction * (targets - begin))
    return 1 / once, 20 / (time.process_time() - clock)


def rows(case: str) -> Iterator[tuple[str, ...]]:
    """Leave poses out of an animation, one at a time."""
    name, _, step = case.partition(":")
    sequence = animation(name)
    sequence = sequence[:: int(step or 1)]
    points = sequence.points.astype(np.float64)
    results: dict[int, list[list[float]]] = {count: [] for count in HANDLE_COUNTS}
    for left_out in range(1, len(points), max(1, len(points) // MAX_POSES))[:MAX_POSES]:
        frames = np.delete(points, left_out, axis=0)
        known = mixseq.MeshSequence.from_arrays(frames, sequence.polygons, fps=sequence.fps)
        model = mixseq.fit(known, exact=True)
        scale, edges, expected = model.space.scale, model.mixed.topology.edges, points[left_out]
        vertices = vertex_solver(frames / scale)
        gradients = gradient_solver(frames / scale, GradientSpace(model.mixed.topology, scale, frames[0] / scale))
        lengths = edge_lengths(expected, edges)
        parts = model.parts, len(model.decomposition.parts)
        stills = [mixseq.fit(known[0:1], parts=each) for each in parts]
        for count in HANDLE_COUNTS:
            ids = farthest_vertices(points[0], count)
            targets, places = expected[ids], frames[:, ids]
            offsets = places - targets
            if count >= MIN_HANDLES_OF_FREE_BODY:
                offsets = offsets - offsets.mean(axis=1, keepdims=True)
            start = int(np.linalg.norm(offsets, axis=(1, 2)).argmin())
            when = float(model.times[start])
            handles = [Handle(when, target, int(vertex)) for vertex, target in zip(ids, targets, strict=True)]
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", MixseqWarning)  # targets that are missed
                found = [pose(model, handles)(when)]
            solvers = (vertices, gradients) if count in GRADIENT_HANDLE_COUNTS else (vertices,)
            found += [solve(ids, targets / scale, start) * scale for solve in solvers]
            is_free = count >= MIN_HANDLES_OF_FREE_BODY
            solvers_of_stills = [StillSolver(still, rows_of(still, ids), DEFAULT_SOFTNESS, is_free) for still in stills]
            found += [solver.points(0.0, solver.solve(0.0, targets)) for solver in solvers_of_stills]
            errors = [
                (
                    float(np.sqrt(np.square(x - expected).sum(axis=1).mean()) / scale),
                    float(np.sqrt(np.square(edge_lengths(x, edges) / np.maximum(lengths, 1e-12) - 1).mean())),
                )
                for x in found
            ]
            results[count].append([*np.ravel(errors), *speeds(model, ids, targets, start)])
    for count, measured in results.items():
        *errors, once, dragging = np.median(measured, axis=0)
        cells = [f"{rms:.4f} / {strain:.3f}" for rms, strain in np.reshape(errors, (-1, 2))]
        cells[-2:-2] = ["-"] * (5 - len(cells))
        yield case, str(count), *cells, f"{once:.0f}", f"{dragging:.0f}"


if __name__ == "__main__":
    sys.exit(print_table(COLUMNS, rows, NAMES))
