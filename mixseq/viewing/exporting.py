"""What a page is given of a mesh, and what is told of it afterwards."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from mixseq.arrays import Float, FloatArray
from mixseq.sequence import SequenceHeader

if TYPE_CHECKING:
    from mixseq.viewing.colouring import Colouring


@dataclass(frozen=True, eq=False)
class Exported:
    """A mesh in a page.

    Attributes
    ----------
    name : str
        What stands above it.
    header : SequenceHeader
        Everything but the points.
    poses : callable
        Takes times ``(n,)`` as `elapsed` has them, yields points ``(B, V, 3)`` in blocks; see `poses_of`.
    elapsed : (n,) float64
        Times that have poses, in seconds since the first of them; increasing.
    colourings : mapping of str to Colouring
        What colours may show, the first one first.
    signals : mapping, optional
        The signals of a model, for its charts (`mixseq.viewing.signals.signals_of`).
    """

    name: str
    header: SequenceHeader
    poses: Callable[[Float], Iterable[FloatArray]]
    elapsed: Float
    colourings: Mapping[str, Colouring]
    signals: Mapping[str, Any] | None = None


@dataclass(frozen=True)
class ExportedItem:
    """What became of a mesh in a page.

    Attributes
    ----------
    name : str
        What stands above it.
    frames : int
        Stored poses.
    error : float
        No coordinate is off by more, in units of the mesh.
    positions, colours : int
        Characters of the file that its positions and its colours take.
    """

    name: str
    frames: int
    error: float
    positions: int
    colours: int
