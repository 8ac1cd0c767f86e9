"""Compiled loops of `mixseq.coding.bitstream.signal_coder`: numbers of one signal, node by node, written or read alike.

Numbers and values have separate loops that can run at the same time: a number is coded in contexts of other numbers,
without values.

Frozen: changing this breaks old files (golden: ``tests/coding/golden/*.npz``). All decisions use integers, except the
sums of `predictor_kernels.predict`, which are rounded.
"""

from __future__ import annotations

import math

import numpy as np

from mixseq.arrays import Float, Index
from mixseq.coding.bitstream.arithmetic import Coded, code_number
from mixseq.coding.bitstream.bit_models import BitModels, code
from mixseq.coding.bitstream.predictor_kernels import UNIT, Small, predict
from mixseq.compiled import compiled, joined

LEVELS = 32
"""Number of levels of expected sizes, two in an octave. Frozen: breaks old files."""

DEPTHS = 18
"""Number of node classes, by bit length of the node number: about its level in the graph. Frozen: breaks old files."""

AGES = 8
"""Number of classes of signals by the count of those before. Frozen: breaks old files."""

INPUTS = 5
"""Contexts of a number. Frozen: breaks old files."""

CONTEXTS = LEVELS * LEVELS
"""Number of contexts per input. Frozen: breaks old files."""

_LONGEST = 24
"""Largest bit length with models for all questions. Frozen: breaks old files."""

_MOST = 55
"""Largest bit length of a number. Frozen: breaks old files."""

POSITIONS = 2 * _LONGEST
"""Number of modelled questions about a number. Frozen: breaks old files."""

_FARTHEST = 2.0**54
"""Largest magnitude of numbers: trial steps may be too fine for doubles. Free: only encoders round."""

_LARGEST = 1 << 40
"""Upper bound to which sizes are clamped. Frozen: breaks old files."""


@compiled
def code_numbers(
    coded: Coded,
    models: BitModels,
    age: int,
    neighbours: Small,
    counts: Small,
    activity: Index,
    around: Index,
    before: Index,
    numbers: Index,
) -> None:
    """Write or read the `numbers` ``(N,)`` int64 of a signal; `age` is the count of signals before.

    `activity` and `around` ``(N,)`` int64 are sizes of numbers in earlier signals, weighted towards newer ones, at a
    node and adjacent to it, in 1 / `UNIT` steps; `before` ``(N,)`` int64 are the numbers of the signal before.
    """
    contexts = models.contexts
    age = min(level(age), AGES - 1)
    bits = 0
    for node in range(len(numbers)):
        while node >> bits:
            bits += 1
        size = size_beside(node, neighbours, counts, activity, numbers)
        expected = expected_size(size, activity[node], around[node])
        here, beside, ring = level(size), level(activity[node]), level(around[node])
        depth = min(bits, DEPTHS - 1)
        contexts[0] = here * LEVELS + beside
        contexts[1] = beside * LEVELS + ring
        contexts[2] = min(fine_level(expected), CONTEXTS // DEPTHS - 1) * DEPTHS + depth
        contexts[3] = here * LEVELS + level(UNIT * min(abs(before[node]), _LARGEST))
        contexts[4] = level(expected) * AGES + age
        numbers[node] = code_signed(coded, models, numbers[node])


@compiled
def round_off(
    targets: Float,
    margins: Float,
    neighbours: Small,
    counts: Small,
    weights: Float,
    steps: Index,
    activity: Index,
    around: Index,
    numbers: Index,
    values: Index,
) -> None:
    """Predict `targets` ``(N,)`` node by node; write rounded differences `numbers`, decoded `values`, ``(N,)`` int64.

    Targets, `values`, `steps` ``(N,)`` are in 1 / `UNIT` steps; `activity` and `around` as in `code_numbers`. Numbers
    are rounded up from 1 - `margins` ``(LEVELS,)``, by the level of their expected size. Free: only encoders round.
    """
    for node in range(len(values)):
        size = size_beside(node, neighbours, counts, activity, numbers)
        margin = margins[level(expected_size(size, activity[node], around[node]))]
        predicted = predict(node, neighbours, counts, weights, values)
        off = targets[node] - predicted
        number = math.floor(min(abs(off) / steps[node] + margin, _FARTHEST))
        numbers[node] = -number if off < 0.0 else number
        values[node] = predicted + steps[node] * numbers[node]


@compiled
def add_predictions(
    numbers: Index, neighbours: Small, counts: Small, weights: Float, steps: Index, values: Index
) -> None:
    """Write the values ``(N,)`` decoded from numbers ``(N,)``."""
    for node in range(len(values)):
        values[node] = predict(node, neighbours, counts, weights, values) + steps[node] * numbers[node]


@joined
def size_beside(node: int, neighbours: Small, counts: Small, activity: Index, numbers: Index) -> int:
    """Return the mean size of the numbers at a node's neighbours, in 1 / `UNIT` steps; its activity if it has none."""
    if not counts[node]:
        return activity[node]  # type: ignore[no-any-return]
    total = 0
    for i in range(counts[node]):
        total += min(abs(numbers[neighbours[node, i]]), _LARGEST)
    return UNIT * total // counts[node]  # type: ignore[no-any-return]


@joined
def expected_size(size: int, activity: int, around: int) -> int:
    """Return the expected size of a number: .80 of `size` at neighbours, .40 of `activity`, .15 of that around."""
    return (205 * size + 102 * activity + 38 * around) >> 8


@joined
def code_signed(coded: Coded, models: BitModels, number: int) -> int:
    """Write or read a number: its bit length, the highest of the bits after the first, the others, and the sign."""
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
    """Return the bit length of a number that is not negative."""
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
def sizes_after(numbers: Index, ring: Index, starts: Index, activity: Index) -> tuple[Index, Index]:
    """Return the activity ``(N,)`` after a signal's numbers ``(N,)``, and its means over rings ``(N,)``."""
    after, around = np.empty_like(activity), np.empty_like(activity)
    for node in range(len(numbers)):
        size = UNIT * min(abs(numbers[node]), _LARGEST)
        after[node] = (102 * activity[node] + 154 * size) >> 8
    for node in range(len(numbers)):
        total, first, last = 0, starts[node], starts[node + 1]
        for place in range(first, last):
            total += after[ring[place]]
        around[node] = total // (last - first) if last > first else 0
    return after, around
