"""HDF5 models: a shape space and the signals of a sequence in it. Layout in ``docs/file-format.md``.

::

    /                          format = "mixseq-model", version = 6 (2 to 5 before), created_by, settings (JSON), space,
                               name, fps, up_axis, metres_per_unit, vertex_count
    /polygons/                 counts, indices
    /segmentation/             part_of_face, widths                         (mixed space)
    /segmentation/parts/       vertices, sizes                              (mixed space)
    /segmentation/joints/      faces, sizes                                 (mixed space)
    /space/                    scale; placement, shapes (mixed space); reference (all but vertex, basis);
                               reference_lengths (free mixed and edge space); fields (basis space);
                               free (anchored mixed space)
    /space/shares/             sizes, parts, weights                        (anchored mixed space)
    /signals/time/             frames, times, values
    /signals/pose/             offset, matrix
    /signals/shape/            what vectors consist of, see `shape_blocks`
    /signals/placement/        times, rotations, translations

Compressed models have a layout of their own: `mixseq_io.hdf5.compressed_reader`.
"""

from __future__ import annotations

import warnings
from pathlib import Path

import h5py

from mixseq.coding.bitstream.compressed_sequence import CompressedSequence
from mixseq.errors import (
    FormatError,
    InvalidSequenceError,
    MixseqWarning,
    OutputError,
    ReconstructionError,
    SettingsError,
)
from mixseq.public import public
from mixseq.signals.model import Model
from mixseq.version import __version__
from mixseq_io.hdf5.compressed_reader import container_of, sequence_of
from mixseq_io.hdf5.compressed_writer import write_compressed
from mixseq_io.hdf5.contents import Contents, read_contents, reading_h5
from mixseq_io.hdf5.datasets import increasing
from mixseq_io.hdf5.h5_files import (
    MODEL_FORMAT,
    check_version,
    creating_h5,
    put_text,
    read_header,
    write_header,
)
from mixseq_io.hdf5.model_signals import read_signals, write_signals
from mixseq_io.hdf5.older_models import is_old_anchored, read_anchored, read_v1
from mixseq_io.hdf5.salvage import explain_damage, salvage_compressed
from mixseq_io.hdf5.stored_space import read_space, storable, write_space
from mixseq_io.memory import check_memory, memory_limit
from mixseq_io.registry import PathLike

VERSION = 6
"""Since 6 all texts have a fixed length, and so a checksum."""

_DECODED = 16
"""Bytes that decoding takes for each number of a basis and its coefficients."""

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
    space = storable(model.space)
    if model.residual_layer is not None:
        warnings.warn(
            f"{target}: the residual layer of a compressed model is not stored with signals; frames may be off by more "
            "than its bound",
            MixseqWarning,
            stacklevel=2,
        )
    with creating_h5(target) as (file, store):
        put_text(file, "format", MODEL_FORMAT)
        file.attrs["version"] = VERSION
        put_text(file, "created_by", f"mixseq {__version__}")
        file.attrs["vertex_count"] = model.header.vertex_count
        write_header(file, model.header)
        write_space(file, space)
        write_signals(file, model, space)
        store.check()


@public
def load(path: PathLike, salvage: bool = False, *, max_memory: float | None = None) -> Model:
    """Load a model from an HDF5 file.

    Parameters
    ----------
    path : path-like
        A file that `save` wrote, of this version or an older one; its signals may have been edited.
    salvage : bool
        Of a damaged compressed model, return what is not damaged: a `MixseqWarning` tells what is left out, frames or
        accuracy. Other files are loaded as usual.
    max_memory : float, optional
        Bytes that the file's arrays may take, as in `mixseq_io.open_sequence`.

    Returns
    -------
    Model

    Raises
    ------
    FormatError
        If the file is missing, damaged, not a model, or written by a newer mixseq, if its signals contradict
        each other, or if it takes more than `max_memory`.
    """
    with memory_limit(max_memory):
        return _load(Path(path), salvage)


def _load(source: Path, salvage: bool) -> Model:
    if salvage and (rest := salvage_compressed(source)) is not None:
        return decoded(source, rest)
    if source.is_file() and source.stat().st_size and not h5py.is_hdf5(source):
        raise FormatError(f"{source} is not a model, which is an HDF5 file; make one with mixseq encode")
    if source.is_file():
        check_memory(source, source.stat().st_size, "the file itself")
    try:
        file = read_contents(source, MODEL_FORMAT)
    except FormatError as error:
        explain_damage(source, error)
        raise
    if file.kind != MODEL_FORMAT:
        raise FormatError(
            f"{source} is an HDF5 file, but not a mixseq model (format = {file.kind!r}); make one with mixseq encode"
        )
    with reading_h5(source):
        if "coding" in file.attrs:
            return decoded(source, sequence_of(source, container_of(source, file)))
        check_version(source, file, VERSION)
        try:
            return read_v1(source, file) if int(file.attrs["version"]) == 1 else _read(source, file)
        except (InvalidSequenceError, SettingsError, ReconstructionError, IndexError) as error:
            raise FormatError(f"{source}: {error}; it is damaged") from error


def decoded(path: Path, coded: CompressedSequence) -> Model:
    """Return the model of a compressed sequence that was read from a file.

    Raises
    ------
    FormatError
        If its streams contradict each other, or what is in them takes too much memory.
    """
    from mixseq.coding.bitstream.compressed_sequence import to_model

    width, frames = 3 if coded.parameters.factors == "shapes" else 1, coded.header.frame_count
    numbers = coded.parameters.rank * (width * coded.header.vertex_count + 3 * frames)
    check_memory(path, _DECODED * numbers, "its basis and coefficients")
    try:
        return to_model(coded)
    except (FormatError, MemoryError) as error:
        raise FormatError(f"{path}: {error}") from error


def _read(path: Path, file: Contents) -> Model:
    frames = increasing(path, file, "signals/time/frames")
    header = read_header(path, file, int(file.attrs["vertex_count"]), frames)
    if is_old_anchored(path, file):
        return read_anchored(path, file, header)
    return read_signals(path, file, header, read_space(path, file, header))
