"""Undo and redo: the edits of a model, and the current one."""

from __future__ import annotations

from dataclasses import dataclass

from mixseq.signals import Model


@dataclass(frozen=True, eq=False)
class Step:
    """A model and the edit that made it."""

    name: str  # what was done, such as repeat; that of the first step is empty
    model: Model  # what came of it
    # Of a retiming, its keys: times of the output and of the source, in seconds.
    keys: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True, eq=False)
class History:
    """Steps and the index of the current one; immutable."""

    steps: tuple[Step, ...]  # the first is the model as it was opened
    now: int = 0  # which of them is seen

    @classmethod
    def of(cls, model: Model) -> History:
        """Make the history of an unedited model."""
        return cls((Step("", model),))

    @property
    def model(self) -> Model:
        """The current model."""
        return self.steps[self.now].model

    @property
    def changed(self) -> bool:
        """Whether the current model is edited."""
        return self.now > 0

    def done(self, name: str, model: Model) -> History:
        """Return the history after an edit; undone steps are dropped."""
        return History((*self.steps[: self.now + 1], Step(name, model)), self.now + 1)

    @property
    def before_retiming(self) -> History:
        """The history without its last step if that is a retiming, so that its keys can be moved."""
        return self.undone() if self.steps[self.now].keys else self

    def retimed(self, model: Model, keys: tuple[tuple[float, float], ...]) -> History:
        """Return the history with a retiming of `before_retiming` as its last step."""
        before = self.before_retiming
        return History((*before.steps[: before.now + 1], Step("retime", model, keys)), before.now + 1)

    @property
    def undoes(self) -> str | None:
        """Name of the edit that `undone` undoes, if any."""
        return self.steps[self.now].name if self.now else None

    @property
    def redoes(self) -> str | None:
        """Name of the edit that `redone` redoes, if any."""
        return self.steps[self.now + 1].name if self.now + 1 < len(self.steps) else None

    def undone(self) -> History:
        """Return the history one step back, or unchanged at its start."""
        return History(self.steps, max(self.now - 1, 0))

    def redone(self) -> History:
        """Return the history one step ahead, or unchanged at its end."""
        return History(self.steps, min(self.now + 1, len(self.steps) - 1))
