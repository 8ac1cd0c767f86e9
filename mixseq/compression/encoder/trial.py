"""A trial: one compression with a given step, its bytes and its error.

The spatial basis is rounded first. The coefficients are then fitted to the sequence with the *decoded* basis, which
compensates some of the rounding error; then they are rounded. If there is a bound, residuals are displacements where
decoded frames are farther than it from the original.

Parts are independent, and two are rounded at a time, to limit memory. Rounding determines the error of a trial; its
bytes take as long again, and are made on demand by `code_basis` and `code_coefficients`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixseq.compression.bitstream.compressed_sequence import Chunk
from mixseq.compression.bitstream.residual_layer import write_residuals
from mixseq.compression.bitstream.signal_coder import NumberModels, Signal, SignalCoder, Writer
from mixseq.compression.bitstream.signal_graph import SignalGraph, path_graph
from mixseq.compression.bitstream.spatial_basis import (
    Part,
    SpatialBasis,
    assemble_basis,
    groups_of_parts,
    parts_of,
    whole,
    write_labels,
)
from mixseq.compression.encoder.components import PartComponents, PrincipalComponents
from mixseq.runtime.parallel import thread_executor, two_thread_executor
from mixseq.sequence.sequence import FrameStore, block_size, iterate_blocks
from mixseq.types import Float, Index

CHUNK, FEWEST = 512, 16
"""Number of frames in a chunk by default, approximately, and smallest number."""


class RoundedPart(NamedTuple):
    """Decoded basis vectors ``(K, c, n)`` of a part, and their ``K c`` signals for coding."""

    vectors: Float
    signals: list[Signal]


def round_basis(parts: Sequence[PartComponents], step: float) -> list[RoundedPart]:
    """Round the components of every part until they vanish, without the constant one of trajectories."""
    return list(two_thread_executor()(_round_part, step, parts))


def _round_part(step: float, part: PartComponents) -> RoundedPart:
    coder, signals, rank = SignalCoder(part.part.graph, part.coordinates), list[Signal](), part.rank(step)
    vectors = np.empty((rank, part.coordinates, part.part.graph.size))
    for place, coordinate in np.ndindex(vectors.shape[:2]):
        vectors[place, coordinate], signal = coder.round(part.vector(place)[coordinate] / step)
        signals.append(signal)
    return RoundedPart(step * vectors, signals)


def code_basis(rounded: Sequence[RoundedPart], labels: Index, graph: SignalGraph) -> tuple[bytes, ...]:
    """Return the streams of the groups of a basis, as `read_basis` reads them: labels ``(V,)``."""
    models, streams = NumberModels(), []
    for number, of_parts in enumerate(groups_of_parts([len(part.vectors) for part in rounded])):
        writer = Writer()
        if number == 0 and len(rounded) > 1:
            write_labels(writer, labels, graph)
        for place, group in of_parts:
            coordinates = rounded[place].vectors.shape[1]
            for signal in rounded[place].signals[coordinates * group.start : coordinates * group.stop]:
                writer.write(signal, models)
        streams.append(writer.finish())
    return tuple(streams)


def chunks(frame_count: int, size: int = CHUNK) -> list[range]:
    """Return the frames of every chunk of about `size` frames."""
    number = max(1, round(frame_count / size))
    ends = [frame_count * place // number for place in range(number + 1)]
    return [range(a, b) for a, b in pairwise(ends)]


def round_coefficients(
    basis: SpatialBasis, coefficients: Float, step: float, size: int = CHUNK
) -> tuple[Float, list[list[Signal]]]:
    """Round coefficients ``(T, K, d)`` of the vectors that vary."""
    scales, owners = basis.norms[basis.varying] / step, basis.parts[basis.varying]
    decoded, spans = np.empty_like(coefficients), chunks(len(coefficients), size)
    numbers = coefficients * scales[:, None]
    of_parts = [np.flatnonzero(owners == part) for part in range(len(basis.blocks))]
    work = [(frames, places) for frames in spans for places in of_parts]
    signals: list[list[Signal]] = []
    for (frames, places), (values, some) in zip(
        work, two_thread_executor()(_round_chunk, numbers, work), strict=True
    ):
        decoded[frames.start : frames.stop, places] = values / scales[places, None]
        signals.append(some)
    order = np.argsort(np.concatenate(of_parts), kind="stable")
    dim, count = coefficients.shape[2], len(of_parts)
    in_turn = []
    for first in range(0, len(signals), count):
        ready = [signal for some in signals[first : first + count] for signal in some]
        in_turn.append([ready[dim * place + coordinate] for place in order for coordinate in range(dim)])
    return decoded, in_turn


def _round_chunk(numbers: Float, work: tuple[range, Index]) -> tuple[Float, list[Signal]]:
    """Round the numbers ``(T, K, d)`` of one part, those ``(n,)`` of its vectors, in the frames of a chunk."""
    frames, places = work
    some = numbers[frames.start : frames.stop, places]
    coder, signals = SignalCoder(path_graph(len(frames)), some.shape[2]), list[Signal]()
    values = np.empty_like(some)
    for place, coordinate in np.ndindex(some.shape[1:]):
        values[:, place, coordinate], signal = coder.round(some[:, place, coordinate])
        signals.append(signal)
    return values, signals


def code_coefficients(signals: Sequence[Signal]) -> bytes:
    """Return the stream of a chunk, as `read_coefficients` reads it."""
    models, writer = NumberModels(), Writer()
    for signal in signals:
        writer.write(signal, models)
    return writer.finish()


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
        found = tuple(two_thread_executor()(_components_of, (components, least), parts))
        return cls(components, found, graph, labels, share)


def _components_of(known: tuple[PrincipalComponents, float], part: Part) -> PartComponents:
    return PartComponents(known[0], part, known[1])


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
        basis, *coefficients = thread_executor()(_result_of, None, self._work)
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
    blocks = zip(iterate_blocks(sequence.points), decoded_blocks(basis, coefficients), strict=True)
    return sum(float(np.square(points - block).sum()) for points, block in blocks)


def decoded_blocks(basis: SpatialBasis, coefficients: Float) -> Iterator[Float]:
    """Yield decoded frames of coefficients in the blocks of `mixseq.sequence.sequence.iterate_blocks`."""
    size = block_size(basis.vertex_count)
    for start in range(0, len(coefficients), size):
        yield basis.frames(coefficients[start : start + size])


def width(bound: float) -> float:
    """Return the unit w of the residual layer for a bound, both in the units of the sequence."""
    return float(2.0 * bound / np.sqrt(3.0))


def needed(apart: Float, bound: float) -> Index:
    r"""Return the residuals ``(T, V, 3)`` that bring differences ``(T, V, 3)`` within a bound :math:`\varepsilon`.

    Where a difference exceeds the bound, it is rounded to multiples of :math:`w = 2 \varepsilon / \sqrt 3` in every
    coordinate, which leaves at most :math:`w / 2` in each, so :math:`\varepsilon` in all. Elsewhere residuals are zero.
    """
    far = np.einsum("tvi,tvi->tv", apart, apart) > bound * bound
    return np.where(far[..., None], np.rint(apart / width(bound)), 0.0).astype(np.int64)


def with_residuals(sequence: FrameStore, trial: Trial, bound: float) -> Trial:
    """Return a trial with the residual layer that keeps a bound, in the units of the sequence."""

    def numbers(frame: int) -> NDArray[np.int64]:
        one = slice(frame, frame + 1)
        apart = np.asarray(sequence.points[one] - trial.basis.frames(trial.coefficients[one]))
        return np.asarray(needed(apart, bound)[0])

    layers = (write_residuals(numbers, frames, trial.candidate.graph) for frames in trial.spans)
    return replace(trial, residuals=tuple(layers), bound=bound)
