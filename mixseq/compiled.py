"""Inner loops, compiled by numba when they are first called, and kept on disk for the next run.

Compiled functions release the interpreter's lock and add in the order in which they are written, so that their
results have the same bits on any number of threads. Division by zero gives infinity, as in NumPy. Nobody calls them
from C: without an entry for that they compile in about two thirds of the time.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
import numpy as np

Function = TypeVar("Function", bound=Callable[..., Any])

_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}


def compiled(function: Function) -> Function:
    """Compile a function of arrays and numbers."""
    try:
        return cast(Function, numba.njit(cache=True, **_OPTIONS)(function))
    except RuntimeError:  # there is no folder to keep it in: it is compiled in every run
        return cast(Function, numba.njit(**_OPTIONS)(function))


def inlined(function: Function) -> Function:
    """Compile a function into those that call it."""
    return cast(Function, numba.njit(inline="always", error_model="numpy")(function))


def constant(number: int) -> int:
    """Return a number for arguments of compiled functions: of each literal, they would compile a version of its own."""
    return cast(int, np.int64(number))
