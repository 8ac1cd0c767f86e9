"""Versions and sequence headers of mixseq's HDF5 files; `h5_writing` writes them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import FormatError
from mixseq.sequence import Polygons, SequenceHeader
from mixseq_io.hdf5.contents import Contents
from mixseq_io.surface_arrays import SURFACE_ARRAYS, surface_of_arrays

MODEL_FORMAT = "mixseq-model"
"""Root attribute `format` of a model."""


def check_version(path: Path, file: Contents, known: int) -> None:
    """Raise an error for another version of the format."""
    version = int(file.attrs["version"])
    if version != known:
        raise FormatError(
            f"{path} has version {version} of its format, and this mixseq reads version {known}; "
            "it was written by another version of mixseq: make it again with this one"
        )


def read_header(path: Path, file: Contents, vertex_count: int, times: NDArray[np.float64]) -> SequenceHeader:
    """Read the header stored by `mixseq_io.hdf5.h5_writing.write_header`."""
    return SequenceHeader(
        polygons=Polygons(file.arrays["polygons/counts"], file.arrays["polygons/indices"]),
        vertex_count=vertex_count,
        times=times,
        fps=float(file.attrs["fps"]),
        up_axis=file.text("up_axis"),
        metres_per_unit=float(file.attrs["metres_per_unit"]),
        name=file.text("name"),
        surface=surface_of_arrays(_surface_arrays(file), path.parent),
    )


def _surface_arrays(file: Contents) -> dict[str, NDArray[Any]]:
    names = [name for name in SURFACE_ARRAYS if f"surface/{name}" in file.arrays]
    arrays = {name: np.asarray(file.arrays[f"surface/{name}"]) for name in names}
    return {
        name: np.char.decode(array, "utf-8") if array.dtype.kind == "S" else array
        for name, array in arrays.items()
    }
