"""Undo and redo: the steps that made a model, and which of them is seen."""

from __future__ import annotations

from dataclasses import dataclass

from mixseq.signals import Model


@dataclass(frozen=True, eq=False)
class Step:
    """A model and what made it."""

    name: str  # what was done, such as repeat; that of the first step is empty
    model: Model  # what came of it
    # Of a retiming, its keys: times of the output and of the source, in seconds.
    keys: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True, eq=False)
class History:
    """Steps, and which of them is seen now; every change is a new history."""

    steps: tuple[Step, ...]  # the first is the model as it was opened
    now: int = 0  # which of them is seen

    @classmethod
    def of(cls, model: Model) -> History:
        """Begin with a model to which nothing was done."""
        return cls((Step("", model),))

    @property
    def model(self) -> Model:
        """The model that is seen."""
        return self.steps[self.now].model

    @property
    def changed(self) -> bool:
        """Whether it is another model than the one that was opened."""
        return self.now > 0

    def done(self, name: str, model: Model) -> History:
        """Return the history after an edit; what had been undone is gone."""
        return History((*self.steps[: self.now + 1], Step(name, model)), self.now + 1)

    @property
    def before_retiming(self) -> History:
        """The history without its last step if that is a retiming, so that keys can be moved again."""
        return self.undone() if self.steps[self.now].keys else self

    def retimed(self, model: Model, keys: tuple[tuple[float, float], ...]) -> History:
        """Return the history with a retiming of `before_retiming` as its last step."""
        before = self.before_retiming
        return History((*before.steps[: before.now + 1], Step("retime", model, keys)), before.now + 1)

    @property
    def undoes(self) -> str | None:
        """What `undone` undoes, if there is anything."""
        return self.steps[self.now].name if self.now else None

    @property
    def redoes(self) -> str | None:
        """What `redone` does again, if there is anything."""
        return self.steps[self.now + 1].name if self.now + 1 < len(self.steps) else None

    def undone(self) -> History:
        """Return the history one step back; at its begin as it is."""
        return History(self.steps, max(self.now - 1, 0))

    def redone(self) -> History:
        """Return the history one step ahead; at its end as it is."""
        return History(self.steps, min(self.now + 1, len(self.steps) - 1))
