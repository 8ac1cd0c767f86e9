"""Markers are pairs of whole numbers, with names for messages."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mixseq.errors import SettingsError
from mixseq.retargeting.markers import Markers


def test_pairs_become_columns() -> None:
    markers = Markers.of(np.array([[1.0, 2], [3, 4], [5, 6]]))
    assert markers.source.tolist() == [1, 3, 5]
    assert markers.target.tolist() == [2, 4, 6]
    assert len(markers) == 3
    assert markers.source.dtype == np.int64


def test_no_pairs_are_no_markers() -> None:
    assert len(Markers.of([])) == 0


@pytest.mark.parametrize(
    "pairs", [[1, 2, 3], [[1, 2, 3]], [[1.5, 2]], [["a", "b"]], [[1, 2], [3]], [[[1, 2]]], None]
)
def test_what_is_no_pairs_is_refused(pairs: Any) -> None:
    with pytest.raises(SettingsError, match=r"\(n, 2\) whole numbers"):
        Markers.of(pairs)


@pytest.mark.parametrize(
    ("names", "called"),
    [((), "2 (3 -> 4)"), (("nose", "tail"), "'tail' (3 -> 4)"), (("nose", ""), "2 (3 -> 4)")],
)
def test_messages_call_them_by_name_or_number(names: tuple[str, ...], called: str) -> None:
    assert Markers.of([[1, 2], [3, 4]], names).name(1) == called


def test_names_are_one_each_or_none() -> None:
    with pytest.raises(SettingsError, match="2 markers and 1 names"):
        Markers.of([[1, 2], [3, 4]], ("nose",))
