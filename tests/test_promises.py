"""Promises on sequences that try to break them: some of what `scripts/bench promises` tries."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

import mixseq
from scripts.benchmarks.common.adversarial import SEQUENCES
from scripts.benchmarks.common.promises import attempts, distance

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
    ],
)
def test_promises_are_kept_or_refused(name: str, expected: dict[str, str], reason: str) -> None:
    found = list(attempts(name, *SEQUENCES[name](), (1e-4,)))
    assert {each.way: each.kind for each in found} == expected
    assert all(re.search(reason, each.words) for each in found if each.kind == "refused")


@pytest.mark.slow
def test_broken_promises_are_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    points, faces = SEQUENCES["two frames"]()
    still = mixseq.fit(mixseq.MeshSequence.from_arrays(points[[0, 0]], faces), exact=True)
    verify = mixseq.verify

    def liar(*given: Any) -> Any:
        return verify(given[0])  # which holds, as there is no original

    monkeypatch.setattr(mixseq, "fit", lambda *given, **settings: still)
    monkeypatch.setattr(mixseq, "verify", liar)
    fitted, compressed, exact = attempts("two frames", points, faces, (1e-3,))
    assert (fitted.kind, compressed.kind, exact.kind) == ("broken", "verify wrong", "broken")
    assert fitted.error == pytest.approx(distance(points, points[[0, 0]]))


def test_distances_are_in_diagonals_at_any_scale() -> None:
    points = np.array([[[0.0, 0, 0], [3, 4, 0]]])
    for scale in (1e-300, 1.0, 1e300):
        assert distance(points * scale, points * scale + np.array([0, 0, 10 * scale])) == pytest.approx(2)
    assert distance(np.zeros((1, 3, 3)), np.ones((1, 3, 3))) == pytest.approx(3**0.5)
