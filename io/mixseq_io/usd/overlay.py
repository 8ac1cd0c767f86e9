"""A USD layer with new points over an existing file, which keeps everything else.

The file is a sublayer; the layer overrides points, extents, velocities, and authored normals that renderers use. USD
scales time codes of sublayers with another ``timeCodesPerSecond``, so that its cameras keep their seconds. Meshes are
unbound from skeletons and blend shapes, old velocities and accelerations are blocked
(https://openusd.org/release/api/class_sdf_value_block.html), and instances are made unique.

Meshes are held still below moving transforms, since the layer's points are their whole motion. Operations that move
this mesh only are held at their first frame. Others are inverted: the outermost prim with nothing but the mesh below it
gets their inverses with the same samples. ``!resetXformStack!`` is unsuitable: Blender 5 ignores it, Hydra 2 does where
it stands alone (https://github.com/PixarAnimationStudios/OpenUSD/issues/3781), and it would detach the mesh from any
referencing prim. Other motion of the file (cameras, hair, lights, materials) keeps its times, or is retimed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt

from mixseq.errors import FormatError, OutputError
from mixseq.mesh.polygons import PolygonMatch, Polygons, describe_difference, reversed_winding
from mixseq.sequence.header import SequenceHeader
from mixseq.types import FloatArray, IntArray
from mixseq_io.originals import is_retimed, match_meshes
from mixseq_io.reader import warn
from mixseq_io.scene_meshes import SceneMesh
from mixseq_io.surfaces import are_valid_indices
from mixseq_io.usd.layers import (
    WORLD,
    Bounds,
    Cast,
    Normals,
    Placed,
    Samples,
    Space,
    SpaceAt,
    attribute_in,
    override,
)
from mixseq_io.usd.motion import VERTICES, Mover, Shown, Skin, Weld, skins_of, unwelded, weld
from mixseq_io.usd.stage import (
    Notes,
    Operations,
    Placement,
    is_spline,
    lineage,
    open_stage,
    operations_of,
    prims_of,
    product,
    reference_to,
    shortened,
    translate_usd_read_errors,
    varies,
)

_INVERSE = "!invert!"


@dataclass(frozen=True, eq=False)
class Holding:
    """Operations that hold a mesh still."""

    carrier: Usd.Prim
    own: Operations
    undone: Operations
    fixed: Operations

    def to_world(self, code: float) -> Gf.Matrix4d:
        """Return the mesh-to-world transform of a mesh that is held as at a time code."""
        return product((*self.own, *self.fixed), code)

    def author(self, layer: Sdf.Layer, shown: Shown) -> None:
        """Author the operations in a layer, held as in its first frame."""
        for attribute in dict.fromkeys(each.GetAttr() for each in self.own):
            if varies(attribute):
                held = attribute_in(layer, str(attribute.GetPath()), attribute.GetTypeName())
                held.default = attribute.Get(Usd.TimeCode(shown.below(shown.start)))
        if not self.undone:
            return
        copies = {
            each: self._copy(layer, each, shown) for each in dict.fromkeys(op.GetAttr() for op in self.undone)
        }
        # The outermost operation comes first, and the first to be undone is the innermost.
        undoing = [("" if each.IsInverseOp() else _INVERSE) + copies[each.GetAttr()] for each in self.undone]
        order = UsdGeom.Xformable(self.carrier).GetXformOpOrderAttr()
        override(layer, order).default = Vt.TokenArray([*undoing, *(order.Get() or ())])

    def _copy(self, layer: Sdf.Layer, attribute: Usd.Attribute, shown: Shown) -> str:
        """Copy an attribute of an ancestor to the carrier, and return its name."""
        name = f"{attribute.GetName()}:undo{attribute.GetPath().pathElementCount - 1}"
        while self.carrier.HasAttribute(name):
            name += "_"
        path = f"{self.carrier.GetPath()}.{name}"
        copy = attribute_in(layer, path, attribute.GetTypeName())
        if not varies(attribute):
            copy.default = attribute.Get(Usd.TimeCode.EarliestTime())
        elif is_spline(attribute) and shown.sources is None:
            raise OutputError(
                f"{attribute.GetPath()} is a spline; bake it into time samples, or write a stand-alone file with "
                "flatten=True (--flatten)"
            )
        else:
            for code, value in shown.samples(attribute):
                layer.SetTimeSample(path, code, value)
        return name


def holding_of(mesh: Usd.Prim) -> Holding | None:
    """Return how a mesh can be held still; None if nothing moves it, or other prims are below it."""
    carrier = _carrier(mesh)
    if carrier is None or not Placement(mesh).moves:
        return None
    every = tuple(operations_of(mesh))
    own = sum(each.GetAttr().GetPath().HasPrefix(carrier.GetPath()) for each in every)
    moving = max(number for number, each in enumerate(every, 1) if varies(each.GetAttr()))
    return Holding(carrier, every[:own], every[own:moving], every[max(own, moving) :])


def _carrier(mesh: Usd.Prim) -> Usd.Prim | None:
    """Return the outermost transformed prim with no other transforms below it but this mesh's, if any."""
    carrier = None
    for each in lineage(mesh):
        within = Usd.PrimRange(each, Usd.TraverseInstanceProxies())
        others = (below for below in within if not mesh.GetPath().HasPrefix(below.GetPath()))
        if UsdSkel.Root(each) or any(map(UsdGeom.Xformable, others)):  # roots have extents in their space
            return carrier
        carrier = each if UsdGeom.Xformable(each) else carrier
    return carrier


@dataclass(frozen=True, eq=False)
class Fit:
    """Mesh of the sequence matched with a mesh of the file.

    `corner_points` ``(C,)`` are the points at the file's corners, `match` maps its polygons and corners to the
    sequence's, `turned` means reversed corner order, `weld` maps points to vertices.
    """

    scene_mesh: SceneMesh
    mesh: UsdGeom.Mesh
    corner_points: IntArray
    match: PolygonMatch
    turned: bool
    weld: Weld


@dataclass(frozen=True, eq=False)
class Original:
    """File that fits a sequence."""

    path: Path
    stage: Usd.Stage
    fits: tuple[Fit, ...]

    @property
    def rate(self) -> float:
        """Time codes per second."""
        return self.stage.GetTimeCodesPerSecond()


def open_original(path: Path, header: SequenceHeader) -> Original:
    """Open a file that a sequence may be laid over."""
    try:
        with translate_usd_read_errors(path):
            stage = open_stage(path)
    except FormatError as error:
        raise OutputError(str(error)) from error
    up = str(UsdGeom.GetStageUpAxis(stage))
    if up != header.up_axis:
        raise OutputError(
            f"{path} has {up} up, the sequence {header.up_axis}; convert_units (--convert-axes {up}) turns it"
        )
    unit = UsdGeom.GetStageMetersPerUnit(stage)
    if not np.isclose(unit, header.metres_per_unit, rtol=1e-6):
        raise OutputError(
            f"{path} has units of {unit:g} m, the sequence of {header.metres_per_unit:g} m; convert_units "
            f"(--convert-units {unit:g}) scales it"
        )
    rate = stage.GetTimeCodesPerSecond()
    if not 0 < rate < np.inf:
        raise OutputError(f"{path} has {rate:g} time codes per second, a positive number is needed")
    try:
        meshes = {str(prim.GetPath()): mesh for prim in prims_of(path, stage) if (mesh := UsdGeom.Mesh(prim))}
        return Original(path, stage, tuple(match_meshes(path, header, meshes, _fitted, _difference)))
    except FormatError as error:
        raise OutputError(str(error)) from error


def _difference(scene_mesh: SceneMesh, mesh: UsdGeom.Mesh) -> str:
    """Return the first difference from the only candidate mesh, in words."""
    stored, places = _stored(mesh)
    if stored is None:
        return ""
    for seams in (weld(mesh, places), unwelded(len(places))):
        if seams.vertex_count == scene_mesh.vertex_count:
            theirs = seams.polygons(stored)
            return describe_difference(scene_mesh.polygons, theirs, ("the sequence", str(mesh.GetPath())))
    return f"it has {len(places)} points, the sequence {scene_mesh.vertex_count} vertices"


def _fitted(scene_mesh: SceneMesh, mesh: UsdGeom.Mesh) -> Fit | None:
    """Match a mesh of the sequence with one of the file; None if faces differ."""
    stored, places = _stored(mesh)
    if stored is None:
        return None
    reverse = reversed_winding(stored.counts, keep_first=True)
    # The sequence may have come from elsewhere, with a vertex for every point.
    for seams in (weld(mesh, places), unwelded(len(places))):
        if seams.vertex_count != scene_mesh.vertex_count:
            continue
        # Readers reverse left-handed faces.
        for turned in (False, True):
            found = scene_mesh.match(seams.polygons(stored), reverse if turned else None)
            if found is not None:
                ours, match = found
                return Fit(ours, mesh, stored.indices, match, turned, seams)
    return None


def _stored(mesh: UsdGeom.Mesh) -> tuple[Polygons | None, FloatArray]:
    """Return a mesh's faces by points, None if they are invalid, and its points ``(P, 3)``."""
    earliest = Usd.TimeCode.EarliestTime()
    counts = np.array(mesh.GetFaceVertexCountsAttr().Get(earliest) or (), dtype=np.int32)
    points = np.array(mesh.GetFaceVertexIndicesAttr().Get(earliest) or (), dtype=np.int32)
    places = np.array(mesh.GetPointsAttr().Get(earliest) or (), dtype=np.float32).reshape(-1, 3)
    sound = (
        counts.min(initial=3) >= 3 and counts.sum() == points.size and are_valid_indices(points, len(places))
    )
    return (Polygons(counts, points) if sound else None), places


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
    of_corner = scene_mesh.normal_groups[fit.match.corners]
    groups: IntArray | None = scene_mesh.normal_groups
    order: IntArray | None = of_corner
    if interpolation == UsdGeom.Tokens.uniform:
        counts = scene_mesh.polygons.counts
        groups, order = np.repeat(np.arange(len(counts)), counts), fit.match.polygons
    elif interpolation != UsdGeom.Tokens.faceVarying:
        interpolation = UsdGeom.Tokens.vertex
        order = np.zeros(len(fit.weld.of_point), dtype=np.int64)
        order[fit.corner_points] = of_corner  # all corners of a point share their normal
        if fit.weld.is_identity:
            groups = order = None
    return Normals(attribute=attribute, interpolation=interpolation, groups=groups, order=order)


def _switch_off(layer: Sdf.Layer, mesh: UsdGeom.Mesh, placed: Placed) -> None:
    """Block stale attributes of the old points, and unbind skeletons and blend shapes."""
    prim = mesh.GetPrim()
    skinned = any(UsdSkel.BindingAPI(each) for each in lineage(prim))
    stale = [prim.GetAttribute(name) for name in ("velocities", "accelerations", "primvars:normals:indices")]
    deforming = [each for each in prim.GetAuthoredAttributes() if _is_of_skeletons(each.GetName())]
    for attribute in [*stale, *(deforming if skinned else [])]:
        if attribute.HasAuthoredValue() and attribute.GetName() not in placed.attributes:
            override(layer, attribute).default = Sdf.ValueBlock()
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
            override(layer, hint).default = Sdf.ValueBlock()


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
        override(layer, orientation).default = tokens.leftHanded if left_handed else tokens.rightHanded


def _tell_vertices(layer: Sdf.Layer, fit: Fit) -> None:
    """Store the vertex of every point, which readers cannot derive from sampled points."""
    if fit.weld.is_identity:
        return
    path = f"{fit.mesh.GetPath()}.{VERTICES}"
    vertices = attribute_in(layer, path, Sdf.ValueTypeNames.IntArray, Sdf.VariabilityUniform)
    vertices.custom = True
    vertices.default = Vt.IntArrayFromBuffer(fit.weld.of_point.astype(np.int32))


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


def warn_of_rest(
    target: Path, header: SequenceHeader, original: Original, times: NDArray[np.float64]
) -> None:
    """Warn of visible prims of a file that move or change, if a sequence shows other `times` ``(T,)`` in s."""
    if not is_retimed(header, times):
        return
    cure = "; whole_stage=True (--whole-stage) retimes everything" if np.isfinite(times).all() else ""
    ours = {fit.mesh.GetPath() for fit in original.fits}
    prims = [each for each in prims_of(original.path, original.stage) if each.GetPath() not in ours]
    skins = skins_of([mesh for each in prims if (mesh := UsdGeom.Mesh(each))], Notes(original.path))
    if paths := [str(each.GetPath()) for each in prims if _is_seen(each) and _changes(each, skins)]:
        warn(f"{target}: what else moves in {original.path} is not retimed: {shortened(paths)}{cure}")


def retime_rest(layer: Sdf.Layer, target: Path, original: Original, shown: Shown) -> None:
    """Author samples, at the layer's frames, of moving attributes that the layer does not author itself."""
    every = Usd.PrimRange.Stage(original.stage, Usd.TraverseInstanceProxies())
    moving = [
        each for prim in every for each in _animated(prim) if not layer.GetAttributeAtPath(each.GetPath())
    ]
    split_instances(layer, target, [each.GetPrim() for each in moving])
    samples = Samples(layer)
    for attribute in moving:
        path = str(attribute.GetPath())
        override(layer, attribute)
        for code, value in shown.samples(attribute):
            samples.put((code, {path: _as_named_from(target, value)}))


def _is_seen(prim: Usd.Prim) -> bool:
    """Whether a prim is visible itself, unlike groups, skeletons and their animations."""
    groups = (UsdGeom.Scope, UsdSkel.Root, UsdSkel.Skeleton, UsdSkel.Animation)
    return prim.GetTypeName() not in ("", "Xform") and not any(kind(prim) for kind in groups)


def _changes(prim: Usd.Prim, skins: Mapping[Sdf.Path, Skin]) -> bool:
    if mesh := UsdGeom.Mesh(prim):
        return bool(Mover(mesh, skins.get(prim.GetPath())).sources)
    moves = bool(UsdGeom.Xformable(prim)) and Placement(prim).moves
    return moves or any(True for _ in _animated(prim))


def _animated(prim: Usd.Prim) -> Iterator[Usd.Attribute]:
    return (each for each in prim.GetAuthoredAttributes() if each.ValueMightBeTimeVarying())


def _as_named_from(target: Path, value: Any) -> Any:
    """Return a value with asset paths rewritten for another file."""
    if isinstance(value, Sdf.AssetPath) and value.resolvedPath:
        return Sdf.AssetPath(reference_to(Path(value.resolvedPath), target))
    return value
