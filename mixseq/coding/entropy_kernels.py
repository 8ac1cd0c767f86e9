"""Compiled loops of `mixseq.coding.entropy`."""

from __future__ import annotations

import numpy as np

from mixseq.arrays import Float, Index
from mixseq.compiled import compiled


@compiled
def shares(counts: Index, contexts: Index) -> Float:
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
def count(counts: Index, symbols: Index, contexts: Index, weight: int, most: int) -> None:
    """Add symbols ``(n,)`` to the counts of their contexts, and halve counts that are too many."""
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
