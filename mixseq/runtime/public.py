"""Arguments of public functions: checks of annotated types, and files in place of their contents.

A path in place of a sequence, model, markers, contacts, map, labels or keys of a retiming is read first
(`mixseq_io.path_arguments`); a file that stays open is closed when the function returns. A model in place of a sequence
is decoded at its frames. Other types raise a `TypeError` that names the argument. The functions themselves check
values.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack
from functools import cache, wraps
from inspect import Parameter, signature
from types import NoneType, UnionType
from typing import Any, Literal, ParamSpec, Protocol, TypeAlias, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from mixseq.runtime.lazy import connected
from mixseq.types import PathLike

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")
Contents = TypeVar("Contents")

FileOr: TypeAlias = Contents | PathLike
"""Argument of a public function, or the path of its file. `public` reads the file; the functions' bodies cast."""


class HasFrames(Protocol):
    """Model in place of a sequence; `public` decodes it at its frames."""

    @property
    def frames(self) -> Any:
        """Decoded points of the frames."""


_SEQUENCE_TYPES = {"Frames", "MeshSequence"}

_TYPE_NAMES = {
    "Frames": "MeshSequence or an open reader",
    "PathLike": "path",
    "bool": "True or False",
    "float": "number",
    "int": "whole number",
    "ndarray": "array",
    "str": "text",
}
"""Names of types in error messages."""

_CURES = {
    "Model": "mixseq.fit makes one of a sequence, mixseq.load reads one",
    "MeshSequence": "mixseq.read reads one, MeshSequence.from_arrays makes one of arrays",
    "Frames": "mixseq.read reads one, MeshSequence.from_arrays makes one of arrays",
    "Skin": "mixseq.fit_skin and mixseq.fit_morph make them",
    "Markers": "mixseq.read_markers reads them, Markers.from_pairs makes them of pairs",
}


def public(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """Let a function accept paths in place of file contents; raise TypeError for arguments of other types."""
    function_signature = signature(function)

    @cache
    def accepted_types() -> dict[str, tuple[Any, ...]]:
        hints = get_type_hints(function, localns=_PublicNames())
        kinds = (Parameter.POSITIONAL_ONLY, Parameter.POSITIONAL_OR_KEYWORD, Parameter.KEYWORD_ONLY)
        return {
            name: _alternatives(hints[name])
            for name, parameter in function_signature.parameters.items()
            if parameter.kind in kinds and name in hints
        }

    @wraps(function)
    def call(*args: Parameters.args, **kwargs: Parameters.kwargs) -> Result:
        try:
            bound = function_signature.bind(*args, **kwargs)
        except TypeError:
            return function(*args, **kwargs)  # raises Python's message
        with ExitStack() as opened:
            for name, given in bound.arguments.items():
                if name not in accepted_types():
                    continue
                types = accepted_types()[name]
                value = bound.arguments[name] = _resolve(name, given, types, bound.arguments)
                if value is not given and isinstance(value, AbstractContextManager):
                    opened.enter_context(value)
                if not any(_is_instance(value, hint) for hint in types):
                    raise TypeError(
                        f"{function.__name__}: {name} is of type {type(value).__name__}; {_format_expected(types)}"
                    )
            return function(*bound.args, **bound.kwargs)

    return call


class _PublicNames(dict[str, Any]):
    """Look up public names in annotations, which modules import for type checking only."""

    def __missing__(self, name: str) -> Any:
        find_name, _ = connected()
        try:
            return find_name(name)
        except AttributeError as error:
            raise KeyError(name) from error


def _resolve(name: str, value: Any, types: tuple[Any, ...], arguments: Mapping[str, Any]) -> Any:
    """Read the file of a path, and decode a model, in place of a value; earlier `arguments` are already resolved."""
    names = {getattr(hint, "__name__", "") for hint in types}
    if isinstance(value, str | os.PathLike) and not any(_is_instance(value, hint) for hint in types):
        _, argument_reader = connected()
        read = argument_reader(name, names)
        value = value if read is None else read(os.fspath(value), arguments)
    if names & _SEQUENCE_TYPES and "Model" not in names and any(cls.__name__ == "Model" for cls in type(value).mro()):
        return value.frames if "Frames" in names else value.sample()
    return value


def _alternatives(hint: Any) -> tuple[Any, ...]:
    """Return the types in a union; for array-likes, return array, number and mixseq's types."""
    members = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
    if complex not in members:
        contents_types = tuple(member for member in members if member not in (*get_args(PathLike), HasFrames))
        is_file_or = set(get_args(PathLike)) <= set(members) and set(contents_types) - {NoneType}
        return contents_types if is_file_or else members
    kept = (
        member
        for member in members
        if member is NoneType or str(getattr(member, "__module__", "")).startswith("mixseq")
    )
    return (*kept, float, np.ndarray)


def _is_instance(value: Any, hint: Any) -> bool:
    """Return whether a value is of a type, without iterating over its contents."""
    origin = get_origin(hint) or hint
    if origin is Any:
        return True
    if origin is Literal:
        return isinstance(value, tuple({type(choice) for choice in get_args(hint)}))
    if origin in (float, int, complex):
        is_scalar = getattr(value, "ndim", 0) == 0 and not isinstance(value, str | bytes)
        return is_scalar and hasattr(value, "__index__" if origin is int else "__float__")
    if origin is bool:
        return isinstance(value, bool | np.bool_ | int)
    if origin in (np.ndarray, Sequence, Iterable, list):
        return isinstance(value, Iterable) and not isinstance(value, str | bytes | Mapping)
    if origin is Callable:
        return callable(value)
    if getattr(origin, "_is_protocol", False):
        members = (name for name in vars(origin) if name == "__call__" or not name.startswith("_"))
        return all(hasattr(value, name) for name in members)
    return not isinstance(origin, type) or isinstance(value, origin)


def _format_expected(types: tuple[Any, ...]) -> str:
    """Describe the expected types, and how to make a value of them."""
    names = [getattr(hint, "__name__", str(hint)) for hint in types if hint is not NoneType]
    cure = next((f" ({_CURES[name]})" for name in names if name in _CURES), "")
    return f"{' or '.join(_TYPE_NAMES.get(name, name) for name in names)} is expected{cure}"
