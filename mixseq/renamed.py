"""Old names of parameters, which work for one more version."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

from mixseq.errors import SettingsError

P = ParamSpec("P")
R = TypeVar("R")


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
