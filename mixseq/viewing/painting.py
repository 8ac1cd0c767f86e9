"""Which colours meshes can have, worked out when they are first asked for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Single
from mixseq.errors import SettingsError
from mixseq.frame_store import FrameStore
from mixseq.sequence import SequenceHeader
from mixseq.signals import Model
from mixseq.viewing.colouring import Colouring, clay, colourings_of
from mixseq.viewing.shown import Item, Shot

Bytes = NDArray[np.uint8]

SAMPLES = 12
"""So many frames tell how far the scales go."""


@dataclass(frozen=True, eq=False)
class Paint:
    """The colours of all meshes of a shot.

    Attributes
    ----------
    shot : Shot
        As it was opened: edits are measured against the first frames that it had then.
    original : FrameStore, optional
        What errors are measured against.
    """

    shot: Shot
    original: FrameStore | None = None
    _found: dict[int, dict[str, Colouring]] = field(default_factory=dict, init=False, repr=False)

    @cached_property
    def _plain(self) -> list[Colouring]:
        return [clay(item.header.vertex_count) for item in self.shot.items]

    @cached_property
    def names(self) -> tuple[str, ...]:
        """What colours may show, of one mesh at least."""
        some_parts = any(_decomposed(item) for item in self.shot.items)
        some_errors = any(self._reference(item) is not None for item in self.shot.items)
        return (
            "clay",
            *(["parts"] if some_parts else []),
            *(["error"] if some_errors else []),
            "strain",
            "curvature",
        )

    def of(self, index: int, name: str) -> Colouring:
        """Return what colours show of a mesh: clay, where the mesh has no such colours."""
        if name == "clay":  # the first colour that is seen, and all others take time
            return self._plain[index]
        return self.each(index).get(name, self._plain[index])

    def each(self, index: int) -> dict[str, Colouring]:
        """Return all colours that a mesh can have."""
        if index not in self._found:
            self._found[index] = self._colourings(index)
        return self._found[index]

    def shared(self, name: str) -> list[Colouring]:
        """Return the colours of all meshes, with one scale."""
        each = [self.of(index, name) for index in range(len(self.shot.items))]
        tops = [one.top for one in each if not one.constant]
        return [one if one.constant else one.scaled(max(tops)) for one in each]

    def _colourings(self, index: int) -> dict[str, Colouring]:
        item = self.shot.items[index]
        moments = (self.shot.elapsed(frame) for frame in self.shot.spread(SAMPLES))
        parts = item.motion.decomposition if _decomposed(item) and isinstance(item.motion, Model) else None
        return colourings_of(
            item.header,
            item.pose(0.0),
            parts,
            self._reference(item),
            ((elapsed, item.pose(elapsed)) for elapsed in moments),
        )

    def _reference(self, item: Item) -> Callable[[float], Single] | None:
        """Return the original's points at elapsed times, if it is the same mesh."""
        if self.original is None or not _same_mesh(self.original.header, item.header):
            return None
        return Item("the original", self.original).pose


def check_original(shot: Shot, original: FrameStore) -> None:
    """Refuse an original that is of no use.

    Raises
    ------
    SettingsError
        If no mesh of the shot has its vertices and triangles, or one that has them begins at another time.
    """
    header = original.header
    same = [item for item in shot.items if _same_mesh(item.header, header)]
    if not same:
        raise SettingsError(
            f"none of the meshes has the {header.vertex_count} vertices and {len(header.faces)} triangles of the "
            "original; errors need one mesh"
        )
    for item in same:
        if abs(item.header.times[0] - header.times[0]) > 1e-3 / header.fps:
            raise SettingsError(
                f"{item.name} begins at {item.header.times[0]:g} s, the original at {header.times[0]:g} s; errors need "
                "the same times"
            )


def _same_mesh(one: SequenceHeader, other: SequenceHeader) -> bool:
    return one.vertex_count == other.vertex_count and np.array_equal(one.faces, other.faces)


def _decomposed(item: Item) -> bool:
    return isinstance(item.motion, Model) and item.motion.space.decomposed is not None
