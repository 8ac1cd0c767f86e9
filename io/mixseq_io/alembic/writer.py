"""Writer of Alembic files (.abc) in the Ogawa format.

A sequence from an archive becomes a copy of this archive with new points. Any other sequence becomes a new archive with
a mesh per object: a SubD if subdivided, else a PolyMesh. Points are float32, and below a translation if they are far
from zero. Texture coordinates are indexed values at corners. Meshes with hard edges have normals at corners in every
frame. Face sets have assigned materials.

New archives keep original paths, since cache modifiers of other programs refer to meshes by path. A mesh without an
original path is below a transform with the name of the mesh, since programs name imported objects after transforms.

Specification: https://docs.alembic.io/reference/index.html
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from errno import ENOSPC
from functools import cached_property, partial
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mixseq.errors import FormatError, OutputError
from mixseq.mesh.measures import corner_normals
from mixseq.mesh.polygons import reversed_winding
from mixseq.mesh.surface import CornerValues
from mixseq.sequence.header import SequenceHeader
from mixseq.types import Float, FloatArray, IntArray
from mixseq.version import __version__
from mixseq_io.alembic.overlay import (
    CORNER_SCOPE,
    SAMPLE_OVERHEAD_BYTES,
    Original,
    WriteSamples,
    bound_copy_size,
    copy_archive,
    match_archive,
)
from mixseq_io.alembic.reader import COLOUR_PARAMETER
from mixseq_io.alembic.samples import (
    LIBRARY_ERRORS,
    Abc,
    AbcGeom,
    AbcMaterial,
    create_array,
    create_time_sampling,
    imath,
    open_archive,
)
from mixseq_io.files import atomic_file
from mixseq_io.reader import FrameBlock, as_float32, summarize_error, validate_blocks
from mixseq_io.scene_meshes import SceneMesh, open_original_file, split_meshes
from mixseq_io.surfaces import RoundingMonitor, lost_scale, warn_of_losses

ObjectPath = tuple[str, ...]
"""Names of the transforms from the root to a mesh, followed by the name of the mesh."""


def choose_paths(header: SequenceHeader, scene_meshes: Sequence[SceneMesh]) -> list[ObjectPath]:
    """Return the paths of all meshes in a new archive: the original paths, or ``/<name>/<object>/<object>``.

    Original paths are kept if all contain a transform, a depth-first walk meets them in their order, and the common
    ancestor, if any, has the sequence's name.
    """
    own = [tuple(mesh.path.split("/")[1:]) for mesh in scene_meshes if mesh.path.startswith("/")]
    if len(own) == len(scene_meshes) and _are_valid_paths(own) and _common_name(own) in ("", header.name):
        return own
    root = make_valid_name(header.name)
    if len(scene_meshes) == 1:
        return [(root, root)]
    return [(root, name, name) for name in make_unique_names(mesh.name for mesh in scene_meshes)]


def _are_valid_paths(paths: Sequence[ObjectPath]) -> bool:
    """Whether each mesh is below a named transform, none is below another, and a depth-first walk keeps their order."""
    first_ids: dict[ObjectPath, int] = {}
    walk = [[first_ids.setdefault(path[:end], i) for end in range(1, len(path) + 1)] for i, path in enumerate(paths)]
    meshes = set(paths)
    ancestors = {path[:end] for path in meshes for end in range(1, len(path))}
    is_named = all(len(path) > 1 and all(path) for path in meshes)
    return is_named and len(meshes) == len(paths) and not meshes & ancestors and walk == sorted(walk)


def _common_name(paths: Sequence[ObjectPath]) -> str:
    """Return the name that readers give the sequence: the name of its only mesh, or of the common ancestor."""
    shared = list(takewhile(lambda names: len(set(names)) == 1, zip(*paths, strict=False)))
    return shared[-1][0] if shared else ""


def make_valid_name(name: str) -> str:
    """Return an object name without slashes, or "mesh" for an empty name."""
    return name.replace("/", "_") or "mesh"


def make_unique_names(names: Iterable[str]) -> list[str]:
    """Return valid unique names; repeated names get a number: "a", "a_2"."""
    unique: dict[str, None] = {}
    numbers: dict[str, int] = {}
    for name in map(make_valid_name, names):
        number, candidate = numbers.get(name, 1), name
        while candidate in unique:
            number += 1
            candidate = f"{name}_{number}"
        numbers[name] = number
        unique[candidate] = None
    return list(unique)


_SCHEME_NAMES = {"catmullClark": "catmull-clark", "loop": "loop", "bilinear": "bilinear"}
_RGB_TYPES = (AbcGeom.OC3fGeomParam, AbcGeom.OC3fGeomParamSample, imath.C3fArray)
_RGBA_TYPES = (AbcGeom.OC4fGeomParam, AbcGeom.OC4fGeomParamSample, imath.C4fArray)

_OBJECT_OVERHEAD_BYTES = 8000
"""Upper bound in bytes on an object's names and headers in the file."""


@dataclass(frozen=True, eq=False)
class NewMesh:
    """Mesh of a new archive, to be created at a path."""

    scene_mesh: SceneMesh
    path: ObjectPath

    @property
    def is_subdivided(self) -> bool:
        """Whether the mesh becomes a SubD, which has no normals."""
        return self.scene_mesh.subdivision != "none"

    def create(self, parent: Any, sampling: int) -> WriteSamples:
        """Create the mesh object with its face sets and colours; return the writer of its samples."""
        mesh = (AbcGeom.OSubD if self.is_subdivided else AbcGeom.OPolyMesh)(parent, self.path[-1], sampling)
        face_sets = self.scene_mesh.face_sets
        members = np.concatenate([each.polygons for each in face_sets]) if face_sets else np.zeros(0)
        is_exclusive = len(np.unique(members)) == len(members)
        for each, name in zip(face_sets, make_unique_names(each.name for each in face_sets), strict=True):
            node = mesh.getSchema().createFaceSet(name)
            polygons = create_array(imath.IntArray, each.polygons)  # must be alive until the sample is set
            node.getSchema().set(AbcGeom.OFaceSetSchemaSample(polygons))
            if is_exclusive:
                node.getSchema().setFaceExclusivity(AbcGeom.FaceSetExclusivity.kFaceSetExclusive)
            if each.material:
                AbcMaterial.addMaterialAssignment(node, each.material)
        if self.scene_mesh.colours is not None:
            self._add_colours(mesh.getSchema(), self.scene_mesh.colours)
        return partial(self._write, mesh)  # keeps the mesh open

    def _add_colours(self, schema: Any, colours: CornerValues) -> None:
        """Add constant colours, without alpha if all colours are opaque."""
        is_opaque = bool((colours.values[:, 3] == 1).all())
        parameter_type, sample_type, array_type = _RGB_TYPES if is_opaque else _RGBA_TYPES
        values = create_array(array_type, colours.values)  # must be alive until the sample is set
        indices = create_array(imath.UnsignedIntArray, colours.indices[self._order])
        parameter = parameter_type(schema.getArbGeomParams(), COLOUR_PARAMETER, True, CORNER_SCOPE, 1)
        parameter.set(sample_type(values, indices, CORNER_SCOPE))

    def _write(
        self, mesh: Any, first: int, points: FloatArray, velocities: FloatArray | None, rounding: RoundingMonitor
    ) -> None:
        schema, vertices, hard_edges = mesh.getSchema(), self.scene_mesh.vertices, self.scene_mesh.hard_edges
        for frame, world in enumerate(points[:, vertices]):
            own_points = (world - rounding.origin).astype(np.float32)
            rounding.measure(first + frame, world, own_points + rounding.origin)
            sample = AbcGeom.OSubDSchemaSample() if self.is_subdivided else AbcGeom.OPolyMeshSchemaSample()
            # A sample refers to its arrays, which must be alive until it is set.
            positions = create_array(imath.V3fArray, own_points)
            sample.setPositions(positions)
            if not schema.getNumSamples():
                self._set_constants(sample)
            if velocities is not None:
                own_velocities = create_array(imath.V3fArray, velocities[frame, vertices])
                sample.setVelocities(own_velocities)
            if hard_edges is not None and not self.is_subdivided:
                normals = corner_normals(own_points[None], self.scene_mesh.polygons, hard_edges)[0]
                own_normals = create_array(imath.V3fArray, normals)
                sample.setNormals(AbcGeom.ON3fGeomParamSample(own_normals, self._arrays["normals"], CORNER_SCOPE))
            schema.set(sample)

    def _set_constants(self, sample: Any) -> None:
        arrays = self._arrays
        sample.setFaceIndices(arrays["corners"])
        sample.setFaceCounts(arrays["counts"])
        if self.is_subdivided:
            sample.setSubdivisionScheme(_SCHEME_NAMES[self.scene_mesh.subdivision])
        if self.scene_mesh.uvs is not None:
            uvs = arrays["uv values"], arrays["uv indices"]
            sample.setUVs(AbcGeom.OV2fGeomParamSample(*uvs, CORNER_SCOPE))

    @cached_property
    def _order(self) -> IntArray:
        return reversed_winding(self.scene_mesh.polygons.counts, keep_first=False)

    @cached_property
    def _arrays(self) -> dict[str, Any]:
        """Constant arrays that samples refer to."""
        scene_mesh, uvs = self.scene_mesh, self.scene_mesh.uvs
        arrays = {
            "counts": create_array(imath.IntArray, scene_mesh.polygons.counts),
            "corners": create_array(imath.IntArray, scene_mesh.polygons.indices[self._order]),
        }
        if uvs is not None:
            arrays["uv values"] = create_array(imath.V2fArray, uvs.values)
            arrays["uv indices"] = create_array(imath.UnsignedIntArray, uvs.indices[self._order])
        if scene_mesh.hard_edges is not None:
            arrays["normals"] = create_array(imath.UnsignedIntArray, scene_mesh.hard_edges[self._order])
        return arrays

    def bound_size(self, frame_count: int, has_velocities: bool) -> int:
        """Return an upper bound on the mesh's size in the file in bytes."""
        mesh, colours = self.scene_mesh, self.scene_mesh.colours
        normal_count = 0 if mesh.hard_edges is None else int(mesh.hard_edges.max(initial=-1)) + 1
        vector_count = mesh.vertex_count * (2 if has_velocities else 1) + normal_count
        constant = 12 * mesh.polygons.indices.size + 4 * mesh.polygons.counts.size + _OBJECT_OVERHEAD_BYTES
        constant += 0 if mesh.uvs is None else 8 * len(mesh.uvs.values)
        constant += sum(4 * each.polygons.size + _OBJECT_OVERHEAD_BYTES for each in mesh.face_sets)
        if colours is not None:
            constant += 16 * len(colours.values) + 4 * colours.indices.size + _OBJECT_OVERHEAD_BYTES
        return frame_count * (12 * vector_count + SAMPLE_OVERHEAD_BYTES) + constant


def create_meshes(top: Any, new_meshes: Sequence[NewMesh], sampling: int, origin: Float) -> list[WriteSamples]:
    """Create meshes below transforms, depth-first as readers go; those at the top move them to an origin ``(3,)``."""
    objects: dict[ObjectPath, Any] = {(): top}
    writers = []
    for new_mesh in new_meshes:
        for end in range(1, len(new_mesh.path)):
            path = new_mesh.path[:end]
            if path not in objects:
                objects[path] = AbcGeom.OXform(objects[path[:-1]], path[-1])
                if end == 1 and origin.any():
                    sample = AbcGeom.XformSample()
                    sample.setTranslation(imath.V3d(*origin.tolist()))
                    objects[path].getSchema().set(sample)
        writers.append(new_mesh.create(objects[new_mesh.path[:-1]], sampling))
    return writers


def write_alembic(
    path: Path,
    header: SequenceHeader,
    blocks: Iterable[FloatArray],
    velocities: Iterable[FloatArray] | None = None,
    flatten: bool = False,
    onto: str | os.PathLike[str] | None = None,
    sources: ArrayLike | None = None,
    rounding: RoundingMonitor | None = None,
) -> None:
    """Write an Alembic file; options as in `FORMATS`. `sources` ``(T,)`` are the original's times in s at frames."""
    match = partial(match_archive, header=header)
    original = open_original_file(path, header, flatten, onto, "Alembic", match)
    scene_meshes = [] if original else split_meshes(header)
    new_meshes = list(map(NewMesh, scene_meshes, choose_paths(header, scene_meshes)))
    has_velocities = velocities is not None
    with atomic_file(path) as temporary:
        _, numbered = validate_blocks(header, blocks, velocities)
        warn_of_losses(path, "Alembic files", _describe_losses(header, new_meshes))
        if original:
            size = bound_copy_size(original, header, has_velocities)
        else:
            size = sum(mesh.bound_size(header.frame_count, has_velocities) for mesh in new_meshes)
        _check_disk_space(temporary, size)
        monitor = rounding or RoundingMonitor(path, "Alembic", header)
        _write(path, temporary, header, original or new_meshes, numbered, has_velocities, sources, monitor)
        with _translate_write_errors(path):
            open_archive(temporary)


_WRITE_ERRORS: tuple[type[Exception], ...] = (*LIBRARY_ERRORS, FormatError)


@contextmanager
def _translate_write_errors(path: Path) -> Iterator[None]:
    """Translate errors of the library into `OutputError`."""
    try:
        yield
    except _WRITE_ERRORS as error:
        raise OutputError(f"cannot write {path}: {summarize_error(error)}; check the disk and the path") from error


def _write(
    path: Path,
    temporary: Path,
    header: SequenceHeader,
    contents: Original | Sequence[NewMesh],
    numbered: Iterable[FrameBlock],
    has_velocities: bool,
    sources: ArrayLike | None,
    rounding: RoundingMonitor,
) -> None:
    """Write all contents; on return, the archive's last object is released and the library completes the file."""
    with _translate_write_errors(path):
        archive = Abc.CreateArchiveWithInfo(str(temporary), header.fps, f"mixseq {__version__}", "")
        sampling = archive.addTimeSampling(create_time_sampling(header.times, 1 / header.fps))
        if isinstance(contents, Original):
            writers = copy_archive(archive, path, contents, header, sampling, has_velocities, sources)
        else:
            writers = create_meshes(archive.getTop(), contents, sampling, rounding.origin)
    for first, block, velocities in numbered:
        as_float32(block, first, "Alembic", header=header)  # reports coordinates that are too large
        if velocities is not None:
            velocities = as_float32(velocities, first, "Alembic", "the velocity of vertex", header)
        with _translate_write_errors(path):
            for write in writers:
                write(first, block, velocities, rounding)


def _check_disk_space(path: Path, size: int) -> None:
    """Raise an error if fewer than `size` bytes are free: on a full disk, the library would crash the process."""
    with path.open("wb") as file:
        if hasattr(os, "posix_fallocate"):  # respects quotas and size limits
            os.posix_fallocate(file.fileno(), 0, size)
        elif shutil.disk_usage(path.parent).free < size:
            raise OSError(ENOSPC, os.strerror(ENOSPC))
    path.unlink()


def _describe_losses(header: SequenceHeader, new_meshes: Sequence[NewMesh]) -> list[str]:
    """Describe the contents that Alembic cannot hold."""
    lost = lost_scale(header, has_velocities=False)
    if any(mesh.is_subdivided and mesh.scene_mesh.hard_edges is not None for mesh in new_meshes):
        lost.append("hard edges of subdivided meshes")
    names = {header.name} if new_meshes else set()
    names |= {mesh.scene_mesh.name for mesh in new_meshes} if len(new_meshes) > 1 else set()
    changed = sorted(repr(name) for name in names if make_valid_name(name) != name)
    return [*lost, f"the names {', '.join(changed)}"] if changed else lost
