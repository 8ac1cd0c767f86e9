"""USD, writing: layers with samples, and packages of them (.usdz).

Values go into Sdf layers directly, past the stage: a layer that is laid over another file must not compose that file
anew with every sample. Binary layers are saved every now and then while they are written, upon which USD lets go of
the samples: of 400 frames of 50 000 vertices (240 MB) it held 34 MB at most when saved every 20 frames, against
268 MB when saved once. Text layers are held in memory whole.

A package is an uncompressed zip file of a layer and of the textures that it names. It goes out of the house, and the
names come from a file that may have come from elsewhere: only what lies in its folder, or in a folder that the user
names, is packed.

Specifications: https://openusd.org/release/api/class_sdf_layer.html, https://openusd.org/release/spec_usdz.html
"""

from __future__ import annotations

import re
import zipfile
from collections.abc import Iterable, Sequence, Sized
from contextlib import suppress
from pathlib import Path

from pxr import Ar, Sdf, UsdUtils

from mixseq.errors import OutputError
from mixseq_io.atomic import raise_system_error
from mixseq_io.usd.diagnostics import save_layer
from mixseq_io.usd.frame_values import Cast, Frame
from mixseq_io.usd.paths import TILES

_BYTES_BETWEEN_SAVES = 64 << 20

_TYPES = {
    "points": Sdf.ValueTypeNames.Point3fArray,
    "extent": Sdf.ValueTypeNames.Float3Array,
    "velocities": Sdf.ValueTypeNames.Vector3fArray,
    "normals": Sdf.ValueTypeNames.Normal3fArray,
    "primvars:normals": Sdf.ValueTypeNames.Normal3fArray,
}


class Samples:
    """A layer that takes frames, and does not grow in memory if it is binary."""

    def __init__(self, layer: Sdf.Layer) -> None:
        self._layer = layer
        self._binary = not layer.realPath.lower().endswith(".usda")
        self._unsaved = 0

    def put(self, frame: Frame) -> None:
        """Set the values of a frame."""
        code, values = frame
        for path, value in values.items():
            self._layer.SetTimeSample(path, code, value)
            self._unsaved += 12 * (len(value) if isinstance(value, Sized) else 1)
        if self._binary and self._unsaved > _BYTES_BETWEEN_SAVES:
            self.save()

    def save(self) -> None:
        """Save what has been put."""
        save_layer(self._layer)
        self._unsaved = 0


def save(layer: Sdf.Layer, frames: Iterable[Frame]) -> None:
    """Save a layer with frames."""
    samples = Samples(layer)
    for frame in frames:
        samples.put(frame)
    samples.save()


def declare(layer: Sdf.Layer, cast: Cast) -> None:
    """Author the attributes that are to have samples, without values."""
    for mesh in cast.meshes:
        for name in mesh.attributes:
            attribute = attribute_in(layer, f"{mesh.path}.{name}", _TYPES[name])
            if mesh.normals and name == mesh.normals.attribute:
                attribute.SetInfo("interpolation", mesh.normals.interpolation)
    for bounds in cast.bounds:
        attribute_in(layer, f"{bounds.path}.extent", _TYPES["extent"])


def attribute_in(
    layer: Sdf.Layer,
    path: str,
    kind: Sdf.ValueTypeName,
    variability: Sdf.Variability = Sdf.VariabilityVarying,
) -> Sdf.AttributeSpec:
    """Return the opinions of a layer on an attribute; made, with overs above, if it has none yet."""
    Sdf.JustCreatePrimAttributeInLayer(layer, Sdf.Path(path), kind, variability)
    return layer.GetAttributeAtPath(path)


def pack(layer: Sdf.Layer, package: Path, name: str, folders: Sequence[Path]) -> list[str]:
    """Write a package of a saved layer."""
    left_out: dict[str, None] = {}

    def packed(asset: str, folder: Path) -> str:
        files = _files_of(layer, asset)
        # Of scenes USD would pack what they name, wherever that is.
        refused = files if _is_scene(asset) else [file for file in files if not _within(file, folders)]
        left_out.update(dict.fromkeys(refused))
        return "" if refused else _unpacked(layer, asset, folder)

    textures = Path(f"{package}.textures")  # goes with the temporary name that the package has
    textures.mkdir()
    UsdUtils.ModifyAssetPaths(layer, lambda asset: packed(asset, textures))
    save_layer(layer)
    if not UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath(layer.realPath), str(package), name):
        raise_system_error("", package.parent)
        raise OutputError(f"{name} cannot be packed; write .usdc, and pack it with usdzip")
    return list(left_out)


def _files_of(layer: Sdf.Layer, asset: str) -> list[str]:
    """Return the files that USD finds for a name in a layer: one, none, or tiles of a texture."""
    outer, _ = Ar.SplitPackageRelativePathOuter(asset)
    named = layer.ComputeAbsolutePath(outer) if outer else ""
    if TILES in named:
        place = Path(named)
        pattern = re.escape(place.name).replace(TILES, r"\d{4}")
        beside = place.parent.iterdir() if place.parent.is_dir() else ()
        return [str(file) for file in beside if re.fullmatch(pattern, file.name)]
    found = str(Ar.GetResolver().Resolve(named))
    return [found] if found else []


def _is_scene(asset: str) -> bool:
    """Whether what is called a texture is one of the files that USD makes a stage of."""
    inner = Ar.SplitPackageRelativePathInner(asset)[1]
    return Sdf.FileFormat.FindByExtension(Path(inner or asset).suffix.lstrip(".")) is not None


def _within(file: str, folders: Sequence[Path]) -> bool:
    """Whether a file, and not a pipe or a device, lies in one of some folders; links count as what they lead to."""
    real = Path(file).resolve()
    return real.is_file() and any(real.is_relative_to(folder.resolve()) for folder in folders)


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
