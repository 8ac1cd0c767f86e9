"""The add-on in Blender, installed from its archive: what `scripts/bench dcc` asks of it, but for the large cache."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from scripts.benchmarks.blender.live_rows import LiveRow, live_rows

pytestmark = pytest.mark.slow


@pytest.mark.skipif("MIXSEQ_BLENDER" not in os.environ, reason="MIXSEQ_BLENDER names no Python that has bpy")
def test_models_live_in_blender(tmp_path: Path) -> None:
    rows = list(live_rows(tmp_path, None))
    assert len(rows) > 10
    assert not [str(row) for row in rows if not row.passed]


@pytest.mark.parametrize(("at_least", "values"), [(False, (1, 2)), (True, (2, 3))])
def test_rows_pass_up_to_their_limits(at_least: bool, values: tuple[float, float]) -> None:
    for value in (1, 2, 3):
        row = LiveRow("speed", value, 2, at_least=at_least)
        assert row.passed == (value in values)
        assert ("**no**" in str(row)) != row.passed
