"""USD, writing: hold meshes still below moving transforms, since the layer's points are their whole motion.

Operations that move this mesh only are held at their first frame. Others are inverted: the outermost prim with nothing
but the mesh below it gets their inverses with the same samples (`transforms`). ``!resetXformStack!`` is unsuitable:
Blender 5 ignores it, Hydra 2 does where it stands alone (https://github.com/PixarAnimationStudios/OpenUSD/issues/3781),
and it would detach the mesh from any referencing prim.
"""

from __future__ import annotations

from dataclasses import dataclass

from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt

from mixseq.errors import OutputError
from mixseq_io.usd.layers import attribute_in
from mixseq_io.usd.prims import lineage
from mixseq_io.usd.shown import Shown
from mixseq_io.usd.transforms import Operations, Placement, is_spline, operations_of, product, varies

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
        authored = attribute_in(layer, str(order.GetPath()), order.GetTypeName(), order.GetVariability())
        authored.default = Vt.TokenArray([*undoing, *(order.Get() or ())])

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
