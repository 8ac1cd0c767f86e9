"""HDF5 files read in a process of their own; attributes and arrays arrive as plain values.

A flipped bit can make HDF5 loop forever, and a crafted file can crash it, so the user's process does not import it: see
`mixseq_io.isolation`, and `mixseq_io.hdf5.inspection` for the worker's side.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import FormatError
from mixseq.mesh.polygons import Polygons
from mixseq.sequence.header import SequenceHeader
from mixseq_io.isolation import call_isolated
from mixseq_io.reader import check_regular_file, translate_read_errors
from mixseq_io.surfaces import SURFACE_ARRAY_NAMES, surface_from_arrays

_OTHER_SIDE = "mixseq_io.hdf5.inspection"


@dataclass(frozen=True)
class Contents:
    """Contents of an HDF5 file."""

    attributes: Mapping[str, Mapping[str, Any]]
    arrays: Mapping[str, NDArray[Any]]

    @property
    def attrs(self) -> Mapping[str, Any]:
        """Root attributes."""
        return self.attributes[""]

    @property
    def kind(self) -> str | None:
        """Root attribute `format`."""
        return self.text("format") if isinstance(self.attrs.get("format"), bytes) else None

    def text(self, name: str, group: str = "") -> str:
        """Return an attribute as text."""
        text: str = self.attributes[group][name].decode("utf-8", "surrogateescape")
        return text


def read_attributes(path: Path) -> Contents:
    """Read a file's attributes without arrays."""
    check_regular_file(path, "HDF5")
    found: Contents = call_isolated(f"{_OTHER_SIDE}:attributes", path)
    return found


def read_contents(
    path: Path, kind: str | None = None, meanwhile: Callable[[], object] | None = None
) -> Contents:
    """Read a file, or its attributes only if its `format` is not `kind`; call `meanwhile` while the worker reads."""
    check_regular_file(path, "HDF5")
    found: Contents = call_isolated(f"{_OTHER_SIDE}:contents", path, kind, meanwhile=meanwhile)
    return found


def translate_h5_errors(path: Path) -> AbstractContextManager[None]:
    """Translate h5py's errors on damaged files, and missing entries, into `FormatError`."""
    return translate_read_errors(
        path, "HDF5", KeyError, RuntimeError, ValueError, TypeError, AttributeError, OverflowError
    )


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
    """Read the header stored by `mixseq_io.hdf5.datasets.write_header`."""
    return SequenceHeader(
        polygons=Polygons(file.arrays["polygons/counts"], file.arrays["polygons/indices"]),
        vertex_count=vertex_count,
        times=times,
        fps=float(file.attrs["fps"]),
        up_axis=file.text("up_axis"),
        metres_per_unit=float(file.attrs["metres_per_unit"]),
        name=file.text("name"),
        surface=surface_from_arrays(_surface_arrays(file), path.parent),
    )


def _surface_arrays(file: Contents) -> dict[str, NDArray[Any]]:
    names = [name for name in SURFACE_ARRAY_NAMES if f"surface/{name}" in file.arrays]
    arrays = {name: np.asarray(file.arrays[f"surface/{name}"]) for name in names}
    return {
        name: np.char.decode(array, "utf-8") if array.dtype.kind == "S" else array
        for name, array in arrays.items()
    }
