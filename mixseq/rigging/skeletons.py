r"""Trees of bones: names, parents, and joints at rest.

The joint of bone b lies at the pivot :math:`p_b`, with axes :math:`A_b` (a rotation) at rest. A motion of the bones in
the world, :math:`R_{tb}` about the pivot that is then at :math:`c_{tb}`, takes the axes to :math:`R_{tb} A_b`. Relative
to the parent a, as in files and engines,

.. math:: Q_{tb} = (R_{ta} A_a)^{-1} R_{tb} A_b, \quad q_{tb} = (R_{ta} A_a)^{-1} (c_{tb} - c_{ta}),

and those of roots are relative to the world. Sums along the tree lead back, parents first.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from mixseq.arrays import Float, FloatArray, Index
from mixseq.errors import InvalidSequenceError
from mixseq.polygons import frozen

_UNIT = 1e-6  # tolerance of the length of quaternions


@dataclass(frozen=True, eq=False)
class Skeleton:
    """Bones in a tree; the formulas are at the head of this module.

    Attributes
    ----------
    names : tuple of str
        B different names.
    parents : (B,) int64
        The bone above each, which stands before it; -1 for roots.
    pivots : (B, 3) float64
        Joints in the rest shape, in the file's units.
    axes : (B, 4) float64
        Axes of the joints at rest: unit quaternions x, y, z, w from them to the world.

    Raises
    ------
    InvalidSequenceError
        If there is no bone, arrays do not fit each other, a name is empty or occurs twice, a parent does not stand
        before its child, a number is not finite, or a quaternion is no unit quaternion.
    """

    names: tuple[str, ...]
    parents: Index
    pivots: Float
    axes: Float

    def __post_init__(self) -> None:
        object.__setattr__(self, "names", tuple(self.names))
        count = len(self.names)
        if not count:
            raise InvalidSequenceError("a skeleton has no bones; one at least is expected")
        twice = [name for name, times in Counter(self.names).items() if not name or times > 1]
        if twice:
            raise InvalidSequenceError(f"the name {twice[0]!r} of a bone is empty or occurs twice; rename it")
        parents = np.asarray(self.parents, dtype=np.int64)
        if parents.shape != (count,):
            raise InvalidSequenceError(f"parents have shape {parents.shape}; ({count},) is expected")
        object.__setattr__(self, "parents", frozen(parents))
        early = (parents < -1) | (parents >= np.arange(count))
        if early.any():
            bone = int(np.argmax(early))
            raise InvalidSequenceError(
                f"the parent of bone {bone} is {parents[bone]}; a bone before it, or -1 for none, is expected"
            )
        for name, width in (("pivots", 3), ("axes", 4)):
            array = np.ascontiguousarray(getattr(self, name), dtype=np.float64)
            if array.shape != (count, width):
                raise InvalidSequenceError(f"{name} have shape {array.shape}; ({count}, {width}) is expected")
            if not np.isfinite(array).all():
                raise InvalidSequenceError(f"{name} have entries that are not finite")
            object.__setattr__(self, name, frozen(array))
        lengths = np.linalg.norm(self.axes, axis=1)
        if (np.abs(lengths - 1) > _UNIT).any():
            bone = int(np.argmax(np.abs(lengths - 1)))
            raise InvalidSequenceError(
                f"the axes of bone {self.names[bone]!r} have length {lengths[bone]:g}; unit quaternions are expected"
            )

    @classmethod
    def flat(cls, pivots: FloatArray) -> Skeleton:
        """Return bones without parents, with the axes of the world, named ``bone_000`` and so on: pivots ``(B, 3)``."""
        count = len(pivots)
        names = tuple(f"bone_{bone:03d}" for bone in range(count))
        axes = np.tile([0.0, 0.0, 0.0, 1.0], (count, 1))
        return cls(names, np.full(count, -1), np.asarray(pivots, dtype=np.float64), axes)

    @property
    def bone_count(self) -> int:
        """Number of bones B."""
        return len(self.names)

    def local_rest(self) -> LocalMotion:
        """Return the rest joints, relative to their parents: rotations ``(B, 4)``, translations ``(B, 3)``."""
        still = np.tile([0.0, 0.0, 0.0, 1.0], (1, self.bone_count, 1))
        rest = self.to_local(still, self.pivots[None])
        return LocalMotion(rest.rotations[0], rest.translations[0])

    def to_local(self, rotations: Float, translations: Float) -> LocalMotion:
        """Return a motion of the world, R ``(T, B, 4)`` and c ``(T, B, 3)``, relative to the parents."""
        turned, places = np.empty_like(rotations), np.array(translations)
        here = [Rotation.from_quat(rotations[:, b]) * self._axes(b) for b in range(self.bone_count)]
        for b, a in enumerate(self.parents.tolist()):
            turned[:, b] = (here[b] if a < 0 else here[a].inv() * here[b]).as_quat()
            if a >= 0:
                places[:, b] = here[a].apply(translations[:, b] - translations[:, a], inverse=True)
        return LocalMotion(turned, places)

    def to_world(self, local: LocalMotion) -> tuple[Float, Float]:
        """Return R ``(T, B, 4)`` and c ``(T, B, 3)`` of a motion relative to the parents."""
        turned, places = np.empty_like(local.rotations), np.array(local.translations)
        here: list[Rotation] = []
        for b, a in enumerate(self.parents.tolist()):
            own = Rotation.from_quat(local.rotations[:, b])
            here.append(own if a < 0 else here[a] * own)
            if a >= 0:
                places[:, b] = places[:, a] + here[a].apply(local.translations[:, b])
            turned[:, b] = (here[b] * self._axes(b).inv()).as_quat()
        return turned, places

    def _axes(self, bone: int) -> Rotation:
        return Rotation.from_quat(self.axes[bone])


@dataclass(frozen=True, eq=False)
class LocalMotion:
    """Rotations and translations of joints relative to their parents, and of roots to the world."""

    rotations: (
        Float  # (..., B, 4) unit quaternions x, y, z, w, from the axes of the joint to those of its parent
    )
    translations: (
        Float  # (..., B, 3) joints in the axes of their parents, from their joints on, in the file's units
    )
