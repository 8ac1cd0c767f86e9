"""Compress a sequence once with a given step (a trial), and determine the number of bytes and the error.

The spatial basis is rounded first. The coefficients are then fitted to the sequence with the *decoded* basis, which
compensates some of the rounding error, and rounded as well. If there is a bound, residuals correct the vertices whose
decoded errors exceed it.

Parts are independent. Two are rounded at a time, and coded meanwhile: rounded signals take more memory than the basis.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixseq.compression.bitstream.compressed_sequence import Chunk
from mixseq.compression.bitstream.residual_layer import write_residuals
from mixseq.compression.bitstream.signal_coder import Signal, SignalCoder, Writer, new_number_models
from mixseq.compression.bitstream.signal_graph import SignalGraph, path_graph
from mixseq.compression.bitstream.spatial_basis import (
    FIRST_GROUP_SIZE,
    MAX_NORM,
    Part,
    SpatialBasis,
    assemble_basis,
    part_groups,
    split_parts,
    write_labels,
)
from mixseq.compression.encoder.components import PartComponents, PrincipalComponents
from mixseq.errors import InvalidSequenceError
from mixseq.runtime.parallel import thread_executor, two_thread_executor
from mixseq.sequence.sequence import FrameStore, block_size, iterate_blocks
from mixseq.types import Float, Index

DEFAULT_CHUNK_FRAMES, MIN_CHUNK_FRAMES = 512, 16  # default and smallest approximate number of frames in a chunk


class RoundedPart(NamedTuple):
    """Decoded basis vectors ``(K, c, n)`` of a part, and their ``K c`` signals for coding."""

    vectors: Float
    signals: list[Signal]


def round_basis(parts: Sequence[PartComponents], step: float) -> Iterator[RoundedPart]:
    """Round the components of every part until they vanish; the constant vector of trajectories is not included."""
    return two_thread_executor()(_round_part, step, parts)


def _round_part(step: float, part: PartComponents) -> RoundedPart:
    shape = part.rank(step), part.coordinates
    values, signals = _round_vectors(part.part.graph, shape, lambda k: part.vector(k) / step)
    part.free_vectors()
    values *= step
    return RoundedPart(values, signals)


def _round_vectors(
    graph: SignalGraph, shape: tuple[int, int], vector_of: Callable[[int], Float]
) -> tuple[Float, list[Signal]]:
    """Round K vectors ``(c, N)``, in steps, for a shape ``(K, c)``; return their values ``(K, c, N)`` and signals."""
    coder, signals = SignalCoder(graph, shape[1]), list[Signal]()
    values = np.empty((*shape, graph.size))
    for k in range(shape[0]):
        for coordinate, target in enumerate(vector_of(k)):
            values[k, coordinate], signal = coder.round(target)
            signals.append(signal)
    return values, signals


def code_basis(
    signals: Iterable[list[Signal]], coordinates: int, labels: Index, graph: SignalGraph
) -> tuple[bytes, ...]:
    """Code the signals of every part, and the labels ``(V,)`` of vertices; return all groups for `read_basis`.

    The signals of the first group, often all, are coded as they come. Lists of signals are emptied.
    """
    models, writer, later = new_number_models(), Writer(), list[list[Signal]]()
    if labels.any():
        write_labels(writer, labels, graph)

    def write_first(signals: list[Signal], count: int) -> None:
        for signal in signals[:count]:
            writer.write(signal, models)
        del signals[:count]

    for of_part in signals:
        write_first(of_part, coordinates * FIRST_GROUP_SIZE)
        later.append(of_part)
    streams = [writer.finish()]
    for group in part_groups([FIRST_GROUP_SIZE + len(of_part) // coordinates for of_part in later])[1:]:
        writer = Writer()
        for part, vectors in group:
            write_first(later[part], coordinates * (vectors.stop - vectors.start))
        streams.append(writer.finish())
    return tuple(streams)


def chunk_ranges(frame_count: int, size: int = DEFAULT_CHUNK_FRAMES) -> list[range]:
    """Return the range of frames of every chunk, which has about `size` frames."""
    count = max(1, round(frame_count / size))
    ends = [frame_count * chunk // count for chunk in range(count + 1)]
    return [range(a, b) for a, b in pairwise(ends)]


def round_coefficients(
    basis: SpatialBasis, coefficients: Float, step: float, spans: Sequence[range]
) -> tuple[Float, list[list[Signal]]]:
    """Round coefficients ``(T, K, d)`` of the varying vectors; return decoded coefficients, and signals by chunk.

    `spans` are the ranges of the times in every chunk.
    """
    scales, part_ids = basis.norms[basis.varying] / step, basis.part_ids[basis.varying]
    decoded = np.empty_like(coefficients)
    vector_ids = [np.flatnonzero(part_ids == part) for part in range(len(basis.part_bases))]
    work = [(frames, ids) for frames in spans for ids in vector_ids]
    rounded = two_thread_executor()(_round_chunk, coefficients * scales[:, None], work)
    signals: list[list[Signal]] = []
    for (frames, ids), (values, part_signals) in zip(work, rounded, strict=True):
        decoded[frames.start : frames.stop, ids] = values.transpose(2, 0, 1) / scales[ids, None]
        signals.append(part_signals)
    order = np.argsort(np.concatenate(vector_ids), kind="stable")
    dim, part_count = coefficients.shape[2], len(vector_ids)
    chunk_signals = []
    for first in range(0, len(signals), part_count):
        by_part = list(chain.from_iterable(signals[first : first + part_count]))
        chunk_signals.append([by_part[dim * k + coordinate] for k in order for coordinate in range(dim)])
    return decoded, chunk_signals


def _round_chunk(numbers: Float, work: tuple[range, Index]) -> tuple[Float, list[Signal]]:
    """Round numbers ``(T, K, d)`` in the frames of a chunk for the vectors ``(n,)`` of a part; `work` has both."""
    frames, vector_ids = work
    chunk = numbers[frames.start : frames.stop, vector_ids].transpose(1, 2, 0)
    return _round_vectors(path_graph(len(frames)), (chunk.shape[0], chunk.shape[1]), chunk.__getitem__)


def code_coefficients(signals: Sequence[Signal]) -> bytes:
    """Code the coefficients of a chunk; return the stream for `read_coefficients`."""
    models, writer = new_number_models(), Writer()
    for signal in signals:
        writer.write(signal, models)
    return writer.finish()


LATE_VERTEX_SIZE = 0.35  # bytes per vertex outside the coarse mesh, relative to it: finer levels are predicted better
MIN_ALGEBRAIC_ERROR = 1e-10  # squared error over motion below which errors are measured on frames: sums lose digits


@dataclass(frozen=True, eq=False)
class Candidate:
    """A way to code a sequence: one kind of components, and a division of the mesh into parts."""

    components: PrincipalComponents  # principal components of the whole mesh
    parts: tuple[PartComponents, ...]  # principal components of every part
    graph: SignalGraph  # prediction graph of the whole mesh
    labels: Index  # (V,) part of every vertex
    share: float = 1.0  # ratio of these vertices to the vertices of the whole mesh

    @classmethod
    def from_labels(
        cls,
        components: PrincipalComponents,
        labels: Index,
        faces: NDArray[np.integer],
        graph: SignalGraph,
        min_norm: float = 0.0,
        share: float = 1.0,
    ) -> Candidate:
        """Make a candidate from part labels ``(V,)``; components of parts with norms below `min_norm` are dropped."""
        parts = split_parts(labels, faces) if labels.any() else [Part(np.arange(graph.size), graph)]
        of_parts = two_thread_executor()(lambda _, part: PartComponents(components, part, min_norm), None, parts)
        return cls(components, tuple(of_parts), graph, labels, share)


@dataclass(frozen=True, eq=False)
class Trial:
    """A sequence quantised with a step. Sizes are in bytes; on a coarse mesh they estimate those of the whole mesh."""

    candidate: Candidate  # components and parts of the sequence
    step: float  # quantisation step, in the units of the sequence
    # Number of coded basis vectors of every part, including zero vectors, which `basis` omits.
    ranks: tuple[int, ...]
    basis: SpatialBasis  # decoded basis
    coefficients: Float  # (T, K, d) decoded coefficients
    spans: tuple[range, ...]  # frames of every chunk
    groups: tuple[bytes, ...]  # streams of the basis
    coefficient_streams: tuple[bytes, ...]  # streams of the coefficients of every chunk
    error: float  # root of the sum of all squared distances, without the residual layer
    residuals: tuple[bytes, ...] = ()  # residual layer of every chunk, if there is a bound
    bound: float | None = None  # bound of the residual layer

    @property
    def chunks(self) -> tuple[Chunk, ...]:
        """Chunks with their frames and streams."""
        residuals = self.residuals or (b"",) * len(self.spans)
        streams = zip(self.spans, self.coefficient_streams, residuals, strict=True)
        return tuple(Chunk(frames.start, len(frames), *of_frames) for frames, *of_frames in streams)

    @property
    def basis_size(self) -> int:
        """Size of the basis."""
        late = LATE_VERTEX_SIZE * (1 / self.candidate.share - 1)
        return round((1 + late) * sum(map(len, self.groups)))

    @property
    def signal_size(self) -> int:
        """Size of the basis and the coefficients."""
        return self.basis_size + sum(map(len, self.coefficient_streams))

    @property
    def size(self) -> int:
        """Size of basis, coefficients and residual layer."""
        return self.signal_size + sum(map(len, self.residuals))


def try_step(sequence: FrameStore, candidate: Candidate, step: float, chunk: int = DEFAULT_CHUNK_FRAMES) -> Trial:
    """Round a sequence with one step."""
    vectors = list[Float]()

    def signals_of_parts() -> Iterator[list[Signal]]:
        for of_part, signals in round_basis(candidate.parts, step):
            vectors.append(of_part)
            yield signals
            del signals

    groups = code_basis(signals_of_parts(), candidate.parts[0].coordinates, candidate.labels, candidate.graph)
    ranks = tuple(map(len, vectors))
    vertices = [components.part.vertices for components in candidate.parts]
    basis = assemble_basis(candidate.components.kind, vectors, vertices, len(sequence.points))
    if not basis.norms.max(initial=0.0) < MAX_NORM:
        raise InvalidSequenceError(
            f"{sequence.header.name!r}: the mesh is {sequence.diagonal:.3g} units across, and players of compressed "
            "models compute in single precision; scale the sequence, in the program it comes from"
        )
    fits = [part.fit(part_basis) for part, part_basis in zip(candidate.parts, basis.part_bases, strict=True)]
    scales, part_ids = basis.norms[basis.varying], basis.part_ids[basis.varying]
    # Vectors over the whole mesh are longer; coefficients are rounded as accurately as for those.
    length_ratio = candidate.share**-0.5
    exact = order_coefficients(basis, [fit.coefficients for fit in fits])
    spans = tuple(chunk_ranges(len(sequence.points), chunk))
    decoded, signals = round_coefficients(basis, exact * (length_ratio / scales[:, None]), step, spans)
    unit_coefficients = decoded * (scales[:, None] / length_ratio)
    squares = candidate.components.left_out
    for part, fit in enumerate(fits):
        squares += fit.squares_of(unit_coefficients[:, part_ids == part].transpose(1, 0, 2)) / candidate.share
    motion = np.square(candidate.components.norms).sum()
    if squares <= MIN_ALGEBRAIC_ERROR * motion and candidate.share == 1:
        squares = squared_error(sequence, basis, decoded)
    error = float(np.sqrt(max(squares, 0.0)))
    coded = tuple(thread_executor()(lambda _, of_chunk: code_coefficients(of_chunk), None, signals))
    return Trial(candidate, step, ranks, basis, decoded, spans, groups, coded, error)


def order_coefficients(basis: SpatialBasis, coefficients: Sequence[Float]) -> Float:
    """Merge the coefficients ``(K, T, d)`` of every part into one array ``(T, K, d)`` in coding order."""
    part_ids = basis.part_ids[basis.varying]
    ordered = np.empty((len(part_ids), *coefficients[0].shape[1:]))
    for part, of_part in enumerate(coefficients):
        ordered[part_ids == part] = of_part
    return ordered.transpose(1, 0, 2)


def squared_error(sequence: FrameStore, basis: SpatialBasis, coefficients: Float) -> float:
    """Return the sum of all squared distances of decoded frames from the frames of a sequence."""
    blocks = zip(iterate_blocks(sequence.points), decode_blocks(basis, coefficients), strict=True)
    return sum(float(np.square(points - block).sum()) for points, block in blocks)


def decode_blocks(basis: SpatialBasis, coefficients: Float) -> Iterator[Float]:
    """Yield decoded frames of coefficients in the blocks of `mixseq.sequence.sequence.iterate_blocks`."""
    size = block_size(basis.vertex_count)
    for start in range(0, len(coefficients), size):
        yield basis.frames(coefficients[start : start + size])


def residual_unit(bound: float) -> float:
    """Return the unit w of the residual layer for a bound, both in the units of the sequence."""
    return float(2.0 * bound / np.sqrt(3.0))


def quantise_residuals(errors: Float, bound: float) -> Index:
    r"""Return the residuals ``(T, V, 3)`` that bring errors ``(T, V, 3)`` within a bound :math:`\varepsilon`.

    An error above the bound is rounded to multiples of :math:`w = 2 \varepsilon / \sqrt 3` in every coordinate. The
    remaining error is at most :math:`w / 2` per coordinate, so at most :math:`\varepsilon`. Other residuals are zero.
    """
    exceeds_mask = np.einsum("tvi,tvi->tv", errors, errors) > bound * bound
    return np.where(exceeds_mask[..., None], np.rint(errors / residual_unit(bound)), 0.0).astype(np.int64)


def add_residuals(sequence: FrameStore, trial: Trial, bound: float) -> Trial:
    """Add the residual layer that keeps a bound, in the units of the sequence, to a trial; its vectors are freed."""

    def frame_residuals(frame: int) -> Index:
        frames = slice(frame, frame + 1)
        errors = np.asarray(sequence.points[frames] - trial.basis.frames(trial.coefficients[frames]))
        return np.asarray(quantise_residuals(errors, bound)[0])

    layers = tuple(write_residuals(frame_residuals, frames, trial.candidate.graph) for frames in trial.spans)
    used = replace(trial.basis, part_bases=())  # its vectors are larger than the sequence
    return replace(trial, residuals=layers, bound=bound, basis=used)
