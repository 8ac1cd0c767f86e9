"""USD layers with samples: values of every frame in the spaces of their prims, in one file, clips or a package.

Values go into Sdf layers directly, so that an overlay need not compose its file anew for every sample. Binary layers
are saved repeatedly while written, which frees samples: 400 frames of 50 000 vertices (240 MB) took 34 MB when saved
every 20 frames, 268 MB when saved once. Text layers are held in memory.

World-space points and velocities of the sequence are multiplied by the inverse of the prim's local-to-world transform.
Extents are computed from the written values, normals from every frame's points.

Packages (.usdz) are uncompressed zip files of a layer and textures. Since original files may be untrusted, only
textures in their folder, or in folders that the user names, are packed.

Clip ``i`` holds the frames from its first one to the first one of clip ``i + 1``, inclusive, so that USD interpolates
within a clip. Clip times equal stage times and are authored for every frame: USD before 26.11 otherwise loses the
offset of referencing shots, and rounds times between the first and the last. A manifest lists the attributes in clips,
so that USD need not open all of them.

Specifications: https://openusd.org/release/api/class_sdf_layer.html, https://openusd.org/release/spec_usdz.html,
https://openusd.org/release/api/_usd__page__value_clips.html
"""

from __future__ import annotations

import os
import re
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Sized
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Ar, Gf, Sdf, Usd, UsdUtils, Vt

from mixseq.errors import OutputError
from mixseq.mesh.measures import corner_normals
from mixseq.types import Float, FloatArray, IntArray
from mixseq_io.files import backup_path, raise_system_error, temporary_prefix
from mixseq_io.reader import FrameBlock, as_float32, warn
from mixseq_io.scene_meshes import SceneMesh
from mixseq_io.usd.stage import TILES, clips_folder, save_layer

Frame = tuple[float, Mapping[str, Any]]
"""A time code, and values by the paths of their attributes."""


@dataclass(frozen=True, eq=False)
class Space:
    """Space of a prim at some time."""

    to_world: Float
    to_local: Float


WORLD = Space(np.eye(4), np.eye(4))
SpaceAt = Callable[[float], Space]
"""Function from a time in seconds to a prim's space; exactly `WORLD` for the identity, to avoid rounding."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Normals:
    """Attribute and interpolation of a mesh's normals."""

    attribute: str
    interpolation: str
    groups: IntArray | None = None
    order: IntArray | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class Placed:
    """Mesh that gets samples, at a prim's path in a space.

    `of_point` ``(P,)`` are the mesh's vertices of the prim's points, by default the same; `normals` may be None.
    """

    path: str
    scene_mesh: SceneMesh
    of_point: IntArray | None = None
    space: SpaceAt = lambda time: WORLD
    normals: Normals | None = None
    velocities: bool = False

    @property
    def attributes(self) -> tuple[str, ...]:
        """Names of the sampled attributes."""
        velocities = ("velocities",) if self.velocities else ()
        normals = (self.normals.attribute,) if self.normals else ()
        return ("points", "extent", *velocities, *normals)

    def points(self, values: FloatArray) -> FloatArray:
        """Return the values ``(P, 3)`` of the prim's points, given values ``(V, 3)`` of the sequence's vertices."""
        own = values[self.scene_mesh.vertices]
        return own if self.of_point is None else own[self.of_point]


@dataclass(frozen=True, eq=False, kw_only=True)
class Bounds:
    """Prim above meshes with an extent of its own: the root of a skeleton."""

    path: str
    scene_meshes: tuple[SceneMesh, ...]
    space: SpaceAt
    others: Callable[[float], FloatArray]


@dataclass(frozen=True, eq=False)
class Cast:
    """All prims that get samples."""

    meshes: tuple[Placed, ...]
    bounds: tuple[Bounds, ...] = ()


def frames(
    cast: Cast, codes: NDArray[np.float64], times: NDArray[np.float64], numbered: Iterable[FrameBlock]
) -> Iterator[Frame]:
    """Yield the values of every frame: time codes, times in s ``(T,)``."""
    for first, block, speeds in numbered:
        for frame, points in enumerate(block, first):
            velocities = None if speeds is None else speeds[frame - first]
            yield float(codes[frame]), dict(_values(cast, frame, float(times[frame]), points, velocities))


def _values(
    cast: Cast, frame: int, time: float, points: FloatArray, velocities: FloatArray | None
) -> Iterator[tuple[str, Any]]:
    placed = [(mesh, mesh.space(time)) for mesh in cast.meshes]
    local = as_float32(_in_spaces(points, placed, direction=False)[None], frame, "USD")[0]
    for mesh, space in placed:
        own = mesh.points(local)
        yield f"{mesh.path}.points", Vt.Vec3fArrayFromBuffer(own)
        yield f"{mesh.path}.extent", extent_of(own)
        if mesh.normals:
            normals = _normals(mesh.normals, points[mesh.scene_mesh.vertices], mesh.scene_mesh, space)
            yield f"{mesh.path}.{mesh.normals.attribute}", Vt.Vec3fArrayFromBuffer(normals)
    if velocities is not None:
        turned = _in_spaces(velocities, placed, direction=True)
        local = as_float32(turned[None], frame, "USD", "the velocity of vertex")[0]
        for mesh, _ in placed:
            if mesh.velocities:
                yield f"{mesh.path}.velocities", Vt.Vec3fArrayFromBuffer(mesh.points(local))
    for bounds in cast.bounds:
        yield f"{bounds.path}.extent", extent_of(_box(bounds, points, time))


def _in_spaces(vectors: FloatArray, placed: list[tuple[Placed, Space]], *, direction: bool) -> FloatArray:
    """Transform world-space positions, or directions, ``(V, 3)`` into the spaces of their meshes."""
    if all(space is WORLD for _, space in placed):
        return vectors
    local = vectors.astype(np.float64)
    for mesh, space in placed:
        if space is not WORLD:
            shift = 0.0 if direction else space.to_local[3, :3]
            local[mesh.scene_mesh.vertices] = local[mesh.scene_mesh.vertices] @ space.to_local[:3, :3] + shift
    return local


def _normals(
    normals: Normals, points: FloatArray, scene_mesh: SceneMesh, space: Space
) -> NDArray[np.float32]:
    """Return normals in a mesh's space: for x' = x M normals are n' = n M⁻ᵀ, hence n = n' Mᵀ."""
    unit = corner_normals(points[None], scene_mesh.polygons, normals.groups)[0]
    if space is not WORLD:
        local = unit @ space.to_world[:3, :3].T
        unit = (local / np.linalg.norm(local, axis=1, keepdims=True)).astype(np.float32)
    return unit if normals.order is None else np.asarray(unit[normals.order])


def _box(bounds: Bounds, points: FloatArray, time: float) -> FloatArray:
    """Return the corners ``(n, 3)`` of boxes around everything below a prim, in the prim's space."""
    own = [points[scene_mesh.vertices] for scene_mesh in bounds.scene_meshes if scene_mesh.vertex_count]
    sides = [zip(each.min(axis=0), each.max(axis=0), strict=True) for each in own]
    corners = np.array([corner for box in sides for corner in product(*box)], dtype=np.float64).reshape(-1, 3)
    to_local = bounds.space(time).to_local
    return np.concatenate([corners @ to_local[:3, :3] + to_local[3, :3], bounds.others(time)])


def extent_of(points: FloatArray) -> Any:
    """Return the bounding box of points ``(n, 3)`` as USD's extent."""
    if not len(points):
        return Vt.Vec3fArray([Gf.Range3f().GetMin(), Gf.Range3f().GetMax()])  # USD's box around nothing
    return Vt.Vec3fArrayFromBuffer(np.stack([points.min(axis=0), points.max(axis=0)]).astype(np.float32))


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


def override(layer: Sdf.Layer, attribute: Usd.Attribute) -> Sdf.AttributeSpec:
    """Return the spec in a layer of an attribute of a file below."""
    return attribute_in(layer, str(attribute.GetPath()), attribute.GetTypeName(), attribute.GetVariability())


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


_CLIP_SET = "mixseq"
"""Name other than "default", which the file below may have; sets of one name are merged key by key."""


def save_in_clips(
    layer: Sdf.Layer, cast: Cast, frames: Iterable[Frame], length: int, folder: NewFolder
) -> None:
    """Write frames into clips of `length` frames, and save a layer with their order."""
    starts: list[float] = []
    times: list[float] = []
    clip: Samples | None = None
    for number, frame in enumerate(frames):
        times.append(frame[0])
        if number % length == 0:
            starts.append(frame[0])
            if clip:
                clip.put(frame)
                clip.save()
            clip = Samples(_empty(folder.path / folder.clip(len(starts)), cast, layer.timeCodesPerSecond))
        if clip:
            clip.put(frame)
    if clip:
        clip.save()
    save_layer(_empty(folder.path / folder.manifest, cast, layer.timeCodesPerSecond))
    assets = Sdf.AssetPathArray(
        [Sdf.AssetPath(folder.asset(folder.clip(number + 1))) for number in range(len(starts))]
    )
    for path in [*(mesh.path for mesh in cast.meshes), *(bounds.path for bounds in cast.bounds)]:
        description = {
            "assetPaths": assets,
            "times": Vt.Vec2dArray([(time, time) for time in times]),
            "active": Vt.Vec2dArray([(start, float(number)) for number, start in enumerate(starts)]),
            "primPath": path,
            "manifestAssetPath": Sdf.AssetPath(folder.asset(folder.manifest)),
        }
        layer.GetPrimAtPath(path).SetInfo("clips", {_CLIP_SET: description})
    save_layer(layer)


def _empty(file: Path, cast: Cast, rate: float) -> Sdf.Layer:
    layer = Sdf.Layer.CreateNew(str(file))
    layer.timeCodesPerSecond = rate
    declare(layer, cast)
    return layer


class NewFolder:
    """Folder for the clips of a file, written under a temporary name and installed when complete."""

    def __init__(self, owner: Path, resources: ExitStack) -> None:
        self.target = self.path = self._old = clips_folder(owner)
        self._stem = owner.stem
        self._resources = resources
        self._installed = False

    @property
    def manifest(self) -> str:
        """File name of the manifest."""
        return f"{self._stem}.manifest.usdc"

    def clip(self, number: int) -> str:
        """Return the file name of a clip, counted from 1."""
        return f"{self._stem}.{number:04d}.usdc"

    def asset(self, name: str) -> str:
        """Return the asset path, in a layer beside the folder, of a file in it."""
        return f"./{self.target.name}/{name}"

    def make(self) -> None:
        """Create the folder, empty."""
        if self.target.exists() and not _is_of_clips(self.target, self._stem):
            raise OutputError(
                f"{self.target} has other files than clips, which are not deleted; move it away, or write to another "
                "name"
            )
        name = self._resources.enter_context(temporary_prefix(self.target.parent))
        self.path, self._old = Path(f"{name}.new"), backup_path(name, self.target)
        self.path.mkdir()

    def install(self) -> None:
        """Move the folder into place; the replaced one is kept until the end."""
        for file in self.path.iterdir():
            with file.open("rb") as stream:
                os.fsync(stream.fileno())
        if self.target.exists():
            self.target.rename(self._old)
        self.path.rename(self.target)
        self._installed = True

    def warn_if_unused(self) -> None:
        """Warn of clips left by an older file of this name that this one does not use."""
        with suppress(OSError):
            if _is_of_clips(self.target, self._stem) and (self.target / self.manifest).exists():
                warn(
                    f"{self.target} has the clips of an older file of this name; the new one does not use them, remove "
                    "them if no other does"
                )

    def undo(self) -> None:
        """Restore the previous folder."""
        if self._installed:
            self.target.rename(self.path)
        if self._old.exists():
            self._old.rename(self.target)


@contextmanager
def new_folder(owner: Path) -> Iterator[NewFolder]:
    """Yield a folder for the clips of a file; after an exception the previous state is restored."""
    with ExitStack() as resources:
        folder = NewFolder(owner, resources)
        try:
            yield folder
        except BaseException:
            with suppress(OSError):
                folder.undo()
            raise


def _is_of_clips(folder: Path, stem: str) -> bool:
    return folder.is_dir() and all(
        file.name.startswith(f"{stem}.") and file.suffix == ".usdc" for file in folder.iterdir()
    )
