"""Arguments of public functions: checks of annotated types, and files in place of their contents.

Paths in place of sequences, models, markers, contacts, maps, labels or keys of a retiming are read first
(`mixseq_io.path_arguments`). A model in place of a sequence is sampled at its frames. Other types raise a `TypeError`
that names the argument. Values are checked by the functions.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache, wraps
from inspect import Parameter, signature
from types import NoneType, UnionType
from typing import Any, Literal, ParamSpec, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from mixseq.runtime.lazy import connected

P = ParamSpec("P")
R = TypeVar("R")

_SEQUENCES = {"Frames", "MeshSequence"}

_CALLED = {
    "Frames": "MeshSequence or an open reader",
    "PathLike": "path",
    "bool": "True or False",
    "float": "number",
    "int": "whole number",
    "ndarray": "array",
    "str": "text",
}
"""Names of types in messages."""

_CURES = {
    "Model": "mixseq.fit makes one of a sequence, mixseq.load reads one",
    "MeshSequence": "mixseq.read reads one, MeshSequence.from_arrays makes one of arrays",
    "Frames": "mixseq.read reads one, MeshSequence.from_arrays makes one of arrays",
    "Skin": "mixseq.fit_skin and mixseq.fit_morph make them",
    "Markers": "mixseq.read_markers reads them, Markers.from_pairs makes them of pairs",
}


def public(function: Callable[P, R]) -> Callable[P, R]:
    """Let a function take paths in place of file contents; TypeError for arguments of types outside its annotations."""
    parameters = signature(function)

    @cache
    def hints() -> dict[str, tuple[Any, ...]]:
        found = get_type_hints(function, localns=_Names())
        named = (Parameter.POSITIONAL_ONLY, Parameter.POSITIONAL_OR_KEYWORD, Parameter.KEYWORD_ONLY)
        return {
            name: _choices(found[name])
            for name, parameter in parameters.parameters.items()
            if parameter.kind in named and name in found
        }

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            given = parameters.bind(*args, **kwargs)
        except TypeError:
            return function(*args, **kwargs)  # which says so in its own words
        for name, value in given.arguments.items():
            if name not in hints():
                continue
            wanted = hints()[name]
            value = given.arguments[name] = _taken(name, value, wanted, given.arguments)
            if not any(_fits(value, choice) for choice in wanted):
                raise TypeError(
                    f"{function.__name__}: {name} is of type {type(value).__name__}; {_told(wanted)}"
                )
        return function(*given.args, **given.kwargs)

    return call


class _Names(dict[str, Any]):
    """Names of annotations that are imported for type checking only: the public ones."""

    def __missing__(self, name: str) -> Any:
        try:
            return connected().find(name)
        except AttributeError as error:
            raise KeyError(name) from error


def _taken(name: str, value: Any, wanted: tuple[Any, ...], arguments: Mapping[str, Any]) -> Any:
    """Return the value that a path or a model stands for, else the value; earlier `arguments` are read already."""
    names = {getattr(choice, "__name__", "") for choice in wanted}
    if isinstance(value, str | os.PathLike) and not any(_fits(value, choice) for choice in wanted):
        read = connected().argument_reader(name, names)
        return value if read is None else read(os.fspath(value), arguments)
    if names & _SEQUENCES and "Model" not in names and type(value).__name__ == "Model":
        return value.sample()
    return value


def _choices(hint: Any) -> tuple[Any, ...]:
    """Return the members of a union; array-likes count as an array and numbers."""
    found = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
    if complex not in found:
        return found
    ours = (
        each
        for each in found
        if each is NoneType or str(getattr(each, "__module__", "")).startswith("mixseq")
    )
    return (*ours, float, np.ndarray)


def _fits(value: Any, hint: Any) -> bool:
    """Whether a value is of a type, as far as can be checked without reading it."""
    origin = get_origin(hint) or hint
    if origin is Any:
        return True
    if origin is Literal:
        return isinstance(value, tuple({type(choice) for choice in get_args(hint)}))
    if origin in (float, int, complex):
        number = getattr(value, "ndim", 0) == 0 and not isinstance(value, str | bytes)
        return number and hasattr(value, "__index__" if origin is int else "__float__")
    if origin is bool:
        return isinstance(value, bool | np.bool_ | int)
    if origin in (np.ndarray, Sequence, Iterable, list):
        return isinstance(value, Iterable) and not isinstance(value, str | bytes | Mapping)
    if origin is Callable:
        return callable(value)
    if getattr(origin, "_is_protocol", False):
        return all(
            hasattr(value, name) for name in vars(origin) if name == "__call__" or not name.startswith("_")
        )
    return not isinstance(origin, type) or isinstance(value, origin)


def _told(wanted: tuple[Any, ...]) -> str:
    """Describe the expected type, and its source in mixseq."""
    names = [getattr(choice, "__name__", str(choice)) for choice in wanted if choice is not NoneType]
    cure = next((f" ({_CURES[name]})" for name in names if name in _CURES), "")
    return f"{' or '.join(_CALLED.get(name, name) for name in names)} is expected{cure}"
