"""Animations of a glTF file: properties of nodes over time, frame times, and the points that follow.

Points are in world space: morph targets first, then the skin, or else the node's transform.

Specification: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html#appendix-c-interpolation
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from mixseq.errors import FormatError, SettingsError
from mixseq.sequence.frame_rates import NTSC_RATES, snap_to_ntsc
from mixseq.sequence.header import DEFAULT_FPS
from mixseq.types import Float, FloatArray
from mixseq_io.gltf.document import Document, Fields
from mixseq_io.gltf.primitives import Weld, deltas, influences, target_count
from mixseq_io.gltf.scene import Pose, Scene
from mixseq_io.reader import warn
from mixseq_io.scene_meshes import (
    MAX_INSERTED_FRAMES,
    TIME_TOLERANCE,
    format_names,
    insert_times,
    snap_to_frames,
)

USUAL_RATES = (24.0, 30.0, 25.0, 60.0, 50.0, 48.0, 120.0, 100.0, 12.0, 15.0, 20.0, 10.0, *NTSC_RATES)
"""Rates in Hz, the most usual first."""

_MOST_FRAMES = 1_000_000
_FASTEST_PLAYED = 60.0
"""Highest rate in Hz at which keys count as frames; finer grids are hundredths of seconds or ticks."""
_GAP = 1.5  # frames; a wider one has room for another
_GRID = 2e-3  # of a frame; keys are float32


def time_tolerance(times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the difference ``(n,)`` in s below which times are equal: a microsecond or a float32 step."""
    return np.maximum(TIME_TOLERANCE, np.spacing(np.abs(times).astype(np.float32)).astype(np.float64))


def key_times(channels: Iterable[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Return the times ``(n,)`` of all channels, increasing; equal times of two channels count once."""
    found = np.empty(0)
    for times in sorted(channels, key=len, reverse=True):
        found = insert_times(found, times, time_tolerance(times))
    return found


def sampled_times(path: Path, keys: NDArray[np.float64], fps: float) -> NDArray[np.float64]:
    """Return times ``(n,)`` from the first key to the last, `fps` per second."""
    if not (np.isfinite(fps) and fps > 0):
        raise SettingsError(f"fps is {fps}; a positive number is expected")
    if not keys.size:
        return keys
    count = (keys[-1] - keys[0]) * fps + _GRID
    if not count < _MOST_FRAMES:
        raise FormatError(
            f"{path}: {keys[-1] - keys[0]:g} s at {fps:g} frames per second are too many frames"
        )
    times: NDArray[np.float64] = keys[0] + np.arange(int(count) + 1) / fps
    return times


def played_times(keys: NDArray[np.float64], rate: float) -> NDArray[np.float64]:
    """Return the times of keys ``(n,)``, and of the frames played in wider gaps between them.

    These are ``k / rate`` if the first key is on that grid, else ``rate`` per second from the first key on. Frames less
    than half a frame from a key are left out; nothing is added above 100 000 frames or where every frame has a key.

    Examples
    --------
    >>> played_times(np.array([0.5, 0.75, 2.1]), 4).tolist()
    [0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.1]
    """
    gaps = np.diff(keys) * rate
    wide = gaps > _GAP
    if not wide.any() or not gaps.sum() < MAX_INSERTED_FRAMES:
        return keys
    first = snap_to_frames(keys[:1], rate)[0] * rate
    whole = np.rint(first)
    start = whole if abs(first - whole) < _GRID else first
    frames = (start + np.arange(int(gaps.sum()) + 2)) / rate
    after = np.searchsorted(keys, frames)
    inside = (after > 0) & (after < keys.size)
    frames, after = frames[inside], after[inside]
    room = np.minimum(frames - keys[after - 1], keys[after] - frames) * rate >= 0.5 - _GRID
    return np.union1d(keys, frames[room & wide[after - 1]])


def played_rate(keys: NDArray[np.float64]) -> float:
    """Return the frame rate of keys ``(n,)``: that of their grid, 24 if it is finer than 60."""
    rate = rate_of(keys)
    return rate if rate <= _FASTEST_PLAYED else DEFAULT_FPS


def rate_of(times: NDArray[np.float64]) -> float:
    """Return the frame rate of even keys ``(n,)``, else of the grid that they lie on, 24 if there is none.

    Examples
    --------
    >>> rate_of(np.arange(96) / np.float32(29.97)) == 30000 / 1001
    True
    >>> rate_of(np.array([0.0, 1, 2, 5]) / 12), rate_of(np.array([0.0, 0.5, 0.6]))
    (12.0, 30.0)
    """
    if times.size < 2:
        return DEFAULT_FPS
    even = _even_rate(times)
    if even:
        return even
    steps = times - times[0]
    own = 1 / float(np.median(np.diff(times)))
    likely = [rate for rate in USUAL_RATES if abs(rate - own) < 1e-3 * own] or [own]
    # A few distant keys determine no rate.
    for rate in (*(likely if own >= min(USUAL_RATES) else []), *USUAL_RATES):
        frames = steps * rate
        if np.abs(frames - np.rint(frames)).max() < _GRID:
            return rate
    return DEFAULT_FPS


def _even_rate(times: NDArray[np.float64]) -> float | None:
    """Return the rate of float32 keys ``(n,)`` at even frames, None for others and for keys far apart.

    Of the rates that round to the same keys it is a usual one, or else the one with the fewest digits.
    """
    count, span = times.size - 1, float(times[-1] - times[0])
    rounding = 2 * float(np.spacing(np.float32(np.abs(times).max())))
    rate = count / span if 0 < span < np.inf else 0.0
    if not rate >= min(USUAL_RATES):
        return None
    if not np.abs(times - times[0] - np.arange(count + 1) / rate).max() <= rounding:
        return None
    whole = round(float(times[-1]) * rate)
    if (
        whole > count
        and np.abs(times * (whole / times[-1]) - np.arange(whole - count, whole + 1)).max() < _GRID
    ):
        rate, span = whole / float(times[-1]), float(times[-1])  # of frames from 0 on, the most precise
    error = rate * rounding / span
    usual = min((*USUAL_RATES, round(rate * 1.001) / 1.001), key=lambda usual: abs(usual - rate))
    # also what was rounded when somebody typed it, 29.97, as long as that makes no difference
    if abs(usual - rate) <= max(error, _GRID * rate / count if snap_to_ntsc(rate) == usual else 0.0):
        return usual
    rounded = (round(rate, digits) for digits in range(6))
    return next((simple for simple in rounded if abs(simple - rate) <= error), rate)


_WIDTHS = {"translation": 3, "rotation": 4, "scale": 3}
_INTERPOLATIONS = ("LINEAR", "STEP", "CUBICSPLINE")
NO_ANIMATION = "none"
"""Choice of animation that reads the nodes without any, mostly at rest."""

_LATEST = 1e9


@dataclass(frozen=True, eq=False)
class Channel:
    """Keyframes of one property of one node."""

    node: int
    name: str
    times: NDArray[np.float64]
    values: NDArray[np.float32]
    interpolation: str

    @property
    def moves(self) -> bool:
        """Whether the property changes over time."""
        at_keys = self.values[:, 1] if self.interpolation == "CUBICSPLINE" else self.values
        tangents = self.values[:, ::2] if self.interpolation == "CUBICSPLINE" else self.values[:0]
        return len(at_keys) > 1 and bool((at_keys[1:] != at_keys[:-1]).any() or tangents.any())

    @property
    def moves_straight(self) -> bool:
        """Whether points that follow this channel alone move linearly in time between keys."""
        return self.interpolation == "LINEAR" and self.name in ("translation", "weights")

    def at(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the values ``(B, k)`` at times ``(B,)`` in s, constant before the first key and after the last."""
        after = np.clip(np.searchsorted(self.times, times, side="right"), 1, max(len(self.times) - 1, 1))
        before, after = after - 1, np.minimum(after, len(self.times) - 1)
        step = self.times[after] - self.times[before]
        s = np.clip((times - self.times[before]) / np.where(step > 0, step, 1.0), 0.0, 1.0)[:, None]
        first, second = self.values[before].astype(np.float64), self.values[after].astype(np.float64)
        if self.interpolation == "STEP":
            # Keys are float32: frames at a rate may be just before the key that they are meant for.
            almost = (s > 0) & ((self.times[after] - times)[:, None] <= time_tolerance(times)[:, None])
            return np.where((s < 1) & ~almost, first, second)
        if self.interpolation == "CUBICSPLINE":
            return hermite(
                first[:, 1], step[:, None] * first[:, 2], second[:, 1], step[:, None] * second[:, 0], s
            )
        if self.name == "rotation":
            return slerp(first, second, s)
        return (1 - s) * first + s * second


def hermite(
    a: NDArray[np.float64],
    leaving: NDArray[np.float64],
    b: NDArray[np.float64],
    arriving: NDArray[np.float64],
    s: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the Hermite cubics from `a` to `b` ``(n, k)``, tangents per step, at `s` ``(n, 1)``, not normalised."""
    return (
        (2 * s**3 - 3 * s**2 + 1) * a
        + (s**3 - 2 * s**2 + s) * leaving
        + (3 * s**2 - 2 * s**3) * b
        + (s**3 - s**2) * arriving
    )


def slerp(a: NDArray[np.float64], b: NDArray[np.float64], s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Interpolate quaternions from `a` to `b` ``(n, 4)`` on the short arc, at fractions `s` ``(n, 1)``."""
    cosine = np.sum(a * b, axis=1, keepdims=True)
    angle = np.arccos(np.clip(np.abs(cosine), 0.0, 1.0))
    small = angle < 1e-6  # a straight line is the arc to rounding
    sine = np.where(small, 1.0, np.sin(angle))
    first = np.where(small, 1 - s, np.sin((1 - s) * angle) / sine)
    second = np.where(small, s, np.sin(s * angle) / sine)
    return first * a + np.where(cosine < 0, -second, second) * b


def pose_at(channels: Collection[Channel], times: NDArray[np.float64]) -> Pose:
    """Return the animated values at times ``(B,)`` in seconds."""
    return {(channel.node, channel.name): channel.at(times) for channel in channels}


def choose_animation(document: Document, choice: str | int | None) -> Fields | None:
    """Return the animation chosen by name or number; the first by default, None if the file has none.

    The prefix that exporters write before a "|", as in ``AnimalArmature|Gallop``, may be left out of a name.
    `NO_ANIMATION` selects the nodes as they stand in the file, unless an animation has that name.
    """
    animations = document.items("animations")
    names = [each.text("name") or f"animation {index}" for index, each in enumerate(animations)]
    if choice is None:
        if len(animations) > 1:
            warn(
                f"{document.path}: of {len(names)} animations the first, {names[0]!r}, is read; the option animation "
                f"(--animation on the command line) chooses another one: {_numbered(names, 1)}"
            )
        return animations[0] if animations else None
    if choice in names:
        return animations[names.index(str(choice))]
    number = str(choice)
    if number.isdecimal() and len(number) < 10 and int(number) < len(animations):
        return animations[int(number)]
    ending = [index for index, name in enumerate(names) if name.endswith(f"|{choice}")]
    if len(ending) == 1:
        return animations[ending[0]]
    if choice == NO_ANIMATION:
        return None
    raise SettingsError(
        f"{document.path} has {'several animations' if ending else 'no animation'} {choice!r}; "
        f"there are {_numbered(names) or 'none'}"
    )


def _numbered(names: Sequence[str], first: int = 0) -> str:
    """Return at most 20 names with their numbers, from `first` on, for a message: ``1 'Dance', 2 'Death'``."""
    return format_names([f"{number} {name!r}" for number, name in enumerate(names)][first:], str)


def told_by(animation: Fields | None, name: str, least: float = -_LATEST) -> float | None:
    """Return an animation's number `name` written by mixseq, such as its rate or start, if above `least`."""
    extras = {} if animation is None else animation.values.get("extras")
    value = extras.get(name) if isinstance(extras, dict) else None
    return (
        float(value)
        if isinstance(value, int | float) and not isinstance(value, bool) and least < value < _LATEST
        else None
    )


def read_channels(document: Document, animation: Fields | None, nodes: Collection[int]) -> list[Channel]:
    """Read the channels of an animation that animate some of the given nodes."""
    if animation is None:
        return []
    samplers = animation.objects("samplers")
    channels: dict[tuple[int, str], Channel] = {}
    pointers = numbers = 0
    for fields in animation.objects("channels"):
        target = fields.object("target")
        node, name = target.index("node"), target.text("path")
        pointers += name == "pointer"
        if node not in nodes or node is None or name not in (*_WIDTHS, "weights"):
            continue
        number = fields.integer("sampler")
        if number >= len(samplers):
            raise fields.error(f"has sampler {number} of {len(samplers)}; the file is damaged")
        channel = _channel(document, node, name, samplers[number])
        numbers += channel.times.size + channel.values.size
        document.check_effort(numbers, animation.place)
        channels[node, name] = channel
    if pointers:
        warn(
            f"{document.path}: {pointers} channels of KHR_animation_pointer are left out; only nodes are animated"
        )
    return list(channels.values())


def _channel(document: Document, node: int, name: str, sampler: Fields) -> Channel:
    interpolation = sampler.text("interpolation", "LINEAR")
    if interpolation not in _INTERPOLATIONS:
        raise sampler.error(
            f"has the interpolation {interpolation[:40]!r}; one of {_INTERPOLATIONS} is expected"
        )
    times = document.accessor(sampler.integer("input")).astype(np.float64)
    values = document.accessor(sampler.integer("output"))
    if times.ndim != 1 or not times.size or not np.isfinite(times).all() or (np.diff(times) <= 0).any():
        raise sampler.error("has times that do not increase; the file is damaged")
    if not np.isfinite(values).all():
        raise sampler.error("has values that are not finite; the file is damaged")
    tangents = 3 if interpolation == "CUBICSPLINE" else 1
    per_key, rest = divmod(values.size, tangents * times.size)
    width = _WIDTHS.get(name, per_key)
    if rest or per_key != width or values.ndim != (1 if name == "weights" else 2):
        raise sampler.error(
            f"has {values.size} values for {times.size} keys of {name} ({interpolation}); "
            f"{tangents * times.size} times {width or 'the number of weights'} are expected"
        )
    shape = (times.size, 3, width) if tangents == 3 else (times.size, width)
    return Channel(node, name, times, values.reshape(shape), interpolation)


@dataclass(frozen=True, eq=False)
class NodeSkin:
    """Skin of a mesh: nodes of its J joints, weights ``(W, J)`` whose rows sum to 1, and `inverse_binds` ``(J, 4, 4)``.

    Inverse bind matrices take mesh space to each joint's space in the bind pose.
    """

    joints: Sequence[int]
    inverse_binds: NDArray[np.float64]
    weights: csr_array

    def matrices(self, world: Mapping[int, Float]) -> NDArray[np.float64]:
        """Return the matrices ``(B, J, 4, 4)`` that move points bound to the joints."""
        joints = np.broadcast_arrays(*(world[joint] for joint in self.joints))
        return np.stack(joints, axis=1) @ self.inverse_binds


@dataclass(frozen=True, eq=False)
class Shape:
    """Node with a welded mesh: rest positions ``(W, 3)``, static morph weights ``(K,)``, and a skin or None.

    A skin replaces the node's transform.
    """

    scene: Scene
    node: int
    weld: Weld
    rest: NDArray[np.float64]
    weights: NDArray[np.float64]
    skin: NodeSkin | None

    @property
    def bearers(self) -> Sequence[int]:
        """Nodes whose matrices move the mesh."""
        return [self.node] if self.skin is None else self.skin.joints

    def handedness(self, world: Mapping[int, Float]) -> NDArray[np.float64]:
        """Return the orientation ``(B,)``: 1 as modelled, -1 mirrored, 0 flat; of joints the majority decides."""
        if self.skin is None:
            return _signs(world[self.node])
        used = np.unique(self.skin.weights.indices)
        matrices = self.skin.matrices(world)
        return np.asarray(np.sign(_signs(matrices[:, used]).sum(axis=1)))

    def points(self, pose: Pose, world: Mapping[int, Float], frames: int) -> FloatArray:
        """Return the points ``(B, W, 3)`` in world space for the B frames of a pose, given the bearers' matrices."""
        own = self._morphed(pose, frames)
        if self.skin is None:
            matrices = np.broadcast_to(world[self.node], (frames, 4, 4))
            return own @ matrices[:, :3, :3].transpose(0, 2, 1) + matrices[:, None, :3, 3]
        joints = self.skin.matrices(world)[:, :, :3].reshape(-1, len(self.skin.joints), 12)
        joints = np.broadcast_to(joints, (frames, *joints.shape[1:]))
        return np.stack([_skinned(*each, self.skin.weights) for each in zip(own, joints, strict=True)])

    def _morphed(self, pose: Pose, frames: int) -> NDArray[np.float64]:
        points = np.tile(self.rest, (frames, 1, 1))
        weights = np.broadcast_to(pose.get((self.node, "weights"), self.weights), (frames, len(self.weights)))
        for target in np.flatnonzero(weights.any(axis=0)):
            here = np.flatnonzero(weights[:, target])
            delta = deltas(self.weld.primitives, int(target))[self.weld.representatives]
            points[here] += weights[here, target, None, None] * delta
        return points


def _signs(matrices: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(np.nan_to_num(np.sign(np.linalg.det(matrices[..., :3, :3]))))


def _skinned(
    points: NDArray[np.float64], joints: NDArray[np.float64], weights: csr_array
) -> NDArray[np.float64]:
    blended = (weights @ joints).reshape(-1, 3, 4)
    return np.asarray(np.einsum("vij,vj->vi", blended[:, :, :3], points) + blended[:, :, 3])


def bearers(document: Document, node: Fields, index: int) -> list[int]:
    """Return the nodes whose matrices move a node's mesh: its skin's joints, or the node itself."""
    skin = node.index("skin")
    if skin is None:
        return [index]
    return joints_of(document, document.item("skins", skin))


def joints_of(document: Document, skin: Fields) -> list[int]:
    """Return the nodes of a skin's joints."""
    joints = skin.integers("joints")
    if not joints:
        raise skin.error("has no joints; the file is damaged")
    for joint in joints:
        document.item("nodes", joint)
    return joints


def read_shape(document: Document, scene: Scene, node: int, weld: Weld) -> Shape:
    """Read the shape of a node's mesh."""
    fields = scene.nodes[node]
    mesh = document.item("meshes", fields.integer("mesh"))
    positions = np.concatenate([each.positions for each in weld.primitives]).astype(np.float64)
    count = target_count(weld.primitives)
    owner = fields if "weights" in fields else mesh
    weights = owner.numbers("weights", count) if "weights" in owner and count else None
    skin = fields.index("skin")
    return Shape(
        scene=scene,
        node=node,
        weld=weld,
        rest=positions[weld.representatives],
        weights=np.zeros(count) if weights is None else weights,
        skin=None if skin is None else _read_skin(document, skin, bearers(document, fields, node), weld),
    )


def _read_skin(document: Document, index: int, joints: Sequence[int], weld: Weld) -> NodeSkin:
    fields = document.item("skins", index)
    inverse_binds = inverse_binds_of(document, fields, len(joints))
    joint, weight = influences(weld.primitives)
    if not joint.size:
        raise fields.error("moves a mesh that has no JOINTS_0 and WEIGHTS_0; the file is damaged")
    if joint.max() >= len(joints):
        raise fields.error(
            f"has {len(joints)} joints, but vertices follow joint {joint.max()}; the file is damaged"
        )
    rows = weld.representatives
    return NodeSkin(joints, inverse_binds, _normalised(joint[rows], weight[rows], len(joints)))


def inverse_binds_of(document: Document, skin: Fields, count: int) -> NDArray[np.float64]:
    """Return a skin's matrices ``(J, 4, 4)`` from the mesh to each of its `count` joints."""
    binds = skin.index("inverseBindMatrices")
    if binds is None:
        return np.tile(np.eye(4), (count, 1, 1))
    matrices = document.accessor(binds)
    if matrices.ndim != 2 or matrices.shape[1] != 16 or len(matrices) < count:
        raise skin.error(f"has {count} joints, but inverse bind matrices of shape {matrices.shape}")
    return matrices[:count].reshape(-1, 4, 4).transpose(0, 2, 1).astype(np.float64)


def _normalised(joint: NDArray[np.int64], weight: NDArray[np.float64], joints: int) -> csr_array:
    """Return weights ``(W, J)`` with row sums 1, as in renderers; vertices without weight follow the first joint."""
    sums = weight.sum(axis=1, keepdims=True)
    weight = np.where(sums != 0, weight / np.where(sums != 0, sums, 1), np.arange(weight.shape[1]) == 0)
    rows = np.repeat(np.arange(len(weight)), weight.shape[1])
    matrix = csr_array((weight.reshape(-1), (rows, joint.reshape(-1))), shape=(len(weight), joints))
    matrix.eliminate_zeros()
    return matrix
