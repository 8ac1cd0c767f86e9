"""Round a basis, and its coefficients, to their decoded values.

Parts are independent, and two are rounded at a time, to limit memory. Rounding determines the error of a trial; its
bytes take as long again, and are made on demand by `code_basis` and `code_coefficients`.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from mixseq.arrays import Float, Index
from mixseq.coding.bitstream.part_labels import write_labels
from mixseq.coding.bitstream.signal_coder import NumberModels, Signal, SignalCoder, Writer
from mixseq.coding.bitstream.signal_graph import SignalGraph, path_graph
from mixseq.coding.bitstream.spatial_basis import SpatialBasis, groups_of_parts
from mixseq.coding.encoder.part_components import PartComponents
from mixseq.mapping import on_two_threads

CHUNK, FEWEST = 512, 16
"""Number of frames in a chunk by default, approximately, and smallest number."""


class RoundedPart(NamedTuple):
    """Decoded basis vectors ``(K, c, n)`` of a part, and their ``K c`` signals for coding."""

    vectors: Float
    signals: list[Signal]


def round_basis(parts: Sequence[PartComponents], step: float) -> list[RoundedPart]:
    """Round the components of every part until they vanish, without the constant one of trajectories."""
    return list(on_two_threads()(_round_part, step, parts))


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
        work, on_two_threads()(_round_chunk, numbers, work), strict=True
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
