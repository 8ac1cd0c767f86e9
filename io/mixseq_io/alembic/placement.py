"""From a mesh's own coordinates to the world: the transforms above it, frame by frame.

Between two samples of a transform its translation, its stretch and the angle of its rotation run linearly, as in
Blender. Matrices act on rows: p' = p M.

Specification: https://docs.alembic.io/reference/index.html (``IXformSchema``)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Float, FloatArray
from mixseq.geometry.rigid import nearest_rotations
from mixseq.geometry.rotations import matrices, vectors
from mixseq_io.alembic.library import selector
from mixseq_io.alembic.timing import Track, locate, sample_times


@dataclass(frozen=True, eq=False)
class Placement:
    """Where a mesh is in every frame.

    Parameters
    ----------
    above : tuple of (IXformSchema, Track)
        The transforms above it, the nearest first.
    """

    above: tuple[tuple[Any, Track], ...]

    def to_world(self, frame: int) -> Float:
        """Return the matrix ``(4, 4)`` of a frame."""
        world = np.eye(4)
        for schema, track in self.above:
            matrix, inherits = _local(schema, *track.at(frame))
            with np.errstate(all="ignore"):
                world = world @ matrix
            if not inherits:
                break
        return world


def place(above: tuple[Any, ...], frames: Float) -> Placement:
    """Find the samples of the transforms that frames lie between."""
    return Placement(tuple((schema, locate(_times(schema), frames)) for schema in above))


def _times(schema: Any) -> Float:
    return np.zeros(1) if schema.isConstant() else sample_times(schema)


def _local(schema: Any, before: int, weight: float) -> tuple[Float, bool]:
    if not schema.getNumSamples():
        return np.eye(4), True
    first = schema.getValue(selector(schema, before))
    matrix = np.array(first.getMatrix(), dtype=np.float64)
    if weight:
        second = schema.getValue(selector(schema, before + 1))
        matrix = between(matrix, np.array(second.getMatrix(), dtype=np.float64), weight)
    return matrix, bool(first.getInheritsXforms())


def determinant(matrix: Float) -> float:
    """Return the determinant of a matrix's upper part; negative if it turns left into right."""
    with np.errstate(all="ignore"):
        return float(np.linalg.det(matrix[:3, :3]))


def between(first: Float, second: Float, weight: float) -> Float:
    """Interpolate two affine matrices ``(4, 4)``.

    Examples
    --------
    A quarter turn about z, halfway, does not shrink.

    >>> quarter = np.array([[0.0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    >>> between(np.eye(4), quarter, 0.5)[0, :2].round(6).tolist()
    [0.707107, 0.707107]
    """
    if not (np.isfinite(first).all() and np.isfinite(second).all()):
        return np.full((4, 4), np.nan)  # the reader names the frame and the vertex
    mixed = (1 - weight) * first + weight * second
    turns = nearest_rotations(np.stack([first[:3, :3], second[:3, :3]]))
    stretches = np.stack([first[:3, :3], second[:3, :3]]) @ turns.swapaxes(1, 2)  # rows: stretch, then turn
    step = matrices(weight * vectors(turns[0].T @ turns[1]))
    mixed[:3, :3] = ((1 - weight) * stretches[0] + weight * stretches[1]) @ turns[0] @ step
    return mixed


def moved(points: FloatArray, matrix: Float) -> NDArray[np.float32]:
    """Apply a matrix to points ``(V, 3)``, or only its upper part ``(3, 3)`` to vectors."""
    if np.array_equal(matrix, np.eye(len(matrix))):
        return np.asarray(points, dtype=np.float32)
    with np.errstate(all="ignore"):  # what overflows is reported by the reader, with its vertex
        world = points.astype(np.float64) @ matrix[:3, :3]
        if len(matrix) == 4:
            world += matrix[3, :3]
        return world.astype(np.float32)
