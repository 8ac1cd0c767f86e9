"""Objects that compute some of what they know once: ahead of threads that share it, and left out of their pickles."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import fields
from typing import Any, Self, TypeVar

Made = TypeVar("Made")


class PickledWithoutCaches:
    """A dataclass that is pickled as its fields, and made of them again.

    What it computed and kept (cached properties) stays behind: it is large, parts of it, such as factored matrices,
    cannot be pickled, and it follows from the fields.
    """

    def constants(self) -> Iterable[object]:
        """Return what is computed once and used again and again, such as factored matrices."""
        return ()

    def prepared(self) -> Self:
        """Compute all `constants`, and theirs, so that threads that share the object do not all do so; return it."""
        for each in self.constants():
            if isinstance(each, PickledWithoutCaches):
                each.prepared()
        return self

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return _made, (type(self), {field.name: getattr(self, field.name) for field in fields(self)})  # type: ignore[arg-type]


def _made(kind: Callable[..., Made], settings: dict[str, Any]) -> Made:
    return kind(**settings)
