r"""Code whole numbers with few bytes: range coding by *constriction*, with an adaptive model of every context.

A number :math:`n` is coded as a symbol of its context's model, an escape for numbers that are too large for the
alphabet. The models start as two-sided geometric distributions

.. math:: p_c(n) \propto r_c^{|n|}, \qquad r_c = m_c / (1 + m_c)

with a mean magnitude :math:`m_c` for every context, and are counts from there on: after every array the symbols that
were coded are added. Whoever decodes adds the same counts, so nothing is said about them in the file. Counts are whole
numbers, and probabilities are their quotients, which are the same on every machine; the logarithms that would not be
are nowhere used.

Frozen: changing this breaks old files (golden: ``tests/coding/golden/*.npz``).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from mixseq.arrays import Float, Index
from mixseq.compiled import compiled
from mixseq.errors import FormatError

MOST = 1 << 11
"""A context forgets, by halves, what it counted beyond so many numbers. Frozen: breaks old files."""

START = 1 << 3
"""How many numbers the first guess counts for. Frozen: breaks old files."""

FLOOR = 1
"""Counts of numbers that nobody expects, in 64ths. Frozen: breaks old files."""

_BITS = 8
"""Bits of large numbers are stored so many at a time. Frozen: breaks old files."""


class Tables:
    """Adaptive models of numbers: a table of counts for every context.

    Parameters
    ----------
    magnitudes : (C,) float
        Mean magnitude of the numbers that is expected in every context, larger than zero.
    largest : int
        Numbers up to this magnitude have symbols of their own.
    """

    def __init__(self, magnitudes: Float | list[float], largest: int = 15) -> None:
        self.largest = largest
        ratios = np.asarray(magnitudes, dtype=np.float64)
        ratios = ratios / (1.0 + ratios)
        powers = np.ones((len(ratios), largest + 1))
        for exponent in range(1, largest + 1):  # products, not powers: those differ between machines
            powers[:, exponent] = powers[:, exponent - 1] * ratios
        shares = np.concatenate([powers[:, :0:-1], powers], axis=1)
        whole = np.zeros(len(ratios))
        for column in shares.T:
            whole = whole + column
        # In 64ths of a number; one more symbol, the last, for numbers that are larger.
        counts = np.floor(64 * START * shares / whole[:, None]).astype(np.int64) + FLOOR
        self.counts: Index = np.concatenate([counts, np.full((len(ratios), 1), FLOOR)], axis=1)
        self._large = np.full((1, 64), 8, dtype=np.int64)

    def probabilities(self, contexts: Index) -> Float:
        """Return the probabilities ``(n, 2 largest + 2)`` of the symbols of numbers in contexts ``(n,)``."""
        return _quotients(self.counts, contexts)

    def update(self, symbols: Index, contexts: Index) -> None:
        """Count symbols ``(n,)`` in contexts ``(n,)``."""
        _count(self.counts, symbols, contexts, 64, 64 * MOST)


class Writer:
    """Collects numbers; `finish` makes bytes of them."""

    def __init__(self) -> None:
        from constriction import stream

        self._coder: Any = stream.queue.RangeEncoder()

    def put(self, numbers: Index, contexts: Index, tables: Tables) -> None:
        """Write numbers ``(n,)`` of any sign and size, each in its context ``(n,)``; the tables learn them."""
        if not len(numbers):
            return
        far = np.abs(numbers) > tables.largest
        symbols = np.where(far, 2 * tables.largest + 1, numbers + tables.largest)
        self._coder.encode(symbols.astype(np.int32), _any(), tables.probabilities(contexts))
        tables.update(symbols, contexts)
        if far.any():
            self._put_large(numbers[far], tables)

    def _put_large(self, numbers: Index, tables: Tables) -> None:
        """Signs, how many bits there are beyond the alphabet, and these bits (the code of Elias)."""
        rest = np.abs(numbers) - tables.largest
        lengths = _bit_lengths(rest)
        self.put_flat((numbers < 0).astype(np.int64), 2)
        shares = (tables._large / tables._large.sum())[0]
        self._coder.encode(lengths.astype(np.int32), _one(shares))
        tables._large[0] += 64 * np.bincount(lengths, minlength=64)
        for shift in range(0, int(lengths.max()), _BITS):
            some = lengths > shift
            self.put_flat((rest[some] >> shift) & ((1 << _BITS) - 1), 1 << _BITS)

    def put_flat(self, numbers: Index, size: int) -> None:
        """Write numbers ``(n,)`` from 0 to below `size`, all equally likely."""
        if len(numbers) and size > 1:
            self._coder.encode(numbers.astype(np.int32), _flat(size))

    def finish(self) -> bytes:
        """Return everything that was written."""
        words: bytes = self._coder.get_compressed().astype("<u4").tobytes()
        return words


class Reader:
    """Reads what a `Writer` wrote, in the same order, with tables that learned the same.

    Parameters
    ----------
    data : bytes
        What `Writer.finish` returned.

    Raises
    ------
    FormatError
        If the data end early or are no such data (not all damage is noticed: files have checksums).
    """

    def __init__(self, data: bytes) -> None:
        from constriction import stream

        if len(data) % 4:
            raise FormatError("coded numbers end within a word; the file is damaged")
        self._coder: Any = stream.queue.RangeDecoder(np.frombuffer(data, dtype="<u4").astype(np.uint32))

    def get(self, contexts: Index, tables: Tables) -> Index:
        """Read numbers ``(n,)`` in contexts ``(n,)``; the tables learn them."""
        if not len(contexts):
            return np.zeros(0, dtype=np.int64)
        symbols = self._decode(_any(), tables.probabilities(contexts))
        tables.update(symbols, contexts)
        numbers = symbols - tables.largest
        far = symbols == 2 * tables.largest + 1
        if far.any():
            numbers[far] = self._get_large(int(far.sum()), tables)
        return numbers

    def _get_large(self, count: int, tables: Tables) -> Index:
        negative = self.get_flat(count, 2)
        lengths = self._decode(_one((tables._large / tables._large.sum())[0]), count)
        tables._large[0] += 64 * np.bincount(lengths, minlength=64)
        rest = np.zeros(count, dtype=np.int64)
        for shift in range(0, int(lengths.max()), _BITS):
            some = lengths > shift
            rest[some] |= self.get_flat(int(some.sum()), 1 << _BITS) << shift
        return np.where(negative == 1, -1, 1) * (rest + tables.largest)

    def get_flat(self, count: int, size: int) -> Index:
        """Read `count` numbers from 0 to below `size` that `Writer.put_flat` wrote."""
        if not count or size <= 1:
            return np.zeros(count, dtype=np.int64)
        return self._decode(_flat(size), count)

    def _decode(self, model: Any, parameters: Any) -> Index:
        try:
            return np.asarray(self._coder.decode(model, parameters), dtype=np.int64)
        except (AssertionError, ValueError) as error:
            raise FormatError("coded numbers are damaged") from error


def _any() -> Any:
    """The family of all distributions of symbols."""
    from constriction import stream

    return stream.model.Categorical(perfect=False)


def _one(shares: Float) -> Any:
    from constriction import stream

    return stream.model.Categorical(shares, perfect=False)


def _flat(size: int) -> Any:
    from constriction import stream

    return stream.model.Uniform(size)


def _bit_lengths(numbers: Index) -> Index:
    """Return how many bits numbers ``(n,)`` have, all larger than zero."""
    lengths = np.zeros(len(numbers), dtype=np.int64)
    rest = numbers.copy()
    while rest.any():
        lengths += rest > 0
        rest >>= 1
    return lengths


@compiled
def _quotients(counts: Index, contexts: Index) -> Float:
    """Return the probabilities ``(n, S)`` of symbols in contexts ``(n,)``: quotients of counts ``(C, S)``."""
    size = counts.shape[1]
    whole = np.zeros(len(counts))
    rows = np.empty((len(contexts), size))
    for row in range(len(contexts)):
        context = contexts[row]
        if whole[context] == 0.0:
            total = 0
            for symbol in range(size):
                total += counts[context, symbol]
            whole[context] = total
        for symbol in range(size):
            rows[row, symbol] = counts[context, symbol] / whole[context]
    return rows


@compiled
def _count(counts: Index, symbols: Index, contexts: Index, weight: int, most: int) -> None:
    """Add symbols ``(n,)`` to the counts ``(C, S)`` of their contexts ``(n,)``, and halve counts that are too many."""
    for place in range(len(symbols)):
        counts[contexts[place], symbols[place]] += weight
    for context in range(len(counts)):
        total = 0
        for symbol in range(counts.shape[1]):
            total += counts[context, symbol]
        while total > most:
            total = 0
            for symbol in range(counts.shape[1]):
                counts[context, symbol] = (counts[context, symbol] + 1) // 2
                total += counts[context, symbol]


def pack_leb128(numbers: Iterable[int]) -> bytes:
    """Write whole numbers, none of them negative, 7 bits to the byte, the lowest first (LEB128).

    Examples
    --------
    >>> pack_leb128([5, 300]).hex(), list(unpack_leb128(pack_leb128([5, 300])))
    ('05ac02', [5, 300])
    """
    packed = bytearray()
    for number in numbers:
        while number > 127:
            packed.append(number & 127 | 128)
            number >>= 7
        packed.append(number)
    return bytes(packed)


def unpack_leb128(packed: bytes) -> Iterator[int]:
    """Read what `pack_leb128` wrote."""
    number = shift = 0
    for byte in packed:
        number |= (byte & 127) << shift
        shift += 7
        if byte < 128:
            yield number
            number = shift = 0
