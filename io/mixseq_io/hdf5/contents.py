"""Read attributes and arrays of HDF5 files in a worker process.

A flipped bit can make HDF5 loop forever, and a crafted file can crash HDF5. Therefore only the worker opens files, by
`mixseq_io.hdf5.inspection`; see `mixseq_io.isolation`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import FormatError
from mixseq.mesh.polygons import Polygons
from mixseq.sequence.header import SequenceHeader
from mixseq_io.isolation import call_isolated
from mixseq_io.reader import check_regular_file, translate_read_errors
from mixseq_io.surfaces import SURFACE_ARRAY_NAMES, surface_from_arrays

if TYPE_CHECKING:
    from mixseq_io.coded.streams import Container

_WORKER_MODULE = "mixseq_io.hdf5.inspection"


@dataclass(frozen=True)
class Contents:
    """Attributes of an HDF5 file by name of the group, "" for the root, and arrays by name of the dataset."""

    path: Path
    attributes: Mapping[str, Mapping[str, Any]]
    arrays: Mapping[str, NDArray[Any]]

    @property
    def attrs(self) -> Mapping[str, Any]:
        """Attributes of the root."""
        return self.attributes[""]

    @property
    def kind(self) -> str | None:
        """Root attribute `format`, or None if it is missing or not a text."""
        return self.text("format") if isinstance(self.attrs.get("format"), bytes) else None

    def text(self, name: str, group: str = "") -> str:
        """Return the text of an attribute stored by `mixseq_io.hdf5.datasets.write_text`."""
        text: str = self.attributes[group][name].decode("utf-8", "surrogateescape")
        return text

    def group(self, name: str) -> Contents:
        """Return the contents of a group, as of a file of its own."""
        inside = f"{name}/"
        attributes = {
            each.removeprefix(inside): values for each, values in self.attributes.items() if each.startswith(inside)
        }
        arrays = {each.removeprefix(inside): array for each, array in self.arrays.items() if each.startswith(inside)}
        return Contents(self.path, {**attributes, "": self.attributes[name]}, arrays)


def read_attributes(path: Path) -> Contents:
    """Read the attributes of a file, without its arrays."""
    return read_contents(path, "")


def read_contents(path: Path, kind: str, meanwhile: Callable[[], object] | None = None) -> Contents:
    """Read a file, but only the attributes if `format` is not `kind`; call `meanwhile` while the worker reads."""
    check_regular_file(path, "HDF5")
    contents: Contents = call_isolated(f"{_WORKER_MODULE}:load_contents", path, kind, meanwhile=meanwhile)
    return contents


def translate_h5_errors(path: Path) -> AbstractContextManager[None]:
    """Translate errors of h5py, and of missing or malformed entries, into `FormatError`."""
    return translate_read_errors(
        path, "HDF5", KeyError, RuntimeError, ValueError, TypeError, AttributeError, OverflowError
    )


MODEL_FORMAT = "mixseq-model"
"""Value of the root attribute `format` in models."""


def parse_container(file: Contents) -> Container:
    """Return the text and streams of a compressed model, and of its further bodies."""
    from mixseq_io.coded.streams import Container

    with translate_h5_errors(file.path):
        if file.kind != MODEL_FORMAT or "coding" not in file.attrs:
            raise FormatError(f"{file.path} is not a compressed model; make one with mixseq encode --max-error")
        own, *bodies = (
            Container(
                text=bytes(each.attrs["coding"]),
                streams=each.arrays["streams"].astype(np.uint8).tobytes(),
                version=int(file.attrs["version"]),
            )
            for each in (file, *bodies_of(file))
        )
        return replace(own, bodies=tuple(bodies))


def bodies_of(file: Contents) -> list[Contents]:
    """Return the groups of the further bodies of a model: ``bodies/0``, ``bodies/1``, ..."""
    count = sum(name.startswith("bodies/") and name.count("/") == 1 for name in file.attributes)
    return [file.group(f"bodies/{number}") for number in range(count)]


def check_version(file: Contents, supported: int) -> None:
    """Raise an error if the version of a file's format differs from the supported version."""
    version = int(file.attrs["version"])
    if version != supported:
        raise FormatError(
            f"{file.path} has version {version} of its format, and this mixseq reads version {supported}; "
            "it was written by another version of mixseq: make it again with this one"
        )


def read_header(file: Contents, vertex_count: int, times: NDArray[np.float64]) -> SequenceHeader:
    """Return the header stored by `mixseq_io.hdf5.datasets.write_header`."""
    stored = {name: file.arrays.get(f"surface/{name}") for name in SURFACE_ARRAY_NAMES}
    arrays = {
        name: np.char.decode(array, "utf-8") if array.dtype.kind == "S" else array
        for name, array in stored.items()
        if array is not None
    }
    return SequenceHeader(
        polygons=Polygons(file.arrays["polygons/counts"], file.arrays["polygons/indices"]),
        vertex_count=vertex_count,
        times=times,
        fps=float(file.attrs["fps"]),
        up_axis=file.text("up_axis"),
        metres_per_unit=float(file.attrs["metres_per_unit"]),
        name=file.text("name"),
        surface=surface_from_arrays(arrays, file.path.parent),
    )
