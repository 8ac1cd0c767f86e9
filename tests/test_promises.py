"""Promises on sequences that try to break them: some of them, and with MIXSEQ_EXHAUSTIVE all, in half an hour."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mixseq
from tests.adversarial import SEQUENCES
from tests.promises import attempts, distance

REFUSED = {"fit": "refused", "compress": "refused", "exact": "refused"}
KEPT = {"fit": "kept", "compress": "kept", "exact": "kept"}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "expected", "reason"),
    [
        ("scale 1e-310", REFUSED, "squares of such lengths do not fit into double precision"),
        ("scale 1e200", REFUSED, "squares of such lengths do not fit"),
        ("offset 1e300", REFUSED, "their squares do not fit"),
        ("offset 1e8", KEPT | {"exact": "refused"}, "move the sequence to the origin"),
        ("growth 1e-6 to 1e6", REFUSED, "beyond the digits|double precision cannot resolve"),
        ("not a number", REFUSED, "coordinates must be finite"),
        ("collapsed part", KEPT, ""),
        ("growth from a point, 1e-6", KEPT, ""),
        ("growth from a point, 1e6", KEPT, ""),
    ],
)
def test_promises_are_kept_or_refused(name: str, expected: dict[str, str], reason: str) -> None:
    found = list(attempts(*SEQUENCES[name](), (1e-4,)))
    assert {each.way: each.kind for each in found} == expected
    assert all(re.search(reason, each.words) for each in found if each.kind == "refused")


@pytest.mark.slow
@pytest.mark.exhaustive
@pytest.mark.parametrize("name", SEQUENCES)
def test_no_promise_is_broken(name: str) -> None:
    found = list(attempts(*SEQUENCES[name](), (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)))
    assert not [each for each in found if each.kind not in ("kept", "refused")]


@pytest.mark.slow
@pytest.mark.realdata
@pytest.mark.exhaustive
def test_no_promise_about_an_animation_is_broken(data: Path) -> None:
    for path in sorted((data / "npz").glob("*.npz")):
        with np.load(path) as arrays:
            found = list(attempts(arrays["points"], arrays["faces"], (1e-3, 1e-5)))
        assert not [each for each in found if each.kind != "kept"], path.stem


@pytest.mark.slow
def test_broken_promises_are_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    points, faces = SEQUENCES["two frames"]()
    still = mixseq.fit(mixseq.MeshSequence.from_arrays(points[[0, 0]], faces), exact=True)
    verify = mixseq.verify

    def liar(*given: Any) -> Any:
        return verify(given[0])  # which holds, as there is no original

    monkeypatch.setattr(mixseq, "fit", lambda *given, **settings: still)
    monkeypatch.setattr(mixseq, "verify", liar)
    fitted, compressed, exact = attempts(points, faces, (1e-3,))
    assert (fitted.kind, compressed.kind, exact.kind) == ("broken", "verify wrong", "broken")
    assert fitted.error == pytest.approx(distance(points, points[[0, 0]]))


def test_distances_are_in_diagonals_at_any_scale() -> None:
    points = np.array([[[0.0, 0, 0], [3, 4, 0]]])
    for scale in (1e-300, 1.0, 1e300):
        assert distance(points * scale, points * scale + np.array([0, 0, 10 * scale])) == pytest.approx(2)
    assert distance(np.zeros((1, 3, 3)), np.ones((1, 3, 3))) == pytest.approx(3**0.5)
