"""Statistics of values that come block by block."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixseq.runtime.low_memory import RunningStatistics
from tests.meshes import seeds


@given(seeds, st.lists(st.integers(0, 1500), min_size=1, max_size=8), st.integers(0, 5000), st.booleans())
@settings(max_examples=60, deadline=None)
def test_statistics_equals_brute_force(seed: int, sizes: list[int], skipped: int, ties: bool) -> None:
    rng = np.random.default_rng(seed)
    blocks = [rng.exponential(size=size) for size in sizes]
    if ties:
        blocks = [np.round(block, 1) for block in blocks]
    everything = np.concatenate(blocks)
    gathered = RunningStatistics(everything.size + skipped)
    for block in blocks:
        gathered.add(block)
    result = gathered.result()
    assert result.skipped == skipped
    if not everything.size:
        assert (result.rms, result.p999, result.max) == (0, 0, 0)
        return
    assert result.max == everything.max()
    assert result.p999 == np.quantile(everything, 0.999, method="inverted_cdf")
    assert result.rms == pytest.approx(np.sqrt(np.square(everything).mean()))


def test_statistics_when_a_block_is_as_long_as_what_is_kept() -> None:
    gathered = RunningStatistics(1000)
    everything = np.concatenate([[9.0, 1.0], np.full(997, 2.0), [5.0]])
    for block in (everything[:2], everything[2:]):
        gathered.add(block)
    assert gathered.result().p999 == 5.0


def test_what_is_not_finite_is_skipped() -> None:
    gathered = RunningStatistics(4)
    gathered.add(np.array([1.0, np.nan, 3.0]))
    gathered.add(np.array([np.inf]))
    result = gathered.result()
    assert (result.max, result.p999, result.skipped) == (3.0, 3.0, 2)
    assert RunningStatistics(3).result().skipped == 3
