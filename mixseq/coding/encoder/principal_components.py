r"""Principal components of a sequence: the spatial basis before it is rounded.

trajectories
    :math:`x_t(v) = u_0(t) / \sqrt V + \sum_k u_k(t)\, b_k(v)`: principal components of the vertices' trajectories. A
    basis vector :math:`b_k` has one number at each vertex, its coefficients :math:`u_k(t)` three coordinates. A rigid
    part needs four of them, which are affine functions of the place. The best for most sequences.
shapes
    :math:`x_t(v) = b_0(v) / \sqrt T + \sum_k u_k(t)\, b_k(v)`: principal components of the frames. A basis vector has
    three coordinates at each vertex, its coefficients are numbers. For meshes that have few vertices for their frames'
    number.

Both are optimal in the least-squares sense. If every number of :math:`b_k` and of :math:`u_k \|b_k\|` is rounded to a
multiple of the same step, all of them cost the same bits and make the same error: reverse water-filling.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from mixseq.arrays import Float, Index
from mixseq.coding.bitstream.spatial_basis import BasisKind
from mixseq.disk_array import LargeArray, column_blocks, new_large_array
from mixseq.frame_store import FrameStore

MOST = 3000
"""Principal components are found of so many rows or columns; of longer sequences, frames are left out for it."""


_AT_ONCE = 128
"""So many components are computed at once."""


@dataclass(frozen=True, eq=False)
class PrincipalComponents:
    """Basis vectors over the mesh, most important first.

    Attributes
    ----------
    kind : {"trajectories", "shapes"}
        What is compared: vertices or frames.
    vectors : (K, c, V) array, perhaps on disk, of float64
        Basis vectors in the units of the sequence, without the constant one of trajectories, of which c = 1; c = 3 of
        shapes.
    norms : (K,) float64
        Their norms, decreasing (but for the mean of shapes, the first).
    """

    kind: BasisKind
    vectors: LargeArray
    norms: Float


def principal_components(
    sequence: FrameStore, kind: BasisKind, least: float, some: Index | None = None
) -> PrincipalComponents:
    """Find the principal components of a sequence, or of some of its vertices.

    Parameters
    ----------
    sequence : FrameStore
        The sequence.
    kind : {"trajectories", "shapes"}
        What is compared: vertices or frames.
    least : float
        Components with a norm below this are left out, in the units of the sequence.
    some : (n,) int64, optional
        Vertices, by default all.
    """
    if some is not None:
        sequence = FrameStore(sequence.header, _of_vertices(sequence, some))
    count, vertices = len(sequence.points), sequence.points.shape[1]
    rows, coordinates = (3, 1) if kind == "trajectories" else (1, 3)
    stride = -(-min(rows * count, coordinates * vertices) // MOST)
    frames = np.arange(0, count, stride)
    mean = _mean_shape(sequence, frames) if kind == "shapes" else None
    table = _centred(sequence, frames, mean)
    most = max(min(len(table) - (mean is not None), coordinates * vertices), 1)
    # Each of the frames that were looked at stands for those beside it.
    sizes, blocks = _principal(table, least / np.sqrt(stride), most)
    first = [] if mean is None else [np.sqrt(count) * mean.T]
    vectors = new_large_array((len(first) + len(sizes), coordinates, vertices))
    for row, vector in enumerate(first):
        vectors[row : row + 1] = vector[None]
    done = len(first)
    for block in blocks:
        cubes = np.sqrt(stride) * block.reshape(-1, vertices, coordinates).transpose(0, 2, 1)
        vectors[done : done + len(cubes)] = cubes
        done += len(cubes)
    norms = np.append([np.linalg.norm(vector) for vector in first], np.sqrt(stride) * sizes)
    return PrincipalComponents(kind, vectors, norms)


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
