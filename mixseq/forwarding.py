"""Packages whose names are imported when they are first used, so that who needs one of them does not wait for all."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


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
