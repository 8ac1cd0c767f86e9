"""USD, skinning: skeletons and blend shapes that move meshes (UsdSkel), computed by USD's own implementation.

The points of a skinned mesh are blended from its shapes, taken by ``geomBindTransform`` into skeleton space, moved by
the joints (linear or dual quaternion skinning), and placed by the skeleton's transform instead of the mesh's.

Specification: https://openusd.org/release/api/_usd_skel__intro.html
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt

from mixseq.errors import InvalidSequenceError
from mixseq_io.usd.prims import Notes, lineage


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

    def bind_transform(self, code: float) -> Gf.Matrix4d:
        """Return the mesh-to-skeleton transform at bind time."""
        return self.query.GetGeomBindTransform(Usd.TimeCode(code))

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
