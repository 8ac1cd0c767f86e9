"""Pickles of objects that remember what they computed: only what they were made of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from typing import Any, TypeVar

Made = TypeVar("Made")


class PickledWithoutCaches:
    """A dataclass that is pickled as its fields, and made of them again.

    What it computed and kept (cached properties) stays behind: it is large, parts of it, such as factored matrices,
    cannot be pickled, and it follows from the fields.
    """

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return _made, (type(self), {field.name: getattr(self, field.name) for field in fields(self)})  # type: ignore[arg-type]


def _made(kind: Callable[..., Made], settings: dict[str, Any]) -> Made:
    return kind(**settings)
