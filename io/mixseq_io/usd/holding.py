"""USD, writing: meshes are held still where transforms above them move.

The points of a layer are all of a mesh's motion. Transforms that move at times of their own would move it between its
frames and beyond them, at another speed than a retimed mesh, and its velocities would not be the whole truth. So
operations that move nothing but this mesh are held as they are in the first frame. Those that move other things, too,
are undone: the outermost prim that has nothing but the mesh below it gets their inverses, copies with the same samples,
so that both together are none at any time (`transforms`).

``!resetXformStack!`` would be shorter, but Blender 5 does not heed it, nor does Hydra 2 where it stands alone [1]_, and
it would cut the mesh off from whatever the layer is referenced under.

References
----------
.. [1] https://github.com/PixarAnimationStudios/OpenUSD/issues/3781
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
    """How a mesh is held still."""

    carrier: Usd.Prim
    own: Operations
    undone: Operations
    fixed: Operations

    def to_world(self, code: float) -> Gf.Matrix4d:
        """Return the transform from the mesh to the world, where it is held as it is at a time code."""
        return product((*self.own, *self.fixed), code)

    def author(self, layer: Sdf.Layer, shown: Shown) -> None:
        """Author it in a layer, the operations held as they are in its first frame."""
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
        """Give the carrier a copy of an attribute of a prim above it, and return its name."""
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
    """Return how a mesh can be held still; None where nothing moves it, or where other things are below it."""
    carrier = _carrier(mesh)
    if carrier is None or not Placement(mesh).moves:
        return None
    every = tuple(operations_of(mesh))
    own = sum(each.GetAttr().GetPath().HasPrefix(carrier.GetPath()) for each in every)
    moving = max(number for number, each in enumerate(every, 1) if varies(each.GetAttr()))
    return Holding(carrier, every[:own], every[own:moving], every[max(own, moving) :])


def _carrier(mesh: Usd.Prim) -> Usd.Prim | None:
    """Return the outermost prim with a transform below which nothing has one but this mesh, if any."""
    carrier = None
    for each in lineage(mesh):
        within = Usd.PrimRange(each, Usd.TraverseInstanceProxies())
        others = (below for below in within if not mesh.GetPath().HasPrefix(below.GetPath()))
        if UsdSkel.Root(each) or any(map(UsdGeom.Xformable, others)):  # roots have extents in their space
            return carrier
        carrier = each if UsdGeom.Xformable(each) else carrier
    return carrier
