"""A compressed sequence: streams of bytes, and the few numbers that say how to read them."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import Literal, get_args

from mixseq.errors import SettingsError
from mixseq.sequence import SequenceHeader

FactorName = Literal["trajectories", "shapes"]


@dataclass(frozen=True)
class Chunk:
    """Consecutive frames, which can be decoded without those of other chunks.

    Attributes
    ----------
    first, count : int
        The frames: ``first`` to ``first + count - 1``.
    tracks : bytes
        The time signals at these frames.
    corrections : bytes
        What brings vertices below the bound; empty if nothing has to.
    """

    first: int
    count: int
    tracks: bytes
    corrections: bytes = b""


MOST_PARTS = 128
"""Meshes are cut into so many parts at most."""


@dataclass(frozen=True)
class CodingParameters:
    """What has to be known to decode, all of it plain numbers and strings.

    Attributes
    ----------
    factors : {"trajectories", "shapes"}
        What the fields over the mesh are: see `mixseq.coding.factors`.
    rank : int
        Number K of fields that are coded, of all parts together.
    frame_count : int
        Number T of frames that were coded; a damaged file may have fewer.
    step : float
        Quantisation step, in the units of the sequence.
    diagonal : float
        Diagonal of the bounding box of the first frame, in the units of the sequence.
    max_error : float
        Largest distance of a vertex from the original at the frames, in diagonals, measured by decoding; a promise.
    kg_percent : float
        KG error of all frames, measured.
    promised : bool
        Whether `max_error` was asked for: then it is the bound that was asked for, and corrections see to it.
    correction : float
        Unit of the corrections, in the units of the sequence; zero if there are none.
    ranks : tuple of int
        Number of fields of every part, if the mesh has several, see `mixseq.coding.parts`.

    Raises
    ------
    SettingsError
        If one of them is of another type, or out of range: somebody wrote it into a file.
    """

    factors: FactorName
    rank: int
    frame_count: int
    step: float
    diagonal: float
    max_error: float
    kg_percent: float
    promised: bool
    correction: float = 0.0
    ranks: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if self.factors not in get_args(FactorName):
            raise SettingsError(
                f"factors is {self.factors!r}; {' or '.join(get_args(FactorName))} is expected"
            )
        for name in ("rank", "frame_count"):
            value = getattr(self, name)
            if not (isinstance(value, int) and value > 0):
                raise SettingsError(f"{name} is {value!r}; a whole number above zero is expected")
        for name, sign in (
            ("step", 1),
            ("diagonal", 1),
            ("max_error", 0),
            ("kg_percent", 0),
            ("correction", 0),
        ):
            value = getattr(self, name)
            if not (isinstance(value, int | float) and 0 <= value < inf and (value or not sign)):
                raise SettingsError(
                    f"{name} is {value!r}; a {'positive' if sign else 'non-negative'} number is expected"
                )
        object.__setattr__(self, "ranks", tuple(self.ranks))
        if self.ranks and not (len(self.ranks) <= MOST_PARTS and sum(self.ranks) == self.rank):
            raise SettingsError(f"the parts have {self.ranks} fields, which are not {self.rank} in all")
        if self.ranks and self.factors == "shapes":
            raise SettingsError("shapes are of the whole mesh, not of parts")
        if any(not (isinstance(rank, int) and rank > 0) for rank in self.ranks):
            raise SettingsError(f"ranks are {self.ranks}; whole numbers above zero are expected")
        if not isinstance(self.promised, bool):
            raise SettingsError(f"promised is {self.promised!r}; true or false is expected")


@dataclass(frozen=True)
class Coded:
    """A compressed sequence, as a file holds it.

    Attributes
    ----------
    header : SequenceHeader
        Mesh and times.
    parameters : CodingParameters
        How to read the streams.
    fields : tuple of bytes
        Signals over the mesh, in groups; each group needs those before it, and makes the sequence more accurate.
    chunks : tuple of Chunk
        Signals over time: all frames, in order.
    """

    header: SequenceHeader
    parameters: CodingParameters
    fields: tuple[bytes, ...]
    chunks: tuple[Chunk, ...]
