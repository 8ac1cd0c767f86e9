"""HDF5 files read in a process of their own; attributes and arrays arrive as plain values.

A flipped bit can make HDF5 loop forever, and a crafted file can crash it, so the user's process does not import it: see
`mixseq_io.isolation`, and `mixseq_io.hdf5.unpacking` for the worker's side.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from mixseq_io.isolation import call_isolated
from mixseq_io.reader import check_regular, reading

_OTHER_SIDE = "mixseq_io.hdf5.unpacking"


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
    check_regular(path, "HDF5")
    found: Contents = call_isolated(f"{_OTHER_SIDE}:attributes", path)
    return found


def read_contents(
    path: Path, kind: str | None = None, meanwhile: Callable[[], object] | None = None
) -> Contents:
    """Read a file, or its attributes only if its `format` is not `kind`; call `meanwhile` while the worker reads."""
    check_regular(path, "HDF5")
    found: Contents = call_isolated(f"{_OTHER_SIDE}:contents", path, kind, meanwhile=meanwhile)
    return found


def reading_h5(path: Path) -> AbstractContextManager[None]:
    """Translate h5py's errors on damaged files, and missing entries, into `FormatError`."""
    return reading(path, "HDF5", KeyError, RuntimeError, ValueError, TypeError, AttributeError, OverflowError)
