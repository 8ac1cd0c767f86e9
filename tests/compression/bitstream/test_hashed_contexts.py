"""Bits in several contexts: contexts are spread over slots by products that overflow, on every machine alike."""

from __future__ import annotations

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st

from mixseq.compression.bitstream.arithmetic import (
    CONTEXTS_PER_BIT,
    HashedBits,
    code_hashed_bit,
    finish_stream,
    has_failed,
    new_hashed_bits,
    new_hashed_output,
    new_input_stream,
)
from mixseq.runtime.jit import compiled
from mixseq.types import Index

GOLDEN_RATIO = 11400714819323198485


@compiled
def code_small(bits: HashedBits, known: Index) -> None:
    """Code a bit in contexts of which a compiler can see that they are from 2 to 4095."""
    for i in range(CONTEXTS_PER_BIT):
        bits.contexts[i] = (known[i] & 255) << 4 | 2
    code_hashed_bit(bits, 0, 1)


def slots_of_a_one(bits: HashedBits) -> list[int]:
    """Return the slot of every input whose frequency a bit that was 1 has raised; there is one in each."""
    raised = bits.models.frequencies[:, :, 0] > 1 << 23
    assert (raised.sum(axis=1) == 1).all()
    slots: list[int] = raised.argmax(axis=1).tolist()
    return slots


@settings(max_examples=20, deadline=None)
@given(st.lists(st.integers(-(2**63), 2**63 - 1), min_size=CONTEXTS_PER_BIT, max_size=CONTEXTS_PER_BIT))
@example([0, 1, -1, 530, 1 << 60, -(1 << 60), 2**63 - 1, -(2**63)])
def test_slots_are_the_highest_bits_of_the_product(contexts: list[int]) -> None:
    bits = new_hashed_output(1, 1)
    bits.contexts[:] = contexts
    code_hashed_bit(bits, 0, 1)
    expected = [(each * GOLDEN_RATIO % 2**64) >> 48 for each in contexts]
    assert slots_of_a_one(bits) == expected


def test_products_overflow_where_it_is_known_how_large_they_are() -> None:
    """LLVM may take for granted that products of signed numbers do not."""
    bits, known = new_hashed_output(1, 1), np.arange(33, 33 + CONTEXTS_PER_BIT)
    code_small(bits, known)
    assert slots_of_a_one(bits) == [((16 * each + 2) * GOLDEN_RATIO % 2**64) >> 48 for each in known.tolist()]


@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 1)), max_size=300))
@settings(max_examples=20, deadline=None)
def test_bits_come_back(pairs: list[tuple[int, int]]) -> None:
    writer = new_hashed_output(len(pairs), 1)
    for context, bit in pairs:
        writer.contexts[:2] = context, 1
        assert code_hashed_bit(writer, 0, bit) == bit
    reader = new_hashed_bits(new_input_stream(finish_stream(writer.stream)), 1)
    for context, bit in pairs:
        reader.contexts[:2] = context, 1
        assert code_hashed_bit(reader, 0, 0) == bit
    assert not has_failed(reader)
    for number in range(1000):
        reader.contexts[:] = 99991 * number + np.arange(CONTEXTS_PER_BIT)
        code_hashed_bit(reader, 0, 0)
    assert has_failed(reader)


def test_bits_that_are_always_the_same_take_little() -> None:
    writer = new_hashed_output(2000, 1)
    for _ in range(2000):
        code_hashed_bit(writer, 0, 1)
    assert len(finish_stream(writer.stream)) < 10
