"""Motion of USD meshes: skins, welded points, sources of motion, and the map of a layer's time to the file below.

The points of a skinned mesh are blended from its shapes, taken by ``geomBindTransform`` into skeleton space, moved by
the joints (linear or dual quaternion skinning), and placed by the skeleton's transform instead of the mesh's. USD's own
implementation (UsdSkel) computes them.

Points are split where texture coordinates or normals differ. Meshes of skeletons are welded where position, joints,
weights and blend shapes are bit-identical; game-engine characters would otherwise be cut open along all seams. Other
meshes are not, since points with time samples would all have to be read. A layer with new points stores the vertex of
every point in the attribute `VERTICES`.

A sublayer keeps its seconds at any rate of the layer above. When the whole stage is retimed, its moving attributes get
samples in the layer, taken at the times that the frames show; a layer offset suffices for constant speed forwards only.

Specification: https://openusd.org/release/api/_usd_skel__intro.html
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt

from mixseq.errors import InvalidSequenceError, SettingsError
from mixseq.mesh.polygons import Polygons
from mixseq.sequence.header import SequenceHeader
from mixseq.types import IntArray
from mixseq_io.surfaces import are_valid_indices, renumber_by_appearance
from mixseq_io.usd.stage import Notes, Placement, lineage, time_codes, varies


@dataclass(frozen=True)
class Pose:
    """Pose of a skeleton at one time."""

    joints: Vt.Matrix4dArray
    weights: Vt.FloatArray


@dataclass(frozen=True, eq=False)
class Skeleton:
    """Skeleton prim, that of the instance where several share a prototype, its query, and its bound animation."""

    prim: Usd.Prim
    query: UsdSkel.SkeletonQuery

    @cached_property
    def has_joints(self) -> bool:
        """Whether it has a pose of an animation or of rest."""
        return len(self.query.ComputeSkinningTransforms(Usd.TimeCode.EarliestTime())) > 0

    @cached_property
    def animation(self) -> UsdSkel.Animation | None:
        """Bound animation, or None."""
        query = self.query.GetAnimQuery()
        return UsdSkel.Animation(query.GetPrim()) if query else None

    def pose(self, code: float) -> Pose:
        """Return the pose at a time code."""
        query = self.query.GetAnimQuery()
        weights = query.ComputeBlendShapeWeights(Usd.TimeCode(code)) if query else ()
        return Pose(self.query.ComputeSkinningTransforms(Usd.TimeCode(code)), Vt.FloatArray(weights))


def bound(skeleton: Skeleton, _: float) -> Pose:
    """Return the bind pose, without blend shapes."""
    joints = len(skeleton.query.GetJointOrder())
    query = skeleton.query.GetAnimQuery()
    shapes = len(query.GetBlendShapeOrder()) if query else 0
    return Pose(Vt.Matrix4dArray([Gf.Matrix4d(1)] * joints), Vt.FloatArray([0.0] * shapes))


@dataclass(frozen=True, eq=False)
class Skin:
    """Skeleton and skinning query of a mesh; the cache is kept since it owns the queries' data."""

    skeleton: Skeleton
    query: UsdSkel.SkinningQuery
    cache: UsdSkel.Cache

    @cached_property
    def has_joints(self) -> bool:
        """Whether joints move the mesh."""
        return self.query.HasJointInfluences() and self.skeleton.has_joints

    @cached_property
    def has_shapes(self) -> bool:
        """Whether blend shapes move the mesh."""
        animation = self.skeleton.animation
        weighted = animation is not None and animation.GetBlendShapeWeightsAttr().HasAuthoredValue()
        return weighted and self.query.HasBlendShapes()

    def attributes(self) -> Iterator[Usd.Attribute]:
        """Yield the attributes, besides points, that determine the shape in skeleton space."""
        animation = self.skeleton.animation
        if self.has_joints:
            if animation is not None:
                yield animation.GetTranslationsAttr()
                yield animation.GetRotationsAttr()
                yield animation.GetScalesAttr()
            yield self.query.GetJointIndicesPrimvar().GetAttr()
            yield self.query.GetJointWeightsPrimvar().GetAttr()
            if self.query.GetGeomBindTransformAttr():
                yield self.query.GetGeomBindTransformAttr()
        if self.has_shapes and animation is not None:
            yield animation.GetBlendShapeWeightsAttr()

    def deformed(self, points: Vt.Vec3fArray, pose: Pose, code: float) -> Vt.Vec3fArray:
        """Return the mesh's posed points, in skeleton space if it has joints, else in mesh space.

        Raises `InvalidSequenceError` if joints or shapes do not fit the points.
        """
        moved = Vt.Vec3fArray(points)  # USD works in place; copies are made when they are written to
        if self.has_shapes and not self._blend(moved, pose):
            raise InvalidSequenceError(
                f"the blend shapes of {self.query.GetPrim().GetPath()} do not fit its {len(points)} points; "
                "export the character again"
            )
        if self.has_joints and not self.query.ComputeSkinnedPoints(pose.joints, moved, Usd.TimeCode(code)):
            raise InvalidSequenceError(
                f"the joint indices and weights of {self.query.GetPrim().GetPath()} do not fit its "
                f"{len(points)} points and its skeleton's {len(pose.joints)} joints; export the character again"
            )
        return moved

    def _blend(self, points: Vt.Vec3fArray, pose: Pose) -> bool:
        shapes, indices, offsets = self._shapes
        mapper = self.query.GetBlendShapeMapper()
        weights = mapper.Remap(pose.weights) if mapper else pose.weights
        # Between a shape's inbetweens, two of them are weighted; USD calls shapes and inbetweens subshapes.
        subshapes = shapes.ComputeSubShapeWeights(weights)
        deform: Any = shapes.ComputeDeformedPoints  # the type stubs miss its parameters
        return bool(deform(*subshapes, indices, offsets, points))

    @cached_property
    def _shapes(self) -> tuple[UsdSkel.BlendShapeQuery, list[Vt.IntArray], list[Vt.Vec3fArray]]:
        query = UsdSkel.BlendShapeQuery(UsdSkel.BindingAPI(self.query.GetPrim()))
        return query, query.ComputeBlendShapePointIndices(), query.ComputeSubShapePointOffsets()


def skins_of(meshes: Sequence[UsdGeom.Mesh], notes: Notes) -> dict[Sdf.Path, Skin]:
    """Return the skins of meshes by path; bindings are inherited as in USD."""
    roots = {
        each.GetPath(): UsdSkel.Root(each)
        for mesh in meshes
        for each in lineage(mesh.GetPrim())
        if UsdSkel.Root(each)
    }
    instances = Usd.TraverseInstanceProxies()
    cache = UsdSkel.Cache()
    skins = {}
    for root in roots.values():
        cache.Populate(root, instances)
        for binding in cache.ComputeSkelBindings(root, instances):
            found = binding.GetSkeleton()
            skeleton = Skeleton(found.GetPrim(), cache.GetSkelQuery(found))
            for query in binding.GetSkinningTargets():
                skin = Skin(skeleton, query, cache)
                if skin.has_joints or skin.has_shapes:
                    skins[query.GetPrim().GetPath()] = skin
    for mesh in meshes:
        prim = mesh.GetPrim()
        if _wants_skeleton(prim) and mesh.GetPath() not in skins:
            notes.add(prim, "bound to no skeleton with a pose below a SkelRoot, and not moved by one")
    return skins


def _wants_skeleton(prim: Usd.Prim) -> bool:
    """Whether a mesh has a binding to joints or blend shapes; layers of new points block it."""
    binding = UsdSkel.BindingAPI(prim)
    parts = (binding.GetJointIndicesAttr(), binding.GetBlendShapesAttr()) if binding else ()
    return any(part.HasAuthoredValue() for part in parts)


VERTICES = "mixseq:vertices"


@dataclass(frozen=True, eq=False)
class Weld:
    """Map of a mesh's points to its vertices."""

    of_point: IntArray
    representatives: IntArray

    @property
    def is_identity(self) -> bool:
        """Whether every point is a separate vertex."""
        return len(self.of_point) == len(self.representatives)

    @property
    def vertex_count(self) -> int:
        """Number W of vertices."""
        return len(self.representatives)

    def polygons(self, polygons: Polygons) -> Polygons:
        """Return polygons of points as polygons of vertices."""
        return Polygons(polygons.counts, self.of_point[polygons.indices])


def unwelded(count: int) -> Weld:
    """Return the identity map of `count` points."""
    return Weld(np.arange(count), np.arange(count))


def weld(mesh: UsdGeom.Mesh, points: NDArray[np.float32]) -> Weld:
    """Return the weld of a mesh's points ``(P, 3)`` in some frame."""
    labels = _told(mesh, len(points))
    if labels is None:
        labels = _found(mesh, points)
    return Weld(*renumber_by_appearance(labels))


def _told(mesh: UsdGeom.Mesh, count: int) -> IntArray | None:
    """Return the vertices ``(P,)`` stored by a layer of mixseq, None if absent or of another size."""
    attribute = mesh.GetPrim().GetAttribute(VERTICES)
    if not attribute or attribute.GetTypeName() != Sdf.ValueTypeNames.IntArray:
        return None
    labels = np.array(attribute.Get() or (), dtype=np.int32)
    return labels if len(labels) == count else None


def _found(mesh: UsdGeom.Mesh, points: NDArray[np.float32]) -> IntArray:
    attribute = mesh.GetPointsAttr()
    influences = list(_influences(mesh, len(points)))
    known = [each for each in influences if each is not None]
    if attribute.ValueMightBeTimeVarying() or not known or len(known) < len(influences):
        return np.arange(len(points))
    rows = np.hstack([points, *known])
    return np.unique(np.ascontiguousarray(rows), axis=0, return_inverse=True)[1].reshape(-1)


def _influences(mesh: UsdGeom.Mesh, count: int) -> Iterator[NDArray[np.float32] | None]:
    """Yield arrays ``(P, n)`` of each influence on the points; None for one that is time-sampled or does not fit."""
    binding = UsdSkel.BindingAPI(mesh.GetPrim())
    for primvar in (binding.GetJointIndicesPrimvar(), binding.GetJointWeightsPrimvar()):
        if not primvar or primvar.GetInterpolation() != UsdGeom.Tokens.vertex:
            continue  # one for all points
        values = np.array(primvar.ComputeFlattened() or (), dtype=np.float32)
        fits = len(values) == count * primvar.GetElementSize() and not primvar.ValueMightBeTimeVarying()
        yield values.reshape(count, -1) if fits else None
    if not binding.GetBlendShapesAttr().HasAuthoredValue():
        return
    query = UsdSkel.BlendShapeQuery(binding)
    indices = [np.array(each, dtype=np.int64) for each in query.ComputeBlendShapePointIndices()]
    for subshape, value in enumerate(query.ComputeSubShapePointOffsets()):
        offsets = np.array(value or (), dtype=np.float32).reshape(-1, 3)
        if not len(offsets):
            continue  # the shape at weight 0
        rows = indices[query.GetBlendShapeIndex(subshape)]
        rows = rows if rows.size else np.arange(count)
        if len(rows) != len(offsets) or not are_valid_indices(rows, count):
            yield None
            continue
        dense = np.zeros((count, 3), dtype=np.float32)
        dense[rows] = offsets
        yield dense


@dataclass(frozen=True, eq=False)
class Shown:
    """Time codes of the file below, by those of a layer."""

    rate_below: float
    rate: float
    codes: NDArray[np.float64]
    sources: NDArray[np.float64] | None = None

    @property
    def start(self) -> float:
        """Time of the layer's first frame, in seconds."""
        return float(self.codes[0]) / self.rate

    def below(self, time: float) -> float:
        """Return the file's time code at a time of the layer, in seconds."""
        if self.sources is None:
            return time * self.rate_below
        return float(np.interp(time * self.rate, self.codes, self.sources)) * self.rate_below

    def samples(self, attribute: Usd.Attribute) -> Iterator[tuple[float, Any]]:
        """Yield the layer's time codes with the values of a varying attribute of the file."""
        if self.sources is None:
            every = np.array(attribute.GetTimeSamples(), dtype=np.float64)
            codes = every * (self.rate / self.rate_below)
        else:
            codes, every = self.codes, self.sources * self.rate_below
        for code, below in zip(codes.tolist(), every.tolist(), strict=True):
            value = attribute.Get(Usd.TimeCode(below))
            yield code, Sdf.ValueBlock() if value is None else value


def source_times(header: SequenceHeader, sources: ArrayLike) -> NDArray[np.float64]:
    """Return the times ``(T,)`` of the original that frames show, in seconds."""
    times = np.asarray(sources, dtype=np.float64)
    if times.shape != header.times.shape:
        raise SettingsError(
            f"sources are {times.size} times for {header.frame_count} frames; give one for every frame"
        )
    return times


def shown_by(header: SequenceHeader, rate_below: float, sources: NDArray[np.float64] | None = None) -> Shown:
    """Return the map from a sequence's frames to a file with a rate."""
    if sources is not None and not np.isfinite(sources).all():
        frame = int(np.argmin(np.isfinite(sources)))
        raise SettingsError(
            f"frame {frame} shows no single time of the original, so that the whole stage cannot be retimed; leave out "
            "whole_stage"
        )
    return Shown(rate_below, header.fps, time_codes(header.times, header.fps), sources)


@dataclass(frozen=True, eq=False)
class Mover:
    """Mesh and its sources of motion."""

    mesh: UsdGeom.Mesh
    skin: Skin | None

    @cached_property
    def placement(self) -> Placement:
        """Placement of the points' space: the skeleton's if joints move them, else the mesh's."""
        return Placement(
            self.skin.skeleton.prim if self.skin and self.skin.has_joints else self.mesh.GetPrim()
        )

    @cached_property
    def sources(self) -> tuple[Usd.Attribute, ...]:
        """Attributes that move the mesh over time."""
        deforming = self.skin.attributes() if self.skin else ()
        transforms = (each.GetAttr() for each in self.placement.operations)
        every = (self.mesh.GetPointsAttr(), *transforms, *deforming)
        return tuple(each for each in every if varies(each))

    @property
    def only_points_move(self) -> bool:
        """Whether neither transforms nor skeletons nor blend shapes move the mesh."""
        return all(each == self.mesh.GetPointsAttr() for each in self.sources)


@dataclass(frozen=True, eq=False)
class AnimatedMesh:
    """Mesh over the frames of a sequence."""

    mover: Mover
    codes: NDArray[np.float64]

    @property
    def start(self) -> float:
        """Time code of the first frame."""
        return float(self.codes[0])

    @property
    def mesh(self) -> UsdGeom.Mesh:
        """The mesh."""
        return self.mover.mesh

    @cached_property
    def weld(self) -> Weld:
        """Map of points to vertices, from the first frame, for all frames."""
        value = self.mesh.GetPointsAttr().Get(Usd.TimeCode(self.start))
        return weld(self.mesh, np.array(value or (), dtype=np.float32).reshape(-1, 3))

    @property
    def point_count(self) -> int:
        """Number of points."""
        return len(self.weld.of_point)

    @property
    def vertex_count(self) -> int:
        """Number of vertices."""
        return self.weld.vertex_count

    @cached_property
    def _first_determinant(self) -> float:
        """Determinant in the first frame with a nonzero one, since objects may appear by scaling up from zero."""
        every = (self.mover.placement.to_world(code).GetDeterminant3() for code in self.codes.tolist())
        return next((each for each in every if each), 1.0)

    @property
    def mirrored(self) -> bool:
        """Whether the transform to the world mirrors."""
        skin = self.mover.skin
        sign = self._first_determinant
        if skin and skin.has_joints:
            sign *= skin.query.GetGeomBindTransform(Usd.TimeCode(self.start)).GetDeterminant3()
        return sign < 0

    def points(self, code: float, pose: Pose | None) -> NDArray[np.float32]:
        """Return the vertices ``(V, 3)`` in world space at a time code, with the skeleton in a pose."""
        path = self.mesh.GetPath()
        value = self.mesh.GetPointsAttr().Get(Usd.TimeCode(code))
        if value is None:
            raise InvalidSequenceError(f"{path} has no points")
        if len(value) != self.point_count:
            raise InvalidSequenceError(
                f"{path} has {len(value)} points, the first frame {self.point_count}; every frame needs the same "
                "vertices in the same order"
            )
        if self.mover.skin and pose:
            value = self.mover.skin.deformed(value, pose, code)
        matrix = self.mover.placement.to_world(code)
        if matrix.GetDeterminant3() * self._first_determinant < 0:
            raise InvalidSequenceError(
                f"the transform of {path} mirrors it relative to earlier frames, which turns its faces inside "
                "out; give the animated scale one sign"
            )
        return _placed(value, matrix, 1.0)[self.weld.representatives]

    def velocities(self, code: float) -> NDArray[np.float32]:
        """Return the velocities ``(V, 3)`` in world space, in units per second."""
        value = self.mesh.GetVelocitiesAttr().Get(Usd.TimeCode(code))
        if value is None or len(value) != self.point_count:
            raise InvalidSequenceError(
                f"{self.mesh.GetPath()} has {len(value or ())} velocities for {self.point_count} points; give as many"
            )
        return _placed(value, self.mover.placement.to_world(code), 0.0)[self.weld.representatives]

    def has_velocities(self, notes: Notes) -> bool:
        """Whether velocities can be read; problems are noted."""
        velocities = self.mesh.GetVelocitiesAttr()
        if not velocities.HasAuthoredValue():
            return False
        first = velocities.Get(Usd.TimeCode(self.start))
        if velocities.GetTimeSamples() != self.mesh.GetPointsAttr().GetTimeSamples():
            problem = "are not sampled at the times of the points"
        elif len(first or ()) != self.point_count:
            problem = f"are {len(first or ())} for {self.point_count} points"
        elif self.mover.skin or not self.mover.only_points_move:
            problem = "are those under a transform or a skeleton that moves, too"
        else:
            return True
        notes.add(self.mesh.GetPrim(), f"velocities {problem}; they are left out")
        return False


def _placed(value: Vt.Vec3fArray, to_world: Gf.Matrix4d, weight: float) -> NDArray[np.float32]:
    """Return points (weight 1) or vectors (weight 0) ``(n, 3)`` in world space."""
    rows = np.array(value, dtype=np.float32).reshape(-1, 3)
    if to_world == Gf.Matrix4d(1.0):
        return rows
    matrix = np.array(to_world, dtype=np.float64)
    with np.errstate(all="ignore"):  # overflow is reported by the reader, with its vertex
        return np.asarray(rows @ matrix[:3, :3] + weight * matrix[3, :3], dtype=np.float32)
