"""Markers: pairs of vertices, one on the source and one on the target, that a person says are the same."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike

import numpy as np
from numpy.typing import ArrayLike

from mixseq.arrays import Index
from mixseq.errors import SettingsError


@dataclass(frozen=True, eq=False)
class Markers:
    """Pairs of vertices.

    Attributes
    ----------
    source, target : (n,) int64
        Vertices of the source and of the target; those of one row are a pair.
    names : tuple of str
        What messages call them: one each, or none. Those without a name, or an empty one, are numbered from 1.
    """

    source: Index
    target: Index
    names: tuple[str, ...] = ()

    @classmethod
    def of(cls, pairs: ArrayLike, names: tuple[str, ...] = ()) -> Markers:
        """Make markers of pairs ``(n, 2)`` of whole numbers: source, target.

        Raises
        ------
        SettingsError
            If they are no pairs of whole numbers, or there are more or fewer names.
        """
        try:
            table = np.asarray(pairs)
            table = table.reshape(-1, 2) if table.size == 0 else table
            whole = table.astype(np.int64)
        except (TypeError, ValueError):
            if isinstance(pairs, str | PathLike):
                raise SettingsError(
                    f"markers are the name of a file, {str(pairs)!r}; read it with mixseq.read_markers"
                ) from None
            raise SettingsError(
                "markers are no pairs of vertices; (n, 2) whole numbers are expected"
            ) from None
        if table.ndim != 2 or table.shape[1] != 2 or not np.array_equal(whole, table):
            raise SettingsError(
                f"markers have shape {table.shape}; (n, 2) whole numbers, source and target, are expected"
            )
        if names and len(names) != len(whole):
            raise SettingsError(
                f"there are {len(whole)} markers and {len(names)} names; give one each, or none"
            )
        return cls(whole[:, 0].copy(), whole[:, 1].copy(), names)

    def __len__(self) -> int:
        return len(self.source)

    def name(self, number: int) -> str:
        """What a message calls a marker: its name if it has one, and its pair of vertices."""
        name = self.names[number] if self.names else ""
        called = f"'{name}'" if name else f"{number + 1}"
        return f"{called} ({self.source[number]} -> {self.target[number]})"
