"""Inner loops, compiled by numba on first call and cached on disk.

Compiled functions release the interpreter's lock and add in source order, so results are bitwise independent of the
number of threads. Division by zero gives infinity, as in NumPy. Without an entry point for C they compile in about two
thirds of the time.

If the cache on disk is damaged, or cannot be written, functions are compiled again, with a warning.

Signals are deferred while functions are loaded, saved and return results: numba does not check whether the Python
code it calls failed, llvmlite frees twice what was interrupted, and a file half written would stay.
"""

from __future__ import annotations

import pickle
import warnings
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core.caching import CompileResultCacheImpl, FunctionCache
from numba.core.runtime.nrt import rtsys
from numba.core.serialize import _numba_unpickle
from numba.core.types import unliteral

from mixseq.errors import MixseqWarning
from mixseq.runtime.interrupts import unbroken

unbroken(_numba_unpickle)

Function = TypeVar("Function", bound=Callable[..., Any])

_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}

_DAMAGE = (pickle.UnpicklingError, EOFError, AttributeError, ImportError, LookupError, TypeError, ValueError)
"""Exceptions raised by damaged pickles."""


def compiled(function: Function) -> Function:
    """Compile a function of arrays and numbers."""
    made = numba.njit(**_OPTIONS)(function)
    if made is function:  # NUMBA_DISABLE_JIT
        return function
    made.get_call_template = partial(_as_any_number, made.get_call_template)
    with suppress(RuntimeError):  # there is no folder to keep it in: it is compiled in every run
        made._cache = _Cache(function)  # type: ignore[no-untyped-call]
    return cast(Function, made)


def inlined(function: Function) -> Function:
    """Compile a function that numba inlines into its callers."""
    return cast(Function, numba.njit(inline="always", error_model="numpy")(function))


def joined(function: Function) -> Function:
    """Compile a function that LLVM inlines into its callers: faster than `inlined`, and faster to compile.

    Arguments keep their types. LLVM assumes that signed sums and products do not overflow; use `numpy.uint64` for
    intended overflow.
    """
    made = numba.njit(forceinline=True, **_OPTIONS)(function)
    if made is not function:  # NUMBA_DISABLE_JIT
        made.get_call_template = partial(_as_any_number, made.get_call_template)
    return cast(Function, made)


def _as_any_number(find: Callable[..., Any], arguments: Any, keywords: Mapping[str, Any]) -> Any:
    """Return the version of a function for variable numbers; for literals numba would compile one version each."""
    plain: Callable[[Any], Any] = unliteral
    return find(tuple(map(plain, arguments)), {name: plain(each) for name, each in keywords.items()})


class _Kept(CompileResultCacheImpl):
    """The cached form of a function, without the *environments* of numba's own functions.

    Those create Python objects, which is unused here. Loading them imports numba's modules and SciPy's linear algebra:
    half the time until a compressed file is open.
    """

    def reduce(self, made: Any) -> tuple[Any, ...]:
        """Return the arguments for a pickle."""
        *rest, environments = super().reduce(made)  # type: ignore[no-untyped-call]
        return (*rest, tuple(each for each in environments if not _is_of_numba(each)))


def _is_of_numba(environment: Any) -> bool:
    return str(environment.globals["__name__"]).startswith("numba.")


class _Cache(FunctionCache):
    """numba's cache of compiled functions, with errors turned into recompilation."""

    _impl_class = _Kept

    @unbroken
    def load_overload(self, signature: Any, target: Any) -> Any:
        """Return a compiled function or None, without numba's `refresh`, which loads compilers in 0.25 s."""
        try:
            rtsys.initialize(target)
            return self._load_overload(signature, target)  # type: ignore[no-untyped-call]
        except OSError as error:
            self._give_up(error)
        except _DAMAGE:
            _tell(
                f"what is kept of compiled functions in {self.cache_path} is damaged; they are compiled again"
            )
            try:
                Path(self._cache_file._index_path).unlink(missing_ok=True)
            except OSError as error:
                self._give_up(error)
        return None

    @unbroken
    def save_overload(self, signature: Any, made: Any) -> None:
        """Save a compiled function."""
        try:
            super().save_overload(signature, made)  # type: ignore[no-untyped-call]
        except OSError as error:
            self._give_up(error)

    def _give_up(self, error: OSError) -> None:
        self.disable()  # type: ignore[no-untyped-call]
        _tell(
            f"compiled functions cannot be kept in {self.cache_path} ({error.strerror or error}), so they are "
            "compiled in every run; NUMBA_CACHE_DIR names another folder"
        )


_told: set[str] = set()


def _tell(message: str) -> None:
    kind = message.partition(" in ")[0]
    if kind not in _told:
        _told.add(kind)
        warnings.warn(message, MixseqWarning, stacklevel=2)
