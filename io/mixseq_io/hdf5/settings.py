"""Numbers and settings of a shape space in HDF5 that are no arrays."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from mixseq.errors import FormatError
from mixseq.shells.fitting import ShellSettings
from mixseq.shells.shell import Relaxation


def read_scale(path: Path, file: h5py.File) -> float:
    """Read the length of the space's unit."""
    scale = float(file["space"].attrs["scale"])
    if not (np.isfinite(scale) and scale > 0):
        raise FormatError(f"{path}: the scale of the space is {scale}; a positive number is expected")
    return scale


def write_settings(file: h5py.File, settings: Mapping[str, Mapping[str, Any]]) -> None:
    """Store settings by what they are about."""
    file.attrs["settings"] = json.dumps(settings, sort_keys=True)


def read_settings(path: Path, file: h5py.File, about: str, known: Collection[str]) -> dict[str, Any]:
    """Read settings of what they are about, which are among those that are known."""
    found: dict[str, Any] = _all_settings(file)[about]
    unknown = sorted(set(found) - set(known))
    if unknown:
        raise FormatError(f"{path}: this mixseq does not know the setting {unknown[0]!r}; upgrade it")
    return found


def _all_settings(file: h5py.File) -> dict[str, dict[str, Any]]:
    settings: dict[str, dict[str, Any]] = json.loads(str(file.attrs["settings"]))
    return settings


def read_shell(path: Path, file: h5py.File) -> ShellSettings:
    """Read the settings of fits to lengths and angles."""
    shell = read_settings(path, file, "shell", ShellSettings.__dataclass_fields__)
    return ShellSettings(**{"accuracy": 0.0, **shell})  # older files were checked without it


def read_relaxation(path: Path, file: h5py.File) -> Relaxation:
    """Read how lengths and angles are made to agree; older models, where they were fitted to, do as new ones."""
    if "relaxation" not in _all_settings(file):
        read_shell(path, file)
        return Relaxation()
    return Relaxation(**read_settings(path, file, "relaxation", Relaxation.__dataclass_fields__))
