r"""Tables of the logistic function and its inverse, in whole numbers: :math:`p = 1 / (1 + e^{-x})`.

Frozen: changing this breaks old files (golden: ``tests/coding/golden/*.npz``, ``tests/formats/golden/compressed-v1*``).
"""

from __future__ import annotations

import numpy as np

from mixseq.arrays import Index

FAR = 2047
"""Largest magnitude of x, in units of 2^-8: about 8, a chance of 1 in 3000. Frozen: breaks old files."""


def logistic_tables() -> tuple[Index, Index]:
    """Return x of p, and p of x.

    Returns
    -------
    stretch : (4096,) int64
        The x, in units of 2^-8, of the chances p in units of 2^-12.
    squash : (2 FAR + 1,) int64
        The p, in units of 2^-16, of x from ``-FAR`` to ``FAR``.
    """
    squash = np.ones(2 * FAR + 1)
    factor = 1.0039138893383475  # exp(1 / 256), and products of it: exp itself differs between machines
    for x in range(FAR):
        squash[FAR + x + 1] = squash[FAR + x] * factor
    squash[:FAR] = 1 / squash[:FAR:-1]
    squash = np.floor(65536 * (squash / (1 + squash)))
    stretch = np.searchsorted(squash, np.arange(4096) * 16 + 8).clip(0, 2 * FAR) - FAR
    return stretch.astype(np.int64), squash.astype(np.int64)
