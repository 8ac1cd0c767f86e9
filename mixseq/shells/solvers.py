"""Sparse symmetric positive definite systems: analyse a pattern once, factor its matrices, solve for right-hand sides.

With rslab (``pip install 'mixseq[fast]'``) a pattern is ordered once, and matrices are factored by supernodes; SciPy's
SuperLU takes several times longer. Both solve to rounding precision, independently of the number of threads.

rslab keeps a thread pool for every requested number of threads. A forked process inherits pools without threads, and
would wait for them forever. It therefore requests numbers of threads that its ancestors did not use.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from functools import cached_property
from itertools import count
from typing import Any, Protocol

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from mixseq.errors import ReconstructionError
from mixseq.types import Float, Index

MIN_ROWS_FOR_THREADS = 30_000
"""Number of rows below which a matrix is factored by one thread, since several matrices are factored at once."""

_DEFAULT_THREADS = 4
"""Default number of threads of rslab."""

_UNREACHABLE_WORK = 1 << 62
"""Amount of work above which rslab solves on its global pool, which a forked process cannot replace."""


class Factor:
    """A factored matrix."""

    def __init__(self, solve: Callable[[Float], Float]) -> None:
        self._solve = solve

    def solve(self, right: Float) -> Float:
        """Solve for right-hand sides ``(n,)`` or ``(n, k)``."""
        return np.asarray(self._solve(np.ascontiguousarray(right)), dtype=np.float64)


class Analysis(Protocol):
    """Symbolic factorisation of a pattern."""

    def factor(self, values: Float) -> Factor:
        """Factor the matrix with values ``(N,)`` of the lower triangle, in the order of the pattern."""


def analyse(starts: Index, rows: Index, threads: int | None = None) -> Analysis:
    """Analyse the pattern of a symmetric positive definite matrix: starts ``(n + 1,)``, rows ``(N,)``."""
    rslab = _rslab()
    return _SuperLUAnalysis(starts, rows) if rslab is None else _RslabAnalysis(rslab, starts, rows, threads)


def factorise(matrix: sparse.sparray) -> Factor:
    """Factor a symmetric positive definite matrix ``(n, n)``, with both triangles stored."""
    lower = sparse.csc_array(sparse.tril(sparse.csc_array(matrix)))
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


class _RslabAnalysis:
    def __init__(self, rslab: Any, starts: Index, rows: Index, threads: int | None) -> None:
        size = len(starts) - 1
        self._threads = 1 if threads is None and size < MIN_ROWS_FOR_THREADS else threads
        self._symbolic = None
        if size:
            pattern = sparse.csc_array((np.ones(len(rows)), rows, starts), shape=(size, size))
            self._symbolic = rslab.analyze(
                pattern,
                path="ldlt",
                threads=_pools.request(self._threads),
                solve_par_min_work=_UNREACHABLE_WORK,
            )

    def factor(self, values: Float) -> Factor:
        if self._symbolic is None:
            return Factor(lambda right: right)
        if not np.isfinite(values).all():
            raise _singular_error(ValueError("values are not finite"))
        try:
            factor = self._symbolic.factor(values, threads=_pools.request(self._threads))
        except RuntimeError as error:
            raise _singular_error(error) from None
        return Factor(lambda right: (factor.solve if right.ndim == 1 else factor.solve_many)(right))


class _SuperLUAnalysis:
    """Indices of the values of both triangles, because SuperLU does not store an analysis.

    SuperLU runs in symmetric mode with ``relax=1``. Otherwise, it joins columns to supernodes against the minimum
    degree ordering, which takes ten times as long.
    """

    def __init__(self, starts: Index, rows: Index) -> None:
        self._starts, self._rows = starts, rows

    @cached_property
    def _both(self) -> tuple[Index, sparse.csc_array]:
        """Index of each value in the lower triangle, and the full matrix."""
        size = len(self._starts) - 1
        columns = np.repeat(np.arange(size), np.diff(self._starts))
        number = np.arange(1, len(self._rows) + 1)
        below = self._rows > columns
        i = np.concatenate([self._rows, columns[below]])
        j = np.concatenate([columns, self._rows[below]])
        full = sparse.coo_array((np.concatenate([number, number[below]]), (i, j)), shape=(size, size)).tocsc()
        full.sort_indices()
        return full.data.astype(np.int64) - 1, full

    def factor(self, values: Float) -> Factor:
        source, full = self._both
        if not full.shape[0]:
            return Factor(lambda right: right)
        matrix = sparse.csc_array((values[source], full.indices, full.indptr), shape=full.shape)
        options = {"SymmetricMode": True}
        try:
            return Factor(splu(matrix, "MMD_AT_PLUS_A", 0.0, relax=1, options=options).solve)
        except RuntimeError as error:
            raise _singular_error(error) from None
