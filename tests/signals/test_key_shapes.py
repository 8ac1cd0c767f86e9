"""Frames that stand for all others."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mixseq.signals.detail import choose_keys, key_map
from mixseq.signals.modes import principal_modes
from tests.signals.test_pose import METRIC, vectors


@given(count=st.integers(1, 7), rank=st.integers(0, 4), seed=st.integers(0, 50))
def test_weights_add_up_to_one(count: int, rank: int, seed: int) -> None:
    modes = principal_modes(vectors(count, rank, seed=seed), METRIC)
    points = modes.sizes * np.random.default_rng(seed).standard_normal((5, len(modes.sizes)))
    frames = choose_keys(modes.scores)
    weights = key_map(modes.scores[frames]).weights(points)
    assert weights.shape[1] == len(frames) <= min(count, len(modes.sizes) + 1)
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-9)


def test_key_frames_stand_for_all_others() -> None:
    given_ = vectors(count=8, rank=3)
    modes = principal_modes(given_, METRIC).first(3)
    frames = choose_keys(modes.scores)
    assert len(frames) == 4
    weights = key_map(modes.scores[frames]).weights(modes.scores)
    np.testing.assert_allclose(weights @ given_[frames], given_, atol=1e-10)
    np.testing.assert_allclose(weights[frames], np.eye(4), atol=1e-9)
    assert np.abs(weights).max() < 4, "key frames are spread widely"
