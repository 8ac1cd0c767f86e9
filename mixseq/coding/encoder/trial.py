"""A trial: one compression with a given step, its bytes and its error.

The spatial basis is rounded first. The coefficients are then fitted to the sequence with the *decoded* basis, which
compensates some of the rounding error; then they are rounded.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Float, Index
from mixseq.coding.bitstream.compressed_sequence import Chunk
from mixseq.coding.bitstream.signal_coder import Signal
from mixseq.coding.bitstream.signal_graph import SignalGraph
from mixseq.coding.bitstream.spatial_basis import Part, SpatialBasis, assemble_basis, parts_of, whole
from mixseq.coding.encoder.part_components import PartComponents
from mixseq.coding.encoder.principal_components import PrincipalComponents
from mixseq.coding.encoder.rounding import (
    CHUNK,
    RoundedPart,
    chunks,
    code_basis,
    code_coefficients,
    round_basis,
    round_coefficients,
)
from mixseq.frame_store import FrameStore, block_size, blocks_of
from mixseq.mapping import on_threads, on_two_threads

FINER = 0.35
"""Bytes of a late-coded vertex, relative to the mean of those before it: it is predicted better."""

MANY = 1 << 22
"""Count of numbers above which signals are coded at once, asked for or not: pending ones take 20 bytes each."""

DIGITS = 1e-10
"""Share of the squared motion below which squared errors are measured on frames, as algebra loses too many digits."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A way to code a sequence: its components, of one kind, and its parts."""

    components: PrincipalComponents  # principal components of the whole mesh
    parts: tuple[PartComponents, ...]  # principal components of every part
    graph: SignalGraph  # prediction graph of the whole mesh
    labels: Index  # (V,) part of every vertex
    share: float = 1.0  # these vertices' share of a larger mesh

    @classmethod
    def of(
        cls,
        components: PrincipalComponents,
        labels: Index,
        faces: NDArray[np.integer],
        graph: SignalGraph,
        least: float = 0.0,
        share: float = 1.0,
    ) -> Candidate:
        """Make a candidate with parts by labels ``(V,)``, without components of parts with a norm below `least`."""
        parts = parts_of(labels, faces) if labels.any() else whole(graph)
        found = tuple(on_two_threads()(_components_of, (components, least), parts))
        return cls(components, found, graph, labels, share)


def _components_of(known: tuple[PrincipalComponents, float], part: Part) -> PartComponents:
    components, least = known
    return PartComponents(components, part, least)


class Streams(NamedTuple):
    """Bytes of the groups of a basis, and of the coefficients in every chunk."""

    basis: tuple[bytes, ...]
    coefficients: tuple[bytes, ...]


class Coding:
    """The streams of rounded signals, made when first asked for."""

    def __init__(self, candidate: Candidate, basis: list[RoundedPart], chunks: list[list[Signal]]) -> None:
        self._work: list[Callable[[], Any]] = [
            partial(code_basis, basis, candidate.labels, candidate.graph),
            *(partial(code_coefficients, signals) for signals in chunks),
        ]

    @cached_property
    def streams(self) -> Streams:
        """The streams, made in parallel."""
        basis, *coefficients = on_threads()(_result_of, None, self._work)
        self._work = []  # signals take the most memory of a trial
        return Streams(basis, tuple(coefficients))


def _result_of(_: None, work: Callable[[], Any]) -> Any:
    return work()


@dataclass(frozen=True, eq=False)
class Trial:
    """A sequence, rounded with one step."""

    candidate: Candidate  # the way it is coded
    step: float  # the step, in the units of the sequence
    # Number of coded basis vectors of every part, with zero ones, which are not in the basis.
    ranks: tuple[int, ...]
    basis: SpatialBasis  # the decoded basis
    coefficients: Float  # (T, K, d) its decoded coefficients
    spans: tuple[range, ...]  # frames of every chunk
    coding: Coding  # streams of both
    error: float  # root of the sum of all squared distances, without the residual layer
    residuals: tuple[bytes, ...] = ()  # the residual layer of every chunk, if there is a bound
    bound: float | None = None  # bound of the residual layer

    @property
    def chunks(self) -> tuple[Chunk, ...]:
        """Streams of the chunks."""
        residuals = self.residuals or (b"",) * len(self.spans)
        return tuple(
            Chunk(frames.start, len(frames), stream, rest)
            for frames, stream, rest in zip(
                self.spans, self.coding.streams.coefficients, residuals, strict=True
            )
        )

    @property
    def signals(self) -> int:
        """Number of bytes without the residual layer."""
        return self.basis_size + sum(map(len, self.coding.streams.coefficients))

    @property
    def basis_size(self) -> int:
        """Number of bytes of the basis; for a share of a larger mesh, about those of the whole."""
        finer = FINER * (1 / self.candidate.share - 1)
        return round((1 + finer) * sum(map(len, self.coding.streams.basis)))

    @property
    def size(self) -> int:
        """Number of bytes; for a share of a larger mesh, about those of the whole."""
        return self.signals + sum(map(len, self.residuals))


def try_step(sequence: FrameStore, candidate: Candidate, step: float, chunk: int = CHUNK) -> Trial:
    """Round a sequence with one step."""
    rounded = round_basis(candidate.parts, step)
    vectors = [part.vectors for part in rounded]
    parts = [one.part.vertices for one in candidate.parts]
    basis = assemble_basis(candidate.components.kind, vectors, parts, len(sequence.points))
    fits = [part.fitted(block) for part, block in zip(candidate.parts, basis.blocks, strict=True)]
    scales, owners = basis.norms[basis.varying], basis.parts[basis.varying]
    # Vectors over the larger mesh are longer: coefficients get the accuracy that they would have there.
    longer = candidate.share**-0.5
    nearest = in_order(basis, [fit.coefficients for fit in fits])
    decoded, signals = round_coefficients(basis, nearest * (longer / scales[:, None]), step, chunk)
    moved = decoded * (scales[:, None] / longer)
    squares = candidate.components.left_out
    for place, fit in enumerate(fits):
        squares += fit.squares_of(moved[:, owners == place].transpose(1, 0, 2)) / candidate.share
    if squares <= DIGITS * np.square(candidate.components.norms).sum() and candidate.share == 1:
        squares = squared_error(sequence, basis, decoded)
    ranks = tuple(map(len, vectors))
    error = float(np.sqrt(max(squares, 0.0)))
    spans, coding = tuple(chunks(len(decoded), chunk)), Coding(candidate, rounded, signals)
    if sum(part.vectors.size for part in rounded) + decoded.size > MANY:
        _ = coding.streams
    return Trial(candidate, step, ranks, basis, decoded, spans, coding, error)


def in_order(basis: SpatialBasis, coefficients: Sequence[Float]) -> Float:
    """Return coefficients ``(K, T, d)`` of all parts in coding order, ``(T, K, d)``."""
    owners = basis.parts[basis.varying]
    ordered = np.empty((len(owners), *coefficients[0].shape[1:]))
    for place, some in enumerate(coefficients):
        ordered[owners == place] = some
    return ordered.transpose(1, 0, 2)


def squared_error(sequence: FrameStore, basis: SpatialBasis, coefficients: Float) -> float:
    """Return the sum of all squared distances of decoded frames from those of a sequence."""
    blocks = zip(blocks_of(sequence.points), decoded_blocks(basis, coefficients), strict=True)
    return sum(float(np.square(points - block).sum()) for points, block in blocks)


def decoded_blocks(basis: SpatialBasis, coefficients: Float) -> Iterator[Float]:
    """Yield decoded frames of coefficients in the blocks of `mixseq.frame_store.blocks_of`."""
    size = block_size(basis.vertex_count)
    for start in range(0, len(coefficients), size):
        yield basis.frames(coefficients[start : start + size])
