"""Models read as sequences: their frames."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from mixseq.arrays import FloatArray
from mixseq_io.reader import SequenceReader


class ModelReader(SequenceReader):
    """Decodes the frames of a model as they are asked for."""

    def __init__(self, path: Path) -> None:
        from mixseq.signals.decoding import FRAMES
        from mixseq_io.loading import load  # models build on formats, not formats on models

        self._model = load(path)
        self._most = FRAMES
        super().__init__(path, self._model.header)

    def _read_blocks(self, size: int) -> Iterator[FloatArray]:
        return self._model.blocks(self._model.times, min(size, self._most))
