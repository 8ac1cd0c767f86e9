"""Inner loops, compiled by numba on first call and cached on disk.

Compiled functions release the interpreter's lock. They add in source order, so results are bitwise independent of the
number of threads. Division by zero gives infinity, as in NumPy. Without an entry point for C, compilation takes a third
less time.

A wheel can bring functions compiled for `PORTABLE_CPU` (``scripts/compiled_wheel.py``). They are used where processor,
system, Python, numba and the text of the functions are those they were compiled for, otherwise functions are compiled.

If the cache on disk is damaged, or cannot be written, functions are compiled again, with a warning.

Signals are deferred while functions are loaded, saved and return results. The reasons: numba ignores exceptions of
Python code that it calls, llvmlite frees memory twice after an interrupt, and partly written files would remain.
"""

from __future__ import annotations

import logging
import warnings
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import cache, partial
from hashlib import sha256
from pathlib import Path
from pickle import UnpicklingError
from typing import Any, TypeVar, cast

import numba
from llvmlite.binding import parse_assembly, parse_bitcode  # type: ignore[import-untyped]
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile
from numba.core.dispatcher import Dispatcher
from numba.core.runtime.nrt import rtsys
from numba.core.serialize import _numba_unpickle
from numba.core.types import unliteral

from mixseq.errors import MixseqWarning
from mixseq.runtime.interrupts import uninterrupted

uninterrupted(_numba_unpickle)

Function = TypeVar("Function", bound=Callable[..., Any])

_NUMBA_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}

_INLINED_OPTIONS: dict[str, Any] = {"forceinline": True, "_nrt": False}

_PICKLE_ERRORS = (UnpicklingError, EOFError, AttributeError, ImportError, LookupError, TypeError, ValueError)
"""Errors raised by loading damaged pickles."""


PORTABLE_CPU = "x86-64-v3"
"""Processor for which a wheel brings compiled functions: any x86-64 that has AVX2 (from 2013 on)."""

_PORTABLE_CPU_FEATURES = {"+avx2", "+bmi", "+bmi2", "+f16c", "+fma", "+lzcnt", "+movbe", "+popcnt"}
"""Features that a processor needs for this code, as LLVM names them."""


def compiled(function: Function) -> Function:
    """Compile a function of arrays and numbers."""
    dispatcher = numba.njit(**_NUMBA_OPTIONS)(function)
    if dispatcher is function:  # NUMBA_DISABLE_JIT
        return function
    dispatcher.get_call_template = partial(_unliteral_template, dispatcher.get_call_template)
    with suppress(RuntimeError):  # without a folder for the cache, compile in every run
        dispatcher._cache = _Cache(function)  # type: ignore[no-untyped-call]
    return cast(Function, dispatcher)


def inlined(function: Function) -> Function:
    """Compile a function that numba inlines into its callers."""
    return cast(Function, numba.njit(inline="always", error_model="numpy")(function))


def force_inlined(function: Function) -> Function:
    """Compile a function that LLVM inlines into its callers: faster than `inlined`, and faster to compile.

    Arguments keep their types. LLVM assumes that signed sums and products do not overflow; use `numpy.uint64` for
    intended overflow. References to arrays are not counted, which takes longer than many a function does, so the
    function neither allocates nor returns arrays.
    """
    dispatcher = numba.njit(**_NUMBA_OPTIONS, **_INLINED_OPTIONS)(function)
    if dispatcher is not function:  # NUMBA_DISABLE_JIT
        dispatcher.get_call_template = partial(_unliteral_template, dispatcher.get_call_template)
    return cast(Function, dispatcher)


def _unliteral_template(find: Callable[..., Any], arguments: Any, keywords: Mapping[str, Any]) -> Any:
    """Return the call template for non-literal numbers, as numba would compile one version for each literal."""
    variable: Callable[[Any], Any] = unliteral
    return find(tuple(map(variable, arguments)), {name: variable(value) for name, value in keywords.items()})


class _CompactCacheImpl(CompileResultCacheImpl):
    """The cached form of a function, without the *environments* of numba's own functions.

    Environments create Python objects, which compiled functions here do not need. Loading environments imports numba's
    modules and SciPy's linear algebra, which is half of the time to open a compressed file.
    """

    def reduce(self, overload: Any) -> tuple[Any, ...]:
        """Return the arguments for a pickle."""
        *rest, environments = super().reduce(overload)  # type: ignore[no-untyped-call]
        kept = (entry for entry in environments if not str(entry.globals["__name__"]).startswith("numba."))
        return (*rest, tuple(kept))

    def rebuild(self, target: Any, payload: tuple[Any, ...]) -> Any:
        """Return the function of a pickle; what its callers link is parsed when one of them is compiled."""
        (name, kind, (machine_code, bitcode)), function, *rest, environments = payload
        symbols = {function.llvm_func_name, function.llvm_cpython_wrapper_name, function.env_name}
        target.codegen()._engine._defined_symbols |= symbols | {each.env_name for each in environments}
        library_data = name, kind, (machine_code, _empty_bitcode())
        overload = super().rebuild(target, (library_data, function, *rest, environments))  # type: ignore[no-untyped-call]
        overload.library._get_module_for_linking = cache(partial(parse_bitcode, bitcode))
        return overload


@cache
def _empty_bitcode() -> bytes:
    return bytes(parse_assembly("").as_bitcode())


@cache
def _file_hash(file: str) -> bytes:
    return sha256(Path(file).read_bytes()).digest()


def _source_hash(function: Callable[..., Any]) -> str:
    """Return the hash of the texts of a function's module, and of the modules whose compiled functions it can call."""
    functions, hashes = [function], {}
    for caller in functions:  # grows
        file = caller.__code__.co_filename
        if file not in hashes:
            hashes[file] = _file_hash(file)
            functions += [value.py_func for value in caller.__globals__.values() if isinstance(value, Dispatcher)]
    return sha256(b"".join(sorted(hashes.values()))).hexdigest()


class _Cache(FunctionCache):
    """numba's cache of compiled functions, which compiles again on errors and if called functions change."""

    _impl_class = _CompactCacheImpl

    @uninterrupted
    def load_overload(self, signature: Any, target: Any) -> Any:
        """Return a cached compiled function or None; skip numba's `refresh`, which takes 0.25 s to load compilers."""
        self._cache_file._version = f"{numba.__version__} {_source_hash(self._py_func)}"
        self._cache_file._source_stamp = None  # the version is compared before what may be of other types is unpickled
        try:
            rtsys.initialize(target)
            overload = self._load_overload(signature, target)  # type: ignore[no-untyped-call]
            if overload is None:
                overload = self._load_shipped(signature, target)
            if overload is None:
                logging.getLogger("mixseq").debug("compiling %s", self._name)
            return overload
        except OSError as error:
            self._disable(error)
        except _PICKLE_ERRORS:
            _warn_once(f"the cache of compiled functions in {self.cache_path} is damaged; they are compiled again")
            try:
                Path(self._cache_file._index_path).unlink(missing_ok=True)
            except OSError as error:
                self._disable(error)
        return None

    def _load_shipped(self, signature: Any, target: Any) -> Any:
        """Return a function that the package brings compiled for `PORTABLE_CPU`, or None; its folder is only read."""
        signature, (triple, _, features), hashes = self._index_key(signature, target.codegen())  # type: ignore[no-untyped-call]
        if not set(features.split(",")) >= _PORTABLE_CPU_FEATURES:
            return None
        folder = Path(self._py_func.__code__.co_filename).parent / "__pycache__"
        file = IndexDataCacheFile(str(folder), self._impl.filename_base, None)  # type: ignore[no-untyped-call]
        file._version = self._cache_file._version
        data = file.load((signature, (triple, PORTABLE_CPU, ""), hashes))  # type: ignore[no-untyped-call]
        return None if data is None else self._impl.rebuild(target, data)

    @uninterrupted
    def save_overload(self, signature: Any, overload: Any) -> None:
        """Save a compiled function."""
        try:
            super().save_overload(signature, overload)  # type: ignore[no-untyped-call]
        except OSError as error:
            self._disable(error)

    def _disable(self, error: OSError) -> None:
        self.disable()  # type: ignore[no-untyped-call]
        _warn_once(
            f"compiled functions cannot be saved in {self.cache_path} ({error.strerror or error}), so they are "
            "compiled in every run; set NUMBA_CACHE_DIR to another folder"
        )


_warned: set[str] = set()


def _warn_once(message: str) -> None:
    kind = message.partition(" in ")[0]
    if kind not in _warned:
        _warned.add(kind)
        warnings.warn(message, MixseqWarning, stacklevel=2)
