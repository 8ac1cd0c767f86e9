r"""Rigs for engines: a skin over a tree of moving bones, or a base mesh with morph targets.

*Trees of bones.* At rest, the joint of bone b is at the pivot :math:`p_b`, with axes :math:`A_b` (a rotation). The
world motion of bone b rotates the axes to :math:`R_{tb} A_b`, and moves the pivot to :math:`c_{tb}`. Relative to the
parent a, as in files and engines, rotations and translations are

.. math:: Q_{tb} = (R_{ta} A_a)^{-1} R_{tb} A_b, \quad q_{tb} = (R_{ta} A_a)^{-1} (c_{tb} - c_{ta}),

and roots are relative to the world. Composing motions from parents to children inverts these formulas.

*Linear blend skinning.* A vertex has at most four bones; morph targets may correct the rest shape before skinning:

.. math::

    x_t(v) = \sum_{i=1}^4 w_{vi} \Bigl( R_{tb} \bigl( r_v + \sum_m a_{tm} d_{mv} - p_b \bigr) + c_{tb} \Bigr),
    \quad b = b_{vi}, \quad w_{vi} \ge 0, \quad \sum_i w_{vi} = 1

*Morph targets.* :math:`x_t(v) = x_0(v) + \sum_m w_{tm} d_m(v)`.

Skins and morphs yield blocks of frames like `mixseq.sequence.sequence.MeshSequence`, for `mixseq.compare` and writers.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mixseq.errors import InvalidSequenceError, SettingsError
from mixseq.mesh.polygons import read_only
from mixseq.mesh.rotations import align_quat_signs, normalise_quat, quat_to_matrix
from mixseq.sequence.header import SequenceHeader
from mixseq.types import Float, FloatArray, Index

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

BONES_PER_VERTEX = 4  # number of skinning weights of a vertex, as in engines and in the core of glTF 2.0

_UNIT_TOLERANCE = 1e-6  # tolerated deviation from one of sums of weights and lengths of quaternions
_TIME_TOLERANCE_FRAMES = 1e-3  # tolerated time before the first and after the last frame, in frames


@dataclass(frozen=True, eq=False)
class Skeleton:
    """Tree of bones.

    Attributes
    ----------
    names : tuple of str
        Unique names of B bones.
    parents : (B,) int64
        Parent of every bone; parents precede their children, and roots have -1.
    pivots : (B, 3) float64
        Positions of the joints at rest, in the file's units.
    axes : (B, 4) float64
        Rotations from joint axes at rest to world axes: unit quaternions x, y, z, w.

    Raises
    ------
    InvalidSequenceError
        If there is no bone, shapes do not match, a name is empty or repeated, a parent does not precede its child, a
        number is not finite, or a quaternion is not of unit length.
    """

    names: tuple[str, ...]
    parents: Index
    pivots: Float
    axes: Float

    def __post_init__(self) -> None:
        object.__setattr__(self, "names", tuple(self.names))
        count = len(self.names)
        if not count:
            raise InvalidSequenceError("a skeleton has no bones; at least one is expected")
        invalid = [name for name, uses in Counter(self.names).items() if not name or uses > 1]
        if invalid:
            raise InvalidSequenceError(f"the name {invalid[0]!r} of a bone is empty or occurs twice; rename it")
        _set_array(self, "parents", (count,), np.int64)
        is_early = (self.parents < -1) | (self.parents >= np.arange(count))
        if is_early.any():
            bone = int(np.argmax(is_early))
            raise InvalidSequenceError(
                f"the parent of bone {bone} is {self.parents[bone]}; a bone before it, or -1 for none, is expected"
            )
        _set_array(self, "pivots", (count, 3))
        _set_array(self, "axes", (count, 4))
        lengths = np.linalg.norm(self.axes, axis=1)
        if (np.abs(lengths - 1) > _UNIT_TOLERANCE).any():
            bone = int(np.argmax(np.abs(lengths - 1)))
            raise InvalidSequenceError(
                f"the axes of bone {self.names[bone]!r} have length {lengths[bone]:g}; unit quaternions are expected"
            )

    @classmethod
    def from_pivots(cls, pivots: FloatArray) -> Skeleton:
        """Return bones ``bone_000``, ``bone_001``, ... without parents at pivots ``(B, 3)``, with world axes."""
        count = len(pivots)
        names = tuple(f"bone_{bone:03d}" for bone in range(count))
        axes = np.tile([0.0, 0.0, 0.0, 1.0], (count, 1))
        return cls(names, np.full(count, -1), np.asarray(pivots, dtype=np.float64), axes)

    @property
    def bone_count(self) -> int:
        """Number of bones B."""
        return len(self.names)

    def local_rest(self) -> tuple[Float, Float]:
        """Return rotations ``(B, 4)`` and translations ``(B, 3)`` of the joints at rest, relative to their parents."""
        identity = np.tile([0.0, 0.0, 0.0, 1.0], (1, self.bone_count, 1))
        rotations, translations = self.to_local(identity, self.pivots[None])
        return rotations[0], translations[0]

    def to_local(self, rotations: Float, translations: Float) -> tuple[Float, Float]:
        """Convert a world motion, R ``(T, B, 4)`` and c ``(T, B, 3)``, to Q and q relative to the parents."""
        local_rotations, local_translations = np.empty_like(rotations), np.array(translations)
        world = [_rotation(rotations[:, bone]) * self._axes(bone) for bone in range(self.bone_count)]
        for bone, parent in enumerate(self.parents.tolist()):
            if parent < 0:
                local_rotations[:, bone] = world[bone].as_quat()
                continue
            local_rotations[:, bone] = (world[parent].inv() * world[bone]).as_quat()
            offsets = translations[:, bone] - translations[:, parent]
            local_translations[:, bone] = world[parent].apply(offsets, inverse=True)
        return local_rotations, local_translations

    def to_world(self, local_rotations: Float, local_translations: Float) -> tuple[Float, Float]:
        """Convert motions Q ``(T, B, 4)`` and q ``(T, B, 3)`` relative to the parents to a world motion, R and c."""
        rotations, translations = np.empty_like(local_rotations), np.array(local_translations)
        world: list[Rotation] = []
        for bone, parent in enumerate(self.parents.tolist()):
            rotation = _rotation(local_rotations[:, bone])
            world.append(rotation if parent < 0 else world[parent] * rotation)
            if parent >= 0:
                offsets = world[parent].apply(local_translations[:, bone])
                translations[:, bone] = translations[:, parent] + offsets
            rotations[:, bone] = (world[bone] * self._axes(bone).inv()).as_quat()
        return rotations, translations

    def _axes(self, bone: int) -> Rotation:
        return _rotation(self.axes[bone])


def _rotation(quaternions: Float) -> Rotation:
    """Make rotations of unit quaternions; the first one loads SciPy."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_quat(quaternions)


class _RigFrames(ABC):
    """Frames of a rig, computed on demand."""

    header: SequenceHeader

    @abstractmethod
    def _frames(self, frames: slice) -> Float:
        """Return the points ``(n, V, 3)`` of a range of frames."""

    def blocks(self, size: int = 16) -> Iterator[Float]:
        """Iterate over the points in blocks ``(n, V, 3)`` of at most `size` frames."""
        for start in range(0, self.header.frame_count, size):
            yield self._frames(slice(start, start + size))

    def points(self) -> Float:
        """Return all frames ``(T, V, 3)``."""
        return np.concatenate(list(self.blocks()))


@dataclass(frozen=True, eq=False)
class Skin(_RigFrames):
    """Mesh skinned to moving bones, optionally with morph targets.

    Attributes
    ----------
    header : SequenceHeader
        Mesh and times.
    rest : (V, 3) float64
        Rest shape r, in the file's units.
    skeleton : Skeleton
        Bones, with pivots p in the rest shape.
    rotations : (T, B, 4) float64
        World rotations R from rest: unit quaternions x, y, z, w, without sign flips between frames.
    translations : (T, B, 3) float64
        World positions c of the pivots.
    influences : (V, 4) int64
        Bone of every skinning weight.
    weights : (V, 4) float64
        Non-negative skinning weights w; rows add to one.
    targets : (M, V, 3) float64
        Morph targets d: displacements of the rest shape before skinning.
    target_weights : (T, M) float64
        Weights a of the targets.

    Raises
    ------
    InvalidSequenceError
        If shapes do not match, a bone does not exist, a weight is negative, weights do not add to one, or a quaternion
        is not of unit length.
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
        t, v, b, m = self.header.frame_count, self.header.vertex_count, self.bone_count, len(self.targets)
        _set_array(self, "rest", (v, 3))
        _set_array(self, "rotations", (t, b, 4))
        _set_array(self, "translations", (t, b, 3))
        _set_array(self, "weights", (v, BONES_PER_VERTEX))
        _set_array(self, "targets", (m, v, 3))
        _set_array(self, "target_weights", (t, m))
        _set_array(self, "influences", (v, BONES_PER_VERTEX), np.int64)
        is_outside = (self.influences < 0) | (self.influences >= b)
        if is_outside.any():
            vertex, column = np.argwhere(is_outside)[0]
            raise InvalidSequenceError(
                f"vertex {vertex} follows bone {self.influences[vertex, column]}, but bones are 0 to {b - 1}"
            )
        sums = self.weights.sum(axis=1)
        is_invalid = (self.weights < 0).any(axis=1) | (np.abs(sums - 1) > _UNIT_TOLERANCE)
        if is_invalid.any():
            vertex = int(np.argmax(is_invalid))
            raise InvalidSequenceError(
                f"the weights of vertex {vertex} are {self.weights[vertex].tolist()}; "
                "numbers that are not negative and add to one are expected"
            )
        lengths = np.linalg.norm(self.rotations, axis=2)
        if (np.abs(lengths - 1) > _UNIT_TOLERANCE).any():
            frame, bone = np.argwhere(np.abs(lengths - 1) > _UNIT_TOLERANCE)[0]
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
        """Pivots p ``(B, 3)`` of the bones in the rest shape."""
        return self.skeleton.pivots

    def local_motion(self) -> tuple[Float, Float]:
        """Return rotations ``(T, B, 4)``, without sign flips, and translations ``(T, B, 3)`` relative to parents."""
        rotations, translations = self.skeleton.to_local(self.rotations, self.translations)
        return remove_sign_flips(rotations), translations

    def resampled(self, times: ArrayLike, fps: float | None = None) -> Skin:
        """Resample the skin at other times, interpolating keys as engines do.

        Rotations relative to the parents are interpolated spherically (Shoemake 1985). Translations relative to the
        parents and target weights are interpolated linearly.

        Parameters
        ----------
        times : (n,) array_like
            Increasing times between the first and the last frame, in seconds.
        fps : float, optional
            Frame rate; by default the frame rate of the header.

        Raises
        ------
        SettingsError
            If a time is before the first frame or after the last one.
        InvalidSequenceError
            If times do not increase.
        """
        header = self.header.with_times(times, fps)
        before, after, fraction = _bracket_times(self.header, header.times)
        rotations, translations = self.local_motion()
        rotations = slerp(rotations[before], rotations[after], fraction[:, None, None])
        translations = _interpolate(translations, before, after, fraction)
        rotations, translations = self.skeleton.to_world(rotations, translations)
        return replace(
            self,
            header=header,
            rotations=remove_sign_flips(rotations),
            translations=translations,
            target_weights=_interpolate(self.target_weights, before, after, fraction),
        )

    def _frames(self, frames: slice) -> Float:
        return np.stack([self._frame(frame) for frame in range(self.header.frame_count)[frames]])

    def _frame(self, frame: int) -> Float:
        """Return the points ``(V, 3)`` of a frame by linear blend skinning."""
        rotations = rotation_matrices(self.rotations[frame])
        offsets = self.translations[frame] - np.einsum("bij,bj->bi", rotations, self.pivots)
        motions = np.concatenate([rotations, offsets[:, :, None]], axis=2)
        shape = self.rest + np.einsum("m,mvi->vi", self.target_weights[frame], self.targets)
        blended = self.blend_matrices(motions)
        return np.asarray(np.einsum("vij,vj->vi", blended[:, :, :3], shape) + blended[:, :, 3])

    def blend_matrices(self, matrices: Float) -> Float:
        """Return the mean matrix ``(V, 3, k)`` of every vertex by skinning weights: matrices ``(B, 3, k)``."""
        blended = np.zeros((len(self.rest), *matrices.shape[1:]))
        for column in range(BONES_PER_VERTEX):
            blended += self.weights[:, column, None, None] * matrices[self.influences[:, column]]
        return blended


@dataclass(frozen=True, eq=False)
class Morph(_RigFrames):
    """Mesh with morph targets (blend shapes).

    Attributes
    ----------
    header : SequenceHeader
        Mesh and times.
    base : (V, 3) float64
        Base shape, in the file's units.
    targets : (M, V, 3) float64
        Displacements of the base.
    weights : (T, M) float64
        Weights of the targets.

    Raises
    ------
    InvalidSequenceError
        If shapes do not match.
    """

    header: SequenceHeader
    base: Float
    targets: Float
    weights: Float

    def __post_init__(self) -> None:
        t, v, m = self.header.frame_count, self.header.vertex_count, len(self.targets)
        _set_array(self, "base", (v, 3))
        _set_array(self, "targets", (m, v, 3))
        _set_array(self, "weights", (t, m))

    def _frames(self, frames: slice) -> Float:
        displacements = self.weights[frames] @ self.targets.reshape(len(self.targets), self.base.size)
        return np.asarray(self.base + displacements.reshape(-1, *self.base.shape))

    def resampled(self, times: ArrayLike, fps: float | None = None) -> Morph:
        """Resample the morph at other times, by linear interpolation of weights.

        Raises
        ------
        SettingsError
            If a time is before the first frame or after the last one.
        InvalidSequenceError
            If times do not increase.
        """
        header = self.header.with_times(times, fps)
        weights = _interpolate(self.weights, *_bracket_times(self.header, header.times))
        return replace(self, header=header, weights=weights)


def rotation_matrices(quaternions: FloatArray) -> Float:
    """Return the rotation matrices ``(..., 3, 3)`` of quaternions ``(..., 4)``, in the order x, y, z, w."""
    return quat_to_matrix(np.roll(quaternions, 1, axis=-1))


def remove_sign_flips(quaternions: FloatArray) -> Float:
    """Choose signs of quaternions ``(T, ..., 4)``: w >= 0 in the first frame, then closest to the previous frame."""
    identity = np.broadcast_to([0.0, 0.0, 0.0, 1.0], quaternions.shape[1:])
    return align_quat_signs(quaternions, identity)


def slerp(p: Float, q: Float, fraction: Float) -> Float:
    """Interpolate unit quaternions ``(..., 4)`` spherically from p to q, along the shorter arc."""
    q = np.where(np.sum(p * q, axis=-1, keepdims=True) < 0, -q, q)
    # The angle is computed from chord lengths, which is accurate for small angles.
    chord, sum_length = (np.linalg.norm(each, axis=-1, keepdims=True) for each in (p - q, p + q))
    angle = 2 * np.arctan2(chord, sum_length)
    is_small = np.sin(angle) < 1e-8
    first = np.where(is_small, 1 - fraction, np.sin((1 - fraction) * angle))
    second = np.where(is_small, fraction, np.sin(fraction * angle))
    return normalise_quat(first * p + second * q)


def _bracket_times(header: SequenceHeader, times: Float) -> tuple[Index, Index, Float]:
    """Return the frames before and after every time, and the fraction of the interval between both."""
    frame_times, tolerance = header.times, _TIME_TOLERANCE_FRAMES / header.fps
    if len(times) and (times[0] < frame_times[0] - tolerance or times[-1] > frame_times[-1] + tolerance):
        raise SettingsError(
            f"times from {times[0]:g} s to {times[-1]:g} s leave those of the frames, "
            f"{frame_times[0]:g} s to {frame_times[-1]:g} s; give times between them"
        )
    last = max(len(frame_times) - 2, 0)
    before = np.clip(np.searchsorted(frame_times, times, side="right") - 1, 0, last)
    after = np.minimum(before + 1, len(frame_times) - 1)
    span = np.where(after > before, frame_times[after] - frame_times[before], 1.0)
    return before, after, np.clip((times - frame_times[before]) / span, 0.0, 1.0)


def _interpolate(values: Float, before: Index, after: Index, fraction: Float) -> Float:
    fraction = fraction.reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray((1 - fraction) * values[before] + fraction * values[after])


def _set_array(rig: object, name: str, shape: tuple[int, ...], dtype: type = np.float64) -> None:
    """Replace an array of a rig by a read-only array of finite numbers; raise if its shape differs from `shape`."""
    array: NDArray[Any] = np.ascontiguousarray(getattr(rig, name), dtype=dtype)
    if array.shape != shape:
        raise InvalidSequenceError(f"{name} have shape {array.shape}; {shape} is expected")
    if not np.isfinite(array).all():
        raise InvalidSequenceError(f"{name} have entries that are not finite")
    object.__setattr__(rig, name, read_only(array))
