"""HDF5 and glTF files that hold a mesh sequence or a model; a model is read as its frames."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mixseq.arrays import FloatArray
from mixseq.errors import SettingsError
from mixseq_io.loading import is_model, load
from mixseq_io.reader import SequenceReader


class ModelReader(SequenceReader):
    """Reader that decodes the frames of a model on demand."""

    def __init__(self, path: Path) -> None:
        from mixseq.signals.decoding import FRAMES

        self._model = load(path)
        self._most = FRAMES
        super().__init__(path, self._model.header)

    def _read_blocks(self, size: int) -> Iterator[FloatArray]:
        return self._model.blocks(self._model.times, min(size, self._most))


def open_h5(path: Path) -> SequenceReader:
    """Open an HDF5 file with a sequence or a model."""
    if is_model(path):
        return ModelReader(path)
    from mixseq_io.hdf5 import sequence_files

    return sequence_files.open_h5(path)


def open_gltf(path: Path, **options: Any) -> SequenceReader:
    """Open a glTF file with meshes or a compressed model."""
    if not is_model(path):
        from mixseq_io.gltf import reader

        return reader.open_gltf(path, **options)
    given = [name for name, value in options.items() if value is not None]
    if given:
        raise SettingsError(
            f"{path} holds a compressed model, which has no {given[0]} to choose; leave it out"
        )
    return ModelReader(path)
