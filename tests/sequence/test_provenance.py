"""What is known of where frames come from: sums of bounds, edits, texts, and what files store."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from mixseq.errors import SettingsError
from mixseq.sequence.provenance import (
    MAX_STEPS,
    Provenance,
    as_edited,
    format_error,
    frames_checksum,
    with_other_motion,
)

WALK = Provenance("walk.usdc", checksum=7)
RANK = Provenance("r10.h5", WALK, 6e-4, diagonal=2.0)
SMALL = Provenance("small.h5", RANK, 1e-4, diagonal=2.5, promised=True, order="vertices")


def test_bounds_add_up_as_lengths() -> None:
    """1e-4 of 2.5 and 6e-4 of 2 are 0.00145, which is 7.25e-4 of 2."""
    assert WALK.bounds == []
    (step, bound), (first, total) = SMALL.bounds
    assert (step, bound, first) == (SMALL, 1e-4, RANK)
    assert total == pytest.approx((1e-4 * 2.5 + 6e-4 * 2.0) / 2.0, rel=1e-15)


def test_nothing_is_said_beyond_edits_and_unmeasured_errors() -> None:
    edited = as_edited(SMALL)
    assert edited is not None
    assert [bound for _, bound in edited.bounds] == [None, None]
    for gap in (replace(RANK, edited=True), replace(RANK, max_error=None)):
        assert [bound for _, bound in replace(SMALL, source=gap).bounds] == [1e-4, None]
    assert as_edited(None) is None


@pytest.mark.parametrize(
    ("provenance", "text"),
    [
        (WALK, ""),
        (replace(WALK, edited=True), "an edit of walk.usdc"),
        (RANK, "6e-4 from walk.usdc"),
        (SMALL, "1e-4 from r10.h5, which is 6e-4 from walk.usdc"),
        (replace(SMALL, edited=True), "an edit of what is 1e-4 from r10.h5, which is 6e-4 from walk.usdc"),
        (
            replace(SMALL, source=replace(RANK, edited=True)),
            "1e-4 from r10.h5, which is an edit of what is 6e-4 from walk.usdc",
        ),
        (Provenance("", WALK, edited=True), "an edit of walk.usdc"),
        (Provenance("small.h5", Provenance(""), 0.001), "1e-3 from an unknown original"),
    ],
)
def test_one_line_tells_all_steps(provenance: Provenance, text: str) -> None:
    assert str(provenance) == text


def test_other_motions_of_a_renumbered_mesh_keep_only_that() -> None:
    moved = with_other_motion(SMALL)
    assert moved is not None
    assert (str(moved), moved.kept_order, [bound for _, bound in moved.bounds]) == (
        "an edit of small.h5",
        "vertices",
        [None],
    )
    assert with_other_motion(RANK) is with_other_motion(None) is None


@pytest.mark.parametrize(
    ("error", "text"),
    [(0, "0"), (1e-4, "1e-4"), (0.00062, "6.2e-4"), (0.00137154, "1.4e-3"), (9.91e-5, "1e-4"), (2.0, "2e0")],
)
def test_bounds_are_rounded_up(error: float, text: str) -> None:
    assert format_error(error) == text
    assert float(text) >= error


def test_the_least_order_of_all_steps_is_kept() -> None:
    assert (WALK.kept_order, RANK.kept_order, SMALL.kept_order) == ("keep", "keep", "vertices")
    assert Provenance("later", replace(SMALL, order="free")).kept_order == "free"


def test_plain_values_come_back() -> None:
    for provenance in (WALK, RANK, SMALL, replace(SMALL, edited=True)):
        plain = json.loads(json.dumps(provenance.to_plain()))
        assert Provenance.from_plain(plain) == provenance
    assert WALK.to_plain() == {"name": "walk.usdc", "checksum": 7}


def test_damaged_values_are_refused() -> None:
    nested: dict[str, object] = {}
    for _ in range(MAX_STEPS):
        nested = {"source": nested}
    numbers: list[object] = [{"name": 3}, {"max_error": -1}, {"diagonal": "2"}, {"order": "any"}]
    damaged: list[object] = [[], {"what": 1}, nested, *numbers]
    for plain in damaged:
        with pytest.raises(SettingsError, match="provenance"):
            Provenance.from_plain(plain)


def test_checksums_are_of_frames_and_not_of_how_they_are_stored() -> None:
    points = np.random.default_rng(1).normal(size=(5, 9, 3)).astype(np.float32)
    points[0, 0, 0] = 0.0
    whole = frames_checksum([points])
    negative = points.copy()
    negative[0, 0, 0] = -0.0
    same = [points[:2], points[2:]], [points.astype(np.float64)], [points[:, ::-1]], [negative]
    assert {frames_checksum(blocks) for blocks in same} == {whole}
    moved = points.copy()
    moved[3, 4, 1] = np.nextafter(moved[3, 4, 1], np.float32(9))
    assert whole not in (frames_checksum([moved]), frames_checksum([points[::-1]]), frames_checksum([points[:4]]))
