"""USD, writing: names of prims, time codes, and paths between files.

Specification: https://openusd.org/release/api/class_sdf_asset_path.html
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Sdf

TILES = "<UDIM>"
"""Placeholder in a texture's name for the number of its tiles, from 1001 on."""


def time_codes(times: NDArray[np.float64], fps: float) -> NDArray[np.float64]:
    """Return ``times * fps`` ``(T,)``, rounded where only floating-point error keeps them from whole numbers.

    Examples
    --------
    >>> time_codes(np.arange(4) / 29.97, 29.97).tolist()
    [0.0, 1.0, 2.0, 3.0]
    """
    codes = times * fps
    nearest = np.rint(codes)
    near = np.abs(codes - nearest) <= 1e-9 * np.maximum(1.0, np.abs(codes))
    rounded = np.where(near, nearest, codes)
    return rounded if (np.diff(rounded) > 0).all() else codes


def identifier(name: str) -> str:
    """Return the closest valid prim name, letters of any script, digits, underscores: "2nd try" becomes "_2nd_try"."""
    cleaned = (
        "".join(letter if Sdf.Path.IsValidIdentifier("_" + letter) else "_" for letter in name) or "mesh"
    )
    return cleaned if Sdf.Path.IsValidIdentifier(cleaned) else "_" + cleaned


class Identifiers:
    """Unique valid prim names of siblings: a second "leg" becomes "leg_2"."""

    def __init__(self, *taken: str) -> None:
        self._taken = set(taken)
        self._next: dict[str, int] = {}

    def take(self, name: str) -> str:
        """Return the closest free name, and reserve it."""
        free = identifier(name)
        number = self._next.get(free, 0)
        while (numbered := f"{free}_{number}" if number else free) in self._taken:
            number += 1
        self._next[free] = number + 1
        self._taken.add(numbered)
        return numbered


def is_prim_path(text: str) -> bool:
    """Whether a text is the absolute path of a prim, such as "/world/fox"."""
    path = Sdf.Path(text) if Sdf.Path.IsValidPathString(text) else Sdf.Path()
    return bool(path.IsAbsolutePath() and path.IsPrimPath())


def reference_to(file: Path, target: Path) -> str:
    """Return the path of `file` in `target`: relative in a shared folder, absolute where symbolic links interfere."""
    absolute, folder = file.absolute(), target.absolute().parent
    try:
        relative = os.path.relpath(absolute, folder)
        shared = os.path.commonpath([absolute, folder])
    except ValueError:  # on different drives
        return absolute.as_posix()
    real = (folder.resolve() / relative).parent
    if Path(shared) == Path(absolute.anchor) or not (real.exists() and real.samefile(absolute.parent)):
        return absolute.as_posix()
    named = Path(relative).as_posix()
    return named if named.startswith("../") else f"./{named}"


def sublayer_of(path: Path) -> str:
    """Return the path of the file that a USD file is a layer over, as written there; "" if it stands alone."""
    layer = Sdf.Layer.FindOrOpen(str(path))
    return next(iter(layer.subLayerPaths), "") if layer else ""


def clips_folder(path: Path) -> Path:
    """Return the folder for a USD file's value clips; it includes the extension, to keep x.usda and x.usdc apart."""
    return path.with_name(f"{path.name}.clips")


def clips_of(path: Path) -> list[Path]:
    """Return the clips and the manifest that a USD file uses; none without clips."""
    folder = clips_folder(path)
    layer = Sdf.Layer.FindOrOpen(str(path)) if folder.is_dir() else None
    if not layer:
        return []
    used: set[str] = set()

    def visit(place: Sdf.Path | str) -> None:
        prim = layer.GetPrimAtPath(place)
        for clips in prim.GetInfo("clips").values() if prim else ():
            assets = [*clips.get("assetPaths", ()), clips.get("manifestAssetPath", Sdf.AssetPath())]
            used.update(asset.path for asset in assets)

    layer.Traverse(Sdf.Path.absoluteRootPath, visit)
    return [file for file in sorted(folder.iterdir()) if f"./{folder.name}/{file.name}" in used]
