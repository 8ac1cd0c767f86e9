"""USD, writing: other motion in the file below: cameras, hair, lights, materials.

Attributes authored by the layer itself, such as points and held transforms, are excluded.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Sdf, Usd, UsdGeom, UsdSkel

from mixseq.sequence import SequenceHeader
from mixseq_io.blocks import warn
from mixseq_io.originals import is_retimed
from mixseq_io.usd.layers import Samples, attribute_in
from mixseq_io.usd.mesh_motion import Mover
from mixseq_io.usd.original import Original
from mixseq_io.usd.overlay import split_instances
from mixseq_io.usd.paths import reference_to
from mixseq_io.usd.prims import Notes, prims_of, shortened
from mixseq_io.usd.shown import Shown
from mixseq_io.usd.skeletons import Skin, skins_of
from mixseq_io.usd.transforms import Placement


def what_else_moves(original: Original) -> list[str]:
    """Return the paths of visible prims, other than the sequence's meshes, that move or change."""
    ours = {fit.mesh.GetPath() for fit in original.fits}
    prims = [each for each in prims_of(original.path, original.stage) if each.GetPath() not in ours]
    skins = skins_of([mesh for each in prims if (mesh := UsdGeom.Mesh(each))], Notes(original.path))
    return [str(each.GetPath()) for each in prims if _is_seen(each) and _changes(each, skins)]


def warn_of_rest(
    target: Path, header: SequenceHeader, original: Original, times: NDArray[np.float64]
) -> None:
    """Warn of other motion in a file if a sequence shows `times` ``(T,)`` in s that differ from its own."""
    if not is_retimed(header, times):
        return
    cure = "; whole_stage=True (--whole-stage) retimes everything" if np.isfinite(times).all() else ""
    if paths := what_else_moves(original):
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
        attribute_in(layer, path, attribute.GetTypeName(), attribute.GetVariability())
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
