"""Trials: the error is known at once, bytes when they are asked for."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mixseq.compression.bitstream import signal_coder
from mixseq.compression.bitstream.signal_graph import mesh_graph
from mixseq.compression.encoder.components import trajectories
from mixseq.compression.encoder.trial import Candidate, Trial, try_step, with_residuals
from mixseq.sequence.sequence import frame_store
from tests.meshes import bar

SEQUENCE = frame_store(bar(sides=4, rings=12, frames=40))
FACES, COUNT = SEQUENCE.header.faces, SEQUENCE.header.vertex_count


def trial() -> Trial:
    """Two parts, several chunks."""
    components, labels = trajectories(SEQUENCE, 1e-6), (np.arange(COUNT) >= COUNT // 2).astype(np.int64)
    return try_step(
        SEQUENCE, Candidate.of(components, labels, FACES, mesh_graph(FACES, COUNT)), 1e-3, chunk=16
    )


def test_nothing_is_coded_before_bytes_are_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    coded, code_numbers = list[int](), signal_coder.code_numbers

    def counted(*given: Any) -> None:
        coded.append(1)
        code_numbers(*given)

    monkeypatch.setattr(signal_coder, "code_numbers", counted)
    one = trial()
    assert one.error > 0
    assert not coded
    assert one.size == sum(map(len, (*one.coding.streams.basis, *one.coding.streams.coefficients)))
    once = len(coded)
    assert once > 0
    bounded = with_residuals(SEQUENCE, one, one.error / 1000)
    assert bounded.signals == one.size < bounded.size
    assert bounded.chunks == tuple(
        replace(chunk, residuals=some) for chunk, some in zip(one.chunks, bounded.residuals, strict=True)
    )
    assert len(coded) == once, "streams were coded once more"


def test_streams_are_the_same_on_any_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    found = []
    for threads in ("1", "2", "3"):
        monkeypatch.setenv("MIXSEQ_THREADS", threads)
        one = trial()
        found.append((one.coding.streams, one.error, one.coefficients.tobytes()))
    assert len(found[0][0].coefficients) > 1
    assert found[1:] == found[:1] * 2
