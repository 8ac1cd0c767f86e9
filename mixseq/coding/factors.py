r"""A sequence as products of signals over the mesh and signals over time.

trajectories
    :math:`x_t(v) = u_0(t) / \sqrt V + \sum_k u_k(t)\, b_k(v)`: principal components of the vertices' trajectories, of
    which one field :math:`b_k` of numbers over the mesh goes with a track :math:`u_k(t)` of three coordinates. A rigid
    part needs four of them, and has fields that are affine functions of the place. The best for most sequences.
shapes
    :math:`x_t(v) = b_0(v) / \sqrt T + \sum_k u_k(t)\, b_k(v)`: principal components of the frames, of which one field
    of three coordinates goes with a track of numbers. For meshes that have few vertices for their frames' number.

Both are optimal in the least-squares sense. If every number of :math:`b_k` and of :math:`u_k \|b_k\|` is rounded to a
multiple of the same step, all of them cost and spoil alike: reverse water-filling.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from mixseq.arrays import Float, Index
from mixseq.coding.coded import FactorName
from mixseq.disk_array import LargeArray, column_blocks, new_large_array
from mixseq.frame_store import FrameStore

MOST = 3000
"""Principal components are found of so many rows or columns; of longer sequences, frames are left out for it."""


_AT_ONCE = 128
"""So many fields are computed at once."""


@dataclass(frozen=True, eq=False)
class Factors:
    """Fields over the mesh, most important first.

    Attributes
    ----------
    name : {"trajectories", "shapes"}
        Which factors.
    fields : (K, c, V) array, perhaps on disk, of float64
        Fields without those that are constant over the mesh: c = 1 number a vertex of trajectories, 3 of shapes.
    sizes : (K,) float64
        Their norms, decreasing (but for the mean of shapes, the first).
    """

    name: FactorName
    fields: LargeArray
    sizes: Float


def factor(sequence: FrameStore, name: FactorName, least: float, some: Index | None = None) -> Factors:
    """Find the fields of a sequence, or of some of its vertices.

    Parameters
    ----------
    sequence : FrameStore
        The sequence.
    name : {"trajectories", "shapes"}
        Which factors.
    least : float
        Fields with a norm below this are left out.
    some : (n,) int64, optional
        Vertices, by default all.
    """
    if some is not None:
        sequence = FrameStore(sequence.header, _of_vertices(sequence, some))
    count, vertices = len(sequence.points), sequence.points.shape[1]
    rows, coordinates = (3, 1) if name == "trajectories" else (1, 3)
    stride = -(-min(rows * count, coordinates * vertices) // MOST)
    frames = np.arange(0, count, stride)
    mean = _mean_shape(sequence, frames) if name == "shapes" else None
    table = _centred(sequence, frames, mean)
    most = max(min(len(table) - (mean is not None), coordinates * vertices), 1)
    # Each of the frames that were looked at stands for those beside it.
    sizes, blocks = _principal(table, least / np.sqrt(stride), most)
    first = [] if mean is None else [np.sqrt(count) * mean.T]
    fields = new_large_array((len(first) + len(sizes), coordinates, vertices))
    for row, field in enumerate(first):
        fields[row : row + 1] = field[None]
    done = len(first)
    for block in blocks:
        cubes = np.sqrt(stride) * block.reshape(-1, vertices, coordinates).transpose(0, 2, 1)
        fields[done : done + len(cubes)] = cubes
        done += len(cubes)
    return Factors(
        name, fields, np.append([np.linalg.norm(field) for field in first], np.sqrt(stride) * sizes)
    )


def _principal(table: LargeArray, least: float, most: int) -> tuple[Float, Iterator[Float]]:
    """Return the singular values of rows ``(R, W)``, `most` of them, and their components scaled by them, in blocks."""
    height, width = table.shape
    if height <= width:
        gram = np.zeros((height, height))
        for _, block in column_blocks(table):
            gram += block @ block.T
    else:
        gram = np.zeros((width, width))
        for start in range(0, height, width):
            block = table[start : start + width]
            gram += block.T @ block
    values, vectors = linalg.eigh(gram)
    sizes = np.sqrt(np.maximum(values[::-1], 0.0))
    kept = max(1, min(int(np.count_nonzero(sizes > least)), most))
    basis = vectors[:, ::-1][:, :kept].T
    if height > width:
        return sizes[:kept], iter([sizes[:kept, None] * basis])
    return sizes[:kept], _projected(table, basis)


def _projected(table: LargeArray, basis: Float) -> Iterator[Float]:
    for start in range(0, len(basis), _AT_ONCE):
        some = basis[start : start + _AT_ONCE]
        components = np.empty((len(some), table.shape[1]))
        for columns, block in column_blocks(table):
            components[:, columns] = some @ block
        yield components


def _centred(sequence: FrameStore, frames: Index, mean: Float | None) -> LargeArray:
    """Return trajectories without the mean of all vertices (3T, V), or frames without the mean shape (T, 3V)."""
    vertices = sequence.points.shape[1]
    if mean is not None:
        table = new_large_array((len(frames), 3 * vertices))
        for row, frame in enumerate(frames):
            table[row : row + 1] = (sequence.points[frame : frame + 1][0] - mean).reshape(1, -1)
        return table
    table = new_large_array((3 * len(frames), vertices))
    for row, frame in enumerate(frames):
        points = sequence.points[frame : frame + 1][0].astype(np.float64)
        table[3 * row : 3 * row + 3] = (points - points.mean(axis=0)).T
    return table


def _of_vertices(sequence: FrameStore, some: Index) -> LargeArray:
    points = new_large_array((len(sequence.points), len(some), 3), sequence.points.dtype)
    for frame in range(len(points)):
        points[frame : frame + 1] = sequence.points[frame : frame + 1][:, some]
    return points


def _mean_shape(sequence: FrameStore, frames: Index) -> Float:
    total = np.zeros(sequence.points.shape[1:])
    for frame in frames:
        total += sequence.points[frame : frame + 1][0]
    return total / len(frames)
