"""Signals over a graph come back bit for bit as whoever coded them knew them, within half a step and a little."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixseq.compression.bitstream.arithmetic import BitModels
from mixseq.compression.bitstream.signal_coder import ROUNDING_MARGINS, Reader, SignalCoder, Writer, new_number_models
from mixseq.compression.bitstream.signal_graph import SignalGraph, mesh_graph, path_graph
from mixseq.errors import FormatError
from mixseq.types import Float
from tests.meshes import grid, seeds, torus

TORUS = torus(16, 9)

GRAPHS: dict[str, Callable[[], SignalGraph]] = {
    "torus": lambda: mesh_graph(TORUS[1], len(TORUS[0])),
    "grid": lambda: mesh_graph(grid(6, 5)[1], 42),
    "vertices without faces": lambda: mesh_graph(np.array([[3, 4, 5]]), 30),
    "one vertex": lambda: mesh_graph(np.zeros((0, 3), dtype=np.int64), 1),
    "one frame": lambda: path_graph(1),
    "two frames": lambda: path_graph(2),
    "a hundred frames": lambda: path_graph(100),
}


def written(coder: SignalCoder, writer: Writer, targets: Float, models: BitModels) -> Float:
    values, signal = coder.round(targets)
    writer.write(signal, models)
    return values


def there_and_back(graph: SignalGraph, signals: list[Float]) -> bytes:
    """Code signals, and check that they come back, and what rounding does to them."""
    coder, writer, models = SignalCoder(graph), Writer(), new_number_models()
    kept = [written(coder, writer, signal, models) for signal in signals]
    data = writer.finish()
    decoder, reader = SignalCoder(graph), Reader(data)
    for signal, known in zip(signals, kept, strict=True):
        np.testing.assert_array_equal(decoder.read(reader), known)
        slack = 1e-12 * np.abs(signal).max()
        assert np.abs(known - signal).max() <= 1 - ROUNDING_MARGINS.min() + slack
    reader.finish()
    return data


@pytest.mark.parametrize("name", GRAPHS)
@pytest.mark.parametrize("size", [0.3, 50.0, 1e6])
def test_signals_come_back(name: str, size: float) -> None:
    graph, rng = GRAPHS[name](), np.random.default_rng(3)
    there_and_back(graph, [size * rng.normal(size=graph.size) / (1 + number) for number in range(10)])


@settings(max_examples=25, deadline=None)
@given(seed=seeds, count=st.integers(1, 60), powers=st.lists(st.integers(-3, 12), max_size=6))
def test_any_signals_over_time_come_back(seed: int, count: int, powers: list[int]) -> None:
    rng = np.random.default_rng(seed)
    there_and_back(path_graph(count), [10.0**power * rng.standard_cauchy(count).clip(-9, 9) for power in powers])


def test_zeros_cost_next_to_nothing() -> None:
    graph = GRAPHS["torus"]()
    data = there_and_back(graph, [np.zeros(graph.size)] * 20)
    assert 8 * len(data) < 0.05 * 20 * graph.size


def test_smooth_signals_cost_less_than_noise() -> None:
    graph, rng = GRAPHS["torus"](), np.random.default_rng(0)
    smooth = [100 * np.sin(TORUS[0] @ rng.normal(size=3) * 0.5) for _ in range(10)]
    noise = [signal[rng.permutation(graph.size)] for signal in smooth]
    assert len(there_and_back(graph, smooth)) < 0.7 * len(there_and_back(graph, noise))


def test_one_more_bit_of_accuracy_costs_one_more_bit() -> None:
    """Of noise, on average, per number."""
    graph, rng = GRAPHS["torus"](), np.random.default_rng(0)
    noise = list(rng.normal(size=(20, graph.size)))
    sizes = [len(there_and_back(graph, [scale * signal for signal in noise])) for scale in (1e3, 16e3)]
    assert 8 * (sizes[1] - sizes[0]) / (20 * graph.size) == pytest.approx(4, abs=0.3)


def test_signals_in_two_streams() -> None:
    """The coder goes on where it was: a later stream needs the one before, not the other way round."""
    graph, rng = GRAPHS["grid"](), np.random.default_rng(1)
    signals = rng.normal(scale=20, size=(6, graph.size))
    coder, models, streams, kept = SignalCoder(graph), new_number_models(), list[bytes](), list[Float]()
    for part in (signals[:2], signals[2:]):
        writer = Writer()
        kept += [written(coder, writer, signal, models) for signal in part]
        streams.append(writer.finish())
    decoder, found = SignalCoder(graph), []
    for stream, count in zip(streams, (2, 4), strict=True):
        reader = Reader(stream)
        found += [decoder.read(reader) for _ in range(count)]
    np.testing.assert_array_equal(found, kept)


def test_two_coders_share_a_stream() -> None:
    graph, models, writer = GRAPHS["grid"](), new_number_models(), Writer()
    signals = np.random.default_rng(1).normal(scale=20, size=(8, graph.size))
    coders = [SignalCoder(graph, 1, models) for _ in range(2)]
    kept = [written(coder, writer, signal, models) for coder in coders for signal in signals]
    reader, models = Reader(writer.finish()), new_number_models()
    coders = [SignalCoder(graph, 1, models) for _ in range(2)]
    np.testing.assert_array_equal([coder.read(reader) for coder in coders for _ in signals], kept)
    reader.finish()


def test_damaged_streams_are_refused() -> None:
    """Whatever bit is flipped: what comes out is the same, or not what the checksum says."""
    graph, rng = GRAPHS["grid"](), np.random.default_rng(1)
    signals = list(rng.normal(scale=20, size=(4, graph.size)))
    data = there_and_back(graph, signals)
    refused = 0
    for place in range(len(data)):
        damaged = bytearray(data)
        damaged[place] ^= 1 << place % 8
        decoder, reader = SignalCoder(graph), Reader(bytes(damaged))
        try:
            for _ in signals:
                decoder.read(reader)
            reader.finish()
        except FormatError as error:
            assert "damaged" in str(error)
            refused += 1
    assert refused >= len(data) - 1  # the last byte may say more than it has to


@pytest.mark.parametrize("size", [2.0**-30, 1e-3])
def test_other_weights_are_refused_or_no_harm(size: float) -> None:
    """As of a machine that adds otherwise."""
    graph, rng = GRAPHS["torus"](), np.random.default_rng(2)
    coder, writer, models = SignalCoder(graph), Writer(), new_number_models()
    kept = [written(coder, writer, 100 * np.sin(TORUS[0] @ rng.normal(size=3)), models) for _ in range(12)]
    reader, decoder = Reader(writer.finish()), SignalCoder(graph)
    found = []
    for _ in kept:
        found.append(decoder.read(reader))
        decoder._predictor.weights *= 1 + size * rng.normal(size=decoder._predictor.weights.shape)
    if np.array_equal(found, kept):
        reader.finish()
    else:
        with pytest.raises(FormatError, match="IEEE 754"):
            reader.finish()
    assert np.array_equal(found, kept) == (size < 1e-8)


def test_numbers_beyond_the_largest_are_read_as_they_were_written() -> None:
    graph = GRAPHS["a hundred frames"]()
    there_and_back(graph, [np.linspace(-1, 1, 100) * 2.0**power for power in (45, 50, 3, 0)])


def test_models_may_be_shared() -> None:
    """Coders of two graphs take turns in one stream."""
    rng, graphs = np.random.default_rng(4), [GRAPHS["torus"](), GRAPHS["grid"]()]
    signals = [[rng.normal(scale=5, size=graph.size) for graph in graphs] for _ in range(5)]
    models, writer = new_number_models(), Writer()
    coders = [SignalCoder(graph, 1, models) for graph in graphs]
    kept = [[written(coder, writer, one, models) for coder, one in zip(coders, some, strict=True)] for some in signals]
    models, reader = new_number_models(), Reader(writer.finish())
    coders = [SignalCoder(graph, 1, models) for graph in graphs]
    for some in kept:
        for coder, one in zip(coders, some, strict=True):
            np.testing.assert_array_equal(coder.read(reader), one)
    reader.finish()
