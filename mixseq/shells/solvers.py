r"""Sparse symmetric positive definite systems: analyse a pattern once, factor its matrices, solve for right-hand sides.

Of every matrix, only the values of the lower triangle are stored, column by column (compressed sparse columns).

*Vertices from sides* (`PoissonSystem`). From sides ``ij`` of a mesh, the vertices are

.. math:: \min_x \sum_{ij} w_{ij} \, | x_j - x_i - s_{ij} |^2 ,

which is ``L x = B^T W s`` with the incidence matrix B of the sides and the Laplacian ``L = B^T W B``.

With rslab (``pip install 'mixseq[fast]'``) a pattern is ordered once, and matrices are factored by supernodes; SciPy's
SuperLU takes several times longer. Both solve to rounding precision, independently of the number of threads.

rslab keeps a thread pool for every requested number of threads. A forked process inherits pools without threads, and
would wait for them forever. It therefore requests numbers of threads that its ancestors did not use.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from dataclasses import dataclass
from itertools import count
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from mixseq.errors import ReconstructionError, SettingsError
from mixseq.mesh.measures import scatter_add
from mixseq.mesh.rigid import nearest_rotations
from mixseq.mesh.topology import connected_components
from mixseq.runtime.lazy import PickledWithoutCaches, cached_property
from mixseq.shells.kernels import add_weighted_sides
from mixseq.types import Float, Index, Mask

MIN_ROWS_FOR_THREADS = 30_000  # rows below which one thread factors a matrix, as several are factored at once
_DEFAULT_THREADS = 4  # default number of threads of rslab
_UNREACHABLE_WORK = 1 << 62  # work above which rslab solves on its global pool, which a fork cannot replace


class Factor:
    """A factored matrix."""

    def __init__(self, solve: Callable[[Float], Float]) -> None:
        self._solve = solve

    def solve(self, right: Float) -> Float:
        """Solve for right-hand sides ``(n,)`` or ``(n, k)``; for k > 1, a column's bits do not depend on others."""
        return np.asarray(self._solve(np.ascontiguousarray(right)), dtype=np.float64)


class Analysis(NamedTuple):
    """Symbolic factorisation of a pattern."""

    factor: Callable[[Float], Factor]  # factors the matrix with values (N,) of the lower triangle, as in the pattern


def analyse(starts: Index, rows: Index) -> Analysis:
    """Analyse the pattern of a symmetric positive definite matrix: starts ``(n + 1,)``, rows ``(N,)``."""
    if len(starts) == 1:
        return Analysis(lambda values: Factor(lambda right: right))
    rslab = _rslab()
    return Analysis(_analyse_by_superlu(starts, rows) if rslab is None else _analyse_by_rslab(rslab, starts, rows))


def factorise(matrix: sparse.sparray) -> Factor:
    """Factor a symmetric positive definite matrix ``(n, n)``, with both triangles stored."""
    lower = sparse.csc_array(sparse.tril(matrix, format="csc"))
    lower.sort_indices()
    return analyse(lower.indptr.astype(np.int64), lower.indices.astype(np.int64)).factor(lower.data)


def factorise_laplacian(pairs: Index, weights: Float, position_weights: Float) -> Factor:
    r"""Factor :math:`\sum_k w_k |x_{j_k} - x_{i_k}|^2 + \sum_v h_v |x_v|^2`; pairs ``(k, 2)`` have -1 for fixed x."""
    count, diagonal, is_free = len(position_weights), position_weights.copy(), pairs >= 0
    for end in (0, 1):
        is_border = is_free[:, end] & ~is_free[:, 1 - end]
        np.add.at(diagonal, pairs[is_border, end], weights[is_border])
    is_inner = is_free.all(axis=1)
    (i, j), weights = pairs[is_inner].T, weights[is_inner]
    degrees = np.bincount(i, weights, minlength=count) + np.bincount(j, weights, minlength=count)
    places = np.concatenate([i, j]), np.concatenate([j, i])
    coupled = sparse.coo_array((np.tile(weights, 2), places), shape=(count, count))
    return factorise((sparse.diags_array(degrees + diagonal) - coupled).tocsr())


def index_of(ids: Index, count: int) -> Index:
    """Return the index ``(count,)`` of every number below `count` among ids ``(n,)``, -1 if absent."""
    index = np.full(count, -1, dtype=np.int64)
    index[ids] = np.arange(len(ids))
    return index


@dataclass(frozen=True, eq=False)
class BlockPattern(PickledWithoutCaches):
    """The lower triangle of a symmetric matrix of n x n blocks, with all diagonal blocks.

    Unknowns are triples: the coordinates of a vertex, or the columns of a face's frame. Coupled pairs follow from
    connectivity, so that the indices of all values are computed once.
    """

    starts: Index  # (3n + 1,) index of the first value of every column
    rows: Index  # (N,) row of every value, ascending in each column; the first row is on the diagonal
    # (n + m, 3) index of the value in row 0 of every column of the n diagonal blocks, then of the m blocks below; rows
    # 1 and 2 follow. Diagonal blocks only have rows on and below the diagonal.
    places: Index
    keys: Index  # (m,) n * column + row of the blocks below the diagonal, ascending

    @classmethod
    def from_pairs(cls, count: int, pairs: Index) -> BlockPattern:
        """Return the block pattern of `count` vertices coupled in pairs ``(k, 2)``; ignore negative indices."""
        low, high = pairs.min(axis=1, initial=count), pairs.max(axis=1, initial=-1)
        coupled = (low >= 0) & (low < high)
        keys = np.unique(count * low[coupled] + high[coupled])
        column, row = np.divmod(keys, max(count, 1))
        below = np.bincount(column, minlength=count)
        heights = (3 * below[:, None] + np.array([3, 2, 1])).reshape(-1)
        starts = np.concatenate([[0], np.cumsum(heights)]).astype(np.int64)
        tops = starts[:-1].reshape(-1, 3)
        rank = np.arange(len(keys)) - np.searchsorted(column, np.arange(count))[column]
        places = np.concatenate([tops - np.arange(3), tops[column] + np.array([3, 2, 1]) + 3 * rank[:, None]])
        rows = np.empty(starts[-1], dtype=np.int64)
        for j in range(3):
            for i in range(j, 3):
                rows[places[:count, j] + i] = 3 * np.arange(count) + i
            for i in range(3):
                rows[places[count:, j] + i] = 3 * row + i
        return cls(starts, rows, places.astype(np.int64), keys)

    @property
    def block_count(self) -> int:
        """Number n of triples of unknowns."""
        return (len(self.starts) - 1) // 3

    def find_blocks(self, i: Index, j: Index) -> Index:
        """Return the index in `places` of the block that couples i and j, -1 where i or j is negative."""
        low, high = np.minimum(i, j), np.maximum(i, j)
        below = self.block_count + np.searchsorted(self.keys, self.block_count * low + high)
        return np.where(low < 0, -1, np.where(low == high, low, below)).astype(np.int64)

    @cached_property
    def diagonal(self) -> Index:
        """Indices ``(3n,)`` of the values of the diagonal."""
        return self.starts[:-1]

    @cached_property
    def analysis(self) -> Analysis:
        """Symbolic factorisation, shared by all matrices of the pattern."""
        return analyse(self.starts, self.rows)


def solve_frames(pattern: BlockPattern, index: Index, pairs: Index, connections: Float, known: Float) -> Float:
    r"""Return rotations ``(n, 3, 3)`` with connections ``(h, 3, 3)`` between pairs ``(h, 2)``, by least squares.

    Minimise :math:`\sum |F_j - F_i M|^2 + |F_i - F_j M^T|^2` over frames with an index ``(n,)`` of at least zero, then
    project to rotations; other frames are `known` ``(n, 3, 3)``. The pattern couples pairs of indices.
    """
    frames, unknown_ids = known.copy(), np.flatnonzero(index >= 0)
    if not unknown_ids.size:
        return frames
    # Rows of F (one per world coordinate) are independent: F_j - F_i M = 0 reads f_j - M^T f_i = 0 for rows f.
    count, forward = len(unknown_ids), np.swapaxes(connections, 1, 2)
    i, j = index[pairs].T
    diagonal, right = np.zeros((2, count, 3, 3))  # right: (frame, column of F, world coordinate)
    for target, source, end, matrices in ((j, i, 0, forward), (i, j, 1, connections)):
        is_free = target >= 0
        # f_target - matrix f_source, and f_source - matrix^T f_target
        squares = np.eye(3) + matrices @ np.swapaxes(matrices, 1, 2)
        diagonal += scatter_add(squares[is_free].reshape(-1, 9), target[is_free], count).reshape(-1, 3, 3)
        is_border = is_free & (source < 0)
        predicted = 2.0 * matrices[is_border] @ np.swapaxes(known[pairs[is_border, end]], 1, 2)
        right += scatter_add(predicted.reshape(-1, 9), target[is_border], count).reshape(-1, 3, 3)
    values = np.zeros(len(pattern.rows))
    for column in range(3):
        for row in range(column, 3):
            values[pattern.places[:count, column] + row] = diagonal[:, row, column]
    is_inner = (i >= 0) & (j >= 0)
    first, second = i[is_inner], j[is_inner]
    # In the lower triangle, the higher number is the row.
    blocks = -2.0 * np.where((second > first)[:, None, None], forward[is_inner], connections[is_inner])
    places = pattern.places[pattern.find_blocks(first, second)][:, None, :] + np.arange(3)[:, None]
    np.add.at(values, places, blocks)
    solution = pattern.analysis.factor(values).solve(right.reshape(-1, 3)).reshape(-1, 3, 3)
    frames[unknown_ids] = nearest_rotations(np.swapaxes(solution, 1, 2))
    return frames


@dataclass(frozen=True, eq=False)
class PoissonSystem(PickledWithoutCaches):
    """The Poisson system of a graph with given sides and fixed vertices."""

    edges: Index  # (S, 2) vertices i, j of sides, which may be repeated or equal
    weights: Float  # (S,) weights w, which may be negative (obtuse triangles) if L is positive semidefinite
    fixed_mask: Mask  # (n,) vertices with given positions

    @cached_property
    def unknown_ids(self) -> Index:
        """Unknown vertices: all except fixed ones and the first of every component without, which is the origin."""
        component = connected_components(len(self.fixed_mask), self.edges)
        is_known = self.fixed_mask.copy()
        is_held = np.bincount(component, self.fixed_mask) > 0
        is_known[np.unique(component, return_index=True)[1][~is_held]] = True
        return np.flatnonzero(~is_known)

    @cached_property
    def factor(self) -> Factor:
        """Factor of the Laplacian of the unknown vertices."""
        index = index_of(self.unknown_ids, len(self.fixed_mask))
        return factorise_laplacian(index[self.edges], self.weights, np.zeros(len(self.unknown_ids)))

    def solve(self, sides: Float, positions: Float | None = None) -> Float:
        """Solve for vertices ``(n, k)`` with differences ``x_j - x_i`` closest to sides ``(S, k)``.

        Fixed vertices are at positions ``(n, k)``, by default at the origin.
        """
        if len(sides) != len(self.edges):
            raise SettingsError(f"there are {len(sides)} sides; {len(self.edges)} are expected")
        result = np.zeros((len(self.fixed_mask), sides.shape[1]))
        if positions is not None:
            result[self.fixed_mask] = positions[self.fixed_mask]
            sides = sides - (result[self.edges[:, 1]] - result[self.edges[:, 0]])
        if self.unknown_ids.size:
            result[self.unknown_ids] = self.factor.solve(self.right_hand_side(sides))
        return result

    def right_hand_side(self, sides: Float) -> Float:
        """Return the right-hand side ``(u, k)`` of the unknown vertices for sides ``(S, k)``."""
        right = np.zeros((len(self.fixed_mask), sides.shape[1]))
        add_weighted_sides(self.edges, self.weights, np.ascontiguousarray(sides), right)
        return right[self.unknown_ids]


def _rslab() -> Any | None:
    try:
        import rslab
    except ImportError:
        return None
    return rslab


def _import_on_lasting_thread() -> None:
    """Import rslab on a thread that never ends, because rslab crashes after its importing thread has ended."""
    is_imported = threading.Event()

    def import_and_wait() -> None:
        _rslab()
        is_imported.set()
        threading.Event().wait()

    if threading.current_thread() is threading.main_thread():
        _rslab()
    else:
        threading.Thread(target=import_and_wait, daemon=True, name="rslab").start()
        is_imported.wait()


_import_on_lasting_thread()


class _ThreadPools:
    """Numbers of threads requested of rslab in this process and its ancestors."""

    def __init__(self) -> None:
        self._used: frozenset[int] = frozenset()
        self._lost: frozenset[int] = frozenset()

    def request(self, threads: int | None) -> int | None:
        """Return the number of threads to request of rslab instead of `threads`."""
        if self._lost:
            threads = next(size for size in count(threads or _DEFAULT_THREADS) if size not in self._lost)
        self._used |= {threads} if threads else set(range(1, _DEFAULT_THREADS + 1))
        return threads

    def mark_lost(self) -> None:
        """Mark the pools of the parent process as lost."""
        self._lost |= self._used


_pools = _ThreadPools()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pools.mark_lost)


def _singular_error(error: Exception) -> ReconstructionError:
    return ReconstructionError(f"a linear system has no unique solution: {error}")


def _analyse_by_rslab(rslab: Any, starts: Index, rows: Index) -> Callable[[Float], Factor]:
    size = len(starts) - 1
    threads = 1 if size < MIN_ROWS_FOR_THREADS else None
    pattern = sparse.csc_array((np.ones(len(rows)), rows, starts), shape=(size, size))
    limits = {"threads": _pools.request(threads), "solve_par_min_work": _UNREACHABLE_WORK}
    symbolic = rslab.analyze(pattern, path="ldlt", **limits)

    def factor(values: Float) -> Factor:
        if not np.isfinite(values).all():
            raise _singular_error(ValueError("values are not finite"))
        try:
            factored = symbolic.factor(values, threads=_pools.request(threads))
        except RuntimeError as error:
            raise _singular_error(error) from None
        return Factor(lambda right: (factored.solve if right.ndim == 1 else factored.solve_many)(right))

    return factor


def _analyse_by_superlu(starts: Index, rows: Index) -> Callable[[Float], Factor]:
    """Find the indices of the values of both triangles, because SuperLU does not store an analysis.

    SuperLU runs in symmetric mode with ``relax=1``. Otherwise, it joins columns to supernodes against the minimum
    degree ordering, which takes ten times as long.
    """
    size = len(starts) - 1
    columns = np.repeat(np.arange(size), np.diff(starts))
    number = np.arange(1, len(rows) + 1)
    below = rows > columns
    places = np.concatenate([rows, columns[below]]), np.concatenate([columns, rows[below]])
    full = sparse.coo_array((np.concatenate([number, number[below]]), places), shape=(size, size)).tocsc()
    full.sort_indices()
    source = full.data.astype(np.int64) - 1

    def factor(values: Float) -> Factor:
        matrix = sparse.csc_array((values[source], full.indices, full.indptr), shape=full.shape)
        try:
            solve = splu(matrix, "MMD_AT_PLUS_A", 0.0, relax=1, options={"SymmetricMode": True}).solve
        except RuntimeError as error:
            raise _singular_error(error) from None
        # SuperLU sums in another order for several columns.
        return Factor(lambda right: solve(right) if right.ndim == 1 else np.stack(list(map(solve, right.T)), axis=1))

    return factor
