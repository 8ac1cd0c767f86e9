"""Edit scripts: operations on a model as tables in a TOML file, applied in order.

::

    [[edit]]
    operation = "repeat"
    start = 0.2
    end = 1.0
    times = 3

    [[edit]]
    operation = "transition"
    b = "slash.h5"          # a file, relative to the script
    at = 2.0
    duration = 0.25

Operations are functions ``model -> model`` of this package, and the keys of a table are the names of their
parameters; the value of a key follows from the parameter's annotation. A script that begins with ``unit = "frames"``
gives times, and how long things last, as numbers of frames of the edited model (`mixseq.sequence.frame_rates`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from importlib import import_module
from inspect import Parameter, signature
from pathlib import Path
from types import UnionType
from typing import Any, Literal, NamedTuple, Union, get_args, get_origin, get_type_hints

import numpy as np

from mixseq.errors import FormatError, MixseqError, SettingsError
from mixseq.operations.retiming import RetimingKeys, Unit, checked_unit, parse_toml, read_retiming_keys
from mixseq.sequence.frame_rates import number_to_time
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.curve import Curve
from mixseq.signals.model import Model
from mixseq.types import Float


class Readers(NamedTuple):
    """Readers of files, injected because the core has no file formats."""

    model: Callable[[Path], Model]  # reader of model files
    mesh: Callable[[Path], MeshSequence]  # reader of mesh files
    folders: tuple[Path, ...] = ()  # where files may be besides the script's folder and those below


Read = Callable[[Any, Path, Readers], Any]
InSeconds = Callable[[Any, float, Unit], Any]


class WrongTypeError(Exception):
    """A value of the wrong type for a key."""


class Key(NamedTuple):
    """The meaning of a key of a table."""

    parameter: str  # parameter of the operation that its value is for
    required: bool  # whether there is no default
    holds: str  # what the value is, for messages
    # Makes the argument from the value, the folder that paths start from, and readers of files; raises WrongTypeError
    # if the value is something else.
    read: Read
    # For times: makes seconds of what was read, with the frames per second of the model and the script's unit.
    in_seconds: InSeconds | None = None


def keys_of(function: Callable[..., Model]) -> dict[str, Key]:
    """Return the keys of an operation: its parameters that a script can set, without the model."""
    hints, marked = get_type_hints(function), get_type_hints(function, include_extras=True)
    _, *parameters = signature(function).parameters.values()
    keys = {}
    for parameter in parameters:
        name, required = parameter.name, parameter.default is Parameter.empty
        if name in PARSED_PARAMETERS:
            key, holds, read, in_seconds = PARSED_PARAMETERS[name]
            keys[key] = Key(name, required, holds, read, in_seconds)
        elif holds := _holds(hints[name]):
            time = _number_in_seconds if marked[name] != hints[name] else None
            keys[name] = Key(name, required, holds, partial(_plain, hints[name]), time)
    return keys


def _plain(hint: Any, value: Any, folder: Path, readers: Readers) -> Any:
    if not _fits(value, hint):
        raise WrongTypeError
    return value


_NAMES = {bool: "true or false", int: "a whole number", float: "a number", str: "a text"}


def _holds(hint: Any) -> str:
    """Return a description of the values that an annotation allows; empty if TOML has none."""
    origin, choices = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        return " or ".join(filter(None, map(_holds, choices)))
    if origin is Literal:
        return " or ".join(map(repr, choices))
    if origin in (Sequence, list) and choices == (int,):
        return "a list of whole numbers"
    return _NAMES.get(hint, "")


def _fits(value: Any, hint: Any) -> bool:
    origin, choices = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        return any(_fits(value, choice) for choice in choices)
    if origin is Literal:
        return value in list(choices)
    if origin in (Sequence, list):
        return isinstance(value, list) and all(_fits(item, choices[0]) for item in value)
    if hint is float:
        return isinstance(value, int | float) and not isinstance(value, bool)
    return type(value) is hint


def _path(value: Any, folder: Path, readers: Readers) -> Path:
    """Return a file that a script may read: in its folder, `readers.folders`, or below."""
    if not isinstance(value, str) or "\0" in value:
        raise WrongTypeError
    path = folder / value
    found = path.resolve()  # links count as what they lead to
    if not any(found.is_relative_to(each.resolve()) for each in (folder, *readers.folders)):
        raise FormatError(
            f"{value!r} is not in the script's folder, {folder.resolve()}, or below; if you trust the script, name "
            "the folder where the file is: --files-from FOLDER"
        )
    if not path.is_file():
        raise FormatError(f"{path} {'is not a file' if path.exists() else 'does not exist'}")
    return path


def _model(value: Any, folder: Path, readers: Readers) -> Model:
    return readers.model(_path(value, folder, readers))


def _mesh(value: Any, folder: Path, readers: Readers) -> MeshSequence:
    path = _path(value, folder, readers)
    mesh = readers.mesh(path)
    if mesh.frame_count != 1:
        raise SettingsError(f"{path} has {mesh.frame_count} frames; a file with one is expected")
    return mesh


def _pairs(value: Any, folder: Path, readers: Readers) -> Float:
    """Return pairs of numbers ``(N, 2)``, from a list of them or a CSV file."""
    if isinstance(value, list):
        pairs = _as_pairs(value)
        if pairs is None:
            raise WrongTypeError
        return pairs
    return read_pairs(_path(value, folder, readers))


def read_pairs(path: Path) -> Float:
    """Read pairs of numbers ``(N, 2)`` from a CSV file without a header."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = (error.strerror if isinstance(error, OSError) else None) or error
        raise FormatError(f"{path} cannot be read: {reason}") from error
    pairs = _as_pairs([line.split(",") for line in lines if line.strip()])
    if pairs is None:
        raise FormatError(f"{path} is not CSV with two numbers on each line")
    return pairs


def _place(value: Any, folder: Path, readers: Readers) -> Float:
    pairs = _as_pairs([value])
    if pairs is None:
        raise WrongTypeError
    return np.asarray(pairs[0])


def _as_pairs(rows: list[Any]) -> Float | None:
    try:
        pairs = np.array(rows, dtype=np.float64)
    except (ValueError, TypeError):
        return None
    return pairs if pairs.ndim == 2 and pairs.shape[1] == 2 else None


def _weight(value: Any, folder: Path, readers: Readers) -> float | Curve:
    if _fits(value, float):
        return float(value)
    pairs = _pairs(value, folder, readers)
    return Curve(pairs[:, 0], pairs[:, 1:])


def _keys(value: Any, folder: Path, readers: Readers) -> RetimingKeys:
    if isinstance(value, list):
        return RetimingKeys(_pairs(value, folder, readers), None)
    return read_retiming_keys(_path(value, folder, readers))


def _number_in_seconds(value: float, fps: float, unit: Unit) -> float:
    return number_to_time(value, fps) if unit == "frames" else value


def _weight_in_seconds(value: float | Curve, fps: float, unit: Unit) -> float | Curve:
    if isinstance(value, Curve) and unit == "frames":
        return Curve(value.times / fps, value.values)
    return value


_OF_KEYS = "pairs of output and source times, as a list or a CSV or TOML file,"
_OF_WEIGHT = "a number, or pairs of time and weight as a list or a CSV file,"

PARSED_PARAMETERS: Mapping[str, tuple[str, str, Read, InSeconds | None]] = {
    "b": ("b", "the file of a model", _model, None),
    "points": ("mesh", "the file of a mesh", _mesh, None),
    "curve": ("curve", "pairs of x and y, as a list or a CSV file,", _pairs, None),
    "to": ("to", "a list of two numbers, x and y,", _place, None),
    "keys": ("keys", _OF_KEYS, _keys, lambda value, fps, unit: value.in_seconds(fps, fps, unit)),
    "weight": ("weight", _OF_WEIGHT, _weight, _weight_in_seconds),
}
"""Parameters without plain values, in all operations: key in a script, and what `Key` says about it."""


OPERATIONS: Mapping[str, str] = {
    "cut": "timeline:cut",
    "repeat": "timeline:repeat",
    "loop": "timeline:loop",
    "shift": "timeline:shift",
    "speed": "timeline:speed",
    "reverse": "timeline:reverse",
    "retime": "retiming:retime",
    "concatenate": "transitions:concatenate",
    "transition": "transitions:transition",
    "blend": "transitions:blend",
    "in_place": "timeline:in_place",
    "exaggerate": "filters:exaggerate",
    "exaggerate_part": "limbs:exaggerate_part",
    "hold": "limbs:hold",
    "smooth": "filters:smooth",
    "sculpt": "sculpt:sculpt",
    "drag": "sketch:drag",
    "sketch": "sketch:sketch",
    "swap_key": "sculpt:swap_key",
}
"""Modules of this package and functions in them, by the names of operations; imported on first use."""

RETIMING_OPERATIONS = frozenset(
    {"repeat", "loop", "shift", "speed", "reverse", "retime", "concatenate", "transition"}
)
"""Operations that change the mapping between frames and model time."""


@dataclass(frozen=True)
class Edit:
    """An operation and its arguments; call it with a model."""

    number: int  # which table of the script it is, from 1 on
    operation: str  # its name
    arguments: Mapping[str, Any]  # arguments by the names of the parameters, files read
    # Those of them that are times: what makes seconds of them.
    times: Mapping[str, InSeconds] = field(default_factory=dict)
    unit: Unit = "seconds"  # what times are in

    def __call__(self, model: Model) -> Model:
        """Return the edited model; errors name the edit."""
        seconds = {
            name: made(self.arguments[name], model.header.fps, self.unit) for name, made in self.times.items()
        }
        try:
            edited: Model = function_of(self.operation)(model, **{**self.arguments, **seconds})
        except MixseqError as error:
            raise type(error)(f"edit {self.number} ({self.operation}): {error}") from error
        return edited


def read_script(path: Path, readers: Readers) -> list[Edit]:
    """Read an edit script and the files that it names."""
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise FormatError(f"{path} cannot be read: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise FormatError(f"{path} is not a TOML file: {error}") from error
    script = parse_toml(path, text)
    unit = checked_unit(script.pop("unit", None), f"{path}") or "seconds"
    tables = script.pop("edit", [])
    if script:
        raise SettingsError(
            f"{path}: the key {next(iter(script))!r} is outside the tables [[edit]], which hold all"
        )
    if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables) or not tables:
        raise SettingsError(
            f"{path} has no edits; write each as a table [[edit]] with operation = and its settings"
        )
    return [_edit(number, table, path.parent, readers, unit) for number, table in enumerate(tables, start=1)]


def function_of(operation: str) -> Callable[..., Model]:
    """Return the function of an operation."""
    module, name = OPERATIONS[operation].split(":")
    function: Callable[..., Model] = getattr(import_module(f"mixseq.operations.{module}"), name)
    return function


def _edit(number: int, table: Mapping[str, Any], folder: Path, readers: Readers, unit: Unit) -> Edit:
    where = f"edit {number}"
    if "operation" not in table:
        raise SettingsError(f"{where} has no key 'operation'; it is one of {', '.join(OPERATIONS)}")
    operation = table["operation"]
    if operation not in list(OPERATIONS):
        raise SettingsError(
            f"{where}: the operation {operation!r} is not known; known are {', '.join(OPERATIONS)}"
        )
    where = f"{where} ({operation})"
    keys = keys_of(function_of(operation))
    arguments = {}
    for key, value in table.items():
        if key == "operation":
            continue
        if key not in keys:
            known = f"its keys are {', '.join(keys)}" if keys else "it has none"
            raise SettingsError(f"{where}: the key {key!r} is not known; {known}")
        try:
            arguments[keys[key].parameter] = keys[key].read(value, folder, readers)
        except WrongTypeError:
            raise SettingsError(f"{where}: {key} is {value!r}; {keys[key].holds} is expected") from None
        except MixseqError as error:
            raise type(error)(f"{where}: {key}: {error}") from error
    for key, expected in keys.items():
        if expected.required and expected.parameter not in arguments:
            raise SettingsError(f"{where}: the key {key!r} is missing; {expected.holds} is expected")
    times = {each.parameter: each.in_seconds for each in keys.values() if each.in_seconds is not None}
    given = {name: made for name, made in times.items() if name in arguments}
    return Edit(number, operation, arguments, given, unit)
