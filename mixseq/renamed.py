"""Old names of parameters, attributes and of what modules have, which work for one more version."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import wraps
from importlib import import_module
from typing import Any, ParamSpec, TypeVar

from mixseq.errors import SettingsError

P = ParamSpec("P")
R = TypeVar("R")
C = TypeVar("C", bound=type)


def renamed(**names: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Let a function take parameters by their old names, with a warning that tells the new ones.

    Examples
    --------
    >>> @renamed(colour="color")
    ... def paint(color="red"):
    ...     return color
    >>> with warnings.catch_warnings(record=True) as told:
    ...     warnings.simplefilter("always")
    ...     paint(colour="blue"), str(told[0].message)
    ('blue', 'paint: colour is now color')
    """

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        @wraps(function)
        def call(*args: P.args, **kwargs: P.kwargs) -> R:
            for old in names.keys() & kwargs.keys():
                new = names[old]
                if new in kwargs:
                    raise SettingsError(f"{old} is now {new}; leave out {old}")
                warnings.warn(f"{function.__name__}: {old} is now {new}", DeprecationWarning, stacklevel=2)
                kwargs[new] = kwargs.pop(old)
            return function(*args, **kwargs)

        return call

    return decorate


def renamed_attributes(**names: str) -> Callable[[C], C]:
    """Let a data class be made and read by the old names of its attributes, with a warning that tells the new ones."""

    def decorate(cls: C) -> C:
        made: Callable[..., None] = cls.__init__  # type: ignore[misc]

        @wraps(made)
        def make(self: object, *args: Any, **kwargs: Any) -> None:
            for old in names.keys() & kwargs.keys():
                _tell(cls, old)
                kwargs[names[old]] = kwargs.pop(old)  # `dataclasses.replace` gives the new name, too
            made(self, *args, **kwargs)

        def read(old: str) -> property:
            def get(self: object) -> Any:
                _tell(cls, old)
                return getattr(self, names[old])

            return property(get)

        def _tell(cls: type, old: str) -> None:
            warnings.warn(f"{cls.__name__}: {old} is now {names[old]}", DeprecationWarning, stacklevel=3)

        cls.__init__ = make  # type: ignore[misc]
        for old in names:
            setattr(cls, old, read(old))
        return cls

    return decorate


def moved(module: str, **names: str) -> Callable[[str], Any]:
    """Return a ``__getattr__`` for a module whose names are elsewhere now, each as ``"package.module:name"``.

    Examples
    --------
    >>> find = moved("mixseq.sequence", read_sequence="mixseq:read")
    >>> with warnings.catch_warnings(record=True) as told:
    ...     warnings.simplefilter("always")
    ...     find("read_sequence").__name__, str(told[0].message)
    ('read', 'mixseq.sequence.read_sequence is now mixseq.read')
    """

    def find(name: str) -> Any:
        if name not in names:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        where, _, new = names[name].partition(":")
        warnings.warn(f"{module}.{name} is now {where}.{new}", DeprecationWarning, stacklevel=2)
        return getattr(import_module(where), new)

    return find
