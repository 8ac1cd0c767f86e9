"""A trial: one compression with a given step, and the bytes and the error it comes to.

The spatial basis is rounded first. The coefficients are then those nearest to the sequence with the basis *as a decoder
has it*, which makes good for some of the error of rounding; then they are rounded.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Float, Index
from mixseq.coding.bitstream.compressed_sequence import Chunk
from mixseq.coding.bitstream.part_labels import write_labels
from mixseq.coding.bitstream.signal_coder import NumberModels, SignalCoder, Writer
from mixseq.coding.bitstream.signal_graph import SignalGraph
from mixseq.coding.bitstream.spatial_basis import (
    Part,
    SpatialBasis,
    assemble_basis,
    coefficient_coders,
    groups_of_parts,
    parts_of,
    whole,
)
from mixseq.coding.encoder.part_components import PartComponents
from mixseq.coding.encoder.principal_components import PrincipalComponents
from mixseq.frame_store import FrameStore, block_size, blocks_of
from mixseq.mapping import on_threads

CHUNK, FEWEST = 512, 16
"""A chunk has about so many frames by default, and as few at least."""

FINER = 0.35
"""Bytes of a vertex that is coded late, relative to the mean of those before it: it is predicted better."""

DIGITS = 1e-10
"""Squared errors below this share of the squared motion are measured of frames: others have lost too many digits."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A way to code a sequence: with its components, of one kind, and with these parts.

    Attributes
    ----------
    components : PrincipalComponents
        Of the whole mesh.
    parts : tuple of PartComponents
        Of every part.
    graph : SignalGraph
        Of the whole mesh.
    labels : (V,) int64
        Part of every vertex.
    share : float
        Share of a larger mesh that these vertices are.
    """

    components: PrincipalComponents
    parts: tuple[PartComponents, ...]
    graph: SignalGraph
    labels: Index
    share: float = 1.0

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
        """Make one with parts by labels ``(V,)``; components of parts with a norm below `least` left out."""
        parts = parts_of(labels, faces) if labels.any() else whole(graph)
        found = tuple(on_threads()(_components_of, (components, least), parts))
        return cls(components, found, graph, labels, share)


def _components_of(known: tuple[PrincipalComponents, float], part: Part) -> PartComponents:
    components, least = known
    return PartComponents(components, part, least)


@dataclass(frozen=True, eq=False)
class Trial:
    """A sequence, coded with one step.

    Attributes
    ----------
    candidate : Candidate
        How it was coded.
    step : float
        The step, in the units of the sequence.
    ranks : tuple of int
        Number of basis vectors of every part that were coded; those that are zero are not in the basis.
    basis : SpatialBasis
        The basis as a decoder has it.
    coefficients : (T, K, d) float64
        Its coefficients as a decoder has them.
    basis_streams : tuple of bytes
        Streams of its groups.
    chunks : tuple of Chunk
        Streams of the coefficients and, if there is a bound, of the residual layer.
    error : float
        Root of the sum of all squared distances, without the residual layer.
    bound : float, optional
        What the residual layer is for.
    """

    candidate: Candidate
    step: float
    ranks: tuple[int, ...]
    basis: SpatialBasis
    coefficients: Float
    basis_streams: tuple[bytes, ...]
    chunks: tuple[Chunk, ...]
    error: float
    bound: float | None = None

    @property
    def signals(self) -> int:
        """Number of bytes without the residual layer."""
        return self.size - sum(len(chunk.residuals) for chunk in self.chunks)

    @property
    def basis_size(self) -> int:
        """Number of bytes of the basis; if the vertices are a share of a larger mesh, about those of that."""
        finer = FINER * (1 / self.candidate.share - 1)
        return round((1 + finer) * sum(map(len, self.basis_streams)))

    @cached_property
    def size(self) -> int:
        """Number of bytes; if the vertices are a share of a larger mesh, about those of that."""
        return self.basis_size + sum(len(chunk.coefficients) + len(chunk.residuals) for chunk in self.chunks)


def try_step(sequence: FrameStore, candidate: Candidate, step: float, chunk: int = CHUNK) -> Trial:
    """Code a sequence.

    Parameters
    ----------
    sequence : FrameStore
        The sequence.
    candidate : Candidate
        What is known of it, and how it is to be coded.
    step : float
        Quantisation step, in the units of the sequence.
    chunk : int
        A chunk has about so many frames.
    """
    vectors, basis_streams = write_basis(candidate, step)
    parts = [one.part.vertices for one in candidate.parts]
    basis = assemble_basis(candidate.components.kind, vectors, parts, len(sequence.points))
    fits = [part.fitted(block) for part, block in zip(candidate.parts, basis.blocks, strict=True)]
    scales, owners = _varying(basis)
    # Vectors over the larger mesh would be longer: their coefficients are as accurate as they would be then.
    longer = candidate.share**-0.5
    nearest = in_order(basis, [fit.coefficients for fit in fits])
    decoded, streams = write_coefficients(basis, nearest * (longer / scales[:, None]), step, chunk)
    moved = decoded * (scales[:, None] / longer)
    squares = candidate.components.left_out
    for place, fit in enumerate(fits):
        squares += fit.squares_of(moved[:, owners == place].transpose(1, 0, 2)) / candidate.share
    if squares <= DIGITS * np.square(candidate.components.norms).sum() and candidate.share == 1:
        squares = squared_error(sequence, basis, decoded)
    done = tuple(
        Chunk(frames.start, len(frames), stream)
        for frames, stream in zip(chunks(len(decoded), chunk), streams, strict=True)
    )
    ranks = tuple(map(len, vectors))
    error = float(np.sqrt(max(squares, 0.0)))
    return Trial(candidate, step, ranks, basis, decoded, basis_streams, done, error)


def chunks(frame_count: int, size: int = CHUNK) -> list[range]:
    """Return the frames of every chunk, about so many."""
    number = max(1, round(frame_count / size))
    ends = [frame_count * place // number for place in range(number + 1)]
    return [range(a, b) for a, b in pairwise(ends)]


def write_basis(candidate: Candidate, step: float) -> tuple[list[Float], tuple[bytes, ...]]:
    """Code the components of every part until they are zero, as `read_basis` reads them.

    Returns
    -------
    vectors : list of (K, c, n) float64
        Basis vectors of every part as a decoder has them, without the constant one of trajectories.
    streams : tuple of bytes
        Streams of the groups.
    """
    parts, models, streams = candidate.parts, NumberModels(), []
    ranks, coders = [one.rank(step) for one in parts], dict[int, SignalCoder]()
    vectors: list[list[Float]] = [[] for _ in parts]
    for number, of_parts in enumerate(groups_of_parts(ranks)):
        writer = Writer()
        if number == 0 and len(parts) > 1:
            write_labels(writer, candidate.labels, candidate.graph)
        for place, group in of_parts:
            one = parts[place]
            coder = coders.pop(place, None) or SignalCoder(one.part.graph, one.coordinates, models)
            for row in range(group.start, group.stop):
                numbers = one.vector(row) / step
                vectors[place].append(np.stack([coder.write(writer, each) for each in numbers]))
            if (
                group.stop < ranks[place]
            ):  # a coder takes more than a kilobyte a vertex: none is kept that is done
                coders[place] = coder
            del coder
        streams.append(writer.finish())
    return [step * np.array(some) for some in vectors], tuple(streams)


def _varying(basis: SpatialBasis) -> tuple[Float, Index]:
    """Return norms ``(K,)`` and parts ``(K,)`` of the vectors whose coefficients are coded."""
    return basis.norms[basis.varying], basis.parts[basis.varying]


def in_order(basis: SpatialBasis, coefficients: Sequence[Float]) -> Float:
    """Return coefficients ``(K, T, d)`` of all parts in the order in which they are coded, ``(T, K, d)``."""
    owners = basis.parts[basis.varying]
    ordered = np.empty((len(owners), *coefficients[0].shape[1:]))
    for place, some in enumerate(coefficients):
        ordered[owners == place] = some
    return ordered.transpose(1, 0, 2)


def write_coefficients(
    basis: SpatialBasis, coefficients: Float, step: float, size: int = CHUNK
) -> tuple[Float, list[bytes]]:
    """Code coefficients ``(T, K, d)``; return them as decoders have them, and a stream for every chunk."""
    scales, owners = _varying(basis)
    scales = scales / step
    decoded = np.empty_like(coefficients)
    streams = []
    for chunk in chunks(len(coefficients), size):
        writer, coders = Writer(), coefficient_coders(basis, len(chunk))
        frames = slice(chunk.start, chunk.stop)
        for place, coordinate in np.ndindex(coefficients.shape[1:]):
            numbers = coefficients[frames, place, coordinate] * scales[place]
            decoded[frames, place, coordinate] = coders[owners[place]].write(writer, numbers) / scales[place]
        streams.append(writer.finish())
    return decoded, streams


def squared_error(sequence: FrameStore, basis: SpatialBasis, coefficients: Float) -> float:
    """Return the sum of all squared distances of decoded frames from those of a sequence."""
    blocks = zip(blocks_of(sequence.points), decoded_blocks(basis, coefficients), strict=True)
    return sum(float(np.square(points - block).sum()) for points, block in blocks)


def decoded_blocks(basis: SpatialBasis, coefficients: Float) -> Iterator[Float]:
    """Yield the frames of coefficients in blocks of those of `mixseq.frame_store.blocks_of`."""
    size = block_size(basis.vertex_count)
    for start in range(0, len(coefficients), size):
        yield basis.frames(coefficients[start : start + size])
