"""Settings and reports of fits to lengths and angles, and the sparsity pattern of their matrices.

Unknowns are triples: the coordinates of a vertex, or the columns of a face's frame. Coupled pairs follow from
connectivity, so that the indices of all values are computed once. Of every matrix, only the values of the lower
triangle are stored, column by column (compressed sparse columns).
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np

from mixseq.errors import SettingsError
from mixseq.runtime.lazy import PickledWithoutCaches
from mixseq.shells.solvers import Analysis, analyse
from mixseq.types import Index


@dataclass(frozen=True, eq=False)
class BlockPattern(PickledWithoutCaches):
    """The lower triangle of a symmetric matrix of n x n blocks, with all diagonal blocks."""

    starts: Index  # (3n + 1,) index of the first value of every column
    rows: Index  # (N,) row of every value, ascending in each column; the first row is on the diagonal
    # (n + m, 3) index of the value in row 0 of every column of the n diagonal blocks, then of the m blocks below; rows
    # 1 and 2 follow. Diagonal blocks only have rows on and below the diagonal.
    places: Index
    keys: Index  # (m,) n * column + row of the blocks below the diagonal, ascending
    threads: int | None = None  # number of threads that factor one matrix; by default determined by its size

    @classmethod
    def from_pairs(cls, count: int, pairs: Index, threads: int | None = None) -> BlockPattern:
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
        return cls(starts, rows, places.astype(np.int64), keys, threads)

    @property
    def block_count(self) -> int:
        """Number n of triples of unknowns."""
        return (len(self.starts) - 1) // 3

    def find_blocks(self, i: Index, j: Index) -> Index:
        """Return the index in `places` of the block that couples i and j, -1 where i or j is negative."""
        low, high = np.minimum(i, j), np.maximum(i, j)
        below = self.block_count + np.searchsorted(self.keys, self.block_count * low + high)
        return np.where(low < 0, -1, np.where(low == high, low, below)).astype(np.int64)

    def cached_values(self) -> tuple[object, ...]:
        """Implement `PickledWithoutCaches.cached_values`."""
        return (self.analysis,)

    @cached_property
    def diagonal(self) -> Index:
        """Indices ``(3n,)`` of the values of the diagonal."""
        return self.starts[:-1]

    @cached_property
    def analysis(self) -> Analysis:
        """Symbolic factorisation, shared by all matrices of the pattern."""
        return analyse(self.starts, self.rows, self.threads)


@dataclass(frozen=True)
class ShellSettings:
    """Settings of fits to lengths and angles.

    Attributes
    ----------
    bending : float
        Weight of an angle in radians relative to a relative change of length.
    iterations : int
        Largest number of steps.
    tolerance : float
        Convergence limit of the predicted decrease of the energy, as a fraction of the energy.
    exact : float
        Alternative convergence limit of the largest weighted residual.
    accuracy : float
        Alternative convergence limit of the largest change of a coordinate in a step, in the unit of the points
        (diagonals), once the energy has levelled off. Steps shrink about tenfold, so that the final error is smaller.

    Raises
    ------
    SettingsError
        If a setting is not a number, or is negative.
    """

    bending: float = 0.3
    iterations: int = 100
    tolerance: float = 1e-3
    exact: float = 1e-10
    accuracy: float = 5e-5

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            kind = int | np.integer if field.name == "iterations" else int | float | np.number
            if not (isinstance(value, kind) and np.isfinite(value) and value >= 0):
                whole = "whole number" if field.name == "iterations" else "number"
                raise SettingsError(f"{field.name} is {value!r}; a {whole} of 0 or more is expected")

    def for_differences(self) -> ShellSettings:
        """Return settings accurate enough to subtract results for nearly equal targets."""
        return replace(self, tolerance=min(self.tolerance, 1e-10), accuracy=min(self.accuracy, 1e-9))


@dataclass(frozen=True)
class ShellReport:
    """Result of a fit: final energy, number of steps, convergence."""

    energy: float
    iterations: int
    converged: bool
