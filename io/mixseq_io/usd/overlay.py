"""USD, writing: a layer with new points over an existing file, which keeps everything else.

The file is a sublayer; the layer overrides points, extents, velocities, and authored normals that renderers use. USD
scales time codes of sublayers with another ``timeCodesPerSecond``, so that its cameras keep their seconds. Meshes are
unbound from skeletons and blend shapes, old velocities and accelerations are blocked
(https://openusd.org/release/api/class_sdf_value_block.html), and instances are made unique.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt

from mixseq.arrays import FloatArray
from mixseq.errors import OutputError
from mixseq_io.blocks import warn
from mixseq_io.scene_meshes import SceneMesh
from mixseq_io.usd.frame_values import WORLD, Bounds, Cast, Normals, Placed, Space, SpaceAt
from mixseq_io.usd.holding import Holding, holding_of
from mixseq_io.usd.layers import attribute_in
from mixseq_io.usd.original import Fit, Original
from mixseq_io.usd.paths import reference_to
from mixseq_io.usd.prims import lineage, shortened
from mixseq_io.usd.seams import VERTICES
from mixseq_io.usd.shown import Shown
from mixseq_io.usd.transforms import Placement, product

_COPIED = (
    "defaultPrim",
    "expressionVariables",
    "kilogramsPerUnit",
    "renderSettingsPrimPath",
    "colorConfiguration",
    "colorManagementSystem",
)
"""Metadata that USD reads from the root layer only."""


def lay_over(layer: Sdf.Layer, target: Path, original: Original, shown: Shown, velocities: bool) -> Cast:
    """Author everything but samples, and return the prims that get them."""
    put_over(layer, target, original)
    moving = [fit for fit in original.fits if Placement(fit.mesh.GetPrim()).moves]
    holdings = {fit: held for fit in moving if (held := holding_of(fit.mesh.GetPrim()))}
    for held in holdings.values():
        held.author(layer, shown)
    not_held = [str(fit.mesh.GetPath()) for fit in moving if fit not in holdings]
    if not_held:
        warn(
            f"{target}: meshes with other things below them still move with what is above them, between frames and "
            f"beyond them, and have no velocities: {shortened(not_held)}; flatten keeps everything"
        )
    meshes = tuple(
        Placed(
            path=str(fit.mesh.GetPath()),
            scene_mesh=fit.scene_mesh,
            of_point=None if fit.weld.is_identity else fit.weld.of_point,
            space=_space(original, fit.mesh.GetPrim(), shown, holdings.get(fit)),
            normals=_normals(fit),
            velocities=velocities and (fit in holdings or fit not in moving),
        )
        for fit in original.fits
    )
    for fit, placed in zip(original.fits, meshes, strict=True):
        _switch_off(layer, fit.mesh, placed)
        _orient(layer, fit, placed, shown.start)
        _tell_vertices(layer, fit)
    return Cast(meshes, _bounds(original, shown))


def put_over(layer: Sdf.Layer, target: Path, original: Original) -> None:
    """Make a file the sublayer of an empty layer."""
    layer.subLayerPaths.append(reference_to(original.path, target))
    below = original.stage.GetRootLayer()
    for key in _COPIED:
        if below.pseudoRoot.HasInfo(key):
            layer.pseudoRoot.SetInfo(key, below.pseudoRoot.GetInfo(key))
    split_instances(layer, target, [fit.mesh.GetPrim() for fit in original.fits])


def split_instances(layer: Sdf.Layer, target: Path, prims: Iterable[Usd.Prim]) -> None:
    """Turn instances above some prims into ordinary prims, which can have opinions."""
    above = [each for prim in prims for each in lineage(prim) if each.IsInstance()]
    paths = list(dict.fromkeys(str(prim.GetPath()) for prim in above))
    for path in paths:
        Sdf.CreatePrimInLayer(layer, path).SetInfo("instanceable", False)
    if paths:
        warn(f"{target}: instances with moving meshes are instances no longer: {shortened(paths)}")


def _space(original: Original, prim: Usd.Prim, shown: Shown, holding: Holding | None = None) -> SpaceAt:
    placement = Placement(prim)

    def check(matrix: Gf.Matrix4d, time: float) -> None:
        if np.linalg.matrix_rank(np.array(matrix)[:3, :3]) < 3:
            raise OutputError(
                f"{original.path}: the transform of {prim.GetPath()} is singular at {time:g} s, so that points in its "
                "space do not reach everywhere; write a stand-alone file with flatten=True (--flatten)"
            )

    def space(matrix: Gf.Matrix4d, time: float) -> Space:
        if matrix == Gf.Matrix4d(1.0):
            return WORLD
        check(matrix, time)
        to_world = np.array(matrix, dtype=np.float64)
        return Space(to_world, np.asarray(np.linalg.inv(to_world), dtype=np.float64))

    if not holding and placement.moves:
        return lambda time: space(placement.to_world(shown.below(time)), time)
    start = shown.start
    fixed = space(holding.to_world(shown.below(start)) if holding else placement.to_world(0.0), start)

    def still(time: float) -> Space:
        if holding:
            check(product(holding.undone, shown.below(time)), time)
        return fixed

    return still


def _normals(fit: Fit) -> Normals | None:
    """Return how to replace authored normals, None without any; subdivided meshes have none that matter."""
    mesh, scene_mesh = fit.mesh, fit.scene_mesh
    if mesh.GetSubdivisionSchemeAttr().Get() != UsdGeom.Tokens.none:
        return None
    primvar = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("normals")  # counts before the attribute
    if primvar.HasAuthoredValue():
        attribute, interpolation = "primvars:normals", primvar.GetInterpolation()
    elif mesh.GetNormalsAttr().HasAuthoredValue():
        attribute, interpolation = "normals", mesh.GetNormalsInterpolation()
    else:
        return None
    groups = scene_mesh.polygons.indices if scene_mesh.hard_edges is None else scene_mesh.hard_edges
    if interpolation == UsdGeom.Tokens.faceVarying:
        return Normals(
            attribute=attribute, interpolation=interpolation, groups=groups, order=groups[fit.match.corners]
        )
    if interpolation == UsdGeom.Tokens.uniform:
        faces = np.arange(len(scene_mesh.polygons.counts))
        groups = np.repeat(faces, scene_mesh.polygons.counts)
        return Normals(
            attribute=attribute, interpolation=interpolation, groups=groups, order=fit.match.polygons
        )
    if fit.weld.is_identity:
        return Normals(attribute=attribute, interpolation=UsdGeom.Tokens.vertex)
    of_point = np.zeros(len(fit.weld.of_point), dtype=np.int64)  # all corners of a point share their normal
    of_point[fit.corner_points] = groups[fit.match.corners]
    return Normals(attribute=attribute, interpolation=UsdGeom.Tokens.vertex, groups=groups, order=of_point)


def _switch_off(layer: Sdf.Layer, mesh: UsdGeom.Mesh, placed: Placed) -> None:
    """Block stale attributes of the old points, and unbind skeletons and blend shapes."""
    prim = mesh.GetPrim()
    skinned = any(UsdSkel.BindingAPI(each) for each in lineage(prim))
    stale = [prim.GetAttribute(name) for name in ("velocities", "accelerations", "primvars:normals:indices")]
    deforming = [each for each in prim.GetAuthoredAttributes() if _is_of_skeletons(each.GetName())]
    for attribute in [*stale, *(deforming if skinned else [])]:
        if attribute.HasAuthoredValue() and attribute.GetName() not in placed.attributes:
            _block(layer, attribute)
    if skinned:  # also by a binding above it, which can be undone only where the schema is applied
        over = Sdf.CreatePrimInLayer(layer, placed.path)
        if not UsdSkel.BindingAPI(prim):
            over.SetInfo("apiSchemas", Sdf.TokenListOp.Create(prependedItems=["SkelBindingAPI"]))
        names = [each.GetName() for each in prim.GetAuthoredRelationships()]
        for name in {"skel:skeleton", *filter(_is_of_skeletons, names)}:
            unbound = Sdf.RelationshipSpec(over, name, False, Sdf.VariabilityUniform)
            unbound.targetPathList.ClearEditsAndMakeExplicit()
    for each in lineage(prim):
        hint = each.GetAttribute("extentsHint")
        if hint and hint.HasAuthoredValue():
            _block(layer, hint)


def _is_of_skeletons(name: str) -> bool:
    return name.startswith(("skel:", "primvars:skel:"))


def _orient(layer: Sdf.Layer, fit: Fit, placed: Placed, start: float) -> None:
    """Set the orientation of faces mirrored by their skeleton, or no longer by their transform."""
    if not fit.corner_points.size:
        return
    tokens, orientation = UsdGeom.Tokens, fit.mesh.GetOrientationAttr()
    mirrored = np.linalg.det(placed.space(start).to_world[:3, :3]) < 0
    # of the sequence, whose faces are counter-clockwise, the mesh has the reverse if it is turned
    left_handed = fit.turned != mirrored
    if left_handed != (orientation.Get() == tokens.leftHanded):
        turned = attribute_in(
            layer, str(orientation.GetPath()), orientation.GetTypeName(), orientation.GetVariability()
        )
        turned.default = tokens.leftHanded if left_handed else tokens.rightHanded


def _tell_vertices(layer: Sdf.Layer, fit: Fit) -> None:
    """Store the vertex of every point, which readers cannot derive from sampled points."""
    if fit.weld.is_identity:
        return
    path = f"{fit.mesh.GetPath()}.{VERTICES}"
    vertices = attribute_in(layer, path, Sdf.ValueTypeNames.IntArray, Sdf.VariabilityUniform)
    vertices.custom = True
    vertices.default = Vt.IntArrayFromBuffer(fit.weld.of_point.astype(np.int32))


def _block(layer: Sdf.Layer, attribute: Usd.Attribute) -> None:
    attribute_in(
        layer, str(attribute.GetPath()), attribute.GetTypeName(), attribute.GetVariability()
    ).default = Sdf.ValueBlock()


def _bounds(original: Original, shown: Shown) -> tuple[Bounds, ...]:
    """Return the roots of skeletons, whose extents take precedence over those of their meshes."""
    below: dict[Usd.Prim, list[SceneMesh]] = {}
    for fit in original.fits:
        for prim in lineage(fit.mesh.GetPrim()):
            if UsdSkel.Root(prim):
                below.setdefault(prim, []).append(fit.scene_mesh)
    return tuple(
        Bounds(
            path=str(root.GetPath()),
            scene_meshes=tuple(scene_meshes),
            space=_space(original, root, shown),
            others=_others(root, shown, len(scene_meshes)),
        )
        for root, scene_meshes in below.items()
    )


def _others(root: Usd.Prim, shown: Shown, count: int) -> Callable[[float], FloatArray]:
    """Return a root's extent in the file over time, empty unless it has other gprims below than the `count` meshes."""
    nothing = np.zeros((0, 3))
    gprims = [each for each in Usd.PrimRange(root, Usd.TraverseInstanceProxies()) if UsdGeom.Gprim(each)]
    if len(gprims) <= count:
        return lambda time: nothing
    boundable = UsdGeom.Boundable(root)

    def extent(time: float) -> FloatArray:
        code = Usd.TimeCode(shown.below(time))
        known = boundable.GetExtentAttr().Get(code) or UsdGeom.Boundable.ComputeExtentFromPlugins(
            boundable, code
        )
        return nothing if known is None else np.array(known, dtype=np.float64)

    return extent
