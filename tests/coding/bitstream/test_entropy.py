"""Whole numbers come back whatever they are, in about as many bits as their entropy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixseq.arrays import Index
from mixseq.coding.bitstream.entropy import FLOOR, MOST, START, Reader, Tables, Writer
from mixseq.errors import FormatError

MAGNITUDES = [0.1, 1.0, 5.0]
LARGEST = (1 << 63) - 1


def coded(*arrays: tuple[Index, Index]) -> bytes:
    writer, tables = Writer(), Tables(MAGNITUDES)
    for numbers, contexts in arrays:
        writer.put(numbers, contexts, tables)
    return writer.finish()


def laplacian(size: int, seed: int = 0) -> tuple[Index, Index]:
    """Numbers and their contexts, with about the magnitudes that are expected in these."""
    rng = np.random.default_rng(seed)
    contexts = rng.integers(0, 3, size)
    numbers = np.rint(rng.laplace(scale=np.array(MAGNITUDES)[contexts])).astype(np.int64)
    return numbers, contexts


whole = st.one_of(st.integers(-20, 20), st.integers(-LARGEST, LARGEST))
arrays_of = st.lists(st.lists(st.tuples(whole, st.integers(0, 2)), max_size=20), max_size=5)


@settings(max_examples=100, deadline=None)
@given(lists=arrays_of, size=st.integers(1, 1 << 20))
def test_any_numbers_come_back(lists: list[list[tuple[int, int]]], size: int) -> None:
    arrays = [np.array(pairs, dtype=np.int64).reshape(-1, 2) for pairs in lists]
    writer, tables = Writer(), Tables(MAGNITUDES)
    for array in arrays:
        writer.put(array[:, 0], array[:, 1], tables)
        writer.put_flat(np.abs(array[:, 0]) % size, size)
    reader, learned = Reader(writer.finish()), Tables(MAGNITUDES)
    for array in arrays:
        np.testing.assert_array_equal(reader.get(array[:, 1], learned), array[:, 0])
        np.testing.assert_array_equal(reader.get_flat(len(array), size), np.abs(array[:, 0]) % size)
    np.testing.assert_array_equal(learned.counts, tables.counts)


def test_the_largest_numbers_come_back() -> None:
    numbers = np.array([LARGEST, -LARGEST, 0, 15, -15, 16, -16, 1 << 62, -(1 << 32)])
    contexts = np.arange(len(numbers)) % 3
    data = coded((numbers, contexts))
    np.testing.assert_array_equal(Reader(data).get(contexts, Tables(MAGNITUDES)), numbers)


def test_nothing_costs_nothing() -> None:
    none = np.zeros(0, dtype=np.int64)
    assert coded() == coded((none, none)) == b""
    assert len(Reader(b"").get(none, Tables(MAGNITUDES))) == 0
    assert Reader(b"").get_flat(3, 1).tolist() == [0, 0, 0]


def test_numbers_cost_their_entropy() -> None:
    """Two-sided geometric numbers, which the models expect, cost what they must, and little more."""
    rng = np.random.default_rng(1)
    ratio = 0.5  # the mean magnitude r / (1 - r) is 1
    shares = (1 - ratio) / (1 + ratio) * ratio ** np.abs(np.arange(-40, 41))
    numbers = rng.choice(np.arange(-40, 41), size=20_000, p=shares / shares.sum())
    entropy = -(shares * np.log2(shares)).sum() * len(numbers)
    contexts = np.full(500, 1)
    bits = 8 * len(coded(*((batch, contexts) for batch in np.split(numbers, 40))))
    assert 0.99 * entropy < bits < 1.01 * entropy


def test_models_learn_what_nobody_expected() -> None:
    """Numbers that are all 7 are expensive once, in a context where zero is expected."""
    sevens = np.full(100, 7), np.zeros(100, dtype=np.int64)
    once, often = len(coded(sevens)), len(coded(*[sevens] * 20))
    assert once > 50
    assert often < 1.5 * once


def test_first_guesses_are_geometric() -> None:
    tables = Tables([3.0], largest=4)
    shares = tables.probabilities(np.array([0]))[0]
    assert shares.sum() == pytest.approx(1, abs=1e-15)
    np.testing.assert_array_equal(shares[:9], shares[8::-1])
    ideal = 0.75 ** np.abs(np.arange(-4, 5))
    np.testing.assert_allclose(shares[:9], ideal / ideal.sum(), atol=2 / (64 * START))
    assert tables.counts[0, -1] == FLOOR


def test_old_counts_are_forgotten() -> None:
    tables = Tables(MAGNITUDES, largest=2)
    for _ in range(20):
        tables.update(np.full(1000, 4), np.zeros(1000, dtype=np.int64))
        assert tables.counts[0].sum() <= 64 * MOST + tables.counts.shape[1]
    assert tables.counts[0, 4] > 0.99 * tables.counts[0].sum()
    assert (tables.counts > 0).all()


# Damage -----------------------------------------------------------------------------------------------------


def decoded(data: bytes, contexts: Index) -> Index | None:
    try:
        return Reader(data).get(contexts, Tables(MAGNITUDES))
    except FormatError:
        return None


def test_flipped_bits_give_other_numbers_or_an_error() -> None:
    numbers, contexts = laplacian(200)
    numbers[::50] *= 1 << 40
    data = coded((numbers, contexts))
    for bit in range(0, 8 * len(data), 5):
        damaged = bytearray(data)
        damaged[bit // 8] ^= 1 << bit % 8
        found = decoded(bytes(damaged), contexts)
        assert found is None or found.shape == numbers.shape


@pytest.mark.parametrize("length", [0, 4, 40])
def test_missing_ends_give_other_numbers_or_an_error(length: int) -> None:
    numbers, contexts = laplacian(300)
    found = decoded(coded((numbers, contexts))[:length], contexts)
    assert found is None or (found.shape == numbers.shape and not np.array_equal(found, numbers))


@settings(max_examples=100, deadline=None)
@given(words=st.lists(st.integers(0, 2**32 - 1), max_size=20))
def test_noise_gives_numbers_or_an_error(words: list[int]) -> None:
    contexts = np.arange(100) % 3
    found = decoded(np.array(words, dtype="<u4").tobytes(), contexts)
    assert found is None or found.shape == contexts.shape


def test_half_a_word_is_refused() -> None:
    with pytest.raises(FormatError, match="within a word"):
        Reader(b"123")
