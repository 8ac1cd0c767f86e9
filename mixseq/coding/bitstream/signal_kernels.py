"""The compiled loop of `mixseq.coding.bitstream.signal_coder`: one signal, node by node, written or read alike.

Frozen: changing this breaks old files (golden: ``tests/coding/golden/*.npz``). All that decides is whole numbers, but
for the sums of `predictor_kernels.predict`, which are rounded.
"""

from __future__ import annotations

import math

from mixseq.arrays import Float, Index
from mixseq.coding.bitstream.arithmetic import Coded, code_number
from mixseq.coding.bitstream.bit_models import BitModels, code
from mixseq.coding.bitstream.predictor_kernels import UNIT, Small, predict
from mixseq.compiled import compiled, joined

LEVELS = 32
"""Expected sizes are told apart at so many levels, two of them in an octave. Frozen: breaks old files."""

DEPTHS = 18
"""Nodes are told apart by the bits of their number: about their level in the graph. Frozen: breaks old files."""

AGES = 8
"""Signals are told apart by how many were before them. Frozen: breaks old files."""

INPUTS = 5
"""Contexts of a number. Frozen: breaks old files."""

CONTEXTS = LEVELS * LEVELS
"""As many contexts as an input may have. Frozen: breaks old files."""

_LONGEST = 24
"""Numbers of up to so many bits have models for all questions about them. Frozen: breaks old files."""

_MOST = 55
"""Numbers have so many bits at most. Frozen: breaks old files."""

POSITIONS = 2 * _LONGEST
"""Questions about a number that have models. Frozen: breaks old files."""

_FARTHEST = 2.0**54
"""Numbers are not beyond this: steps may be tried that are too fine for doubles. Free: only encoders round."""

_LARGEST = 1 << 40
"""Larger sizes count as this. Frozen: breaks old files."""


@compiled
def code_signal(
    coded: Coded,
    models: BitModels,
    age: int,
    targets: Float,
    margins: Float,
    neighbours: Small,
    counts: Small,
    weights: Float,
    values: Index,
    steps: Index,
    numbers: Index,
    activity: Index,
    around: Index,
) -> None:
    """Write or read a signal: a number for every node, and the value that it makes.

    Parameters
    ----------
    coded, models
        Bytes, and what is known of bits.
    age : int
        How many signals were before.
    targets : (N,) float64
        The signal in 1 / `UNIT` steps, if it is written.
    margins : (LEVELS,) float64
        Numbers are rounded up from one minus this, by the level of their expected size, if they are written.
    neighbours, counts, weights
        Of the predictor.
    values : (N,) int64
        Where the signal goes, in 1 / `UNIT` steps.
    steps : (N,) int64
        Of what numbers are multiples, in 1 / `UNIT` steps.
    numbers : (N,) int64
        Numbers of the signal before, which those of this one replace.
    activity, around : (N,) int64
        Sizes of the numbers of earlier signals, newer ones counting more, here and beside, in 1 / `UNIT` steps.
    """
    contexts = models.contexts
    age = min(level(age), AGES - 1)
    bits = 0
    for node in range(len(values)):
        while node >> bits:
            bits += 1
        count = counts[node]
        size = activity[node]
        if count:
            total = 0
            for i in range(count):
                total += min(abs(numbers[neighbours[node, i]]), _LARGEST)
            size = UNIT * total // count
        expected = (205 * size + 102 * activity[node] + 38 * around[node]) >> 8
        here, beside, ring = level(size), level(activity[node]), level(around[node])
        depth, wanted = min(bits, DEPTHS - 1), level(expected)
        contexts[0] = here * LEVELS + beside
        contexts[1] = beside * LEVELS + ring
        contexts[2] = min(fine_level(expected), CONTEXTS // DEPTHS - 1) * DEPTHS + depth
        contexts[3] = here * LEVELS + level(UNIT * min(abs(numbers[node]), _LARGEST))
        contexts[4] = wanted * AGES + age
        predicted = predict(node, neighbours, counts, weights, values)
        number = 0
        if not coded.decoding:
            off = targets[node] - predicted
            number = math.floor(min(abs(off) / steps[node] + margins[wanted], _FARTHEST))
            if off < 0.0:
                number = -number
        number = code_signed(coded, models, number)
        numbers[node] = number
        values[node] = predicted + steps[node] * number


@joined
def code_signed(coded: Coded, models: BitModels, number: int) -> int:
    """Write or read a number: how many bits it has, the highest of those after the first, the others, and the sign."""
    magnitude = abs(number)
    size = bit_length(magnitude)
    found = 0
    while found < _LONGEST and code(coded, models, found, 1 if size > found else 0):
        found += 1
    if found == _LONGEST:
        while found < _MOST and code_number(coded, 1, 1 if size > found else 0):
            found += 1
    if found == 0:
        return 0
    value = 1
    if found > 1:
        top = code(coded, models, _LONGEST + min(found, _LONGEST) - 2, (magnitude >> (found - 2)) & 1)
        value = ((2 + top) << (found - 2)) | code_number(
            coded, found - 2, magnitude & ((1 << (found - 2)) - 1)
        )
    return -value if code_number(coded, 1, 1 if number < 0 else 0) else value


@joined
def level(size: int) -> int:
    """Return the level of a size in 1 / `UNIT` steps, two in an octave."""
    bits = bit_length(size)
    return min(size if bits < 2 else 2 * (bits - 1) + ((size >> (bits - 2)) & 1), LEVELS - 1)


@joined
def fine_level(size: int) -> int:
    """Return the level of a size in 1 / `UNIT` steps, four in an octave."""
    bits = bit_length(size)
    return size if bits < 3 else 4 * (bits - 2) + ((size >> (bits - 3)) & 3)


@joined
def bit_length(size: int) -> int:
    """Return how many bits a number has, which is not negative."""
    bits = 0
    while size >= 1 << 16:
        size, bits = size >> 16, bits + 16
    if size >= 1 << 8:
        size, bits = size >> 8, bits + 8
    if size >= 1 << 4:
        size, bits = size >> 4, bits + 4
    if size >= 1 << 2:
        size, bits = size >> 2, bits + 2
    if size >= 1 << 1:
        size, bits = size >> 1, bits + 1
    return bits + size


@compiled
def learn_sizes(numbers: Index, ring: Index, starts: Index, activity: Index, around: Index) -> None:
    """Add the sizes of a signal's numbers to the activity ``(N,)``, and write its means over rings, ``around`` (N,)."""
    for node in range(len(numbers)):
        size = UNIT * min(abs(numbers[node]), _LARGEST)
        activity[node] = (102 * activity[node] + 154 * size) >> 8
    for node in range(len(numbers)):
        total, first, last = 0, starts[node], starts[node + 1]
        for place in range(first, last):
            total += activity[ring[place]]
        around[node] = total // (last - first) if last > first else 0
