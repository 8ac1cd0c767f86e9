"""Work at first use: cached results of dataclasses, and packages whose names are imported when they are needed.

Caches are computed ahead of threads that share an object, and left out of pickles.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import fields
from importlib import import_module
from typing import Any, NamedTuple, Self, TypeVar

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


def forwarded(package: str, homes: Mapping[str, str]) -> Callable[[str], Any]:
    """Return the ``__getattr__`` of a package, with the modules of its names from `homes`."""

    def find(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        found = getattr(import_module(homes[name]), name)
        setattr(sys.modules[package], name, found)
        return found

    return find


class Facade(NamedTuple):
    """The top package: its public names, and readers of files for arguments."""

    find: Callable[[str], Any]
    """Return a public object by its name; raises AttributeError."""
    argument_reader: Callable[[str, Collection[str]], Callable[[str, Mapping[str, Any]], Any] | None]
    """Return the reader for an argument by its name and type names: a function of a path and the other arguments."""


_facade: list[Facade] = []


def connect(facade: Facade) -> None:
    """Set the facade that `connected` returns."""
    _facade[:] = [facade]


def connected() -> Facade:
    """Return the facade set by the package `mixseq`, which lower modules do not import."""
    return _facade[0]
