from __future__ import annotations

import numpy as np
import pytest

from mixseq.runtime.progress import log_progress
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.fitting import fit
from mixseq.signals.model import Model


class Heard:
    """Remembers what it is told."""

    def __init__(self) -> None:
        self.calls: list[tuple[int, int, str]] = []

    def __call__(self, done: int, total: int, what: str) -> None:
        self.calls.append((done, total, what))

    def check(self) -> None:
        """Steps count up to their total, which stays."""
        steps = [done for done, _, _ in self.calls]
        assert steps == sorted(steps)
        assert {total for _, total, _ in self.calls} == {steps[-1]}
        assert all(what.strip() and "\n" not in what for _, _, what in self.calls)


def test_fit_tells_its_stages(bent_bar: MeshSequence) -> None:
    heard = Heard()
    fit(bent_bar, parts=2, progress=heard)
    heard.check()
    stages = [
        "finding parts",
        "growing joints",
        "registering parts",
        "encoding frames",
        "choosing modes and knots",
    ]
    assert list(dict.fromkeys(what.partition(", after")[0] for _, _, what in heard.calls)) == stages
    assert "of the tolerance" in heard.calls[-2][2]  # of the model before


def test_sampling_tells_of_every_frame(bar_model: Model) -> None:
    heard = Heard()
    frames = bar_model.sample(fps=20, progress=heard).frame_count
    heard.check()
    assert heard.calls[-1][:2] == (frames, frames)


def test_blocks_tell_after_each(bar_model: Model) -> None:
    heard = Heard()
    for number, _ in enumerate(bar_model.blocks(np.linspace(0, 0.3, 7), size=3, progress=heard)):
        assert len(heard.calls) == number
    heard.check()
    assert heard.calls == [(done, 7, "decoding frames") for done in (3, 6, 7)]


def test_progress_changes_nothing(bent_bar: MeshSequence, bar_model: Model) -> None:
    assert np.array_equal(fit(bent_bar, exact=True, progress=Heard()).vectors, bar_model.vectors)


def test_silent_says_nothing(capfd: pytest.CaptureFixture[str]) -> None:
    log_progress(1, 2, "anything")
    assert capfd.readouterr() == ("", "")


def test_finished_work_is_logged(bent_bar: MeshSequence, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level("DEBUG", logger="mixseq"):
        fit(bent_bar, parts=2)
    assert {record.name for record in caplog.records} == {"mixseq"}
    assert any(message.startswith("choosing modes and knots: done (") for message in caplog.messages)
