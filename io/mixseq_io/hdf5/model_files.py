"""HDF5 models: a shape space and the signals of a sequence in it. Layout in ``docs/file-format.md``.

::

    /                          format = "mixseq-model", version = 1, created_by, settings (JSON), space,
                               name, fps, up_axis, metres_per_unit, vertex_count
    /polygons/                 counts, indices
    /segmentation/             part_of_face, widths                         (mixed space)
    /segmentation/parts/       vertices, sizes                              (mixed space)
    /segmentation/joints/      faces, sizes                                 (mixed space)
    /space/                    scale; reference (all but vertex, basis); shapes, joint_faces (mixed space);
                               reference_lengths (edge space); fields (basis space)
    /space/skinning/           sizes, parts, weights                        (mixed space)
    /space/steadiness/         turns, centres, relation_turns, relation_points  (mixed space)
    /signals/time/             frames, times, values
    /signals/pose/             offset, matrix
    /signals/shape/            what vectors consist of, see `shape_blocks`
    /signals/placement/        times, rotations, translations
    /signals/correction/       times, rotations, translations               (mixed space)

Compressed models have a layout of their own: `mixseq_io.coded.reading`.
"""

from __future__ import annotations

from pathlib import Path

import h5py

from mixseq.errors import FormatError, InvalidSequenceError, ReconstructionError, SettingsError
from mixseq.signals.model import Model
from mixseq.version import __version__
from mixseq_io.hdf5.contents import Contents
from mixseq_io.hdf5.datasets import increasing
from mixseq_io.hdf5.h5_files import MODEL_FORMAT, check_version, read_header
from mixseq_io.hdf5.h5_writing import put_text, write_header
from mixseq_io.hdf5.model_signals import read_signals, write_signals
from mixseq_io.hdf5.stored_space import read_space, storable, write_space

VERSION = 1


def write_model(file: h5py.File, model: Model) -> None:
    """Store a model in a new file; raises `OutputError` if its shape space is not one of mixseq's."""
    space = storable(model.space)
    put_text(file, "format", MODEL_FORMAT)
    file.attrs["version"] = VERSION
    put_text(file, "created_by", f"mixseq {__version__}")
    file.attrs["vertex_count"] = model.header.vertex_count
    write_header(file, model.header)
    write_space(file, space)
    write_signals(file, model, space)


def read_model(path: Path, file: Contents) -> Model:
    """Make a model from a file's contents."""
    check_version(path, file, VERSION)
    try:
        frames = increasing(path, file, "signals/time/frames")
        header = read_header(path, file, int(file.attrs["vertex_count"]), frames)
        return read_signals(path, file, header, read_space(path, file, header))
    except (InvalidSequenceError, SettingsError, ReconstructionError, IndexError) as error:
        raise FormatError(f"{path}: {error}; it is damaged") from error
