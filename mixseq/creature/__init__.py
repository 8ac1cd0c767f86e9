"""A walking fox: the sample animation of mixseq, made from a table of bones.

The bones' flesh is blended into one closed surface (`skeleton`), polygonised (`surface_nets`), posed (`gait`) and
skinned. The middle of a bone moves nearly rigidly and only the joints bend, so the fox is also a test case with known
parts (`part_of_vertex`).
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Float, Index
from mixseq.creature.gait import pose
from mixseq.creature.skeleton import HEADS, NAMES, body_distance, bone_distances
from mixseq.creature.surface_nets import neighbour_mean, polygonise
from mixseq.sequence import MeshSequence
from mixseq.threads import one_blas_thread

__all__ = ["part_of_vertex", "walk_cycle"]

CELL = 0.0215  # metres, about the length of an edge
SOFTNESS = 8  # steps of diffusion, each of which widens a joint by one ring of vertices


def walk_cycle(frames: int = 48, fps: float = 24.0) -> MeshSequence:
    """Animate the fox: one walk cycle on the spot.

    Parameters
    ----------
    frames : int
        Number of frames T of one cycle. Frame T would be frame 0 again.
    fps : float
        Frames per second.

    Returns
    -------
    MeshSequence
        One closed surface of genus 0, about 1 m high, Y up, facing +X, in metres; float64.

    Examples
    --------
    >>> fox = walk_cycle(frames=4)
    >>> fox.points.shape == (4, fox.vertex_count, 3)
    True
    """
    with one_blas_thread():
        rest, faces, weights = _rest()
        rotations, heads = pose(np.arange(frames) / frames)
        # linear blend skinning: bone b takes a point x to rotation x + (head - rotation rest_head)
        shifts = heads - np.einsum("tbij,bj->tbi", rotations, HEADS)
        blended = np.einsum("vb,tbij->tvij", weights, rotations, optimize=True)
        points = np.einsum("tvij,vj->tvi", blended, rest) + np.einsum(
            "vb,tbi->tvi", weights, shifts, optimize=True
        )
    return MeshSequence.from_arrays(points, faces, fps=fps, up_axis="Y", metres_per_unit=1.0, name="fox")


def part_of_vertex() -> tuple[NDArray[np.int64], tuple[str, ...]]:
    """Tell which bone moves each vertex most.

    Returns
    -------
    part : (V,) int64
        Index of the bone with the largest weight.
    names : (B,) str
        Names of the bones.
    """
    with one_blas_thread():
        return np.argmax(_rest()[2], axis=1), NAMES


@cache
def _rest() -> tuple[Float, Index, Float]:
    """Rest pose ``(V, 3)``, faces ``(F, 3)`` and skinning weights ``(V, B)``; read-only, as it is cached."""
    low, high = np.array([-1.05, -0.05, -0.24]), np.array([0.70, 1.08, 0.24])
    points, faces = polygonise(body_distance, low, high, CELL)
    arrays = points, faces, skin_weights(points, faces)
    for array in arrays:
        array.flags.writeable = False
    return arrays


def skin_weights(points: Float, faces: Index) -> Float:
    """Return weights ``(V, B)`` of points ``(V, 3)``, faces ``(F, 3)``: nearest bones, diffused `SOFTNESS` edges."""
    weights: Float = np.eye(len(NAMES))[np.argmin(bone_distances(points), axis=1)]
    mean = neighbour_mean(faces, len(points))
    for _ in range(SOFTNESS):
        weights = (weights + mean @ weights) / 2
    return weights
