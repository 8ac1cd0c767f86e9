"""USD, writing: new points laid over an existing file, of which everything else stays.

The layer has the file as its sublayer and stronger opinions on little: points and extents of the meshes, velocities,
and normals where the file has them and renderers use them. USD scales the time codes of a sublayer that has another
``timeCodesPerSecond``, so that its cameras keep their seconds.

What the file itself would do to the points is switched off: meshes are unbound from skeletons and blend shapes
[1]_, velocities and accelerations that belong to the old points are blocked [2]_, instances that would share
their points with others become prims of their own [3]_.

References
----------
.. [1] https://openusd.org/release/api/_usd_skel__schemas.html
.. [2] https://openusd.org/release/api/class_sdf_value_block.html
.. [3] https://openusd.org/release/api/_usd__page__scenegraph_instancing.html
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdSkel

from mixseq.errors import OutputError
from mixseq.sequence import FloatArray, IntArray
from mixseq_io.blocks import warn
from mixseq_io.pieces import Piece
from mixseq_io.usd.base import Base
from mixseq_io.usd.frames import WORLD, Bounds, Cast, Normals, Placed, Space, SpaceAt
from mixseq_io.usd.layers import attribute_in
from mixseq_io.usd.motion import local_to_world
from mixseq_io.usd.paths import reference_to
from mixseq_io.usd.stage import lineage, shortened

_COPIED = ("kilogramsPerUnit", "renderSettingsPrimPath", "colorConfiguration", "colorManagementSystem")


def lay_over(layer: Sdf.Layer, target: Path, base: Base, velocities: bool) -> Cast:
    """Author everything but samples, and return what is to get them.

    Parameters
    ----------
    layer : Sdf.Layer
        An empty layer.
    target : Path
        Where it will be.
    base : Base
        What it is laid over.
    velocities : bool
        Whether there are velocities.

    Raises
    ------
    OutputError
        If the transform of a mesh is singular.

    Warns
    -----
    MixseqWarning
        If instances become prims of their own, or velocities are left out under transforms that move.
    """
    layer.subLayerPaths.append(reference_to(base.path, target))
    below = base.stage.GetRootLayer()
    layer.defaultPrim = below.defaultPrim
    for key in _COPIED:
        if below.pseudoRoot.HasInfo(key):
            layer.pseudoRoot.SetInfo(key, below.pseudoRoot.GetInfo(key))
    _split_instances(layer, target, base)
    meshes = tuple(_placed(base, *each, velocities) for each in base.meshes)
    for (_, mesh, order), placed in zip(base.meshes, meshes, strict=True):
        _switch_off(layer, mesh, placed)
        _orient(layer, mesh, placed, order)
    left_out = [each.path for each in meshes if velocities and not each.velocities]
    if left_out:
        warn(
            f"{target}: velocities are left out where transforms move, too: {shortened(left_out)}; flatten keeps them"
        )
    return Cast(meshes, _bounds(base))


def _split_instances(layer: Sdf.Layer, target: Path, base: Base) -> None:
    """Give instances prims of their own, on which there can be opinions."""
    above = [prim for _, mesh, _ in base.meshes for prim in lineage(mesh.GetPrim()) if prim.IsInstance()]
    paths = list(dict.fromkeys(str(prim.GetPath()) for prim in above))
    for path in paths:
        Sdf.CreatePrimInLayer(layer, path).SetInfo("instanceable", False)
    if paths:
        warn(f"{target}: instances with moving meshes are instances no longer: {shortened(paths)}")


def _placed(base: Base, piece: Piece, mesh: UsdGeom.Mesh, order: IntArray, velocities: bool) -> Placed:
    prim = mesh.GetPrim()
    return Placed(
        path=str(mesh.GetPath()),
        piece=piece,
        space=_space(base, prim),
        normals=_normals(mesh, piece, order),
        velocities=velocities and not _moves(prim),
    )


def _moves(prim: Usd.Prim) -> bool:
    """Whether transforms move a prim."""
    spaces = [space for each in lineage(prim) if (space := UsdGeom.Xformable(each))]
    return any(space.TransformMightBeTimeVarying() for space in spaces)


def _space(base: Base, prim: Usd.Prim) -> SpaceAt:
    rate = base.stage.GetTimeCodesPerSecond()

    def at(time: float) -> Space:
        to_world = local_to_world(prim, time * rate)
        if np.array_equal(to_world, np.eye(4)):
            return WORLD
        if np.linalg.matrix_rank(to_world[:3, :3]) < 3:
            raise OutputError(
                f"{base.path}: the transform of {prim.GetPath()} is singular at {time:g} s, so that points in its "
                "space do not reach everywhere; write a stand-alone file with flatten=True (--flatten)"
            )
        return Space(to_world, np.asarray(np.linalg.inv(to_world), dtype=np.float64))

    if _moves(prim):
        return at
    fixed = at(0.0)
    return lambda time: fixed


def _normals(mesh: UsdGeom.Mesh, piece: Piece, order: IntArray) -> Normals | None:
    """Return how to replace authored normals, which would be stale; subdivided meshes have none that count."""
    if mesh.GetSubdivisionSchemeAttr().Get() != UsdGeom.Tokens.none:
        return None
    primvar = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("normals")  # counts before the attribute
    if primvar.HasAuthoredValue():
        attribute, interpolation = "primvars:normals", primvar.GetInterpolation()
    elif mesh.GetNormalsAttr().HasAuthoredValue():
        attribute, interpolation = "normals", mesh.GetNormalsInterpolation()
    else:
        return None
    if interpolation == UsdGeom.Tokens.faceVarying:
        groups = piece.polygons.indices if piece.creases is None else piece.creases
        return Normals(attribute=attribute, interpolation=interpolation, groups=groups, order=groups[order])
    if interpolation == UsdGeom.Tokens.uniform:
        faces = np.arange(len(piece.polygons.counts))
        groups = np.repeat(faces, piece.polygons.counts)
        return Normals(attribute=attribute, interpolation=interpolation, groups=groups)
    return Normals(attribute=attribute, interpolation=UsdGeom.Tokens.vertex)


def _switch_off(layer: Sdf.Layer, mesh: UsdGeom.Mesh, placed: Placed) -> None:
    """Block what belongs to the old points, or would move the new ones."""
    prim = mesh.GetPrim()
    skinned = bool(UsdSkel.BindingAPI(prim))
    stale = [prim.GetAttribute(name) for name in ("velocities", "accelerations", "primvars:normals:indices")]
    deforming = [each for each in prim.GetAuthoredAttributes() if _is_of_skeletons(each.GetName())]
    for attribute in [*stale, *(deforming if skinned else [])]:
        if attribute.HasAuthoredValue() and attribute.GetName() not in placed.attributes:
            _block(layer, attribute)
    if skinned:  # the schema stays applied: only by it an inherited binding can be undone
        names = [each.GetName() for each in prim.GetAuthoredRelationships()]
        for name in {"skel:skeleton", *filter(_is_of_skeletons, names)}:
            unbound = Sdf.RelationshipSpec(
                layer.GetPrimAtPath(placed.path), name, False, Sdf.VariabilityUniform
            )
            unbound.targetPathList.ClearEditsAndMakeExplicit()
    for each in lineage(prim):
        hint = each.GetAttribute("extentsHint")
        if hint and hint.HasAuthoredValue():
            _block(layer, hint)


def _is_of_skeletons(name: str) -> bool:
    return name.startswith(("skel:", "primvars:skel:"))


def _orient(layer: Sdf.Layer, mesh: UsdGeom.Mesh, placed: Placed, order: IntArray) -> None:
    """Turn faces that would be inside out: those of a mesh that its skeleton mirrored, or its transform does not."""
    tokens, orientation = UsdGeom.Tokens, mesh.GetOrientationAttr()
    mirrored = np.linalg.det(placed.space(0.0).to_world[:3, :3]) < 0
    clockwise = order[1] != 1  # of the sequence, whose faces are counter-clockwise, the mesh has the reverse
    left_handed = clockwise != mirrored
    if left_handed != (orientation.Get() == tokens.leftHanded):
        turned = attribute_in(
            layer, str(orientation.GetPath()), orientation.GetTypeName(), orientation.GetVariability()
        )
        turned.default = tokens.leftHanded if left_handed else tokens.rightHanded


def _block(layer: Sdf.Layer, attribute: Usd.Attribute) -> None:
    attribute_in(
        layer, str(attribute.GetPath()), attribute.GetTypeName(), attribute.GetVariability()
    ).default = Sdf.ValueBlock()


def _bounds(base: Base) -> tuple[Bounds, ...]:
    """Return the roots of skeletons: their extents follow the skeleton, and count instead of those of the meshes."""
    below: dict[Usd.Prim, list[Piece]] = {}
    for piece, mesh, _ in base.meshes:
        for prim in lineage(mesh.GetPrim()):
            if UsdSkel.Root(prim):
                below.setdefault(prim, []).append(piece)
    return tuple(
        Bounds(
            path=str(root.GetPath()),
            pieces=tuple(pieces),
            space=_space(base, root),
            others=_others(base, root, len(pieces)),
        )
        for root, pieces in below.items()
    )


def _others(base: Base, root: Usd.Prim, count: int) -> Callable[[float], FloatArray]:
    """Return the extent that a root has in the file, if there is more below it than meshes that get new points."""
    nothing = np.zeros((0, 3))
    gprims = [each for each in Usd.PrimRange(root, Usd.TraverseInstanceProxies()) if UsdGeom.Gprim(each)]
    if len(gprims) <= count:
        return lambda time: nothing
    boundable, rate = UsdGeom.Boundable(root), base.stage.GetTimeCodesPerSecond()

    def extent(time: float) -> FloatArray:
        code = Usd.TimeCode(time * rate)
        known = boundable.GetExtentAttr().Get(code) or UsdGeom.Boundable.ComputeExtentFromPlugins(
            boundable, code
        )
        return nothing if known is None else np.array(known, dtype=np.float64)

    return extent
