r"""Predict the probability of the next bit from several contexts by logistic mixing, learned from the bits before.

A bit has a *position* (first question about a number, second, ...) and a *context* in every input, a small integer. In
context :math:`c` of input :math:`i` bits at that position were 1 with the relative frequency :math:`p_{ic}`, counted
:math:`n_{ic}` times. Inputs are mixed in the logistic domain (Mahoney 2005, *Adaptive weighing of context models for
lossless data compression*),

.. math:: x_i = \frac{n_{ic}}{n_{ic} + 1} \ln \frac{p_{ic}}{1 - p_{ic}}, \qquad x = \sum_i w_i x_i,
          \qquad p = \frac{1}{1 + e^{-x}}

so that a new context contributes nothing. After the bit :math:`b`, frequencies move towards it, and weights of the
position by :math:`w_i \leftarrow w_i + \eta (b - p) x_i`.

All values are integers: :math:`p` in units of :math:`2^{-16}`, :math:`x` of :math:`2^{-8}`, :math:`w` of
:math:`2^{-16}`. Frozen: changing this breaks old files (golden: ``tests/coding/golden/*.npz``).
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Index
from mixseq.coding.bitstream.arithmetic import Coded, code_bit
from mixseq.compiled import joined

_FAR = 2047
"""Largest magnitude of x, in units of 2^-8: about 8, a probability of 1 in 3000. Frozen: breaks old files."""

_PATIENCE = 255
"""Largest count in the running mean of a frequency. Frozen: breaks old files."""

_RATE = 48
"""Learning rate of weights, in 1 / 4096 of x's and p's units. Frozen: breaks old files."""

_LEAST = 16
"""Smallest probability of either bit, in units of 2^-16. Frozen: breaks old files."""


class BitModels(NamedTuple):
    """Frequencies and mixing weights of bits, by position and context."""

    # (inputs, contexts, positions) frequencies of 1, and the numbers of bits counted: 256 p + n.
    shares: NDArray[np.int32]
    weights: Index  # (kinds, inputs) weights. Kinds are the positions, unless contexts tell these apart
    contexts: Index  # (inputs,) current contexts, set before every bit
    inputs: Index  # (inputs,) the inputs x of the current bit
    stretch: Index  # (4096,) table of x by p, with p in units of 2^-12
    squash: Index  # (2 _FAR + 1,) table of p by x, from x = -_FAR on
    steps: Index  # (_PATIENCE + 1,) table of the rates of frequencies by n, in units of 2^-16
    trust: Index  # (_PATIENCE + 1,) table of n / (n + 1) by n, in units of 2^-8


def bit_models(inputs: int, contexts: int, positions: int, kinds: int | None = None) -> BitModels:
    """Return untrained models; by default every position is a kind."""
    return BitModels(
        np.full((inputs, contexts, positions), 1 << 23, dtype=np.int32),
        np.full((kinds or positions, inputs), ((1 << 16) + inputs // 2) // inputs, dtype=np.int64),
        np.zeros(inputs, dtype=np.int64),
        np.zeros(inputs, dtype=np.int64),
        *_tables(),
    )


@lru_cache(maxsize=1)
def _tables() -> tuple[Index, Index, Index, Index]:
    stretch, squash = _logistic_tables()
    counts = np.arange(_PATIENCE + 1, dtype=np.int64)
    return (
        stretch,
        squash.clip(_LEAST, 65536 - _LEAST),
        (1 << 17) // (2 * counts + 3),
        256 * counts // (counts + 1),
    )


def _logistic_tables() -> tuple[Index, Index]:
    """Return x ``(4096,)`` of p in units of 2^-12, and p ``(2 _FAR + 1,)`` of x from ``-_FAR`` on."""
    squash = np.ones(2 * _FAR + 1)
    factor = 1.0039138893383475  # exp(1 / 256), and products of it: exp itself differs between machines
    for x in range(_FAR):
        squash[_FAR + x + 1] = squash[_FAR + x] * factor
    squash[:_FAR] = 1 / squash[:_FAR:-1]
    squash = np.floor(65536 * (squash / (1 + squash)))
    stretch = np.searchsorted(squash, np.arange(4096) * 16 + 8).clip(0, 2 * _FAR) - _FAR
    return stretch.astype(np.int64), squash.astype(np.int64)


@joined
def code(coded: Coded, models: BitModels, position: int, bit: int) -> int:
    """Write or read a bit at a position in the current contexts, update the models, and return it."""
    return code_of_kind(coded, models, position, position, bit)


@joined
def code_of_kind(coded: Coded, models: BitModels, position: int, kind: int, bit: int) -> int:
    """Write or read a bit as `code` does, with the mixing weights of a kind."""
    shares, weights, inputs, contexts = models.shares, models.weights, models.inputs, models.contexts
    x = 0
    for i in range(len(inputs)):
        share = shares[i, contexts[i], position]
        inputs[i] = (models.stretch[share >> 12] * models.trust[share & 255]) >> 8
        x += weights[kind, i] * inputs[i]
    chance = models.squash[min(max(x >> 16, -_FAR), _FAR) + _FAR]
    bit = code_bit(coded, chance, bit)
    error = ((bit << 16) - chance) >> 4
    for i in range(len(inputs)):
        weights[kind, i] += (inputs[i] * error * _RATE + (1 << 15)) >> 16
        share = shares[i, contexts[i], position]
        p, seen = share >> 8, share & 255
        p += (((bit << 16) - bit - p) * models.steps[seen]) >> 16
        shares[i, contexts[i], position] = (p << 8) + min(seen + 1, _PATIENCE)
    return bit
