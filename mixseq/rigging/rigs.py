r"""Rigs for engines: a skin over a tree of moving bones, or a base mesh with morph targets.

*Trees of bones.* The joint of bone b lies at the pivot :math:`p_b`, with axes :math:`A_b` (a rotation) at rest. A
motion of the bones in the world, :math:`R_{tb}` about the pivot that is then at :math:`c_{tb}`, takes the axes to
:math:`R_{tb} A_b`. Relative to the parent a, as in files and engines,

.. math:: Q_{tb} = (R_{ta} A_a)^{-1} R_{tb} A_b, \quad q_{tb} = (R_{ta} A_a)^{-1} (c_{tb} - c_{ta}),

and those of roots are relative to the world. Sums along the tree lead back, parents first.

*Linear blend skinning.* A vertex follows at most four bones, and the rest shape may be corrected before:

.. math::

    x_t(v) = \sum_{i=1}^4 w_{vi} \Bigl( R_{tb} \bigl( r_v + \sum_m a_{tm} d_{mv} - p_b \bigr) + c_{tb} \Bigr),
    \quad b = b_{vi}, \quad w_{vi} \ge 0, \quad \sum_i w_{vi} = 1

*Morph targets.* :math:`x_t(v) = x_0(v) + \sum_m w_{tm} d_m(v)`.

Both stream their frames as a `mixseq.sequence.sequence.MeshSequence` does, so that `mixseq.compare` and writers take
them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from mixseq.errors import InvalidSequenceError, SettingsError
from mixseq.mesh.polygons import read_only
from mixseq.sequence.header import SequenceHeader
from mixseq.types import Float, FloatArray, Index

INFLUENCES = 4
"""Largest number of bones of a vertex: that of engines and the core of glTF 2.0."""

_SUM = 1e-6  # tolerance of sums of weights and lengths of quaternions
_MISS = 1e-3  # share of a frame: tolerance of typed times at the first and last frame


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
        object.__setattr__(self, "parents", read_only(parents))
        early = (parents < -1) | (parents >= np.arange(count))
        if early.any():
            bone = int(np.argmax(early))
            raise InvalidSequenceError(
                f"the parent of bone {bone} is {parents[bone]}; a bone before it, or -1 for none, is expected"
            )
        _take(self, "pivots", (count, 3))
        _take(self, "axes", (count, 4))
        lengths = np.linalg.norm(self.axes, axis=1)
        if (np.abs(lengths - 1) > _SUM).any():
            bone = int(np.argmax(np.abs(lengths - 1)))
            raise InvalidSequenceError(
                f"the axes of bone {self.names[bone]!r} have length {lengths[bone]:g}; unit quaternions are expected"
            )

    @classmethod
    def from_pivots(cls, pivots: FloatArray) -> Skeleton:
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


@dataclass(frozen=True, eq=False)
class Skin:
    """A mesh that follows moving bones; the formula is at the head of this module.

    Attributes
    ----------
    header : SequenceHeader
        Mesh and times.
    rest : (V, 3) float64
        Rest shape r, in the file's units.
    skeleton : Skeleton
        The bones: their names and tree, and the pivots p about which they turn, in the rest shape.
    rotations : (T, B, 4) float64
        R, in the world: unit quaternions x, y, z, w; along the frames without jumps of sign.
    translations : (T, B, 3) float64
        Positions of the pivots, c, in the world.
    influences : (V, 4) int64
        Bone of every weight.
    weights : (V, 4) float64
        Not negative, rows add to one.
    targets : (M, V, 3) float64
        Displacements d of the rest shape, added before skinning.
    target_weights : (T, M) float64
        Weights a of the targets.

    Raises
    ------
    InvalidSequenceError
        If arrays do not fit each other, a bone does not exist, a weight is negative, or weights or quaternions do not
        have the length one.
    """

    header: SequenceHeader
    rest: Float
    skeleton: Skeleton
    rotations: Float
    translations: Float
    influences: Index
    weights: Float
    targets: Float
    target_weights: Float

    def __post_init__(self) -> None:
        t, v, b, m = (self.header.frame_count, self.header.vertex_count, self.bone_count, len(self.targets))
        _take(self, "rest", (v, 3))
        _take(self, "rotations", (t, b, 4))
        _take(self, "translations", (t, b, 3))
        _take(self, "weights", (v, INFLUENCES))
        _take(self, "targets", (m, v, 3))
        _take(self, "target_weights", (t, m))
        object.__setattr__(self, "influences", read_only(np.asarray(self.influences, dtype=np.int64)))
        if self.influences.shape != (v, INFLUENCES):
            raise InvalidSequenceError(
                f"influences have shape {self.influences.shape}; ({v}, {INFLUENCES}) is expected"
            )
        outside = (self.influences < 0) | (self.influences >= b)
        if outside.any():
            vertex, column = np.argwhere(outside)[0]
            raise InvalidSequenceError(
                f"vertex {vertex} follows bone {self.influences[vertex, column]}, but bones are 0 to {b - 1}"
            )
        off = (self.weights < 0).any(axis=1) | (np.abs(self.weights.sum(axis=1) - 1) > _SUM)
        if off.any():
            vertex = int(np.argmax(off))
            raise InvalidSequenceError(
                f"the weights of vertex {vertex} are {self.weights[vertex].tolist()}; "
                "numbers that are not negative and add to one are expected"
            )
        lengths = np.linalg.norm(self.rotations, axis=2)
        if (np.abs(lengths - 1) > _SUM).any():
            frame, bone = np.argwhere(np.abs(lengths - 1) > _SUM)[0]
            raise InvalidSequenceError(
                f"frame {frame}: the quaternion of bone {bone} has length {lengths[frame, bone]:g}; "
                "unit quaternions are expected"
            )

    @property
    def bone_count(self) -> int:
        """Number of bones B."""
        return self.skeleton.bone_count

    @property
    def pivots(self) -> Float:
        """Points p ``(B, 3)`` about which the bones turn, in the rest shape."""
        return self.skeleton.pivots

    def local_motion(self) -> LocalMotion:
        """Return joints relative to their parents: rotations ``(T, B, 4)`` and translations ``(T, B, 3)``.

        Rotations have no jumps of sign along the frames.
        """
        found = self.skeleton.to_local(self.rotations, self.translations)
        return replace(found, rotations=remove_sign_flips(found.rotations))

    def blocks(self, size: int = 16) -> Iterator[Float]:
        """Iterate over the points in blocks ``(n, V, 3)`` of at most `size` frames."""
        for start in range(0, self.header.frame_count, size):
            frames = range(start, min(start + size, self.header.frame_count))
            yield np.stack([self._frame(frame) for frame in frames])

    def points(self) -> Float:
        """Return all frames ``(T, V, 3)``."""
        return np.concatenate(list(self.blocks()))

    def resampled(self, times: ArrayLike, fps: float | None = None) -> Skin:
        """Return the same skin at other times.

        Relative to their parents, bones turn at a constant rate from frame to frame, by the shorter way (spherical
        linear interpolation, Shoemake 1985); joints and weights of targets are linear, as engines interpolate keys.

        Parameters
        ----------
        times : (n,) array_like
            Seconds, increasing, between the first and the last frame.
        fps : float, optional
            Frames per second of the time line; that of the header if not given.

        Raises
        ------
        SettingsError
            If a time is before the first frame or after the last one.
        InvalidSequenceError
            If times do not increase.
        """
        header = self.header.with_times(times, fps)
        before, after, share = _between(self.header, header.times)
        local = self.local_motion()
        p, q = local.rotations[before], local.rotations[after]
        q = q * np.where(np.sum(p * q, axis=2, keepdims=True) < 0, -1.0, 1.0)
        moved = LocalMotion(
            _slerp(p, q, share[:, None, None]), _mixed(local.translations, before, after, share)
        )
        rotations, translations = self.skeleton.to_world(moved)
        return replace(
            self,
            header=header,
            rotations=remove_sign_flips(rotations),
            translations=translations,
            target_weights=_mixed(self.target_weights, before, after, share),
        )

    def _frame(self, frame: int) -> Float:
        """Return the points ``(V, 3)`` of a frame, each moved by the weighted mean of its bones' matrices."""
        turn = rotation_matrices(self.rotations[frame])
        shift = self.translations[frame] - np.einsum("bij,bj->bi", turn, self.pivots)
        motions = np.concatenate([turn, shift[:, :, None]], axis=2)
        shape = self.rest + np.einsum("m,mvi->vi", self.target_weights[frame], self.targets)
        blended = np.zeros((len(shape), 3, 4))
        for column in range(INFLUENCES):
            blended += self.weights[:, column, None, None] * motions[self.influences[:, column]]
        return np.asarray(np.einsum("vij,vj->vi", blended[:, :, :3], shape) + blended[:, :, 3])


@dataclass(frozen=True, eq=False)
class Morph:
    """A mesh that is a sum of shapes; the formula is at the head of this module.

    Attributes
    ----------
    header : SequenceHeader
        Mesh and times.
    base : (V, 3) float64
        The shape to which targets are added, in the file's units.
    targets : (M, V, 3) float64
        Displacements of the base.
    weights : (T, M) float64
        Weights of the targets.

    Raises
    ------
    InvalidSequenceError
        If arrays do not fit each other.
    """

    header: SequenceHeader
    base: Float
    targets: Float
    weights: Float

    def __post_init__(self) -> None:
        t, v, m = self.header.frame_count, self.header.vertex_count, len(self.targets)
        _take(self, "base", (v, 3))
        _take(self, "targets", (m, v, 3))
        _take(self, "weights", (t, m))

    def blocks(self, size: int = 16) -> Iterator[Float]:
        """Iterate over the points in blocks ``(n, V, 3)`` of at most `size` frames."""
        flat = self.targets.reshape(len(self.targets), self.base.size)
        for start in range(0, self.header.frame_count, size):
            moved = self.weights[start : start + size] @ flat
            yield self.base + moved.reshape(-1, *self.base.shape)

    def points(self) -> Float:
        """Return all frames ``(T, V, 3)``."""
        return np.concatenate(list(self.blocks()))

    def resampled(self, times: ArrayLike, fps: float | None = None) -> Morph:
        """Return the same morph at other times; weights are interpolated linearly.

        Raises
        ------
        SettingsError
            If a time is before the first frame or after the last one.
        InvalidSequenceError
            If times do not increase.
        """
        header = self.header.with_times(times, fps)
        return replace(
            self, header=header, weights=_mixed(self.weights, *_between(self.header, header.times))
        )


def rotation_matrices(quaternions: FloatArray) -> Float:
    """Return the rotation matrices ``(..., 3, 3)`` of unit quaternions ``(..., 4)`` in the order x, y, z, w."""
    x, y, z, w = np.moveaxis(np.asarray(quaternions, dtype=np.float64), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def remove_sign_flips(quaternions: FloatArray) -> Float:
    """Choose signs of quaternions ``(T, ..., 4)``, w >= 0 at first, then near the one before, for interpolation."""
    q = np.array(quaternions, dtype=np.float64)
    flips = np.ones(q.shape[:-1])
    flips[:1] = np.where(q[:1, ..., 3] < 0, -1.0, 1.0)
    flips[1:] = np.where(np.sum(q[1:] * q[:-1], axis=-1) < 0, -1.0, 1.0)
    return np.asarray(q * np.cumprod(flips, axis=0)[..., None])


def _slerp(p: Float, q: Float, share: Float) -> Float:
    """Interpolate unit quaternions p to q, less than half a turn of the four-sphere apart, by a share of the way."""
    # The angle from chords, which is accurate for small angles too.
    angle = 2 * np.arctan2(
        np.linalg.norm(p - q, axis=-1, keepdims=True), np.linalg.norm(p + q, axis=-1, keepdims=True)
    )
    sine = np.sin(angle)
    straight = sine < 1e-8
    safe = np.where(straight, 1.0, sine)
    first = np.where(straight, 1 - share, np.sin((1 - share) * angle) / safe)
    second = np.where(straight, share, np.sin(share * angle) / safe)
    turned = first * p + second * q
    return np.asarray(turned / np.linalg.norm(turned, axis=-1, keepdims=True))


def _between(header: SequenceHeader, times: Float) -> tuple[Index, Index, Float]:
    """Return the frames before and after every time, and the share of the way from one to the other."""
    own, slack = header.times, _MISS / header.fps
    if len(times) and (times[0] < own[0] - slack or times[-1] > own[-1] + slack):
        raise SettingsError(
            f"times from {times[0]:g} s to {times[-1]:g} s leave those of the frames, "
            f"{own[0]:g} s to {own[-1]:g} s; ask for times between them"
        )
    before = np.clip(np.searchsorted(own, times, side="right") - 1, 0, max(len(own) - 2, 0))
    after = np.minimum(before + 1, len(own) - 1)
    span = np.where(after > before, own[after] - own[before], 1.0)
    return before, after, np.clip((times - own[before]) / span, 0.0, 1.0)


def _mixed(values: Float, before: Index, after: Index, share: Float) -> Float:
    share = share.reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray((1 - share) * values[before] + share * values[after])


def _take(rig: object, name: str, shape: tuple[int, ...]) -> None:
    """Replace an array of a rig by a read-only one of float64; raise an error for another shape."""
    array = np.ascontiguousarray(getattr(rig, name), dtype=np.float64)
    if array.shape != shape:
        raise InvalidSequenceError(f"{name} have shape {array.shape}; {shape} is expected")
    if not np.isfinite(array).all():
        raise InvalidSequenceError(f"{name} have entries that are not finite")
    object.__setattr__(rig, name, read_only(array))
