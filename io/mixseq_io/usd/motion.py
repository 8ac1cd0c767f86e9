"""Motion of USD meshes: skinning, welding of points, animated attributes, and the time map of an overlay layer.

UsdSkel applies blend shapes, ``geomBindTransform`` into skeleton space, linear or dual quaternion skinning, and the
transform of the skeleton instead of the mesh's transform.

Game-engine characters have points split at seams of texture coordinates and normals. Meshes of skeletons are welded
where position, joints, weights and blend shapes are bit-identical. Other meshes are not welded, since all their time
samples would have to be read. A layer with new points stores the vertex of every point in `VERTICES_ATTRIBUTE`.

Sublayers keep their times in seconds if the layer above has another rate. To retime the whole stage, the layer above
gets samples of all animated attributes, evaluated at the source times of its frames. A layer offset could express only
a constant speed.

Specification: https://openusd.org/release/api/_usd_skel__intro.html
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt

from mixseq.errors import InvalidSequenceError, SettingsError
from mixseq.mesh.polygons import Polygons
from mixseq.sequence.header import SequenceHeader
from mixseq.types import FloatArray, IntArray
from mixseq_io.surfaces import are_valid_indices, renumber_by_appearance
from mixseq_io.usd.stage import PrimWarnings, WorldTransform, is_animated, self_and_ancestors, time_codes


@dataclass(frozen=True)
class Pose:
    """Pose of a skeleton at one time."""

    joint_transforms: Vt.Matrix4dArray
    shape_weights: Vt.FloatArray


@dataclass(frozen=True, eq=False)
class Skeleton:
    """Skeleton prim (in an instance, not in the instance's prototype), its query, and its bound animation."""

    prim: Usd.Prim
    query: UsdSkel.SkeletonQuery

    @cached_property
    def has_joints(self) -> bool:
        """Whether the skeleton has joints with an animated pose or a rest pose."""
        return len(self.query.ComputeSkinningTransforms(Usd.TimeCode.EarliestTime())) > 0

    @cached_property
    def animation(self) -> UsdSkel.Animation | None:
        """Bound animation prim, or None."""
        query = self.query.GetAnimQuery()
        return UsdSkel.Animation(query.GetPrim()) if query else None

    def pose(self, code: float) -> Pose:
        """Return the skeleton's pose at a time code."""
        query = self.query.GetAnimQuery()
        weights = query.ComputeBlendShapeWeights(Usd.TimeCode(code)) if query else ()
        return Pose(self.query.ComputeSkinningTransforms(Usd.TimeCode(code)), Vt.FloatArray(weights))


def bind_pose(skeleton: Skeleton, _: float) -> Pose:
    """Return the bind pose of a skeleton, without blend shapes."""
    joint_count = len(skeleton.query.GetJointOrder())
    query = skeleton.query.GetAnimQuery()
    shape_count = len(query.GetBlendShapeOrder()) if query else 0
    return Pose(Vt.Matrix4dArray([Gf.Matrix4d(1)] * joint_count), Vt.FloatArray([0.0] * shape_count))


@dataclass(frozen=True, eq=False)
class Skin:
    """Skeleton and skinning query of a mesh; `cache` is kept alive, since it owns the data of the queries."""

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
        has_weights = animation is not None and animation.GetBlendShapeWeightsAttr().HasAuthoredValue()
        return has_weights and self.query.HasBlendShapes()

    def attributes(self) -> Iterator[Usd.Attribute]:
        """Yield the attributes other than points that deform the mesh in skeleton space."""
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

    def deform(self, points: Vt.Vec3fArray, pose: Pose, code: float) -> Vt.Vec3fArray:
        """Return the mesh's points in a pose: in skeleton space if joints move the mesh, else in mesh space."""
        deformed = Vt.Vec3fArray(points)  # USD modifies this array in place; the array is copied on the first write
        if self.has_shapes and not self._add_blend_shapes(deformed, pose):
            raise InvalidSequenceError(
                f"the blend shapes of {self.query.GetPrim().GetPath()} do not fit its {len(points)} points; "
                "export the character again"
            )
        transforms = pose.joint_transforms
        if self.has_joints and not self.query.ComputeSkinnedPoints(transforms, deformed, Usd.TimeCode(code)):
            raise InvalidSequenceError(
                f"the joint indices and weights of {self.query.GetPrim().GetPath()} do not fit its "
                f"{len(points)} points and its skeleton's {len(transforms)} joints; export the character again"
            )
        return deformed

    def _add_blend_shapes(self, points: Vt.Vec3fArray, pose: Pose) -> bool:
        shapes, indices, offsets = self._blend_shapes
        mapper = self.query.GetBlendShapeMapper()
        weights = mapper.Remap(pose.shape_weights) if mapper else pose.shape_weights
        # USD splits a weight between the two nearest subshapes; shapes and their inbetweens are subshapes.
        subshapes = shapes.ComputeSubShapeWeights(weights)
        deform: Any = shapes.ComputeDeformedPoints  # its type stub has no parameters
        return bool(deform(*subshapes, indices, offsets, points))

    @cached_property
    def _blend_shapes(self) -> tuple[UsdSkel.BlendShapeQuery, list[Vt.IntArray], list[Vt.Vec3fArray]]:
        query = UsdSkel.BlendShapeQuery(UsdSkel.BindingAPI(self.query.GetPrim()))
        return query, query.ComputeBlendShapePointIndices(), query.ComputeSubShapePointOffsets()


def find_skins(meshes: Sequence[UsdGeom.Mesh], warnings: PrimWarnings) -> dict[Sdf.Path, Skin]:
    """Return the skins of meshes by mesh path; meshes inherit skeleton bindings as in USD."""
    ancestors = (prim for mesh in meshes for prim in self_and_ancestors(mesh.GetPrim()))
    roots = {prim.GetPath(): root for prim in ancestors if (root := UsdSkel.Root(prim))}
    instances = Usd.TraverseInstanceProxies()
    cache = UsdSkel.Cache()
    skins = {}
    for root in roots.values():
        cache.Populate(root, instances)
        for binding in cache.ComputeSkelBindings(root, instances):
            skel = binding.GetSkeleton()
            skeleton = Skeleton(skel.GetPrim(), cache.GetSkelQuery(skel))
            for query in binding.GetSkinningTargets():
                skin = Skin(skeleton, query, cache)
                if skin.has_joints or skin.has_shapes:
                    skins[query.GetPrim().GetPath()] = skin
    for mesh in meshes:
        schema = UsdSkel.BindingAPI(mesh.GetPrim())
        attributes = (schema.GetJointIndicesAttr(), schema.GetBlendShapesAttr()) if schema else ()
        # In layers with new points, these attributes are blocked.
        if any(each.HasAuthoredValue() for each in attributes) and mesh.GetPath() not in skins:
            problem = "bound to no skeleton with a pose below a SkelRoot, and not moved by one"
            warnings.add(mesh.GetPrim(), problem)
    return skins


VERTICES_ATTRIBUTE = "mixseq:vertices"


@dataclass(frozen=True, eq=False)
class Weld:
    """Weld of a mesh: the vertex of every point ``(P,)``, and one point of every vertex ``(W,)``."""

    vertex_of_point: IntArray
    point_of_vertex: IntArray

    @property
    def is_identity(self) -> bool:
        """Whether every point is a separate vertex."""
        return len(self.vertex_of_point) == len(self.point_of_vertex)

    @property
    def vertex_count(self) -> int:
        """Number W of vertices."""
        return len(self.point_of_vertex)

    @classmethod
    def identity(cls, point_count: int) -> Weld:
        """Return the weld in which every point is a separate vertex."""
        return cls(np.arange(point_count), np.arange(point_count))

    @classmethod
    def from_mesh(cls, mesh: UsdGeom.Mesh, points: NDArray[np.float32]) -> Weld:
        """Weld a mesh's points ``(P, 3)``, given in any frame."""
        labels = _stored_vertices(mesh, len(points))
        return cls(*renumber_by_appearance(_identical_points(mesh, points) if labels is None else labels))

    def weld_polygons(self, polygons: Polygons) -> Polygons:
        """Return polygons with point indices replaced by vertex indices."""
        return Polygons(polygons.counts, self.vertex_of_point[polygons.indices])


def _stored_vertices(mesh: UsdGeom.Mesh, point_count: int) -> IntArray | None:
    """Return the vertex of each point ``(P,)`` as stored by mixseq; None if absent or of another size."""
    attribute = mesh.GetPrim().GetAttribute(VERTICES_ATTRIBUTE)
    if not attribute or attribute.GetTypeName() != Sdf.ValueTypeNames.IntArray:
        return None
    labels = np.array(attribute.Get() or (), dtype=np.int32)
    return labels if len(labels) == point_count else None


def _identical_points(mesh: UsdGeom.Mesh, points: NDArray[np.float32]) -> IntArray:
    """Label points ``(P,)`` so that points with equal positions and influences share a label."""
    influences = list(_influences(mesh, len(points)))
    valid = [each for each in influences if each is not None]
    if mesh.GetPointsAttr().ValueMightBeTimeVarying() or not valid or len(valid) < len(influences):
        return np.arange(len(points))
    features = np.ascontiguousarray(np.hstack([points, *valid]))
    return np.unique(features, axis=0, return_inverse=True)[1].reshape(-1)


def _influences(mesh: UsdGeom.Mesh, point_count: int) -> Iterator[NDArray[np.float32] | None]:
    """Yield joint indices, weights and shape offsets ``(P, n)``, or None for animated or invalid arrays."""
    binding = UsdSkel.BindingAPI(mesh.GetPrim())
    for primvar in (binding.GetJointIndicesPrimvar(), binding.GetJointWeightsPrimvar()):
        if not primvar or primvar.GetInterpolation() != UsdGeom.Tokens.vertex:
            continue  # constant primvars are equal at all points
        values = np.array(primvar.ComputeFlattened() or (), dtype=np.float32)
        fits = len(values) == point_count * primvar.GetElementSize()
        usable = fits and not primvar.ValueMightBeTimeVarying()
        yield values.reshape(point_count, -1) if usable else None
    if not binding.GetBlendShapesAttr().HasAuthoredValue():
        return
    query = UsdSkel.BlendShapeQuery(binding)
    indices = [np.array(each, dtype=np.int64) for each in query.ComputeBlendShapePointIndices()]
    for subshape, value in enumerate(query.ComputeSubShapePointOffsets()):
        offsets = np.array(value or (), dtype=np.float32).reshape(-1, 3)
        if not len(offsets):
            continue  # no offsets, as for weight 0
        point_ids = indices[query.GetBlendShapeIndex(subshape)]
        point_ids = point_ids if point_ids.size else np.arange(point_count)
        if len(point_ids) != len(offsets) or not are_valid_indices(point_ids, point_count):
            yield None
            continue
        dense_offsets = np.zeros((point_count, 3), dtype=np.float32)
        dense_offsets[point_ids] = offsets
        yield dense_offsets


@dataclass(frozen=True, eq=False)
class TimeMap:
    """Time codes ``(T,)`` of a layer's frames, and the original's times in s at the frames if retimed, else None."""

    original_rate: float
    rate: float
    codes: NDArray[np.float64]
    source_times: NDArray[np.float64] | None = None

    @classmethod
    def from_header(
        cls, header: SequenceHeader, original_rate: float, source_times: NDArray[np.float64] | None = None
    ) -> TimeMap:
        """Map a sequence's frames to an original file whose rate is given in time codes per second."""
        if source_times is not None and not np.isfinite(source_times).all():
            frame = int(np.argmin(np.isfinite(source_times)))
            raise SettingsError(
                f"frame {frame} shows no single time of the original, so that the whole stage cannot be retimed; leave "
                "out whole_stage"
            )
        return cls(original_rate, header.fps, time_codes(header.times, header.fps), source_times)

    @property
    def start_time(self) -> float:
        """Time of the layer's first frame, in seconds."""
        return float(self.codes[0]) / self.rate

    def original_code(self, time: float) -> float:
        """Return the original's time code for a time of the layer in seconds."""
        if self.source_times is None:
            return time * self.original_rate
        return float(np.interp(time * self.rate, self.codes, self.source_times)) * self.original_rate

    def samples(self, attribute: Usd.Attribute) -> Iterator[tuple[float, Any]]:
        """Yield the samples of an original's animated attribute as pairs of the layer's time code and the value."""
        if self.source_times is None:
            original_codes = np.array(attribute.GetTimeSamples(), dtype=np.float64)
            codes = original_codes * (self.rate / self.original_rate)
        else:
            codes, original_codes = self.codes, self.source_times * self.original_rate
        for code, original_code in zip(codes.tolist(), original_codes.tolist(), strict=True):
            value = attribute.Get(Usd.TimeCode(original_code))
            yield code, Sdf.ValueBlock() if value is None else value


@dataclass(frozen=True, eq=False)
class MeshMotion:
    """Mesh with its skin, if any, and the attributes that animate the mesh."""

    mesh: UsdGeom.Mesh
    skin: Skin | None

    @cached_property
    def transform(self) -> WorldTransform:
        """Transform of the points to the world: the skeleton's transform if joints move the mesh, else the mesh's."""
        return WorldTransform(self.skin.skeleton.prim if self.skin and self.skin.has_joints else self.mesh.GetPrim())

    @cached_property
    def animated_attributes(self) -> tuple[Usd.Attribute, ...]:
        """Attributes that move the mesh over time."""
        deforming = self.skin.attributes() if self.skin else ()
        transforming = (op.GetAttr() for op in self.transform.ops)
        attributes = (self.mesh.GetPointsAttr(), *transforming, *deforming)
        return tuple(attribute for attribute in attributes if is_animated(attribute))

    @property
    def only_points_are_animated(self) -> bool:
        """Whether no transform, skeleton or blend shape animates the mesh."""
        return all(attribute == self.mesh.GetPointsAttr() for attribute in self.animated_attributes)


@dataclass(frozen=True, eq=False)
class AnimatedMesh(MeshMotion):
    """Mesh over the frames of a sequence, at time codes ``(T,)``."""

    codes: NDArray[np.float64]

    @property
    def start(self) -> float:
        """Time code of the first frame."""
        return float(self.codes[0])

    @cached_property
    def _first_points(self) -> Any:
        return self.mesh.GetPointsAttr().Get(Usd.TimeCode(self.start))

    @cached_property
    def weld(self) -> Weld:
        """Weld of the points for all frames, computed in the first frame."""
        points = np.array(self._first_points or (), dtype=np.float32)
        if not points.size:
            raise InvalidSequenceError(f"{self.mesh.GetPath()} has no points")
        if points.shape[1:] != (3,):
            raise InvalidSequenceError(f"the points of {self.mesh.GetPath()} are not vectors of three numbers")
        return Weld.from_mesh(self.mesh, points)

    @property
    def point_count(self) -> int:
        """Number of points."""
        return len(self.weld.vertex_of_point)

    @property
    def vertex_count(self) -> int:
        """Number of vertices."""
        return self.weld.vertex_count

    @cached_property
    def _first_determinant(self) -> float:
        """First nonzero determinant of the transform over time, since objects may appear by scaling up from zero."""
        determinants = (self.transform.at(code).GetDeterminant3() for code in self.codes.tolist())
        return next((each for each in determinants if each), 1.0)

    @property
    def is_mirrored(self) -> bool:
        """Whether the transform to the world mirrors the mesh."""
        determinant = self._first_determinant
        if self.skin and self.skin.has_joints:
            determinant *= self.skin.query.GetGeomBindTransform(Usd.TimeCode(self.start)).GetDeterminant3()
        return determinant < 0

    def read_points(self, code: float) -> Any:
        """Return the points ``(P, 3)`` in mesh space before skinning; arrays of .usdc files are read when accessed."""
        value = self._first_points if code == self.start else self.mesh.GetPointsAttr().Get(Usd.TimeCode(code))
        if value is None:
            raise InvalidSequenceError(f"{self.mesh.GetPath()} has no points")
        if len(value) != self.point_count:
            raise InvalidSequenceError(
                f"{self.mesh.GetPath()} has {len(value)} points, the first frame {self.point_count}; every frame needs "
                "the same vertices in the same order"
            )
        return value

    def points(self, code: float, pose: Pose | None) -> FloatArray:
        """Return the vertices ``(V, 3)`` in world space at a time code, given the skeleton's pose."""
        value = self.read_points(code)
        if self.skin and pose:
            value = self.skin.deform(value, pose, code)
        return _transform_vectors(value, self.to_world(code), 1.0)[self.weld.point_of_vertex]

    def to_world(self, code: float) -> Gf.Matrix4d:
        """Return the transform of the points to the world, which may not mirror some frames only."""
        matrix = self.transform.at(code)
        if matrix.GetDeterminant3() * self._first_determinant < 0:
            raise InvalidSequenceError(
                f"the transform of {self.mesh.GetPath()} mirrors it relative to earlier frames, which turns its faces "
                "inside out; give the animated scale one sign"
            )
        return matrix

    def velocities(self, code: float) -> FloatArray:
        """Return the velocities ``(V, 3)`` in world space, in units per second."""
        value = self.mesh.GetVelocitiesAttr().Get(Usd.TimeCode(code))
        if value is None or len(value) != self.point_count:
            raise InvalidSequenceError(
                f"{self.mesh.GetPath()} has {len(value or ())} velocities for {self.point_count} points; give one "
                "velocity per point"
            )
        return _transform_vectors(value, self.transform.at(code), 0.0)[self.weld.point_of_vertex]

    def has_velocities(self, warnings: PrimWarnings) -> bool:
        """Whether the mesh has usable velocities; add a warning if its velocities are unusable."""
        velocities = self.mesh.GetVelocitiesAttr()
        if not velocities.HasAuthoredValue():
            return False
        first = velocities.Get(Usd.TimeCode(self.start))
        if velocities.GetTimeSamples() != self.mesh.GetPointsAttr().GetTimeSamples():
            problem = "are not sampled at the times of the points"
        elif len(first or ()) != self.point_count:
            problem = f"are {len(first or ())} for {self.point_count} points"
        elif self.skin or not self.only_points_are_animated:
            problem = "lack the motion of an animated transform or skeleton"
        else:
            return True
        warnings.add(self.mesh.GetPrim(), f"velocities {problem}; they are left out")
        return False


def _transform_vectors(value: Vt.Vec3fArray, to_world: Gf.Matrix4d, weight: float) -> FloatArray:
    """Return points (weight 1) or directions (weight 0) ``(n, 3)`` in world space; in double precision if they move."""
    vectors = np.array(value, dtype=np.float32).reshape(-1, 3)
    if to_world == Gf.Matrix4d(1.0):
        return vectors
    matrix = np.array(to_world, dtype=np.float64)
    with np.errstate(all="ignore"):  # the reader reports overflow with its vertex
        return np.asarray(vectors @ matrix[:3, :3] + weight * matrix[3, :3])
