"""Signals over a graph come back bit for bit as whoever coded them knew them, within half a step and a little."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixseq.arrays import Float
from mixseq.coding.bitstream.entropy import Reader, Writer
from mixseq.coding.bitstream.signal_coder import MARGIN, NumberModels, SignalCoder
from mixseq.coding.bitstream.signal_graph import SignalGraph, mesh_graph, path_graph
from mixseq.errors import FormatError
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


def there_and_back(graph: SignalGraph, signals: list[Float]) -> bytes:
    """Code signals, and check that they come back, and what rounding does to them."""
    coder, dry, writer = SignalCoder(graph), SignalCoder(graph), Writer()
    kept = [coder.write(writer, signal) for signal in signals]
    data = writer.finish()
    decoder, reader = SignalCoder(graph), Reader(data)
    for signal, known in zip(signals, kept, strict=True):
        np.testing.assert_array_equal(decoder.read(reader), known)
        np.testing.assert_array_equal(dry.quantise(signal), known)
        slack = 1e-12 * np.abs(signal).max()
        assert np.abs(known - signal).max() <= 1 - MARGIN + slack
    return data


@pytest.mark.parametrize("name", GRAPHS)
@pytest.mark.parametrize("size", [0.3, 50.0, 1e6])
def test_signals_come_back(name: str, size: float) -> None:
    graph, rng = GRAPHS[name](), np.random.default_rng(3)
    there_and_back(graph, [size * rng.normal(size=graph.size) / (1 + number) for number in range(10)])


@pytest.mark.parametrize("name", GRAPHS)
def test_signals_may_wait_to_be_coded(name: str) -> None:
    graph, rng = GRAPHS[name](), np.random.default_rng(3)
    signals = [10.0**power * rng.normal(size=graph.size) for power in (0, 3, 9, -2, 1, 1, 1, 1, 1)]
    coder, models, writer = SignalCoder(graph), NumberModels(), Writer()
    for _, waiting in [coder.predict(signal) for signal in signals]:
        models.write(writer, waiting, graph.batches)
    assert writer.finish() == there_and_back(graph, signals)


@settings(max_examples=25, deadline=None)
@given(seed=seeds, count=st.integers(1, 60), powers=st.lists(st.integers(-3, 12), max_size=6))
def test_any_signals_over_time_come_back(seed: int, count: int, powers: list[int]) -> None:
    rng = np.random.default_rng(seed)
    there_and_back(
        path_graph(count), [10.0**power * rng.standard_cauchy(count).clip(-9, 9) for power in powers]
    )


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
    coder, streams, kept = SignalCoder(graph), [], []
    for part in (signals[:2], signals[2:]):
        writer = Writer()
        kept += [coder.write(writer, signal) for signal in part]
        streams.append(writer.finish())
    decoder, found = SignalCoder(graph), []
    for stream, count in zip(streams, (2, 4), strict=True):
        reader = Reader(stream)
        found += [decoder.read(reader) for _ in range(count)]
    np.testing.assert_array_equal(found, kept)


def test_damaged_streams_give_other_signals_or_an_error() -> None:
    graph, rng = GRAPHS["grid"](), np.random.default_rng(1)
    data = there_and_back(graph, list(rng.normal(scale=20, size=(4, graph.size))))
    for place in range(0, len(data), 3):
        damaged = bytearray(data)
        damaged[place] ^= 1 << place % 8
        decoder = SignalCoder(graph)
        try:
            reader = Reader(bytes(damaged))
            assert decoder.read(reader).shape == decoder.read(reader).shape == (graph.size,)
        except FormatError as error:
            assert "damaged" in str(error)
