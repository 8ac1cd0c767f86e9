"""Save models and compressed sequences."""

from __future__ import annotations

import warnings
from pathlib import Path

from mixseq.coding.bitstream.compressed_sequence import CompressedSequence
from mixseq.errors import MixseqWarning, OutputError
from mixseq.public import public
from mixseq.signals.model import Model
from mixseq_io.hdf5.compressed_writer import write_compressed
from mixseq_io.hdf5.h5_writing import creating_h5
from mixseq_io.hdf5.model_files import write_model
from mixseq_io.registry import PathLike

SUFFIXES = (".h5", ".hdf5")


@public
def save(path: PathLike, model: Model | CompressedSequence) -> None:
    """Store a model, or a compressed sequence, in an HDF5 file.

    Parameters
    ----------
    path : path-like
        The file; an existing one is replaced when the new one is complete.
    model : Model or CompressedSequence
        What to store; nothing is lost but the residual layer of a compressed model that was loaded, which is
        reported by a `MixseqWarning`.

    Raises
    ------
    OutputError
        If the file cannot be written, its name does not end in .h5 or .hdf5, or the shape space is not one of
        mixseq's.
    """
    target = Path(path)
    if target.suffix.lower() not in SUFFIXES:
        raise OutputError(f"{target}: models are HDF5 files; end the name in {' or '.join(SUFFIXES)}")
    if isinstance(model, CompressedSequence):
        with creating_h5(target) as (file, store):
            write_compressed(file, model)
            store.check()
        return
    if model.residual_layer is not None:
        warnings.warn(
            f"{target}: the residual layer of a compressed model is not stored with signals; frames may be off by more "
            "than its bound",
            MixseqWarning,
            stacklevel=2,
        )
    with creating_h5(target) as (file, store):
        write_model(file, model)
        store.check()
