"""USD, writing: values of every frame in the spaces of their prims.

World-space points and velocities of the sequence are multiplied by the inverse of the prim's local-to-world transform.
Extents are computed from the written values, normals from every frame's points.

Specification: https://openusd.org/release/api/class_usd_geom_point_based.html
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Vt

from mixseq.arrays import Float, FloatArray, IntArray
from mixseq.geometry.normals import shared_normals
from mixseq_io.blocks import Numbered, as_float32
from mixseq_io.scene_meshes import SceneMesh

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
    cast: Cast, codes: NDArray[np.float64], times: NDArray[np.float64], numbered: Iterable[Numbered]
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
    unit = shared_normals(points[None], scene_mesh.polygons, normals.groups)[0]
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
