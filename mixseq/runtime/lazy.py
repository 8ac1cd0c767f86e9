"""Work at first use: cached results of dataclasses, and packages that import their names on demand.

Cached results are computed once, also if threads share an object, and are excluded from pickles.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Collection, Mapping
from functools import cached_property as _cached_property
from importlib import import_module
from threading import RLock
from typing import TYPE_CHECKING, Any, TypeVar

Instance = TypeVar("Instance")

if TYPE_CHECKING:
    cached_property = _cached_property
else:

    class cached_property(_cached_property):  # noqa: N801
        """A cached property that one thread computes while others wait; results, such as factors, may be large.

        Every property has a lock of its own: properties that use each other never wait for each other in a circle.
        """

        def __init__(self, function: Callable[[Any], Any]) -> None:
            super().__init__(function)
            self._lock = RLock()

        def __get__(self, instance: object, owner: type | None = None) -> Any:
            with self._lock:
                return super().__get__(instance, owner)


class PickledWithoutCaches:
    """A dataclass that is pickled as its fields, without cached properties, which may be large or not picklable."""

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        from dataclasses import fields  # slow to import

        return _from_fields, (type(self), {field.name: getattr(self, field.name) for field in fields(self)})  # type: ignore[arg-type]


def _from_fields(cls: Callable[..., Instance], values: dict[str, Any]) -> Instance:
    return cls(**values)


def lazy_getattr(package: str, modules: Mapping[str, str]) -> Callable[[str], Any]:
    """Return the ``__getattr__`` of a package that imports names from their `modules` at first use."""

    def find(name: str) -> Any:
        if name not in modules:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(import_module(modules[name]), name)
        setattr(sys.modules[package], name, value)
        return value

    return find


FindName = Callable[[str], Any]
ArgumentReader = Callable[[str, Collection[str]], Callable[[str, Mapping[str, Any]], Any] | None]

_connected: list[tuple[FindName, ArgumentReader]] = []


def connect(find_name: FindName, argument_reader: ArgumentReader) -> None:
    """Set the functions of the package `mixseq` that lower modules use without importing it.

    `find_name` returns a public object by its name, or raises AttributeError. `argument_reader` returns the reader for
    an argument with a name and type names; the reader is a function of a path and the other arguments.
    """
    _connected[:] = [(find_name, argument_reader)]


def connected() -> tuple[FindName, ArgumentReader]:
    """Return the functions set by `connect`."""
    return _connected[0]
