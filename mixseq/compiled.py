"""Inner loops, compiled by numba when they are first called, and kept on disk for the next run.

Compiled functions release the interpreter's lock and add in the order in which they are written, so that their
results have the same bits on any number of threads. Division by zero gives infinity, as in NumPy.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(function: Function) -> Function:
    """Compile a function of arrays and numbers."""
    try:
        return cast(Function, numba.njit(nogil=True, cache=True, error_model="numpy")(function))
    except RuntimeError:  # there is no folder to keep it in: it is compiled in every run
        return cast(Function, numba.njit(nogil=True, error_model="numpy")(function))


def inlined(function: Function) -> Function:
    """Compile a function into those that call it."""
    return cast(Function, numba.njit(inline="always", error_model="numpy")(function))
