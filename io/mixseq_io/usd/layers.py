"""USD, writing: layers with samples, and packages of them (.usdz), uncompressed zip files of a layer and textures.

Values go into Sdf layers directly, so that an overlay need not compose its file anew for every sample. Binary layers
are saved repeatedly while written, which frees samples: 400 frames of 50 000 vertices (240 MB) took 34 MB when saved
every 20 frames, 268 MB when saved once. Text layers are held in memory. Since original files may be untrusted, only
textures in their folder, or in folders that the user names, are packed.

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
    """Layer that takes frames in bounded memory, if it is binary."""

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
        """Save the layer."""
        save_layer(self._layer)
        self._unsaved = 0


def save(layer: Sdf.Layer, frames: Iterable[Frame]) -> None:
    """Save a layer with the samples of frames."""
    samples = Samples(layer)
    for frame in frames:
        samples.put(frame)
    samples.save()


def declare(layer: Sdf.Layer, cast: Cast) -> None:
    """Author sampled attributes without values."""
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
    """Return the spec of an attribute in a layer, created with overs above it if missing."""
    Sdf.JustCreatePrimAttributeInLayer(layer, Sdf.Path(path), kind, variability)
    return layer.GetAttributeAtPath(path)


def pack(layer: Sdf.Layer, package: Path, name: str, folders: Sequence[Path]) -> list[str]:
    """Write a package of a saved layer; return the files left out."""
    left_out: dict[str, None] = {}

    def packed(asset: str, folder: Path) -> str:
        files = _files_of(layer, asset)
        # USD would pack all files that scenes refer to, from anywhere.
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
    """Return the files of an asset path in a layer: one, none, or the tiles of a texture."""
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
    """Whether a texture's asset path is a USD file."""
    inner = Ar.SplitPackageRelativePathInner(asset)[1]
    return Sdf.FileFormat.FindByExtension(Path(inner or asset).suffix.lstrip(".")) is not None


def _within(file: str, folders: Sequence[Path]) -> bool:
    """Whether a path is a regular file in one of some folders, with links resolved."""
    real = Path(file).resolve()
    return real.is_file() and any(real.is_relative_to(folder.resolve()) for folder in folders)


def _unpacked(layer: Sdf.Layer, asset: str, folder: Path) -> str:
    """Return the path of a texture, extracted from a package since few viewers read nested ones."""
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
