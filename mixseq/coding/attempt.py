"""One compression with a given step, and what came of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Float
from mixseq.coding.basis import Basis
from mixseq.coding.coded import Chunk
from mixseq.coding.corrections import needed, write_corrections
from mixseq.coding.factors import Factors
from mixseq.coding.graph import SignalGraph
from mixseq.coding.parts import Part
from mixseq.coding.streams import basis_of, chunks, write_fields, write_tracks
from mixseq.frame_store import FrameStore, blocks_of


@dataclass(frozen=True, eq=False)
class Attempt:
    """A sequence, coded with one step.

    Attributes
    ----------
    step : float
        The step.
    ranks : tuple of int
        Number of fields of every part that were coded; those that are zero are not in the basis.
    basis : Basis
        Fields as a decoder has them.
    tracks : (T, K, d) float64
        Tracks as a decoder has them.
    fields : tuple of bytes
        Streams of the fields.
    chunks : tuple of Chunk
        Streams of the tracks and, if there is a bound, of the corrections.
    error : float
        Root of the sum of all squared distances, without corrections.
    bound : float, optional
        What corrections are for.
    """

    step: float
    ranks: tuple[int, ...]
    basis: Basis
    tracks: Float
    fields: tuple[bytes, ...]
    chunks: tuple[Chunk, ...]
    error: float
    bound: float | None = None

    @cached_property
    def size(self) -> int:
        """Number of bytes."""
        return sum(map(len, self.fields)) + sum(len(c.tracks) + len(c.corrections) for c in self.chunks)


def attempt(
    sequence: FrameStore,
    factors: Sequence[Factors],
    step: float,
    parts: Sequence[Part],
    graph: SignalGraph,
    bound: float | None = None,
    dry: bool = False,
) -> Attempt:
    """Code a sequence.

    Parameters
    ----------
    sequence : FrameStore
        The sequence.
    factors : sequence of Factors
        The fields of every part, all of one kind.
    step : float
        Quantisation step, in the units of the sequence.
    parts : sequence of Part
        The parts of the mesh.
    graph : SignalGraph
        Of its mesh.
    bound : float, optional
        Largest distance of a vertex, in the units of the sequence; by default there are no corrections.
    dry : bool
        Leave out the coding: only the error counts.
    """
    decoded, fields = write_fields(factors, step, parts, graph, dry)
    basis = basis_of(factors[0].name, decoded, parts, len(sequence.points))
    # Nearest to the sequence with the fields that decoders have: that makes good some of what rounding spoiled.
    tracks, streams = write_tracks(basis, basis.fit(sequence), step, dry)
    squares = 0.0
    for points, block in zip(blocks_of(sequence.points), basis.blocks(tracks), strict=True):
        squares += float(np.square(points - block).sum())
    done = []
    for frames, stream in zip(chunks(len(tracks)), streams, strict=True):
        corrections = b"" if bound is None else _corrections(sequence, basis, tracks, frames, bound, graph)
        done.append(Chunk(frames.start, len(frames), stream, corrections))
    return Attempt(
        step, tuple(map(len, decoded)), basis, tracks, fields, tuple(done), float(np.sqrt(squares)), bound
    )


def _corrections(
    sequence: FrameStore, basis: Basis, tracks: Float, frames: range, bound: float, graph: SignalGraph
) -> bytes:
    def numbers(frame: int) -> NDArray[np.int64]:
        one = slice(frame, frame + 1)
        apart = np.asarray(sequence.points[one] - basis.frames(tracks[one]))
        return np.asarray(needed(apart, bound)[0])

    return write_corrections((numbers(frame) for frame in frames), graph)
