"""Messages of a page to viser: a few kinds, checked, at a limited rate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from time import monotonic
from typing import Annotated, Any

import msgspec

LARGEST = 2**20
"""Largest message, in bytes; a stroke of the pen has some 200,000."""

Number = Annotated[float, msgspec.Meta(ge=-1e15, le=1e15)]
Pixels = Annotated[float, msgspec.Meta(ge=1, le=1e6)]
Text = Annotated[str, msgspec.Meta(max_length=200)]
Pair = tuple[Number, Number]
Triple = tuple[Number, Number, Number]
Value = bool | Number | str | Annotated[list[Number], msgspec.Meta(max_length=16)]


class Said(msgspec.Struct, tag_field="type", forbid_unknown_fields=True):
    """A message of a page; viser's other kinds (uploads, tunnels, images) are rejected."""


class Camera(Said, tag="ViewerCameraMessage"):
    """The view of the scene."""

    wxyz: tuple[Number, Number, Number, Number]
    position: Triple
    fov: Number
    near: Number
    far: Number
    image_height: Pixels
    image_width: Pixels
    look_at: Triple
    up_direction: Triple


class Click(Said, tag="SceneNodeClickMessage"):
    """A mesh was clicked."""

    name: Text
    instance_index: int | None
    ray_origin: Triple
    ray_direction: Triple
    screen_pos: Pair
    modifier: Text | None = None
    owner: Text = ""


class Command(Said, tag="CommandTriggerMessage"):
    """A key was pressed."""

    uuid: Text


class NewValue(msgspec.Struct, forbid_unknown_fields=True):
    """The new value of a control, without other properties."""

    value: Value


class Change(Said, tag="GuiUpdateMessage"):
    """A control was used."""

    uuid: Text
    updates: NewValue


_DECODER = msgspec.msgpack.Decoder(Camera | Click | Command | Change)
_ENCODER = msgspec.msgpack.Encoder()


def checked_message(raw: bytes | str, controls: Mapping[str, Any]) -> bytes | None:
    """Validate a message and encode it for viser; None to ignore it, ValueError if it is bad."""
    if isinstance(raw, str):
        raise ValueError("text, where bytes are expected")
    try:
        said = _DECODER.decode(raw)
    except (msgspec.DecodeError, RecursionError, UnicodeDecodeError) as error:
        raise ValueError(str(error)) from None
    if isinstance(said, Change):
        if said.uuid not in controls:
            raise ValueError("there is no such control")
        state = controls[said.uuid]._impl
        _check_kind(said.updates.value, state.value, getattr(state.props, "options", None))
        if not _in_range(said.updates.value, state.props):
            return None
    return _ENCODER.encode(said)


def _check_kind(value: Any, before: Any, options: Any) -> None:
    """Raise ValueError for a value of a wrong type for a control."""
    if isinstance(before, bool):
        fits = isinstance(value, bool)
    elif isinstance(before, int | float):
        fits = isinstance(value, float)
    elif isinstance(before, tuple):
        fits = isinstance(value, list) and len(value) == len(before)
    else:
        fits = isinstance(before, str) and isinstance(value, str)
    if not fits:
        raise ValueError("a control cannot have this kind of value")
    if options is not None and value not in options:
        raise ValueError("a control has no such option")


def _in_range(value: Any, props: Any) -> bool:
    low, high = getattr(props, "min", None), getattr(props, "max", None)
    if isinstance(value, str | bool):
        return True
    numbers = value if isinstance(value, list) else [value]
    slack = 1e-9 * max(1.0, *map(abs, numbers)) if numbers else 0.0
    return all(
        (low is None or each >= low - slack) and (high is None or each <= high + slack) for each in numbers
    )


@dataclass
class Rate:
    """A token bucket: events per second, and in a burst."""

    persecond: float
    atonce: float
    _left: float = field(init=False)
    _when: float = field(init=False)

    def __post_init__(self) -> None:
        self._left, self._when = self.atonce, monotonic()

    def wait(self) -> float:
        """Count an event, and return the seconds by which it is early."""
        now = monotonic()
        self._left = min(self.atonce, self._left + (now - self._when) * self.persecond) - 1
        self._when = now
        return max(0.0, -self._left / self.persecond)

    def spare(self) -> bool:
        """Whether another event is allowed; only then it is counted."""
        if self.wait() > 0:
            self._left += 1
            return False
        return True
