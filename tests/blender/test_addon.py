"""Blender itself: the add-on, installed from its archive, and rigs that Blender imports. ``-s`` shows all rows."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.blender.environment import needs_blender
from tests.blender.live_rows import LiveRow, live_rows
from tests.blender.rig_rows import rig_rows

pytestmark = pytest.mark.slow

DATA = Path(os.environ["MIXSEQ_DATA"]) if "MIXSEQ_DATA" in os.environ else None


@needs_blender
@pytest.mark.parametrize("kind", [live_rows, rig_rows])
def test_blender_shows_what_mixseq_decodes(
    kind: Callable[[Path, Path | None], Iterator[LiveRow]], tmp_path: Path
) -> None:
    rows = list(kind(tmp_path, DATA))
    print(*rows, sep="\n")
    assert len(rows) > 5
    assert not [str(row) for row in rows if not row.passed]


@pytest.mark.parametrize(("at_least", "values"), [(False, (1, 2)), (True, (2, 3))])
def test_rows_pass_up_to_their_limits(at_least: bool, values: tuple[float, float]) -> None:
    for value in (1, 2, 3):
        row = LiveRow("speed", value, 2, at_least=at_least)
        assert row.passed == (value in values)
        assert ("**no**" in str(row)) != row.passed
