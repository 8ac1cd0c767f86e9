"""USD, writing: packages (.usdz), uncompressed zip files of a layer and of the textures that it names.

Specification: https://openusd.org/release/spec_usdz.html
"""

from __future__ import annotations

import re
import zipfile
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory

from pxr import Ar, Sdf, UsdUtils

from mixseq.errors import OutputError
from mixseq_io.atomic import raise_system_error
from mixseq_io.usd.diagnostics import save_layer
from mixseq_io.usd.paths import TILES


def pack(layer: Sdf.Layer, package: Path, name: str) -> None:
    """Write a package of a saved layer.

    Parameters
    ----------
    layer : Sdf.Layer
        The layer; its textures are named as from the package's folder.
    package : Path
        The file to write.
    name : str
        What the layer is called in it.

    Raises
    ------
    OutputError
        If USD cannot pack it.
    OSError
        If that is because the disk is full.
    """
    with TemporaryDirectory(prefix=".mixseq.", dir=package.parent) as folder:
        UsdUtils.ModifyAssetPaths(layer, lambda asset: _unpacked(layer, asset, Path(folder)))
        save_layer(layer)
        if not UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath(layer.realPath), str(package), name):
            raise_system_error("", package.parent)
            raise OutputError(f"{name} cannot be packed; write .usdc, and pack it with usdzip")


def _unpacked(layer: Sdf.Layer, asset: str, folder: Path) -> str:
    """Return where a texture is, taken out if it is in a package: packages in packages are not for all viewers."""
    outer, inner = Ar.SplitPackageRelativePathOuter(asset)
    if not inner:  # USD would take tiles of other folders into the package as "../wool.1001.png"
        return layer.ComputeAbsolutePath(asset) if TILES in asset else asset
    with (
        suppress(OSError, KeyError, zipfile.BadZipFile),
        zipfile.ZipFile(layer.ComputeAbsolutePath(outer)) as whole,
    ):
        pattern = re.escape(inner).replace(TILES, r"\d{4}")
        textures = [each for each in whole.infolist() if re.fullmatch(pattern, each.filename)]
        if any(each.compress_type != zipfile.ZIP_STORED for each in textures):  # as the specification has it
            return asset
        data = {Path(each.filename).name: whole.read(each) for each in textures}
        own = folder / str(len(list(folder.iterdir())))
        own.mkdir()
        for name, content in data.items():
            (own / name).write_bytes(content)
        return str(own / Path(inner).name)
    return asset
