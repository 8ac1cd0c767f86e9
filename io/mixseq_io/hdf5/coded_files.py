"""Store compressed models in HDF5, as a dataset with all streams and an attribute that describes them.

::

    /            format = "mixseq-model", version = 1, created_by,
                 coding                  JSON: parameters, name, fps, up_axis, metres_per_unit, counts, first time
    /streams     (n,) uint8: an index, then the concatenation of all streams

All streams share one dataset, since separate datasets need more bytes. Each stream has its own checksum. Strings have
fixed length, since a string of variable length takes 4 KiB. `mixseq_io.coded` defines the text and the streams.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mixseq.errors import FormatError
from mixseq.version import __version__
from mixseq_io.coded.streams import Container
from mixseq_io.hdf5.contents import MODEL_FORMAT, Contents, translate_h5_errors

if TYPE_CHECKING:
    import h5py


def parse_container(file: Contents) -> Container:
    """Return the text and streams of a compressed model."""
    with translate_h5_errors(file.path):
        if file.kind != MODEL_FORMAT or "coding" not in file.attrs:
            raise FormatError(f"{file.path} is not a compressed model; make one with mixseq encode --max-error")
        return Container(
            text=bytes(file.attrs["coding"]),
            streams=file.arrays["streams"].astype(np.uint8).tobytes(),
            version=int(file.attrs["version"]),
        )


def write_container(file: h5py.File, container: Container) -> None:
    """Store the text and streams of a compressed model in a new HDF5 file."""
    import h5py

    for name, text in (
        ("format", MODEL_FORMAT.encode()),
        ("created_by", f"mixseq {__version__}".encode()),
        ("coding", container.text),
    ):
        file.attrs.create(name, text, dtype=h5py.string_dtype("ascii", len(text)))
    file.attrs["version"] = container.version
    file.create_dataset("streams", data=np.frombuffer(container.streams, dtype=np.uint8), track_times=False)
