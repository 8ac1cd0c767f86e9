"""Compressed models in HDF5: one dataset of streams, one attribute that describes them.

::

    /            format = "mixseq-model", version = 1, created_by,
                 coding                  JSON: parameters, name, fps, up_axis, metres_per_unit, counts, first time
    /streams     (n,) uint8: an index, then all streams, one after the other

A second dataset would take more bytes than a checksum of every stream, and strings of variable length 4 KiB each.
Contents are those of `mixseq_io.coded`.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mixseq.errors import FormatError
from mixseq.version import __version__
from mixseq_io.coded.streams import Container
from mixseq_io.hdf5.contents import MODEL_FORMAT, Contents, translate_h5_errors

if TYPE_CHECKING:
    import h5py


def container_of(path: Path, file: Contents) -> Container:
    """Return the container of a compressed model that has been read."""
    with translate_h5_errors(path):
        if file.kind != MODEL_FORMAT or "coding" not in file.attrs:
            raise FormatError(f"{path} is no compressed model; make one with mixseq encode --max-error")
        return Container(
            text=bytes(file.attrs["coding"]),
            streams=file.arrays["streams"].astype(np.uint8).tobytes(),
            version=int(file.attrs["version"]),
        )


def write_container(file: h5py.File, container: Container) -> None:
    """Store a compressed sequence in a new HDF5 file."""
    import h5py

    for name, text in (
        ("format", MODEL_FORMAT.encode()),
        ("created_by", f"mixseq {__version__}".encode()),
        ("coding", container.text),
    ):
        file.attrs.create(name, text, dtype=h5py.string_dtype("ascii", len(text)))
    file.attrs["version"] = container.version
    file.create_dataset("streams", data=np.frombuffer(container.streams, dtype=np.uint8), track_times=False)
