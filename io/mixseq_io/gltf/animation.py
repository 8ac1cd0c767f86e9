"""Animations of a glTF file: properties of nodes over time.

Specification: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html#appendix-c-interpolation
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import SettingsError
from mixseq_io.blocks import warn
from mixseq_io.gltf.document import Document
from mixseq_io.gltf.frame_times import time_tolerance
from mixseq_io.gltf.json_fields import Fields
from mixseq_io.gltf.node_tree import Pose

_WIDTHS = {"translation": 3, "rotation": 4, "scale": 3}
_INTERPOLATIONS = ("LINEAR", "STEP", "CUBICSPLINE")
NO_ANIMATION = "none"
"""Choice of animation that reads the nodes without any, mostly at rest."""

_LONGEST_LIST = 20
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
    shown = [f"{number} {name!r}" for number, name in enumerate(names)][first : first + _LONGEST_LIST]
    more = len(names) - first - _LONGEST_LIST
    return ", ".join(shown) + (f" and {more} more" if more > 0 else "")


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
