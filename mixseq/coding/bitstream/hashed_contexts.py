"""Code bits in contexts too numerous for tables: every context is hashed to 16 bits.

Every bit has a kind and, in every input, a *context*, any 64-bit number. Contexts share the frequencies of `bit_models`
if the highest 16 bits of their product with a constant are the same.

Frozen: changing this breaks old files (golden: ``tests/formats/golden/compressed-v1.h5``).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mixseq.arrays import Index
from mixseq.coding.bitstream import arithmetic
from mixseq.coding.bitstream.arithmetic import BYTES_BEYOND, Coded
from mixseq.coding.bitstream.bit_models import BitModels, bit_models, code_of_kind
from mixseq.compiled import joined

INPUTS = 8
"""Number of contexts of a bit. Frozen: breaks old files."""

SLOTS = 1 << 16
"""Number of hashed contexts per input. Frozen: breaks old files."""

SPREAD = np.uint64(11400714819323198485)
"""Multiplier of the hash: 2^64 / golden ratio. Unsigned: LLVM assumes no signed overflow. Frozen: breaks old files."""

_HIGHEST = np.uint64(48)
"""Right shift of a product to its highest 16 bits, the slot. Frozen: breaks old files."""

_BYTES_OF_BIT = 2
"""Bytes of a bit at most, as probabilities are above 2^-12. Free: memory is allocated ahead."""


class Bits(NamedTuple):
    """Bits that are written or read, and their models."""

    coded: Coded  # bytes that are written or read
    models: BitModels  # models of slots and kinds
    contexts: Index  # (INPUTS,) current contexts, any numbers, set before every bit
    failed: Index  # (1,) whether what is read is damaged


def bits_to_write(count: int, kinds: int) -> Bits:
    """Return untrained models, and room for `count` bits."""
    return _bits(arithmetic.to_write(_BYTES_OF_BIT * count), kinds)


def bits_to_read(data: bytes, kinds: int) -> Bits:
    """Return untrained models for reading the output of `arithmetic.written`."""
    return _bits(arithmetic.to_read(data), kinds)


def with_room(bits: Bits, count: int) -> Bits:
    """Return the same with room for `count` further bits."""
    return bits._replace(coded=arithmetic.with_room(bits.coded, _BYTES_OF_BIT * count))


def _bits(coded: Coded, kinds: int) -> Bits:
    models = bit_models(INPUTS, SLOTS, 1, kinds)
    return Bits(coded, models, np.zeros(INPUTS, dtype=np.int64), np.zeros(1, dtype=np.int64))


@joined
def code(bits: Bits, kind: int, bit: int) -> int:
    """Write or read a bit of a kind in the current contexts, update the models, and return it."""
    slots, contexts = bits.models.contexts, bits.contexts
    for i in range(INPUTS):
        slots[i] = np.int64(np.uint64(contexts[i]) * SPREAD >> _HIGHEST)
    return code_of_kind(bits.coded, bits.models, 0, kind, bit)


@joined
def has_failed(bits: Bits) -> bool:
    """Return whether the stream is damaged or ends early; loops check once a corner, to save time."""
    if bits.coded.place[0] > len(bits.coded.data) + BYTES_BEYOND:
        bits.failed[0] = 1
    return bool(bits.failed[0])
