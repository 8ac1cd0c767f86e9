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
from scipy import linalg

from mixseq.arrays import Float, Index
from mixseq.coding.bitstream.compressed_sequence import Chunk
from mixseq.coding.bitstream.entropy import Writer
from mixseq.coding.bitstream.residual_layer import write_residuals
from mixseq.coding.bitstream.signal_coder import NumberModels, PredictedSignal, SignalCoder
from mixseq.coding.bitstream.signal_graph import SignalGraph
from mixseq.coding.bitstream.spatial_basis import (
    Part,
    SpatialBasis,
    assemble_basis,
    coefficient_coders,
    groups_of_parts,
    write_labels,
)
from mixseq.coding.encoder.principal_components import PrincipalComponents
from mixseq.frame_store import FrameStore, block_size, blocks_of

CHUNK = 512
"""A chunk has about so many frames."""

ZEROS = 3
"""Basis vectors are coded until so many in a row are zero everywhere, after rounding."""


@dataclass(frozen=True, eq=False)
class Trial:
    """A sequence, coded with one step.

    Attributes
    ----------
    step : float
        The step, in the units of the sequence.
    ranks : tuple of int
        Number of basis vectors of every part that were coded; those that are zero are not in the basis.
    basis : SpatialBasis
        The basis as a decoder has it.
    basis_streams : tuple of bytes
        Streams of its groups.
    chunks : tuple of Chunk
        Streams of the coefficients and, if there is a bound, of the residual layer.
    error : float
        Root of the sum of all squared distances, without the residual layer.
    bound : float, optional
        What the residual layer is for.
    """

    step: float
    ranks: tuple[int, ...]
    basis: SpatialBasis
    basis_streams: tuple[bytes, ...]
    chunks: tuple[Chunk, ...]
    error: float
    bound: float | None = None

    @cached_property
    def size(self) -> int:
        """Number of bytes."""
        of_chunks = sum(len(chunk.coefficients) + len(chunk.residuals) for chunk in self.chunks)
        return sum(map(len, self.basis_streams)) + of_chunks


def try_step(
    sequence: FrameStore,
    components: Sequence[PrincipalComponents],
    step: float,
    parts: Sequence[Part],
    graph: SignalGraph,
    bound: float | None = None,
    dry: bool = False,
) -> Trial:
    """Code a sequence.

    Parameters
    ----------
    sequence : FrameStore
        The sequence.
    components : sequence of PrincipalComponents
        Those of every part, all of one kind.
    step : float
        Quantisation step, in the units of the sequence.
    parts : sequence of Part
        The parts of the mesh.
    graph : SignalGraph
        Of its mesh.
    bound : float, optional
        Largest distance of a vertex, in the units of the sequence; by default there is no residual layer.
    dry : bool
        Leave out the coding: only the error counts.
    """
    vectors, basis_streams = write_basis(components, step, parts, graph, dry)
    basis = assemble_basis(components[0].kind, vectors, parts, len(sequence.points))
    coefficients, streams = write_coefficients(basis, least_squares(basis, sequence), step, dry)
    squares = 0.0
    for points, block in zip(blocks_of(sequence.points), decoded_blocks(basis, coefficients), strict=True):
        squares += float(np.square(points - block).sum())
    done = []
    for frames, stream in zip(chunks(len(coefficients)), streams, strict=True):
        residuals = b"" if bound is None else _residuals(sequence, basis, coefficients, frames, bound, graph)
        done.append(Chunk(frames.start, len(frames), stream, residuals))
    ranks = tuple(map(len, vectors))
    return Trial(step, ranks, basis, basis_streams, tuple(done), float(np.sqrt(squares)), bound)


def chunks(frame_count: int) -> list[range]:
    """Return the frames of every chunk."""
    number = max(1, round(frame_count / CHUNK))
    ends = [frame_count * place // number for place in range(number + 1)]
    return [range(a, b) for a, b in pairwise(ends)]


def write_basis(
    components: Sequence[PrincipalComponents],
    step: float,
    parts: Sequence[Part],
    graph: SignalGraph,
    dry: bool = False,
) -> tuple[list[Float], tuple[bytes, ...]]:
    """Code principal components of every part until they are zero, as `read_basis` reads them.

    Returns
    -------
    vectors : list of (K, c, n) float64
        Basis vectors of every part as a decoder has them, without the constant one of trajectories.
    streams : tuple of bytes
        Streams of the groups; none if it is a dry run, which is to see what rounding does.
    """
    vectors, signals = [], []
    for one, part in zip(components, parts, strict=True):
        rounded, predicted = _rounded(one, step, part, dry)
        vectors.append(rounded)
        signals.append(predicted)
    if dry:
        return vectors, ()
    models, streams = NumberModels(), []
    for number, of_parts in enumerate(groups_of_parts([len(some) for some in vectors])):
        writer = Writer()
        if number == 0 and len(parts) > 1:
            write_labels(writer, labels_of(parts), graph)
        for place, group in of_parts:
            for coordinates in signals[place][group]:
                for signal in coordinates:
                    models.write(writer, signal, parts[place].graph.batches)
        streams.append(writer.finish())
    return vectors, tuple(streams)


def labels_of(parts: Sequence[Part]) -> Index:
    """Return the part ``(V,)`` of every vertex."""
    labels = np.empty(sum(len(part.vertices) for part in parts), dtype=np.int64)
    for number, part in enumerate(parts):
        labels[part.vertices] = number
    return labels


def _rounded(
    components: PrincipalComponents, step: float, part: Part, dry: bool
) -> tuple[Float, list[list[PredictedSignal]]]:
    """Return the basis vectors ``(K, c, n)`` of a part after rounding, until they are zero, and what is coded of them.

    Nothing is coded of a dry run.
    """
    coder = SignalCoder(part.graph, components.vectors.shape[1])
    vectors: list[Float] = []
    signals: list[list[PredictedSignal]] = []
    zeros = 0
    for place in range(len(components.vectors)):
        numbers = components.vectors[place : place + 1][0] / step
        if dry:
            vectors.append(np.stack([coder.quantise(one) for one in numbers]))
        else:
            values, predicted = zip(*(coder.predict(one) for one in numbers), strict=True)
            vectors.append(np.stack(values))
            signals.append(list(predicted))
        zeros = 0 if vectors[-1].any() else zeros + 1
        if zeros == ZEROS:
            break
    kept = max(len(vectors) - zeros, 1)
    return step * np.array(vectors[:kept]), signals[:kept]


def least_squares(basis: SpatialBasis, sequence: FrameStore) -> Float:
    """Return the coefficients ``(T, K, 3 / c)`` of the varying vectors that are nearest to a sequence."""
    scales = basis.norms[basis.varying]
    scaled = basis.vectors[basis.varying] / scales[:, None, None]
    count = len(scaled)
    if not count:  # a mean shape, and nothing that moves
        return np.zeros((len(sequence.points), 0, 1))
    flat = scaled.reshape(count, -1)
    # Vectors are nearly orthogonal; a trace of damping is for those that are the same, after rounding.
    gram = flat @ flat.T
    factor = linalg.cho_factor(gram + 1e-9 * np.eye(count))
    coefficients = []
    for block in blocks_of(sequence.points):
        points = block.astype(np.float64)
        if basis.kind == "trajectories":
            right = np.einsum("kv,tvi->kti", flat, points, optimize=True)
        else:
            points = points - basis.mean
            right = np.einsum("kiv,tvi->kt", scaled, points, optimize=True)[..., None]
        right = right.reshape(count, -1)
        solved = linalg.cho_solve(factor, right)
        solved += linalg.cho_solve(factor, right - gram @ solved)  # takes back what the damping took
        coefficients.append(solved.reshape(count, len(points), -1).transpose(1, 0, 2))
    return np.concatenate(coefficients) / scales[:, None]


def write_coefficients(
    basis: SpatialBasis, coefficients: Float, step: float, dry: bool = False
) -> tuple[Float, list[bytes]]:
    """Code coefficients ``(T, K, d)``; return them as decoders have them, and a stream for every chunk."""
    scales = basis.norms[basis.varying, None] / step
    decoded = np.empty_like(coefficients)
    streams = []
    for chunk in chunks(len(coefficients)):
        writer, coders = Writer(), coefficient_coders(basis, len(chunk))
        frames = slice(chunk.start, chunk.stop)
        for place, coordinate in np.ndindex(coefficients.shape[1:]):
            coder = coders[basis.parts[basis.varying][place]]
            numbers = coefficients[frames, place, coordinate] * scales[place]
            values = coder.quantise(numbers) if dry else coder.write(writer, numbers)
            decoded[frames, place, coordinate] = values / scales[place]
        streams.append(writer.finish())
    return decoded, streams


def decoded_blocks(basis: SpatialBasis, coefficients: Float) -> Iterator[Float]:
    """Yield the frames of coefficients in blocks of those of `mixseq.frame_store.blocks_of`."""
    size = block_size(basis.vectors.shape[2])
    for start in range(0, len(coefficients), size):
        yield basis.frames(coefficients[start : start + size])


def width(bound: float) -> float:
    """Return the unit w of the residual layer for a bound, both in the units of the sequence."""
    return float(2.0 * bound / np.sqrt(3.0))


def needed(apart: Float, bound: float) -> Index:
    r"""Return the residuals that bring every vertex below a bound :math:`\varepsilon`.

    Where a decoded frame is further than the bound from the original, the difference is rounded to multiples of
    :math:`w = 2 \varepsilon / \sqrt 3` in every coordinate. What is left is at most :math:`w / 2` in each, so at most
    :math:`\varepsilon` in all. Everywhere else there is no residual.

    Parameters
    ----------
    apart : (T, V, 3) float64
        Originals minus decoded frames, in the units of the sequence.
    bound : float
        The bound, in the same units.

    Returns
    -------
    (T, V, 3) int64
        In units of `width`, zeros where nothing has to be added.
    """
    far = np.einsum("tvi,tvi->tv", apart, apart) > bound * bound
    return np.where(far[..., None], np.rint(apart / width(bound)), 0.0).astype(np.int64)


def _residuals(
    sequence: FrameStore,
    basis: SpatialBasis,
    coefficients: Float,
    frames: range,
    bound: float,
    graph: SignalGraph,
) -> bytes:
    def numbers(frame: int) -> NDArray[np.int64]:
        one = slice(frame, frame + 1)
        apart = np.asarray(sequence.points[one] - basis.frames(coefficients[one]))
        return np.asarray(needed(apart, bound)[0])

    return write_residuals((numbers(frame) for frame in frames), graph)
