"""Dataclasses with cached results: computed ahead of threads that share them, and left out of pickles."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import fields
from typing import Any, Self, TypeVar

Made = TypeVar("Made")


class PickledWithoutCaches:
    """A dataclass that is pickled as its fields, without cached properties, which may be large or not picklable."""

    def constants(self) -> Iterable[object]:
        """Return the cached results, such as factored matrices."""
        return ()

    def prepared(self) -> Self:
        """Compute all `constants` recursively, before threads share the object, and return it."""
        for each in self.constants():
            if isinstance(each, PickledWithoutCaches):
                each.prepared()
        return self

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return _made, (type(self), {field.name: getattr(self, field.name) for field in fields(self)})  # type: ignore[arg-type]


def _made(kind: Callable[..., Made], settings: dict[str, Any]) -> Made:
    return kind(**settings)
