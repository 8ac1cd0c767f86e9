"""Numbers that are evenly spread."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.types import evenly_spaced


@pytest.mark.parametrize("count", [1, 2, 7, 8, 9, 100])
def test_numbers_are_chosen_evenly(count: int) -> None:
    chosen = evenly_spaced(count, 8)
    assert (chosen[0], chosen[-1], len(chosen)) == (0, count - 1, min(count, 8))
    assert np.ptp(np.diff(chosen)) <= 1 if count > 1 else True


def test_of_nothing_nothing_is_chosen() -> None:
    assert evenly_spaced(0, 5).tolist() == []
