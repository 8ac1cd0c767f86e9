"""HDF5 models: a shape space and the signals of a sequence in it. Layout in ``docs/file-format.md``.

::

    /                          format = "mixseq-model", version = 2 or 3, created_by, settings (JSON), space,
                               name, fps, up_axis, metres_per_unit, vertex_count
    /polygons/                 counts, indices
    /segmentation/             part_of_face, widths                         (mixed space)
    /segmentation/parts/       vertices, sizes                              (mixed space)
    /segmentation/joints/      faces, sizes                                 (mixed space)
    /space/                    scale; placement, shapes, trust (mixed space); reference (all but vertex space);
                               reference_lengths (mixed and edge space)
    /space/links/              parts, pivots, rests, own_weights, weights   (mixed space)
    /signals/time/             frames, times, values
    /signals/pose/             offset, matrix
    /signals/shape/            what vectors consist of, see `shape_blocks`
    /signals/placement/        times, rotations, translations
"""

from __future__ import annotations

from pathlib import Path

import h5py

from mixseq.errors import FormatError, InvalidSequenceError, OutputError, ReconstructionError, SettingsError
from mixseq.signals.model import Model
from mixseq.version import __version__
from mixseq_io.hdf5.arrays import increasing
from mixseq_io.hdf5.files import (
    MODEL_FORMAT,
    check_version,
    creating_h5,
    read_header,
    reading_h5,
    write_header,
)
from mixseq_io.hdf5.signals import read_signals, write_signals
from mixseq_io.hdf5.space import read_space, storable, version_of, write_space
from mixseq_io.hdf5.version1 import read_v1
from mixseq_io.registry import PathLike

VERSION = 3
"""Files have the first version that knows their space: older mixseqs read what they can."""

SUFFIXES = (".h5", ".hdf5")


def save(path: PathLike, model: Model) -> None:
    """Store a model in an HDF5 file.

    Parameters
    ----------
    path : path-like
        The file; an existing one is replaced when the new one is complete.
    model : Model
        What to store; nothing is lost.

    Raises
    ------
    OutputError
        If the file cannot be written, its name does not end in .h5 or .hdf5, or the shape space is not one of
        mixseq's.
    """
    target = Path(path)
    if target.suffix.lower() not in SUFFIXES:
        raise OutputError(f"{target}: models are HDF5 files; end the name in {' or '.join(SUFFIXES)}")
    space = storable(model.space)
    with creating_h5(target) as (file, store):
        file.attrs["format"] = MODEL_FORMAT
        file.attrs["version"] = version_of(space)
        file.attrs["created_by"] = f"mixseq {__version__}"
        file.attrs["vertex_count"] = model.header.vertex_count
        write_header(file, model.header)
        write_space(file, space)
        write_signals(file, model, space)
        store.check()


def load(path: PathLike) -> Model:
    """Load a model from an HDF5 file.

    Parameters
    ----------
    path : path-like
        A file that `save` wrote, of this version or an older one; its signals may have been edited.

    Returns
    -------
    Model

    Raises
    ------
    FormatError
        If the file is missing, damaged, not a model, or written by a newer mixseq, or if its signals contradict
        each other.
    """
    source = Path(path)
    if source.is_file() and source.stat().st_size and not h5py.is_hdf5(source):
        raise FormatError(f"{source} is not a model, which is an HDF5 file; make one with mixseq encode")
    with reading_h5(source), h5py.File(source, "r") as file:
        kind = file.attrs.get("format")
        if kind != MODEL_FORMAT:
            raise FormatError(
                f"{source} is an HDF5 file, but not a mixseq model (format = {kind!r}); make one with mixseq encode"
            )
        check_version(source, file, VERSION)
        try:
            return read_v1(source, file) if int(file.attrs["version"]) == 1 else _read(source, file)
        except (InvalidSequenceError, SettingsError, ReconstructionError, IndexError) as error:
            raise FormatError(f"{source}: {error}; it is damaged") from error


def _read(path: Path, file: h5py.File) -> Model:
    frames = increasing(path, file, "signals/time/frames")
    header = read_header(path, file, int(file.attrs["vertex_count"]), frames)
    return read_signals(path, file, header, read_space(path, file, header))
