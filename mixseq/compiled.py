"""Inner loops, compiled by numba when they are first called, and kept on disk for the next run.

Compiled functions release the interpreter's lock and add in the order in which they are written, so that their
results have the same bits on any number of threads. Division by zero gives infinity, as in NumPy. Nobody calls them
from C: without an entry for that they compile in about two thirds of the time.

What is on disk may be cut short, by a crash or a full disk, and the disk may be full or not ours: then functions are
compiled again, and a warning says so.

Compiled functions call Python to unpickle what they need for their results, and do not look whether it failed. llvmlite
frees twice what it was interrupted in freeing. numba leaves a file behind that it was interrupted in writing. So
signals wait while functions are loaded and kept, and while results are made.
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
from mixseq.interrupts import unbroken

unbroken(_numba_unpickle)

Function = TypeVar("Function", bound=Callable[..., Any])

_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}

_DAMAGE = (pickle.UnpicklingError, EOFError, AttributeError, ImportError, LookupError, TypeError, ValueError)
"""What damaged pickles raise."""


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
    """Compile a function into those that call it."""
    return cast(Function, numba.njit(inline="always", error_model="numpy")(function))


def joined(function: Function) -> Function:
    """Compile a function, and let LLVM put it into those that call it: quicker than `inlined`, in less time.

    Its arguments keep their types. LLVM sees more of what numbers can be than it does of other functions, and takes for
    granted that sums and products of numbers with a sign do not overflow: what shall overflow needs `numpy.uint64`.
    """
    made = numba.njit(forceinline=True, **_OPTIONS)(function)
    if made is not function:  # NUMBA_DISABLE_JIT
        made.get_call_template = partial(_as_any_number, made.get_call_template)
    return cast(Function, made)


def _as_any_number(find: Callable[..., Any], arguments: Any, keywords: Mapping[str, Any]) -> Any:
    """Find the version of a function for any numbers: of each that stands in the code, numba would compile its own."""
    plain: Callable[[Any], Any] = unliteral
    return find(tuple(map(plain, arguments)), {name: plain(each) for name, each in keywords.items()})


class _Kept(CompileResultCacheImpl):
    """What is kept of a function: nothing of numba's own functions in it but their code.

    Their *environments* would let them make Python's objects, which none does here. To load them numba imports their
    modules, and one of these SciPy's linear algebra: half the time until a compressed file is open.
    """

    def reduce(self, made: Any) -> tuple[Any, ...]:
        """Return what can be pickled."""
        *rest, environments = super().reduce(made)  # type: ignore[no-untyped-call]
        return (*rest, tuple(each for each in environments if not _is_of_numba(each)))


def _is_of_numba(environment: Any) -> bool:
    return str(environment.globals["__name__"]).startswith("numba.")


class _Cache(FunctionCache):
    """numba's folder of compiled functions, which cannot make a run fail."""

    _impl_class = _Kept

    @unbroken
    def load_overload(self, signature: Any, target: Any) -> Any:
        """Return a compiled function, None if it must be compiled.

        Without what numba's own does first, `refresh`: to load all that functions may be compiled from takes a
        quarter of a second, and what is compiled needs only the memory of arrays.
        """
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
        """Keep a compiled function."""
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
