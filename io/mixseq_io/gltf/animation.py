"""Animations of a glTF file: keyframes of node properties, frame times, and the points of animated meshes.

World-space points are computed by the morph targets, then by the skin, or by the node's transform if it has no skin.

Specification: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html#appendix-c-interpolation
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.sparse import csr_array

from mixseq.errors import FormatError, MixseqError, SettingsError
from mixseq.rigging.rigs import slerp
from mixseq.types import Float, FloatArray, Index, Single
from mixseq_io.gltf.document import POINTER_EXTENSION, Document, Fields, load_document
from mixseq_io.gltf.primitives import Weld, count_targets, read_deltas, read_influences
from mixseq_io.gltf.scene import Pose, Scene
from mixseq_io.reader import warn
from mixseq_io.scene_meshes import MAX_INSERTED_FRAMES, TIME_TOLERANCE, format_names, insert_times, snap_to_frames

_MAX_FRAME_COUNT = 1_000_000
_MIN_GAP_FRAMES = 1.5
_GRID_TOLERANCE_FRAMES = 2e-3
"""Largest distance in frames between a frame and a float32 key that counts as at this frame."""


def time_tolerance(times: Float) -> Float:
    """Return the distance ``(n,)`` in s within which times count as equal: a microsecond, or a larger float32 step."""
    return np.maximum(TIME_TOLERANCE, np.spacing(np.abs(times).astype(np.float32)).astype(np.float64))


def merge_key_times(channels: Iterable[Float]) -> Float:
    """Merge the key times of all channels into increasing times ``(n,)``."""
    merged = np.empty(0)
    for times in sorted(channels, key=len, reverse=True):
        merged = insert_times(merged, times, time_tolerance(times))
    return merged


def sample_times(path: Path, keys: Float, fps: float) -> Float:
    """Return frame times ``(n,)`` in s from the first key to the last, at `fps` frames per second."""
    if not (np.isfinite(fps) and fps > 0):
        raise SettingsError(f"fps is {fps}; a positive number is expected")
    if not keys.size:
        return keys
    count = (keys[-1] - keys[0]) * fps + _GRID_TOLERANCE_FRAMES
    if not count < _MAX_FRAME_COUNT:
        raise FormatError(f"{path}: {keys[-1] - keys[0]:g} s at {fps:g} frames per second are too many frames")
    times: Float = keys[0] + np.arange(int(count) + 1) / fps
    return times


def insert_frames(keys: Float, rate: float) -> Float:
    """Insert frames into gaps between key times ``(n,)``, at least half a frame from every key.

    Frames are at ``k / rate`` if the first key is at such a time, else at multiples of the frame duration after this
    key. If more than 100 000 frames would be inserted, the keys are returned unchanged.

    Examples
    --------
    >>> insert_frames(np.array([0.5, 0.75, 2.1]), 4).tolist()
    [0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.1]
    """
    gaps = np.diff(keys) * rate
    is_wide = gaps > _MIN_GAP_FRAMES
    if not is_wide.any() or not gaps.sum() < MAX_INSERTED_FRAMES:
        return keys
    first = snap_to_frames(keys[:1], rate)[0] * rate
    nearest = np.rint(first)
    start = nearest if abs(first - nearest) < _GRID_TOLERANCE_FRAMES else first
    frames = (start + np.arange(int(gaps.sum()) + 2)) / rate
    after = np.searchsorted(keys, frames)
    is_inside = (after > 0) & (after < keys.size)
    frames, after = frames[is_inside], after[is_inside]
    distance = np.minimum(frames - keys[after - 1], keys[after] - frames) * rate
    return np.union1d(keys, frames[(distance >= 0.5 - _GRID_TOLERANCE_FRAMES) & is_wide[after - 1]])


_PROPERTY_WIDTHS = {"translation": 3, "rotation": 4, "scale": 3}
_INTERPOLATIONS = ("LINEAR", "STEP", "CUBICSPLINE")
NO_ANIMATION = "none"
"""Value of the animation option that selects the static transforms of all nodes, usually the rest pose."""

_MAX_EXTRA_NUMBER = 1e9


@dataclass(frozen=True, eq=False)
class Channel:
    """Keyframes of a node's property at times ``(n,)``, with values ``(n, k)``, or ``(n, 3, k)`` including tangents."""

    node: int
    name: str
    times: Float
    values: Single
    interpolation: str

    @property
    def is_animated(self) -> bool:
        """Whether the property changes over time."""
        is_cubic = self.interpolation == "CUBICSPLINE"
        at_keys = self.values[:, 1] if is_cubic else self.values
        tangents = self.values[:, ::2] if is_cubic else self.values[:0]
        return len(at_keys) > 1 and bool((at_keys[1:] != at_keys[:-1]).any() or tangents.any())

    @property
    def interpolations(self) -> set[str]:
        """All interpolations of the channel's values."""
        return {self.interpolation}

    @property
    def is_linear_motion(self) -> bool:
        """Whether points moved by this channel alone move linearly in time between keys."""
        return self.interpolation == "LINEAR" and self.name in ("translation", "weights")

    @property
    def is_cache(self) -> bool:
        """Whether every key shows another morph target alone: a shape per frame, as mixseq and others store caches."""
        if self.name != "weights" or self.interpolation != "LINEAR" or min(self.values.shape) < 2:
            return False
        shows_one = ((self.values == 0) | (self.values == 1)).all() and (self.values.sum(axis=1) <= 1).all()
        return bool(shows_one) and len(np.unique(self.values, axis=0)) >= max(len(self.values) - 1, 3)

    def evaluate(self, times: Float) -> Float:
        """Return the values ``(B, k)`` at times ``(B,)`` in s, constant before the first key and after the last."""
        after = np.clip(np.searchsorted(self.times, times, side="right"), 1, max(len(self.times) - 1, 1))
        before, after = after - 1, np.minimum(after, len(self.times) - 1)
        step = self.times[after] - self.times[before]
        s = np.clip((times - self.times[before]) / np.where(step > 0, step, 1.0), 0.0, 1.0)[:, None]
        first, second = self.values[before].astype(np.float64), self.values[after].astype(np.float64)
        if self.interpolation == "STEP":
            # A frame time may be slightly before the float32 key of the same frame.
            is_at_key = (s > 0) & ((self.times[after] - times)[:, None] <= time_tolerance(times)[:, None])
            return np.where((s < 1) & ~is_at_key, first, second)
        if self.interpolation == "CUBICSPLINE":
            step = step[:, None]
            return hermite(first[:, 1], step * first[:, 2], second[:, 1], step * second[:, 0], s)
        if self.name == "rotation":
            return slerp(first, second, s)
        return (1 - s) * first + s * second


@dataclass(frozen=True, eq=False)
class SeparateWeights(Channel):
    """Channel of all morph weights of a node, some of which have channels of their own."""

    still: Float  # (k,), all weights without animation
    tracks: Mapping[int, Channel]  # by number of the weight

    @property
    def is_animated(self) -> bool:
        """Whether a weight changes over time."""
        return any(each.is_animated for each in self.tracks.values())

    @property
    def interpolations(self) -> set[str]:
        """Interpolations of all weights."""
        return {each.interpolation for each in self.tracks.values()}

    @property
    def is_linear_motion(self) -> bool:
        """Whether all weights change linearly between keys."""
        return self.interpolations == {"LINEAR"}

    def evaluate(self, times: Float) -> Float:
        """Return all weights ``(B, k)`` at times ``(B,)`` in s; see `Channel.evaluate`."""
        weights = np.tile(self.still, (len(times), 1))
        for number, track in self.tracks.items():
            weights[:, number] = track.evaluate(times)[:, 0]
        return weights


def hermite(a: Float, out_tangent: Float, b: Float, in_tangent: Float, s: Float) -> Float:
    """Evaluate Hermite cubics from `a` to `b` ``(n, k)`` at `s` ``(n, 1)``, with tangents per key interval."""
    return (
        (2 * s**3 - 3 * s**2 + 1) * a
        + (s**3 - 2 * s**2 + s) * out_tangent
        + (3 * s**2 - 2 * s**3) * b
        + (s**3 - s**2) * in_tangent
    )


def evaluate_pose(channels: Collection[Channel], times: Float, step_times: Float | None = None) -> Pose:
    """Return the animated values at times ``(B,)`` in s, of stepped channels at `step_times` if given."""
    return {
        (channel.node, channel.name): channel.evaluate(
            times if step_times is None or channel.interpolation != "STEP" else step_times
        )
        for channel in channels
    }


def choose_animation(document: Document, choice: str | int | None) -> Fields | None:
    """Return the animation with a name or index, by default the first; None for `NO_ANIMATION` or if the file has none.

    Names may omit a prefix that ends in "|", as in ``AnimalArmature|Gallop``. An animation named "none" has precedence.
    """
    animations = document.items("animations")
    names = [each.text("name") or f"animation {index}" for index, each in enumerate(animations)]
    if choice is None:
        if len(animations) > 1:
            warn(
                f"{document.path}: of {len(names)} animations the first, {names[0]!r}, is read; the option animation "
                f"(--animation on the command line) chooses another one: {_format_numbered(names, 1)}"
            )
        return animations[0] if animations else None
    if choice in names:
        return animations[names.index(str(choice))]
    digits = str(choice)
    if digits.isdecimal() and len(digits) < 10 and int(digits) < len(animations):
        return animations[int(digits)]
    matching = [index for index, name in enumerate(names) if name.endswith(f"|{choice}")]
    if len(matching) == 1:
        return animations[matching[0]]
    if choice == NO_ANIMATION:
        return None
    raise SettingsError(
        f"{document.path} has {'several animations' if matching else 'no animation'} {choice!r}; "
        f"there are {_format_numbered(names) or 'none'}"
    )


def animation_choices(path: Path) -> dict[str, str]:
    """Return the choice of every animation by a part of file names, which is empty for a single unnamed one."""
    names = [each.text("name") for each in load_document(path).items("animations")]
    if names == [""]:
        return {"": "0"}
    choices: dict[str, str] = {}
    for index, name in enumerate(names):
        tail = name.rpartition("|")[2]
        is_unique = [other.rpartition("|")[2] for other in names].count(tail) == 1
        label = re.sub(r"[^\w.-]+", "_", tail if is_unique else name).strip("._") or f"animation_{index}"
        if label.casefold() in map(str.casefold, choices):
            label = f"{label}_{index}"
        choices[label] = name if name and names.count(name) == 1 else str(index)
    return choices


def _format_numbered(names: Sequence[str], first: int = 0) -> str:
    """Format the names from index `first` on with their indices for a message: "1 'Dance', 2 'Death'"."""
    return format_names([f"{index} {name!r}" for index, name in enumerate(names)][first:], str)


def read_extra_number(animation: Fields | None, name: str, above: float = -_MAX_EXTRA_NUMBER) -> float | None:
    """Return a number in an animation's ``extras``, such as "fps" or "start", or None unless it exceeds `above`."""
    extras = {} if animation is None else animation.values.get("extras")
    value = extras.get(name) if isinstance(extras, dict) else None
    if not isinstance(value, int | float) or isinstance(value, bool):
        return None
    return float(value) if above < value < _MAX_EXTRA_NUMBER else None


def read_channels(
    document: Document, animation: Fields | None, nodes: Collection[int], errors: dict[int, MixseqError] | None = None
) -> list[Channel]:
    """Read the channels of an animation that target the given nodes; add errors to `errors` by node, or raise them."""
    if animation is None:
        return []
    samplers = animation.objects("samplers")
    channels: dict[tuple[int, str], Channel] = {}
    tracks: defaultdict[int, dict[int, Channel]] = defaultdict(dict)
    with_mesh = {index for index, each in enumerate(document.items("nodes")) if "mesh" in each}
    missing, numbers = [], 0
    for fields in animation.objects("channels"):
        target = fields.object("target")
        node, name = target.index("node"), target.text("path")
        pointer = target.object("extensions").object(POINTER_EXTENSION).text("pointer")
        name, _, weight = name.partition("/")
        is_known = name in _PROPERTY_WIDTHS or (name == "weights" and node in with_mesh)
        if node is None or not is_known or node >= len(document.items("nodes")):
            missing.append(pointer or f"{fields.place} ({name})")
            continue
        if node not in nodes:
            continue
        try:
            channel = _read_channel(document, fields, node, name, samplers)
        except MixseqError as error:
            if errors is None:
                raise
            errors[node] = error
            continue
        numbers += channel.times.size + channel.values.size
        document.check_effort(numbers, animation.place)
        if weight:
            tracks[node][int(weight)] = channel
        else:
            channels[node, name] = channel
    for node, own_tracks in tracks.items():
        channels[node, "weights"] = _join_tracks(document, node, own_tracks)
    if missing:
        warn(
            f"{document.path}: {len(missing)} channels are left out, as they animate no transform or weights of a node "
            f"of the file: {format_names(missing)}"
        )
    return list(channels.values())


def _join_tracks(document: Document, node: int, tracks: Mapping[int, Channel]) -> SeparateWeights:
    """Join the channels of single morph weights of a node."""
    fields = document.item("nodes", node)
    primitives = document.item("meshes", fields.integer("mesh")).objects("primitives")
    count = max((len(each.objects("targets")) for each in primitives), default=0)
    wrong = [number for number, track in tracks.items() if number >= count or track.values.shape[-1] != 1]
    if wrong:
        raise fields.error(f"has {count} morph targets, but weight {wrong[0]} is animated, or has several values")
    times = merge_key_times(each.times for each in tracks.values())
    is_stepped = all(each.interpolation == "STEP" for each in tracks.values())
    still = _read_still_weights(document, fields, count)
    joined = SeparateWeights(
        node, "weights", times, still.astype(np.float32), "STEP" if is_stepped else "LINEAR", still, tracks
    )
    return replace(joined, values=joined.evaluate(times).astype(np.float32))


def _read_still_weights(document: Document, node: Fields, count: int) -> Float:
    """Return the morph weights ``(k,)`` of a node without animation."""
    owner = node if "weights" in node else document.item("meshes", node.integer("mesh"))
    weights = owner.numbers("weights", count) if count else None
    return np.zeros(count) if weights is None else weights


def _read_channel(document: Document, fields: Fields, node: int, name: str, samplers: Sequence[Fields]) -> Channel:
    index = fields.integer("sampler")
    if index >= len(samplers):
        raise fields.error(f"has sampler {index} of {len(samplers)}; the file is damaged")
    sampler = samplers[index]
    interpolation = sampler.text("interpolation", "LINEAR")
    if interpolation not in _INTERPOLATIONS:
        raise sampler.error(f"has the interpolation {interpolation[:40]!r}; one of {_INTERPOLATIONS} is expected")
    times = document.accessor(sampler.integer("input")).astype(np.float64)
    values = document.accessor(sampler.integer("output"))
    if times.ndim != 1 or not times.size or not np.isfinite(times).all() or (np.diff(times) <= 0).any():
        raise sampler.error("has times that do not increase; the file is damaged")
    if not np.isfinite(values).all():
        raise sampler.error("has values that are not finite; the file is damaged")
    is_cubic = interpolation == "CUBICSPLINE"
    count = (3 if is_cubic else 1) * times.size
    per_value, rest = divmod(values.size, count)
    width = _PROPERTY_WIDTHS.get(name, per_value)
    if rest or per_value != width or values.ndim != (1 if name == "weights" else 2):
        raise sampler.error(
            f"has {values.size} values for {times.size} keys of {name} ({interpolation}); "
            f"{count} times {width or 'the number of weights'} are expected"
        )
    shape = (times.size, 3, width) if is_cubic else (times.size, width)
    return Channel(node, name, times, values.reshape(shape), interpolation)


@dataclass(frozen=True, eq=False)
class MeshSkin:
    """Skin of J joint nodes: weights ``(W, J)`` with row sums 1; matrices ``(J, 4, 4)`` from mesh to joint space."""

    joints: Sequence[int]
    inverse_binds: Float
    weights: csr_array

    def joint_matrices(self, world: Mapping[int, Float]) -> Float:
        """Return the matrices ``(B, J, 4, 4)`` from mesh space to the posed world space of each joint."""
        joints = np.broadcast_arrays(*(world[joint] for joint in self.joints))
        return np.stack(joints, axis=1) @ self.inverse_binds


@dataclass(frozen=True, eq=False)
class MeshNode:
    """Node with a welded mesh: rest points ``(W, 3)``, morph weights ``(K,)``, and a skin in place of its transform."""

    scene: Scene
    node: int
    weld: Weld
    rest: Float
    weights: Float
    skin: MeshSkin | None

    @property
    def transform_nodes(self) -> Sequence[int]:
        """Nodes whose matrices move the mesh."""
        return [self.node] if self.skin is None else self.skin.joints

    def orientation(self, world: Mapping[int, Float]) -> Float:
        """Return the orientation per frame ``(B,)`` by majority of the joints: 1 unmirrored, -1 mirrored, 0 flat."""
        if self.skin is None:
            return _determinant_signs(world[self.node])
        used = np.unique(self.skin.weights.indices)
        matrices = self.skin.joint_matrices(world)
        return np.asarray(np.sign(_determinant_signs(matrices[:, used]).sum(axis=1)))

    def world_points(self, pose: Pose, world: Mapping[int, Float], frame_count: int) -> FloatArray:
        """Return the world-space points ``(B, W, 3)`` of B frames, given the world matrices of `transform_nodes`."""
        morphed = self._morph(pose, frame_count)
        if self.skin is None:
            matrices = np.broadcast_to(world[self.node], (frame_count, 4, 4))
            return morphed @ matrices[:, :3, :3].transpose(0, 2, 1) + matrices[:, None, :3, 3]
        joints = self.skin.joint_matrices(world)[:, :, :3].reshape(-1, len(self.skin.joints), 12)
        joints = np.broadcast_to(joints, (frame_count, *joints.shape[1:]))
        return np.stack(
            [
                _blend_linearly(points, matrices, self.skin.weights)
                for points, matrices in zip(morphed, joints, strict=True)
            ]
        )

    def _morph(self, pose: Pose, frame_count: int) -> Float:
        points = np.tile(self.rest, (frame_count, 1, 1))
        weights = pose.get((self.node, "weights"), self.weights)
        weights = np.broadcast_to(weights, (frame_count, len(self.weights)))
        for target in np.flatnonzero(weights.any(axis=0)):
            frames = np.flatnonzero(weights[:, target])
            deltas = read_deltas(self.weld.primitives, int(target))[self.weld.representatives]
            points[frames] += weights[frames, target, None, None] * deltas
        return points


def _determinant_signs(matrices: Float) -> Float:
    return np.asarray(np.nan_to_num(np.sign(np.linalg.det(matrices[..., :3, :3]))))


def _blend_linearly(points: Float, matrices: Float, weights: csr_array) -> Float:
    """Return points ``(W, 3)`` after linear blend skinning by joint matrices ``(J, 12)`` with weights ``(W, J)``."""
    blended = (weights @ matrices).reshape(-1, 3, 4)
    return np.asarray(np.einsum("vij,vj->vi", blended[:, :, :3], points) + blended[:, :, 3])


def read_mesh_node(scene: Scene, node: int, weld: Weld) -> MeshNode:
    """Read a node with a welded mesh."""
    document, fields = scene.document, scene.nodes[node]
    positions = np.concatenate([each.positions for each in weld.primitives]).astype(np.float64)
    skin = fields.index("skin")
    return MeshNode(
        scene=scene,
        node=node,
        weld=weld,
        rest=positions[weld.representatives],
        weights=_read_still_weights(document, fields, count_targets(weld.primitives)),
        skin=None if skin is None else _read_skin(scene, document.item("skins", skin), weld),
    )


def _read_skin(scene: Scene, fields: Fields, weld: Weld) -> MeshSkin:
    nodes = scene.joints(fields)
    inverse_binds = read_inverse_binds(scene.document, fields, len(nodes))
    joints, weights = read_influences(weld.primitives)
    if not joints.size:
        raise fields.error("moves a mesh that has no JOINTS_0 and WEIGHTS_0; the file is damaged")
    if joints.max() >= len(nodes):
        raise fields.error(f"has {len(nodes)} joints, but vertices follow joint {joints.max()}; the file is damaged")
    kept = weld.representatives
    return MeshSkin(nodes, inverse_binds, _normalise_weights(joints[kept], weights[kept], len(nodes)))


def read_inverse_binds(document: Document, skin: Fields, count: int) -> Float:
    """Return a skin's inverse bind matrices ``(J, 4, 4)`` from mesh space to each of its `count` joints."""
    binds = skin.index("inverseBindMatrices")
    if binds is None:
        return np.tile(np.eye(4), (count, 1, 1))
    matrices = document.accessor(binds)
    if matrices.ndim != 2 or matrices.shape[1] != 16 or len(matrices) < count:
        raise skin.error(f"has {count} joints, but inverse bind matrices of shape {matrices.shape}")
    return matrices[:count].reshape(-1, 4, 4).transpose(0, 2, 1).astype(np.float64)


def _normalise_weights(joints: Index, weights: Float, joint_count: int) -> csr_array:
    """Return weights ``(W, J)`` with row sums 1, as in renderers; unweighted vertices get the first joint."""
    vertex_count, per_vertex = weights.shape
    sums = weights.sum(axis=1, keepdims=True)
    weights = np.where(sums != 0, weights / np.where(sums != 0, sums, 1), np.arange(per_vertex) == 0)
    rows = np.repeat(np.arange(vertex_count), per_vertex)
    matrix = csr_array((weights.reshape(-1), (rows, joints.reshape(-1))), shape=(vertex_count, joint_count))
    matrix.eliminate_zeros()
    return matrix
