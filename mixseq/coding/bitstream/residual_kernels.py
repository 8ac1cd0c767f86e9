"""The compiled loop of `mixseq.coding.bitstream.residual_layer`: the residuals of a frame, node by node.

Frozen: changing this breaks old files (golden: ``tests/coding/golden/bounded.npz``). All values are integers.
"""

from __future__ import annotations

import numpy as np

from mixseq.arrays import Index
from mixseq.coding.bitstream.arithmetic import Coded, code_number
from mixseq.coding.bitstream.bit_models import BitModels, code
from mixseq.coding.bitstream.signal_graph import MOST
from mixseq.compiled import compiled, joined

INPUTS = 3
"""Contexts of a bit. Frozen: breaks old files."""

_VOTES = MOST + 1
"""Number of neighbour counts, from none on. Frozen: breaks old files."""

CONTEXTS = 3 * _VOTES * _VOTES
"""Number of contexts per input. Frozen: breaks old files."""

_LONGEST = 8
"""Largest number with models for all of its questions. Frozen: breaks old files."""

_MOST = 62
"""Largest bit length of the excess over that. Frozen: breaks old files."""

POSITIONS = 4 + _LONGEST
"""Modelled questions: any vertex displaced, this one, zero coordinate, sign, above 1, 2, ... Frozen: breaks files."""


@compiled
def code_residuals(
    coded: Coded,
    models: BitModels,
    neighbours: Index,
    counts: Index,
    ring: Index,
    starts: Index,
    last: Index,
    numbers: Index,
) -> None:
    """Write or read the numbers ``(N, 3)`` of a frame, in contexts of those of the frame before, `last`.

    A graph of N nodes has `neighbours` (N, n) before every node, ``counts`` (N,) of them, and all nodes adjacent to
    node i in ``ring[starts[i] : starts[i + 1]]``.
    """
    contexts = models.contexts
    displaced = 0
    for node in range(len(numbers)):
        displaced |= _any(numbers, node)
    contexts[:] = 0
    if not code(coded, models, 0, displaced):
        return
    sums = np.zeros(3, dtype=np.int64)
    for node in range(len(numbers)):
        votes, count = 0, counts[node]
        sums[:] = 0
        for i in range(count):
            beside = neighbours[node, i]
            votes += _any(numbers, beside)
            for k in range(3):
                sums[k] += min(max(numbers[beside, k], -1), 1)
        before = 0
        for place in range(starts[node], starts[node + 1]):
            before += _any(last, ring[place])
        own = _any(last, node)
        contexts[0] = (votes * _VOTES + count) * 3 + (2 * own if own else min(before, 1))
        contexts[1] = (min(before, _VOTES - 1) * _VOTES + min(votes, 3)) * 2 + own
        contexts[2] = min(votes, 3) * 3 + (2 * own if own else min(before, 1))
        if not code(coded, models, 1, _any(numbers, node)):
            for k in range(3):
                numbers[node, k] = 0
            continue
        others = 0
        for k in range(3):
            here, around = min(max(last[node, k], -3), 3) + 3, min(max(sums[k], -3), 3) + 3
            contexts[0] = here * 7 + around
            contexts[1] = (others * 7 + around) * 3 + k
            contexts[2] = (others * 7 + here) * 3 + k
            numbers[node, k] = _code_coordinate(coded, models, numbers[node, k])
            others |= (1 if numbers[node, k] else 0) << k


@joined
def _any(numbers: Index, node: int) -> int:
    return 1 if numbers[node, 0] or numbers[node, 1] or numbers[node, 2] else 0


@joined
def _code_coordinate(coded: Coded, models: BitModels, number: int) -> int:
    if not code(coded, models, 2, 1 if number else 0):
        return 0
    sign = code(coded, models, 3, 1 if number < 0 else 0)
    rest, found = abs(number) - 1, 0
    while found < _LONGEST and code(coded, models, 4 + found, 1 if rest > found else 0):
        found += 1
    if found == _LONGEST:
        beyond, bits, length = max(rest - _LONGEST, 0), 0, 0
        while beyond >> bits:
            bits += 1
        while length < _MOST and code_number(coded, 1, 1 if bits > length else 0):
            length += 1
        found += code_number(coded, length, beyond)
    return -(found + 1) if sign else found + 1
