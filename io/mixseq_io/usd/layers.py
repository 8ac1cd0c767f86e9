"""Writing of time samples in the local spaces of prims to a single USD file, to value clips, or to a package.

Values are set in Sdf layers directly, since a stage would recompose the file below an overlay for every sample. Binary
layers are saved repeatedly, which frees the memory of their samples; text layers stay in memory.

Points and velocities are multiplied by the inverse of the prim's local-to-world transform. Extents are computed from
the local points, and normals from the world-space points of each frame.

Packages (.usdz) are uncompressed zip files of a layer and its textures. Files may be untrusted, so only textures in the
folder of the original, or in folders that the user names, are packed.

Clip ``i`` also holds the first frame of clip ``i + 1``, so that USD interpolates within a clip. Clip times equal stage
times. They are authored for every frame, since USD before 26.11 otherwise loses the offset of referencing shots, and
rounds times between the first and the last. A manifest lists the attributes in clips, so that USD need not open all
clips.

Specifications: https://openusd.org/release/api/class_sdf_layer.html, https://openusd.org/release/spec_usdz.html,
https://openusd.org/release/api/_usd__page__value_clips.html
"""

from __future__ import annotations

import os
import re
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Sized
from contextlib import ExitStack, contextmanager, suppress
from ctypes import memmove
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Ar, Sdf, Usd, UsdGeom, UsdUtils, Vt

from mixseq.errors import OutputError
from mixseq.mesh.measures import bounding_box, corner_normals
from mixseq.types import Float, FloatArray, IntArray
from mixseq_io.files import backup_path, raise_system_error, temporary_prefix
from mixseq_io.reader import FrameBlock, as_float32, warn
from mixseq_io.scene_meshes import SceneMesh
from mixseq_io.surfaces import RoundingMonitor
from mixseq_io.usd.stage import UDIM_PLACEHOLDER, clips_folder, save_layer

FrameValues = tuple[float, Mapping[str, Any]]
"""Time code of a frame, and its values by attribute path."""


@dataclass(frozen=True, eq=False)
class LocalSpace:
    """Transforms ``(4, 4)`` from a prim's space to the world and back, for row vectors."""

    to_world: Float
    to_local: Float

    @staticmethod
    def at_origin(origin: Float) -> LocalSpace:
        """Return the space of points relative to an origin ``(3,)``; `WORLD_SPACE` if it is zero."""
        if not origin.any():
            return WORLD_SPACE
        to_world, to_local = np.eye(4), np.eye(4)
        to_world[3, :3], to_local[3, :3] = origin, -origin
        return LocalSpace(to_world, to_local)


WORLD_SPACE = LocalSpace(np.eye(4), np.eye(4))
LocalSpaceAt = Callable[[float], LocalSpace]
"""Function from a time in s to a prim's space; it returns the object `WORLD_SPACE` to skip identity transforms."""


@dataclass(frozen=True, eq=False)
class SampledNormals:
    """Sampled normals, with normal groups by corner and by written normal (`order`); both are None if per vertex."""

    attribute: str
    interpolation: str
    groups: IntArray | None
    order: IntArray | None


@dataclass(frozen=True, eq=False, kw_only=True)
class SampledMesh:
    """Mesh prim with samples in its local space; `vertex_of_point` ``(P,)`` is None if every point is a vertex."""

    path: str
    scene_mesh: SceneMesh
    vertex_of_point: IntArray | None = None
    space: LocalSpaceAt = lambda time: WORLD_SPACE
    normals: SampledNormals | None = None
    has_velocities: bool = False

    @property
    def attributes(self) -> tuple[str, ...]:
        """Names of the sampled attributes."""
        velocities = ("velocities",) if self.has_velocities else ()
        normals = (self.normals.attribute,) if self.normals else ()
        return ("points", "extent", *velocities, *normals)

    def point_values(self, values: FloatArray) -> FloatArray:
        """Return values ``(P, 3)`` at the prim's points, given values ``(V, 3)`` at the sequence's vertices."""
        vertex_values = values[self.scene_mesh.vertices]
        return vertex_values if self.vertex_of_point is None else vertex_values[self.vertex_of_point]


@dataclass(frozen=True, eq=False, kw_only=True)
class SampledExtent:
    """Extent of a SkelRoot above meshes; `other_corners` are points of the boxes around its other contents."""

    path: str
    scene_meshes: tuple[SceneMesh, ...]
    space: LocalSpaceAt
    other_corners: Callable[[float], FloatArray]


@dataclass(frozen=True, eq=False)
class SampledPrims:
    """All prims that get samples."""

    meshes: tuple[SampledMesh, ...]
    extents: tuple[SampledExtent, ...] = ()


def compute_frame_values(
    prims: SampledPrims,
    codes: NDArray[np.float64],
    times: NDArray[np.float64],
    blocks: Iterable[FrameBlock],
    rounding: RoundingMonitor,
) -> Iterator[FrameValues]:
    """Yield the attribute values of every frame, given the frames' time codes and times in s ``(T,)``."""
    for first_frame, block, velocity_block in blocks:
        for frame, points in enumerate(block, first_frame):
            velocities = None if velocity_block is None else velocity_block[frame - first_frame]
            values = _attribute_values(prims, frame, float(times[frame]), points, velocities, rounding)
            yield float(codes[frame]), dict(values)


def _attribute_values(
    prims: SampledPrims,
    frame: int,
    time: float,
    points: FloatArray,
    velocities: FloatArray | None,
    rounding: RoundingMonitor,
) -> Iterator[tuple[str, Any]]:
    spaces = [mesh.space(time) for mesh in prims.meshes]
    to_local = [space.to_local for space in spaces]
    local = _transform(points, prims, to_local, 1.0)
    if local is not points:
        local = as_float32(local[None], frame, "USD")[0]
    mesh_points = [_vector_array(mesh.point_values(local)) for mesh in prims.meshes]
    extents = [UsdGeom.PointBased.ComputeExtent(each) for each in mesh_points]
    if points.dtype != np.float32:
        boxes = (np.array(extent) for extent, each in zip(extents, mesh_points, strict=True) if len(each))
        corners = np.concatenate([np.zeros((0, 3)), *boxes])
        if not np.isfinite(corners).all():
            as_float32(points[None], frame, "USD")  # raises an error that names the vertex
        world = points if local is points else _transform(local, prims, [space.to_world for space in spaces], 1.0)
        rounding.measure(frame, points, world, corners if world is points else None)
    for mesh, space, values, extent in zip(prims.meshes, spaces, mesh_points, extents, strict=True):
        yield f"{mesh.path}.points", values
        yield f"{mesh.path}.extent", extent
        if mesh.normals:
            normals = _compute_normals(mesh.normals, mesh.scene_mesh, points, space)
            yield f"{mesh.path}.{mesh.normals.attribute}", _vector_array(normals)
    if velocities is not None:
        local_velocities = _transform(velocities, prims, to_local, 0.0)
        local = as_float32(local_velocities[None], frame, "USD", "the velocity of vertex")[0]
        for mesh in prims.meshes:
            if mesh.has_velocities:
                yield f"{mesh.path}.velocities", _vector_array(mesh.point_values(local))
    for parent in prims.extents:
        corners = _box_corners(parent, points, time).astype(np.float32)
        yield f"{parent.path}.extent", UsdGeom.PointBased.ComputeExtent(Vt.Vec3fArrayFromBuffer(corners))


def _vector_array(vectors: FloatArray) -> Vt.Vec3fArray:
    """Copy vectors ``(n, 3)``; `Vt.Vec3fArray.FromBuffer` converts number by number and takes seven times as long."""
    array = Vt.Vec3fArray(len(vectors))
    memory = np.asarray(array)  # read-only, since arrays share memory with their copies; this one has none yet
    with np.errstate(over="ignore", under="ignore"):
        source = np.ascontiguousarray(vectors, dtype=np.float32)
    memmove(memory.ctypes.data, source.ctypes.data, memory.nbytes)
    return array


def _transform(vectors: FloatArray, prims: SampledPrims, matrices: Sequence[Float], weight: float) -> FloatArray:
    """Transform the points (weight 1) or directions (weight 0) ``(V, 3)`` of every mesh by its matrix ``(4, 4)``."""
    identities = (WORLD_SPACE.to_local, WORLD_SPACE.to_world)
    if all(any(matrix is each for each in identities) for matrix in matrices):
        return vectors
    transformed = vectors.astype(np.float64)
    for mesh, matrix in zip(prims.meshes, matrices, strict=True):
        vertices = mesh.scene_mesh.vertices
        transformed[vertices] = transformed[vertices] @ matrix[:3, :3] + (matrix[3, :3] if weight else 0.0)
    return transformed


def _compute_normals(
    normals: SampledNormals, scene_mesh: SceneMesh, points: FloatArray, space: LocalSpace
) -> NDArray[np.float32]:
    """Return normals n in a mesh's local space from world normals n' = n M⁻ᵀ for x' = x M, hence n = n' Mᵀ."""
    unit = corner_normals(points[scene_mesh.vertices][None], scene_mesh.polygons, normals.groups)[0]
    if space is not WORLD_SPACE:
        local = unit @ space.to_world[:3, :3].T
        unit = (local / np.linalg.norm(local, axis=1, keepdims=True)).astype(np.float32)
    return unit if normals.order is None else np.asarray(unit[normals.order])


def _box_corners(extent: SampledExtent, points: FloatArray, time: float) -> FloatArray:
    """Return the corners ``(n, 3)`` of the boxes around all contents of a SkelRoot, in its local space."""
    vertices = [points[scene_mesh.vertices] for scene_mesh in extent.scene_meshes if scene_mesh.vertex_count]
    boxes = [zip(*bounding_box(each), strict=True) for each in vertices]
    corners = np.array([corner for box in boxes for corner in product(*box)], dtype=np.float64).reshape(-1, 3)
    to_local = extent.space(time).to_local
    return np.concatenate([corners @ to_local[:3, :3] + to_local[3, :3], extent.other_corners(time)])


_BYTES_BETWEEN_SAVES = 64 << 20

_VALUE_TYPES = {
    "points": Sdf.ValueTypeNames.Point3fArray,
    "extent": Sdf.ValueTypeNames.Float3Array,
    "velocities": Sdf.ValueTypeNames.Vector3fArray,
    "normals": Sdf.ValueTypeNames.Normal3fArray,
    "primvars:normals": Sdf.ValueTypeNames.Normal3fArray,
}


class SampleWriter:
    """Writer of samples to a layer, in bounded memory if the layer is binary."""

    def __init__(self, layer: Sdf.Layer) -> None:
        self._layer = layer
        self._is_binary = not layer.realPath.lower().endswith(".usda")
        self._unsaved_bytes = 0

    def put(self, frame: FrameValues) -> None:
        """Set the values of a frame."""
        code, values = frame
        for path, value in values.items():
            self._layer.SetTimeSample(path, code, value)
            self._unsaved_bytes += 12 * (len(value) if isinstance(value, Sized) else 1)
        if self._is_binary and self._unsaved_bytes > _BYTES_BETWEEN_SAVES:
            self.save()

    def save(self) -> None:
        """Save the layer."""
        save_layer(self._layer)
        self._unsaved_bytes = 0


def declare_attributes(layer: Sdf.Layer, prims: SampledPrims) -> None:
    """Author the attributes that get samples, without values."""
    for mesh in prims.meshes:
        for name in mesh.attributes:
            attribute = attribute_spec(layer, f"{mesh.path}.{name}", _VALUE_TYPES[name])
            if mesh.normals and name == mesh.normals.attribute:
                attribute.SetInfo("interpolation", mesh.normals.interpolation)
    for extent in prims.extents:
        attribute_spec(layer, f"{extent.path}.extent", _VALUE_TYPES["extent"])


def attribute_spec(
    layer: Sdf.Layer,
    path: str,
    kind: Sdf.ValueTypeName,
    variability: Sdf.Variability = Sdf.VariabilityVarying,
) -> Sdf.AttributeSpec:
    """Return the spec of an attribute in a layer; create a missing spec, with overs for its prim and ancestors."""
    Sdf.JustCreatePrimAttributeInLayer(layer, Sdf.Path(path), kind, variability)
    return layer.GetAttributeAtPath(path)


def override_spec(layer: Sdf.Layer, attribute: Usd.Attribute) -> Sdf.AttributeSpec:
    """Return the spec with which a layer overrides an attribute of a sublayer."""
    path, kind = str(attribute.GetPath()), attribute.GetTypeName()
    return attribute_spec(layer, path, kind, attribute.GetVariability())


def write_package(layer: Sdf.Layer, package: Path, name: str, folders: Sequence[Path]) -> list[str]:
    """Write a package of a saved layer and its textures in the given folders; return files that are not packed."""
    left_out: dict[str, None] = {}

    def rewrite(asset: str) -> str:
        # USD refuses to pack a layer that names a missing file, or one without an extension.
        files = _resolve_files(layer, asset) if Path(asset).suffix else []
        if not files:
            rejected = [asset] if asset else []
        elif _is_scene(asset):  # USD would pack all files that it refers to, from any folder
            rejected = files
        else:
            rejected = [file for file in files if not _is_inside(file, folders)]
        left_out.update(dict.fromkeys(rejected))
        return "" if rejected else _extract_texture(layer, asset, textures)

    textures = Path(f"{package}.textures")  # deleted with all files that have this temporary prefix
    textures.mkdir()
    UsdUtils.ModifyAssetPaths(layer, rewrite)
    save_layer(layer)
    if not UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath(layer.realPath), str(package), name):
        raise_system_error("", package.parent)
        raise OutputError(f"{name} cannot be packed; write .usdc, and pack it with usdzip")
    return list(left_out)


def _resolve_files(layer: Sdf.Layer, asset: str) -> list[str]:
    """Return the files of an asset path in a layer: no file, one file, or all tiles of a texture."""
    outer, _ = Ar.SplitPackageRelativePathOuter(asset)
    absolute = layer.ComputeAbsolutePath(outer) if outer else ""
    if UDIM_PLACEHOLDER in absolute:
        path = Path(absolute)
        pattern = re.escape(path.name).replace(UDIM_PLACEHOLDER, r"\d{4}")
        siblings = path.parent.iterdir() if path.parent.is_dir() else ()
        return [str(file) for file in siblings if re.fullmatch(pattern, file.name)]
    resolved = str(Ar.GetResolver().Resolve(absolute))
    return [resolved] if resolved else []


def _is_scene(asset: str) -> bool:
    """Whether an asset path refers to a USD file instead of a texture."""
    inner = Ar.SplitPackageRelativePathInner(asset)[1]
    return Sdf.FileFormat.FindByExtension(Path(inner or asset).suffix.lstrip(".")) is not None


def _is_inside(file: str, folders: Sequence[Path]) -> bool:
    """Whether a path, with links resolved, is a regular file in one of the given folders."""
    resolved = Path(file).resolve()
    return resolved.is_file() and any(resolved.is_relative_to(folder.resolve()) for folder in folders)


def _extract_texture(layer: Sdf.Layer, asset: str, folder: Path) -> str:
    """Return a texture's asset path; extract it to a folder from a package, since few viewers read nested packages."""
    outer, inner = Ar.SplitPackageRelativePathOuter(asset)
    if not inner:  # relative paths of tiles in other folders would be packed as "../wool.1001.png"
        return layer.ComputeAbsolutePath(asset) if UDIM_PLACEHOLDER in asset else asset
    with (
        suppress(OSError, KeyError, zipfile.BadZipFile),
        zipfile.ZipFile(layer.ComputeAbsolutePath(outer)) as package,
    ):
        pattern = re.escape(inner).replace(UDIM_PLACEHOLDER, r"\d{4}")
        entries = [entry for entry in package.infolist() if re.fullmatch(pattern, entry.filename)]
        if any(entry.compress_type != zipfile.ZIP_STORED for entry in entries):  # the specification forbids compression
            return asset
        data = {Path(entry.filename).name: package.read(entry) for entry in entries}
        subfolder = folder / str(len(list(folder.iterdir())))
        subfolder.mkdir()
        for name, content in data.items():
            (subfolder / name).write_bytes(content)
        return str(subfolder / Path(inner).name)
    return asset


_CLIP_SET = "mixseq"
"""Name of the clip set; an original may use "default", and USD merges clip sets of the same name by key."""


def save_clips(
    layer: Sdf.Layer, prims: SampledPrims, frames: Iterable[FrameValues], length: int, folder: ClipFolder
) -> None:
    """Write frames to clips of `length` frames each, and save a layer that lists the clips."""
    start_codes: list[float] = []
    codes: list[float] = []
    clip: SampleWriter | None = None
    for index, frame in enumerate(frames):
        codes.append(frame[0])
        if index % length == 0:
            start_codes.append(frame[0])
            if clip:
                clip.put(frame)
                clip.save()
            file = folder.path / folder.clip_name(len(start_codes))
            clip = SampleWriter(_create_layer(file, prims, layer.timeCodesPerSecond))
        if clip:
            clip.put(frame)
    if clip:
        clip.save()
    save_layer(_create_layer(folder.path / folder.manifest_name, prims, layer.timeCodesPerSecond))
    clip_numbers = range(1, len(start_codes) + 1)
    prefix = f"./{folder.target.name}/"
    assets = [Sdf.AssetPath(prefix + folder.clip_name(number)) for number in clip_numbers]
    for path in [*(mesh.path for mesh in prims.meshes), *(extent.path for extent in prims.extents)]:
        description = {
            "assetPaths": Sdf.AssetPathArray(assets),
            "times": Vt.Vec2dArray([(code, code) for code in codes]),
            "active": Vt.Vec2dArray([(code, float(clip)) for clip, code in enumerate(start_codes)]),
            "primPath": path,
            "manifestAssetPath": Sdf.AssetPath(prefix + folder.manifest_name),
        }
        layer.GetPrimAtPath(path).SetInfo("clips", {_CLIP_SET: description})
    save_layer(layer)


def _create_layer(file: Path, prims: SampledPrims, rate: float) -> Sdf.Layer:
    layer = Sdf.Layer.CreateNew(str(file))
    layer.timeCodesPerSecond = rate
    declare_attributes(layer, prims)
    return layer


class ClipFolder:
    """Folder of a file's clips; it is written under a temporary name, and renamed when complete."""

    def __init__(self, owner: Path, resources: ExitStack) -> None:
        self.target = self.path = self._backup = clips_folder(owner)
        self._stem = owner.stem
        self.manifest_name = f"{owner.stem}.manifest.usdc"
        self._resources = resources
        self._is_installed = False

    def clip_name(self, number: int) -> str:
        """Return the file name of a clip by its number, from 1."""
        return f"{self._stem}.{number:04d}.usdc"

    def make(self) -> None:
        """Create an empty temporary folder."""
        if os.path.lexists(self.target) and not _holds_only_clips(self.target, self._stem):
            raise OutputError(
                f"{self.target} has other files than clips, which are not deleted; move it away, or write to another "
                "name"
            )
        prefix = self._resources.enter_context(temporary_prefix(self.target.parent))
        self.path, self._backup = Path(f"{prefix}.new"), backup_path(prefix, self.target)
        self.path.mkdir()

    def install(self) -> None:
        """Rename the folder to its target; a replaced folder is kept as a backup until the context ends."""
        for file in self.path.iterdir():
            with file.open("rb") as stream:
                os.fsync(stream.fileno())
        if self.target.exists():
            self.target.rename(self._backup)
        self.path.rename(self.target)
        self._is_installed = True

    def warn_if_unused(self) -> None:
        """Warn of the clips of an older file of the same name, if the new file has no clips."""
        with suppress(OSError):
            if _holds_only_clips(self.target, self._stem) and (self.target / self.manifest_name).exists():
                warn(
                    f"{self.target} has the clips of an older file of this name; the new one does not use them, remove "
                    "them if no other does"
                )

    def undo(self) -> None:
        """Restore the replaced folder."""
        if self._is_installed:
            self.target.rename(self.path)
        if self._backup.exists():
            self._backup.rename(self.target)


@contextmanager
def open_clip_folder(owner: Path) -> Iterator[ClipFolder]:
    """Yield the folder for a file's clips; restore the replaced folder after an exception."""
    with ExitStack() as resources:
        folder = ClipFolder(owner, resources)
        try:
            yield folder
        except BaseException:
            with suppress(OSError):
                folder.undo()
            raise


def _holds_only_clips(folder: Path, stem: str) -> bool:
    return folder.is_dir() and all(
        file.name.startswith(f"{stem}.") and file.suffix == ".usdc" and file.is_file() for file in folder.iterdir()
    )
