r"""Predict bits from several contexts at once (logistic mixing), and sort them by how sure the prediction is.

Every bit is seen in several *contexts*, small whole numbers that say what is known when it is coded. In the context
:math:`c` of input :math:`i` the bit was 1 with the relative frequency :math:`p_{ic}`. The inputs are mixed in the
logistic domain (Mahoney 2005, *Adaptive weighing of context models for lossless data compression*)

.. math:: x_i = \ln \frac{p_{ic}}{1 - p_{ic}}, \qquad x = \sum_i w_i x_i, \qquad p = \frac{1}{1 + e^{-x}}

and after the bit :math:`b` is known the frequencies move towards it, and the weights by
:math:`w_i \leftarrow w_i + \eta (b - p) x_i`.

A bit goes into the *queue* of its prediction: as many queues as there are intervals of :math:`|x|`, a bit for whether
the likelier value came. All bits of a queue are about equally surprising, so that one queue after the other can be
coded by `mixseq.coding.bitstream.entropy`. Whoever decodes has all queues before the first bit is asked for, makes the
same predictions from the bits that came before, and takes each bit from the queue where it must be.

All of it is done with whole numbers: :math:`p` in units of :math:`2^{-16}`, :math:`x` of :math:`2^{-8}`,
:math:`w` of :math:`2^{-16}`. The size of tables, the rates and the first weights are ours.

Frozen: changing this breaks old files (golden: ``tests/formats/golden/compressed-v1.h5``).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Index
from mixseq.coding.bitstream.logistic import FAR, logistic_tables
from mixseq.compiled import compiled, joined

Small = NDArray[np.int32]
Byte = NDArray[np.uint8]

QUEUES = 16
"""Number of queues. The first has bits about which nothing is known. Frozen: breaks old files."""

INPUTS = 8
"""Number of contexts of a bit. Frozen: breaks old files."""

SLOTS = 1 << 16
"""Contexts of an input that are told apart; more share their frequencies. Frozen: breaks old files."""

_PATIENCE = 255
"""Frequencies follow their last so many bits. Frozen: breaks old files."""

_RATE = 32
"""The rate of weights, in 1 / 4096 of x's and p's units. Frozen: breaks old files."""

_FIRST_WEIGHT = 1 << 14
"""Weights to begin with, in units of 2^-16. Frozen: breaks old files."""

SPREAD = np.uint64(11400714819323198485)
"""Spreads contexts over slots (2^64 divided by the golden ratio). Products overflow, which only numbers without a sign
may: of others LLVM takes for granted that they do not. Frozen: breaks old files."""


_HIGHEST = np.uint64(48)
"""The highest 16 bits of a product say which slot it is. Frozen: breaks old files."""


class Bits(NamedTuple):
    """What is known about the bits to come, and the bits.

    Attributes
    ----------
    decoding : bool
        Whether bits are taken from queues.
    queued : (n,) uint8
        If decoding, the bits of all queues, one queue after the other. Else room for bits in the order in which they
        come, each with its queue: ``2 queue + bit``.
    heads, ends : (QUEUES,) int64
        Where the next bit of every queue is, and where the queue ends. If coding, the first head is where the next bit
        is put.
    failed : (1,) int64
        Whether a queue had no more bits.
    contexts : (INPUTS,) int64
        To be set before every bit: what the inputs know, any numbers.
    slots : (INPUTS,) int64
        Where the contexts of the current bit are found.
    shares : (INPUTS, SLOTS) int32
        Frequencies of 1 and from how many bits they are: ``256 p + bits``.
    weights : (sets, INPUTS) int64
        Weights. Bits of different kinds have sets of their own.
    logits : (INPUTS,) int64
        The inputs x of the current bit.
    stretch, squash : int32
        Tables of x of p, and of p of x.
    steps : (_PATIENCE + 1,) int64
        Rates of frequencies.
    """

    decoding: bool
    queued: Byte
    heads: Index
    ends: Index
    failed: Index
    contexts: Index
    slots: Index
    shares: Small
    weights: Index
    logits: Index
    stretch: Small
    squash: Small
    steps: Index


def bits_to_code(room: int, sets: int) -> Bits:
    """Return a state in which nothing is known, with room for so many bits to be coded."""
    return _bits(False, np.empty(room, dtype=np.uint8), np.zeros(QUEUES, dtype=np.int64), sets)


def bits_to_decode(queues: list[Byte], sets: int) -> Bits:
    """Return a state in which nothing is known, with queues of bits."""
    lengths = np.array([len(queue) for queue in queues], dtype=np.int64)
    return _bits(True, np.concatenate(queues), lengths, sets)


def queues_of(bits: Bits) -> list[Byte]:
    """Return the bits that were coded, queue by queue."""
    coded = bits.queued[: bits.heads[0]]
    return [coded[coded >> 1 == queue] & 1 for queue in range(QUEUES)]


def _bits(decoding: bool, queued: Byte, lengths: Index, sets: int) -> Bits:
    stretch, squash = logistic_tables()
    ends = np.cumsum(lengths)
    return Bits(
        decoding=decoding,
        queued=queued,
        heads=ends - lengths,
        ends=ends,
        failed=np.zeros(1, dtype=np.int64),
        contexts=np.zeros(INPUTS, dtype=np.int64),
        slots=np.zeros(INPUTS, dtype=np.int64),
        shares=np.full((INPUTS, SLOTS), 1 << 23, dtype=np.int32),
        weights=np.full((sets, INPUTS), _FIRST_WEIGHT, dtype=np.int64),
        logits=np.zeros(INPUTS, dtype=np.int64),
        stretch=stretch.astype(np.int32),
        squash=squash.astype(np.int32),
        steps=(1 << 17) // (2 * np.arange(_PATIENCE + 1, dtype=np.int64) + 3),
    )


@joined
def code(bits: Bits, kind: int, bit: int) -> int:
    """Code or decode a bit in the contexts that were set, learn from it, and return it.

    Parameters
    ----------
    bits : Bits
        The state.
    kind : int
        The set of weights.
    bit : int
        The bit, if it is coded.
    """
    weights, contexts, slots, shares, logits = (
        bits.weights[kind],
        bits.contexts,
        bits.slots,
        bits.shares,
        bits.logits,
    )
    x = 0
    for i in range(INPUTS):
        slot = np.int64(np.uint64(contexts[i]) * SPREAD >> _HIGHEST)
        slots[i] = slot
        logit = bits.stretch[shares[i, slot] >> 12]
        logits[i] = logit
        x += weights[i] * logit
    x = min(max(x >> 16, -FAR), FAR)
    queue = abs(x) * QUEUES // (FAR + 1)
    likely = 1 if x > 0 else 0
    if bits.decoding:
        place = bits.heads[queue]
        if place >= bits.ends[queue]:
            bits.failed[0] = 1
            return 0
        bits.heads[queue] += 1
        bit = likely ^ int(bits.queued[place])
    else:
        bits.queued[bits.heads[0]] = 2 * queue + (bit ^ likely)
        bits.heads[0] += 1
    error = ((bit << 16) - bits.squash[x + FAR]) >> 4
    for i in range(INPUTS):
        weights[i] += (logits[i] * error * _RATE + (1 << 15)) >> 16
        slot = slots[i]
        share, seen = shares[i, slot] >> 8, shares[i, slot] & 255
        share += (((bit << 16) - bit - share) * bits.steps[seen]) >> 16
        shares[i, slot] = (share << 8) + min(seen + 1, _PATIENCE)
    return bit


@compiled
def pass_through(bits: Bits, bit: int) -> int:
    """Code or decode a bit of which nothing can be known, in the first queue, and return it."""
    if bits.decoding:
        place = bits.heads[0]
        if place >= bits.ends[0]:
            bits.failed[0] = 1
            return 0
        bits.heads[0] += 1
        return int(bits.queued[place])
    bits.queued[bits.heads[0]] = bit
    bits.heads[0] += 1
    return bit
