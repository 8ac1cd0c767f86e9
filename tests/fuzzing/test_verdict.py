"""Classes of cases, in closed form."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from scripts.fuzzing.canary import MARK
from scripts.fuzzing.sandbox import Ended
from scripts.fuzzing.uses import OUT
from scripts.fuzzing.verdict import MOST_MEGABYTES, Found, Kind, classify, compare, tells

WELL = Ended(0, False, "wrote out.npz\n", 0.1, 10)
REFUSED = replace(WELL, code=2, text="mixseq: error: walk.npz is damaged\n")


@pytest.mark.parametrize(
    ("ended", "found", "kind"),
    [
        (WELL, "same", "same"),
        (WELL, "differs", "sound"),
        (WELL, "invalid", "silent change"),
        (WELL, "nothing", "silent change"),
        (REFUSED, "nothing", "refused"),
        (replace(REFUSED, text="Killed\n"), "nothing", "traceback"),
        (replace(WELL, code=1), "same", "traceback"),
        (replace(REFUSED, text="Traceback (most recent call last):\n"), "nothing", "traceback"),
        (replace(WELL, code=-11), "nothing", "signal"),
        (replace(WELL, code=-9, hung=True), "nothing", "hang"),
        (replace(REFUSED, megabytes=MOST_MEGABYTES + 1), "nothing", "memory"),
        (replace(REFUSED, text=REFUSED.text + "\x1b[2J"), "nothing", "escape"),
    ],
)
def test_classes(ended: Ended, found: Found, kind: Kind) -> None:
    assert classify(ended, found, (), told=False, noticed=False) == kind


def test_what_is_outside_weighs_most() -> None:
    hung = replace(WELL, hung=True)
    assert classify(hung, "same", ("secret.h5",), told=False, noticed=False) == "outside read"
    assert classify(hung, "same", (), told=True, noticed=False) == "outside read"


def test_damage_under_a_checksum_must_be_noticed() -> None:
    assert classify(WELL, "differs", (), told=False, noticed=True) == "silent change"
    assert classify(WELL, "same", (), told=False, noticed=True) == "same"


def test_what_was_found_is_compared(tmp_path: Path) -> None:
    expected = tmp_path / "expected"
    points = np.ones((1, 3, 3))
    with expected.open("wb") as file:
        np.savez(file, points=points)
    assert compare(tmp_path, expected) == "nothing"
    for other, found in ((points, "same"), (points * 2, "differs"), (points * np.nan, "invalid")):
        np.savez(tmp_path / OUT, points=other)
        assert compare(tmp_path, expected) == found


def test_text_of_files_outside_is_found_in_what_is_written(tmp_path: Path) -> None:
    assert not tells(WELL, tmp_path)
    assert tells(replace(WELL, text=MARK), tmp_path)
    (tmp_path / "packed.usdz").write_bytes(b"\x00" + MARK.encode())
    assert tells(WELL, tmp_path)
