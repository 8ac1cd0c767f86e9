"""Pose a model by handles in the viewer: vertices that are dragged or pinned, a preview of the pose, and the edit.

A *pending* pose belongs to one time. The body follows every step of a drag: `mixseq.operations.handles.DraggedPose` is
made when the set of handles changes, and solves each pose from the one before. `PoseTool.apply` makes the pose an edit
of the session by `mixseq.operations.pose`, as a script does.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import partial
from typing import Any

import numpy as np

from mixseq.errors import SettingsError
from mixseq.operations.handles import DraggedPose, Handle, pose
from mixseq.signals.bodies import Body
from mixseq.signals.model import Model
from mixseq.types import Float
from mixseq.viewer.session import Session


@dataclass(frozen=True, eq=False)
class PosedModel(Model):
    """A model while handles are dragged: at one time, its points are given."""

    posed: tuple[float, Float] | None = None  # a time, and points (V, 3)

    def alone_as(self, body: Body) -> Model:
        """Return the model of another body alone, whose points are not given."""
        return Model(**_signals(super().alone_as(body)))

    def decode_points(self, times: Float) -> Float:
        """Implement `Decodable.decode_points`."""
        if self.posed is not None and times.tolist() == [self.posed[0]]:
            return self.posed[1][None]
        return super().decode_points(times)


def _signals(model: Model) -> dict[str, Any]:
    return {each.name: getattr(model, each.name) for each in fields(Model)}


@dataclass(frozen=True)
class PendingPose:
    """Immutable handles of a pose that is not applied yet."""

    time: float = 0.0  # time of the dragged handles in seconds
    # Target (3,) of every dragged vertex in the units of the sequence; None for pinned vertices, which stay.
    targets: Mapping[int, Float | None] = field(default_factory=dict)
    is_exact: bool = False

    @property
    def pins(self) -> list[int]:
        """Pinned vertices."""
        return [vertex for vertex, target in self.targets.items() if target is None]

    @property
    def handles(self) -> list[Handle]:
        """Handles of the dragged vertices."""
        return [Handle(self.time, target, vertex) for vertex, target in self.targets.items() if target is not None]

    def __str__(self) -> str:
        counts = (len(self.handles), "handle"), (len(self.pins), "pin")
        return ", ".join(f"{count} {name}{'s' * (count > 1)}" for count, name in counts if count)


class PoseTool:
    """Pose of a session's model by handles."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._dragged: tuple[Any, DraggedPose] | None = None  # what it was made of
        self.pending = PendingPose()

    def check(self) -> None:
        """Raise `SettingsError` if the model cannot be posed by handles."""
        model = self._session.model
        DraggedPose(model, [Handle(model.start, np.zeros(3), 0)])

    def toggle(self, vertex: int) -> None:
        """Pin a vertex, or remove its pin or handle."""
        targets = dict(self.pending.targets)
        if vertex in targets:
            del targets[vertex]
        else:
            targets[vertex] = None
        self._change(replace(self.pending, targets=targets))

    def drag(self, vertex: int, target: Float, time: float) -> None:
        """Move a vertex to a target ``(3,)`` at a time; raise `SettingsError` if a pose of another time is pending."""
        if self.pending.handles and self.pending.time != time:
            raise SettingsError(f"the pose at {self.pending.time:g} s is not applied yet; press Enter or Esc first")
        self._change(replace(self.pending, time=time, targets={**self.pending.targets, vertex: target}))

    def set_exact(self, is_exact: bool) -> None:
        """Set whether the mesh is deformed so that all handles reach their targets."""
        self._change(replace(self.pending, is_exact=is_exact))

    def apply(self, fade: float) -> None:
        """Make the pose an edit, which fades in and out in some seconds, if there is one."""
        done, self.pending = self.pending, PendingPose(is_exact=self.pending.is_exact)
        if done.handles:
            seconds = None if len(self._session.model.times) == 1 else fade  # a still has no motion to fade into
            edit = partial(pose, handles=done.handles, keep=done.pins, fade=seconds, exact=done.is_exact)
            self._session.edit("pose", edit)

    def cancel(self) -> bool:
        """Remove all handles and pins; return False if there are none."""
        is_pending = bool(self.pending.targets)
        self._change(PendingPose(is_exact=self.pending.is_exact))
        return is_pending

    def show(self) -> None:
        """Show the pending pose again, after the session has shown something else."""
        if self.pending.handles:
            self._session.edit("pose", partial(self._preview, self.pending), preview=True)

    def _change(self, pending: PendingPose) -> None:
        had_handles, self.pending = bool(self.pending.handles), pending
        if pending.handles:
            self.show()
        elif had_handles:
            self._session.discard_preview()

    def _preview(self, pending: PendingPose, model: Model) -> Model:
        """Return the model with the pending pose at its time."""
        handles = pending.handles
        key = model, pending.time, [handle.vertex for handle in handles], pending.pins, pending.is_exact
        if self._dragged is None or self._dragged[0] != key:
            self._dragged = key, DraggedPose(model, handles, pending.pins, pending.is_exact)
        dragged = self._dragged[1]
        points = dragged.points(np.array([handle.position for handle in handles]))
        shown = dragged.moved_model() if model.bodies else model
        return PosedModel(**_signals(shown), posed=(pending.time, points))
