"""Packages whose names are imported when they are first used, so that who needs one of them does not wait for all."""

from __future__ import annotations

import sys
from collections.abc import Callable, Collection, Mapping
from importlib import import_module
from typing import Any, NamedTuple


def forwarded(package: str, homes: Mapping[str, str]) -> Callable[[str], Any]:
    """Return the ``__getattr__`` of a package whose names are in the modules that `homes` tells.

    Examples
    --------
    >>> find = forwarded(__name__, {"sqrt": "math"})
    >>> find("sqrt")(9)
    3.0
    >>> find("root")
    Traceback (most recent call last):
    ...
    AttributeError: module 'mixseq.forwarding' has no attribute 'root'
    """

    def find(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        found = getattr(import_module(homes[name]), name)
        setattr(sys.modules[package], name, found)
        return found

    return find


class Facade(NamedTuple):
    """The package above all others: its public names, and its readers of files in the place of arguments."""

    find: Callable[[str], Any]
    """Return a public object by its name; raises AttributeError."""
    reader_of: Callable[[str, Collection[str]], Callable[[str, Mapping[str, Any]], Any] | None]
    """Return the reader for an argument, by its name and its types' names: from path and other arguments to value."""


_facade: list[Facade] = []


def connect(facade: Facade) -> None:
    """Set the facade that `connected` returns."""
    _facade[:] = [facade]


def connected() -> Facade:
    """Return the facade, which the package `mixseq` sets: modules below it do not import it."""
    return _facade[0]
